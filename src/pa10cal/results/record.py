"""What result files are made of: parts with described keys, tables of rows, and the record.

A record is one JSON file, or one line of a file of them. Every key is a field of a frozen pydantic
model; the JSON schemas and the key tables of the docs are made from the fields and the comments
behind or above them (`docs/_site/record_tables.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol, Self, TypeVar

import numpy as np
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

# Keys: those of a mapping, and those that may be absent.


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


def optional() -> Any:
    """Return a field whose key may be absent, and is where its value is None."""
    return Field(default=None, exclude_if=lambda value: value is None)


class Part(BaseModel):
    """An object within a record; where it is made, a key that it does not have is refused."""

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
        """Return how pydantic validates a part: of a list, which may be long, to its first fault.

        Otherwise a list of a million wrong entries would make a million messages.
        """
        schema = handler(source)
        _stop_at_first_fault(schema)
        return schema

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        mine, theirs = self.__dict__, other.__dict__
        return all(_equal(value, theirs[name]) for name, value in mine.items())

    __hash__ = None  # type: ignore[assignment]  # arrays have none


#: Types of a schema that can stop at their first fault, in this release of pydantic.
_CAN_STOP = {
    kind
    for kind, schema in (
        ("list", core_schema.ListSchema),
        ("tuple", core_schema.TupleSchema),
        ("dict", core_schema.DictSchema),
    )
    if "fail_fast" in schema.__annotations__
}


def _stop_at_first_fault(schema: Any, *, outermost: bool = True) -> None:
    """Make validation of lists and mappings in the schema of a part stop at their first fault.

    Args:
        schema: a core schema of pydantic, or a part of it; changed in place.
        outermost: whether the schema of the part itself is yet to be met. That of a part within it
            was changed when that part was built.
    """
    inner = schema
    if isinstance(schema, dict):
        kind = schema.get("type")
        if kind in _CAN_STOP:
            schema["fail_fast"] = True
        if kind == "model" and not outermost:
            return
        outermost = outermost and kind != "model"
        inner = [entry for name, entry in schema.items() if name != "metadata"]
    if isinstance(inner, list | tuple):
        for entry in inner:
            _stop_at_first_fault(entry, outermost=outermost)


def _equal(one: Any, other: Any) -> bool:
    """Return whether two values of a field are equal; entries that are unknown (nan) are."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        numbers = getattr(one, "dtype", None) == np.float64
        return np.array_equal(one, other, equal_nan=numbers)
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    return bool(one == other)


class Table(Part):
    """Rows of a file, held as columns: a JSON list of objects with the same keys.

    A column that is None in memory is null in every row of the file, or absent if `optional`.
    """

    @model_validator(mode="before")
    @classmethod
    def _as_columns(cls, rows: Any) -> Any:
        return _columns(cls, rows) if isinstance(rows, list | tuple) else rows

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        lengths = {name: len(column) for name, column in _present_columns(self).items()}
        if len(set(lengths.values())) > 1:
            raise PydanticCustomError(
                "table", "columns of one length, not {lengths}", {"lengths": lengths}
            )
        return self

    @model_serializer(mode="wrap")
    def _as_rows(self, handler: SerializerFunctionWrapHandler) -> list[dict[str, Any]]:
        columns = handler(self)
        nulls = [None] * len(self)
        filled = [nulls if column is None else column for column in columns.values()]
        return [dict(zip(columns, row, strict=True)) for row in zip(*filled, strict=True)]

    def __len__(self) -> int:
        return len(next(iter(_present_columns(self).values())))


def _columns(table: type[Table], rows: Any) -> dict[str, Any]:
    """Return the columns of a list of rows; keys that the table does not know are passed over.

    A column of which every entry is null is None.
    """
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


def _present_columns(table: BaseModel) -> dict[str, Sized]:
    """Return the columns of a table that are not absent, by name."""
    return {name: column for name, column in table.__dict__.items() if column is not None}


class Record(Part):
    """A result file, or a line of one; `schema` is its first key."""

    # Set by the decorator `filed`.
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


_R = TypeVar("_R", bound=Record)


def filed(schema: str, file: str, *, by: str) -> Callable[[type[_R]], type[_R]]:
    """Return the decorator that states of a record its schema, its file, and its command.

    Args:
        schema: name and version of the format: `pa10cal-base-frame/1`.
        file: where it lies, under the results of its campaign or study.
        by: the command that writes it.
    """

    def mark(record: type[_R]) -> type[_R]:
        record.SCHEMA, record.FILE, record.COMMAND = schema, file, by
        return record

    return mark


# What several records state: the campaign, and an effect with its place.


class CampaignIdentity(Protocol):
    """What records state of a campaign."""

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


class Name(NamedTuple):
    """An effect and where it sits, as a key of mappings and sets, which no part can be."""

    id: str
    of: str


class EffectName(Part):
    """An effect and where it sits."""

    id: str  # id of the effect
    of: str  # where it sits: `joint 2`, `forearm`, `base`, ...

    @property
    def name(self) -> Name:
        """Return the name alone, also of an effect with further keys."""
        return Name(self.id, self.of)

    @property
    def words(self) -> str:
        """Return it as readers see it: `transmission error, joint 2`."""
        return f"{self.id.replace('_', ' ')}, {self.of.replace('_', ' ')}"
