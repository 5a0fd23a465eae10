"""What records are made of: parts with described keys, arrays, tables of rows, and the record.

A record is one JSON file, or one line of a file of them. Every key is a field of a frozen pydantic
model; the JSON schemas and the key tables of the docs are made from the fields and the comments
behind or above them (`docs/_site/record_tables.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sized
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, Self, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

# Arrays in records: nested lists in the file, numpy arrays in memory.

_WORDS = {"f": "finite numbers", "i": "whole numbers", "b": "true or false", "U": "texts"}
#: Letters of all texts of an array, each as long as the longest.
_MOST_LETTERS = 50_000_000
#: Kinds of array that are taken for one of a kind: whole numbers for numbers, nothing for texts.
_TAKEN = {"f": "fiu", "i": "iu", "b": "b", "U": "U"}


class Shape:
    """Makes `Annotated[NDArray[...], Shape("poses", 3)]` a list in the file and an array in memory.

    Arrays come out of a record read-only.

    Attributes:
        sizes: a number is the size there, a name stands for any.
        missing: whether an entry of the first axis may be unknown: null in the file, nan in memory.
    """

    def __init__(self, *sizes: int | str, missing: bool = False) -> None:
        self.sizes = sizes
        self.missing = missing

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Check on the way in, write nested lists on the way out."""
        del handler
        dtype = entry_dtype(source)
        return core_schema.no_info_plain_validator_function(
            partial(self._checked, dtype),
            serialization=core_schema.plain_serializer_function_ser_schema(self._plain),
            metadata={"shape": self, "kind": dtype.kind},  # for the JSON schema in the docs
        )

    def _checked(self, dtype: np.dtype[Any], value: Any) -> NDArray[Any]:
        """Return a copy as an array of its type, null along the first axis made nan."""
        given, wanted = value, [size if isinstance(size, int) else None for size in self.sizes]
        if not _texts_fit(value):
            raise PydanticCustomError("array", "texts of usual lengths")
        if self.missing and not isinstance(value, np.ndarray):
            nothing = np.full([size for size in wanted[1:] if size is not None], np.nan)
            given = [nothing if entry is None else entry for entry in value]
        try:
            array = np.array(given)
        except (TypeError, ValueError):
            array = np.array(object())  # of no shape, and taken for no kind
        if not array.size and None in wanted and array.ndim <= len(wanted):
            array = np.zeros([size or 0 for size in wanted], dtype=dtype)
        if (
            array.dtype.kind not in _TAKEN[dtype.kind]
            or array.ndim != len(wanted)
            or any(want not in (None, size) for want, size in zip(wanted, array.shape, strict=True))
            or not (dtype.kind != "f" or self.missing or np.isfinite(array).all())
        ):
            shape = f"({', '.join(map(str, self.sizes))}{',' if len(self.sizes) == 1 else ''})"
            unknown = ", null where unknown" if self.missing else ""
            said = f"{_WORDS[dtype.kind]}, shape {shape}{unknown}"
            raise PydanticCustomError("array", "{said}", {"said": said})
        array = array.astype(dtype)
        array.setflags(write=False)
        return array

    def _plain(self, value: NDArray[Any]) -> Any:
        entries = value.tolist()
        if not self.missing:
            return entries
        known = np.isfinite(value).reshape(len(value), -1).all(axis=1)
        return [entry if there else None for entry, there in zip(entries, known, strict=True)]


def _texts_fit(value: Any) -> bool:
    """Return whether an array has room for a list: it has that of the longest text for each."""
    if type(value) is not list:
        return True
    kinds = set(map(type, value))
    while kinds == {list}:
        value = list(chain.from_iterable(value))
        kinds = set(map(type, value))
    if str not in kinds:
        return True
    longest = max(len(each) for each in value if type(each) is str)
    return longest * len(value) <= _MOST_LETTERS


def entry_dtype(annotation: Any) -> np.dtype[Any]:
    """Return the type of the entries of `NDArray[...]`.

    Its last argument is the type itself from numpy 2.5 on, and `dtype[type]` before.
    """
    last = get_args(annotation)[-1]
    entries: np.dtype[Any] = np.dtype(next(iter(get_args(last)), last))
    return entries


@dataclass(frozen=True)
class Key:
    """Describes the keys of a mapping, as the docs write them: `dict[Annotated[str, Key(...)]`."""

    name: str  # placeholder without brackets, such as `load`


#: Keys of a mapping by load: `22N`.
LoadKey = Annotated[str, Key("load")]
#: Keys of a mapping by the name of a parameter: `delta_a_1`; of a campaign; of a model.
ParameterKey = Annotated[str, Key("parameter")]
CampaignKey = Annotated[str, Key("campaign")]
ModelKey = Annotated[str, Key("model")]

Vector3 = Annotated[NDArray[np.float64], Shape(3)]
Matrix3 = Annotated[NDArray[np.float64], Shape(3, 3)]
PoseMatrix = Annotated[NDArray[np.float64], Shape(4, 4)]
Numbers = Annotated[NDArray[np.float64], Shape("k")]
#: Columns of a table, and columns of which some entries are not known.
Column = Annotated[NDArray[np.float64], Shape("rows")]
GappyColumn = Annotated[NDArray[np.float64], Shape("rows", missing=True)]
VectorColumn = Annotated[NDArray[np.float64], Shape("rows", 3)]
LabelColumn = Annotated[NDArray[np.str_], Shape("rows")]
CountColumn = Annotated[NDArray[np.int64], Shape("rows")]
FlagColumn = Annotated[NDArray[np.bool_], Shape("rows")]


#: From a standard uncertainty to half of a 95 % interval.
HALF_WIDTH_95 = 1.96


def plain_number(value: float, digits: int = 3, sign: str = "") -> str:
    """Return a number of so many significant digits at most, without an exponent.

    Args:
        sign: `+` where a plus sign is to be shown.
    """
    if not value or not math.isfinite(value):
        return f"{value:{sign}g}"
    last_power = math.floor(math.log10(abs(value))) + 1 - digits
    text = f"{round(value, -last_power):{sign}.{max(-last_power, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def with_half_width_95(value: float, std: float, sign: str = "") -> str:
    """Return a value and half its 95 % interval, to the first digit of that: `13.0 ± 0.4`.

    Args:
        sign: `+` where a plus sign is to be shown.
    """
    half = HALF_WIDTH_95 * std
    if not half > 0.0 or not math.isfinite(half):
        return f"{plain_number(value, sign=sign)} ± {half:g}"
    last_power = math.floor(math.log10(float(f"{half:.0e}")))
    decimals = max(-last_power, 0)
    rounded, half = (round(each, -last_power) for each in (value, half))
    return f"{rounded:{sign}.{decimals}f} ± {half:.{decimals}f}"


def optional() -> Any:
    """Return a field whose key may be absent, and is where its value is None."""
    return Field(default=None, exclude_if=lambda value: value is None)


class Part(BaseModel):
    """A part of a record; a key it does not know is refused where it is made."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
        defer_build=True,
    )

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: type[BaseModel], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Check lists and mappings to their first entry that is wrong: a million may be."""
        schema = handler(source)
        _stop_at_first(schema)
        return schema

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        mine, theirs = self.__dict__, other.__dict__
        return all(_equal(value, theirs[name]) for name, value in mine.items())

    __hash__ = None  # type: ignore[assignment]  # arrays have none


#: Those that can stop at the first entry that is wrong, in this release of pydantic.
_STOPPING = {
    kind
    for kind, schema in (
        ("list", core_schema.ListSchema),
        ("tuple", core_schema.TupleSchema),
        ("dict", core_schema.DictSchema),
    )
    if "fail_fast" in schema.__annotations__
}


def _stop_at_first(schema: Any, *, part: bool = True) -> None:
    """Make lists and mappings within the schema of a part stop so; parts in it have done so."""
    inner = schema
    if isinstance(schema, dict):
        kind = schema.get("type")
        if kind in _STOPPING:
            schema["fail_fast"] = True
        if kind == "model" and not part:
            return
        part = part and kind != "model"
        inner = [each for name, each in schema.items() if name != "metadata"]
    if isinstance(inner, list | tuple):
        for each in inner:
            _stop_at_first(each, part=part)


class Table(Part):
    """Rows of a file, held as columns: a JSON list of objects with the same keys."""

    @model_validator(mode="before")
    @classmethod
    def _as_columns(cls, rows: Any) -> Any:
        return _columns(cls, rows) if isinstance(rows, list | tuple) else rows

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        lengths = {name: len(column) for name, column in _given(self).items()}
        if len(set(lengths.values())) > 1:
            raise PydanticCustomError("table", "columns of one length, not {lengths}", locals())
        return self

    @model_serializer(mode="wrap")
    def _as_rows(self, handler: SerializerFunctionWrapHandler) -> list[dict[str, Any]]:
        columns = handler(self)
        blank = [None] * len(self)
        filled = [blank if column is None else column for column in columns.values()]
        return [dict(zip(columns, row, strict=True)) for row in zip(*filled, strict=True)]

    def __len__(self) -> int:
        return len(next(iter(_given(self).values())))


class Record(Part):
    """A result file, or a line of one; `schema` stands first in it. `filed` says these of it."""

    SCHEMA: ClassVar[str]
    FILE: ClassVar[str]  # where it lies, under the results of its campaign or study
    COMMAND: ClassVar[str]  # the command that writes it

    @classmethod
    def kinds(cls) -> tuple[type[Record], ...]:
        """Return the types among which `kind_of` chooses: itself, or one for each model."""
        return (cls,)

    @classmethod
    def kind_of(cls, content: dict[str, Any]) -> type[Record]:
        """Return the type that some content is of; `content` is that of a file of its schema."""
        del content
        return cls

    @model_serializer(mode="wrap")
    def _with_schema(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {"schema": self.SCHEMA, **handler(self)}


def filed(schema: str, file: str, *, by: str) -> Callable[[type[_R]], type[_R]]:
    """Say of a record its schema, where it lies, and the command that writes it."""

    def mark(record: type[_R]) -> type[_R]:
        record.SCHEMA, record.FILE, record.COMMAND = schema, file, by
        return record

    return mark


_R = TypeVar("_R", bound=Record)


class CampaignIdentity(Protocol):
    """What records say of a campaign."""

    @property
    def name(self) -> str:
        """Return its name."""

    @property
    def provenance(self) -> str:
        """Return where its data come from, in its own words."""

    @property
    def robot(self) -> str:
        """Return the name of its arm."""


class CampaignRecord(Record):
    """A result of one campaign."""

    campaign: str  # name of the campaign


class MeasuredRecord(CampaignRecord):
    """A result that stands on what was measured in a campaign."""

    provenance: str  # where the campaign's data come from, in its own words


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        gaps = getattr(one, "dtype", None) == np.float64
        return np.array_equal(one, other, equal_nan=gaps)
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    return bool(one == other)


def _given(table: BaseModel) -> dict[str, Sized]:
    return {name: column for name, column in table.__dict__.items() if column is not None}


def _columns(table: type[Table], rows: Any) -> dict[str, Any]:
    """Return the columns of a list of rows; keys that the table does not know are passed over."""
    columns: dict[str, Any] = {}
    for name, field in table.model_fields.items():
        if not field.is_required() and not any(name in row for row in rows):
            continue
        try:
            column = [row[name] for row in rows]
        except (KeyError, TypeError):
            raise PydanticCustomError("table", "every row with {name}", {"name": name}) from None
        columns[name] = None if rows and all(entry is None for entry in column) else column
    return columns


# An effect and where it sits, as records name it.


class Name(NamedTuple):
    """An effect and where it sits, to compare and to look up by."""

    id: str
    of: str


#: Probability from which a name is all but certain, and that the smallest set of names holds.
SURE = 0.95


def shown_probability(value: float) -> str:
    """Return a probability with two decimals: one that is not yet sure is not rounded to it."""
    rounded = f"{value:.2f}"
    return f"{SURE - 0.01:.2f}" if value < SURE <= float(rounded) else rounded


class EffectName(Part):
    """An effect and where it sits."""

    id: str  # id of the effect
    of: str  # where it sits: `joint 2`, `forearm`, `base`, ...

    @property
    def name(self) -> Name:
        """Return the name alone."""
        return Name(self.id, self.of)

    @property
    def words(self) -> str:
        """Return it as readers see it: `transmission error, joint 2`."""
        return f"{self.id.replace('_', ' ')}, {self.of.replace('_', ' ')}"


# The kinds of fault of a log: words that verdicts, records and terms share.

#: What is wrong in a log; `docs/results.md` lists the word, `docs/how-to/faults.md` what it means.
FaultKind = Literal[
    "label", "load", "direction", "joint_zero", "joint_sign", "payload", "step_in_time", "outlier"
]
