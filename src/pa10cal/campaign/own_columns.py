"""`columns` of campaign.yaml: what the columns of a user's own files are; messages in their words.

One rule for all messages: a column is called as the file calls it, and beside it as the contract
does, `A6 [°]` (`q6`); a remedy is a key of campaign.yaml and what to set it to.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    StringConstraints,
    model_validator,
)

from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.formats import BY_NAME
from pa10cal.campaign.raw_rows import COMMA, EXCLUDED, OwnColumn, Quarantined
from pa10cal.campaign.recognise import unit_of
from pa10cal.campaign.sniffing import format_of
from pa10cal.errors import RawDataError
from pa10cal.options import Positive, Section

#: What one unit of a column is of the contract's unit: mm, degrees, N m, seconds.
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4}
ANGLES = {"deg": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232}
#: Of polar readings too.
ANGLES_OF_POLAR = {**ANGLES, "gon": 0.9}
#: The unit of joint positions that are counts of an encoder.
COUNTS = "counts"
TORQUES = {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0}
FORCES = {"N": 1.0, "kg": 9.80665}
#: What a number is multiplied by, and what is added then, for the contract's unit.
FACTORS = {
    **(LENGTHS | ANGLES | TORQUES | TIMES | FORCES),
    **{"": 1.0, "C": 1.0, "K": 1.0, "F": 5.0 / 9.0},
}
OFFSETS = {"K": -273.15, "F": -160.0 / 9.0}
SEPARATORS = {"tab": "\t", "blanks": None}

#: Words of rotations, and how many columns each takes.
_ROTATION = re.compile(
    r"quaternion_(wxyz|xyzw)|rotation_vector|matrix|rpy|euler_[XYZ]{3}|fixed_[xyz]{3}"
)


def _some(value: object) -> object:
    """Take one name for a list of one; a number for a name, as files without a header have."""
    listed = value if isinstance(value, list | tuple) else [value]
    return tuple(str(each) if isinstance(each, int) else each for each in listed)


def _each(value: object) -> object:
    """Take one number for a list of one."""
    return value if isinstance(value, list | tuple) else (value,)


def _worded(value: object) -> object:
    """Take numbers for the words that they are in a file."""
    if not isinstance(value, dict):
        return value
    return {str(word) if isinstance(word, int) else word: name for word, name in value.items()}


def _rotation(word: str) -> str:
    axes = word.removeprefix("euler_").removeprefix("fixed_").lower()
    twice = len(axes) == 3 and (axes[0] == axes[1] or axes[1] == axes[2])
    if not _ROTATION.fullmatch(word) or twice:
        raise ValueError(
            "quaternion_wxyz, quaternion_xyzw, rpy (about fixed x, y, z), euler_XYZ, euler_ZYX, "
            "euler_ZYZ … (about axes that turn along), fixed_xyz …, rotation_vector or matrix "
            "(row by row)"
        )
    return word


def _known_format(name: str) -> str:
    if name not in BY_NAME:
        raise ValueError(", ".join(BY_NAME))
    return name


Name = Annotated[str, StringConstraints(min_length=1)]
Names = Annotated[tuple[Name, ...], BeforeValidator(_some), Field(min_length=1)]
Three = Annotated[tuple[Name, ...], BeforeValidator(_some), Field(min_length=3, max_length=3)]
LengthUnit = Literal["mm", "cm", "m", "um", "in"]
One = Annotated[tuple[Name], BeforeValidator(_some)]
# No single u: it marks columns of uncertainties.
Target = Annotated[str, StringConstraints(pattern=r"^([A-Za-tv-z0-9]|[A-Za-z0-9]{2,})$")]


class Time(Section):
    """When a row was taken."""

    names: Names = Field(description="one column, or two with date and time of day")
    unit: Literal["s", "ms", "us", "ns", "min", "d"] = Field(
        "s", description="d: days, as in workbooks"
    )
    format: Name | None = Field(
        default=None,
        description="of dates and times: iso, or such as %d.%m.%Y %H:%M:%S; without it, numbers",
    )


class Joints(Section):
    """Joint positions, in the order of the arm's joints."""

    names: Names
    unit: Literal["deg", "rad", "mrad", "counts"] = "deg"
    stroke_unit: LengthUnit = "mm"
    counts_per_turn: Annotated[tuple[Positive, ...], BeforeValidator(_each)] | None = Field(
        default=None,
        description="of unit counts: how many a turn of the joint; one number, or one a joint",
    )
    zero_count: Annotated[tuple[FiniteFloat, ...], BeforeValidator(_each)] = Field(
        default=(0.0,), description="count at which the joint is at zero; one, or one a joint"
    )
    u: Names | None = Field(default=None, description="standard uncertainties, in the same unit")

    @model_validator(mode="after")
    def _counted(self) -> Joints:
        if (self.unit == COUNTS) != (self.counts_per_turn is not None):
            raise ValueError("counts_per_turn with unit: counts, and only with it")
        for each in (self.counts_per_turn or (1.0,), self.zero_count):
            if len(each) not in (1, len(self.names)):
                raise ValueError("one number of counts, or one for each joint")
        return self

    def scale(self, joint: int) -> tuple[float, float]:
        """Return the degrees a count of a joint, from 0, and the degrees at count 0."""
        per_turn, zero = (
            each[joint if len(each) > 1 else 0]
            for each in (self.counts_per_turn or (1.0,), self.zero_count)
        )
        return 360.0 / per_turn, -360.0 / per_turn * zero


class Torques(Section):
    """Joint torques, in the order of the arm's joints."""

    names: Names
    unit: Literal["Nm", "Nmm", "kNm"] = "Nm"
    u: Names | None = None


class Polar(Section):
    """How polar readings are to be read: horizontal angle, vertical angle, distance."""

    unit: Literal["deg", "gon", "rad", "mrad"] = "deg"
    horizontal: Literal["clockwise", "counterclockwise"] = Field(
        default="clockwise", description="how the horizontal angle counts, seen from above"
    )
    vertical: Literal["zenith", "horizon"] = Field(
        default="zenith", description="from where the vertical angle counts: down, or up"
    )


class Position(Section):
    """A measured position: x, y, z in the instrument's frame, or polar readings."""

    names: Three
    unit: LengthUnit = "mm"
    polar: Polar | None = Field(
        default=None,
        description="the columns are horizontal angle, vertical angle and distance (unit)",
    )
    u: Three | None = None
    u_unit: LengthUnit | None = Field(default=None, description="of u, where it is another")
    coverage: Positive = Field(
        default=1.0, description="what u is divided by: 2 of expanded uncertainties, U(95)"
    )

    @model_validator(mode="after")
    def _no_u_of_polar(self) -> Self:
        if self.polar is not None and self.u is not None:
            raise ValueError("u of x, y and z alone; state instrument.uncertainty_mm for polar")
        return self


class DistanceColumns(Section):
    """A measured distance."""

    names: One
    unit: LengthUnit = "mm"
    u: One | None = None
    u_unit: LengthUnit | None = Field(default=None, description="of u, where it is another")
    coverage: Positive = Field(
        default=1.0, description="what u is divided by: 2 of expanded uncertainties, U(95)"
    )


class RotationColumns(Section):
    """A measured orientation, the target in the instrument's frame."""

    names: Names
    convention: Annotated[str, AfterValidator(_rotation)]
    unit: Literal["deg", "rad", "mrad"] = "deg"
    inverse: bool = Field(default=False, description="the columns hold the inverse rotation")
    u: Names | None = None


class Temperature(Section):
    """Temperature of the arm or of the room."""

    names: One
    unit: Literal["C", "K", "F"] = "C"


class Load(Section):
    """External load."""

    names: One
    unit: Literal["N", "kg"] = "N"


class KindColumn(Section):
    """Which rows are to calibrate with, and which are held out."""

    names: One
    words: dict[str, Literal["grid", "holdout", "line_x", "line_y"]] = Field(
        default_factory=dict, description="what each of the file's own words stands for"
    )


class TargetOfRow(Section):
    """Which target a row is of, in a file with one in each: `position` is where it was."""

    names: One
    words: Annotated[dict[Name, Target], BeforeValidator(_worded)] = Field(
        default_factory=dict, description="what each word of the column stands for"
    )
    endings: dict[Name, Target] = Field(
        default_factory=dict,
        description="of labels such as P1_A: what each ending stands for, after the pose",
    )

    @model_validator(mode="after")
    def _stated_once(self) -> Self:
        if bool(self.words) == bool(self.endings):
            raise ValueError("words of the column, or endings of its labels")
        return self

    @property
    def targets(self) -> tuple[str, ...]:
        """Return the names of the targets."""
        return tuple(dict.fromkeys((self.words or self.endings).values()))

    def of(self, field: str) -> tuple[str, str]:
        """Return what a field says of the pose, and its target; empty for none that is stated."""
        if self.words:
            return field, self.words.get(field, "")
        longest = sorted(self.endings, key=len, reverse=True)
        ending = next((each for each in longest if field.endswith(each)), "")
        return field.removesuffix(ending), self.endings.get(ending, "")


class FileColumns(Section):
    """Layout of one file, and what its columns are. What is not mapped is not read."""

    format: Annotated[str, AfterValidator(_known_format)] | None = Field(
        default=None,
        description="of a file whose table is made by the program, such as kuka or motive; its "
        "columns then have the names that pa10cal columns prints",
    )
    separator: Annotated[str, StringConstraints(pattern=r"^(.|tab|blanks)$")] = Field(
        default=",", description="one character, tab, or blanks for any number of them"
    )
    decimal: Literal[".", ","] = "."
    header: int = Field(
        default=1,
        ge=0,
        le=1000,
        description="line of the column names; 0 where there is none, columns then being 1, 2, …",
    )
    first_row: int = Field(
        default=0, ge=0, description="line of the first row; 0 where it follows the names"
    )
    time: Time | None = None
    kind: KindColumn | None = None
    pose: One | None = None
    load: Load | None = None
    repeat: One | None = None
    joints: Joints | None = None
    torques: Torques | None = None
    temperature: Temperature | None = None
    position: Position | None = None
    rotation: RotationColumns | None = None
    distance: DistanceColumns | None = None
    targets: dict[Target, Position] = Field(default_factory=dict)
    target: TargetOfRow | None = Field(
        default=None, description="of rows of one target each, whose place is position"
    )
    ball: One | None = None
    touch: One | None = None

    @model_validator(mode="after")
    def _one_target_a_row(self) -> Self:
        if self.target is not None and (
            self.position is None or self.position.polar or self.rotation or self.targets
        ):
            raise ValueError("target goes with position as x, y, z, and not with rotation, targets")
        return self


class OwnColumns(Section):
    """Which columns of the raw files hold what, file by file."""

    poses: FileColumns | None = None
    cmm: FileColumns | None = None
    resolver: FileColumns | None = None
    joints: FileColumns | None = None
    readings: FileColumns | None = None


# What a file calls its columns.

_QUATERNION = ("qw", "qx", "qy", "qz")
_JOINT = re.compile(r"(q\d+)_(?:deg|mm)")
#: A name that YAML reads as it is.
_PLAIN = re.compile(r"[^\W\d][\w.]*")
#: Units that may stand for each other.
_FAMILIES = (LENGTHS, ANGLES, TORQUES, TIMES, FORCES, {"C": 1.0, "K": 1.0, "F": 1.0})
#: Words of units, for sentences.
UNIT_WORDS = {
    **{"um": "micrometres", "mm": "millimetres", "cm": "centimetres", "in": "inches"},
    **{"m": "metres", "deg": "degrees", "rad": "radians", "mrad": "milliradians"},
}


@dataclass(frozen=True)
class OwnWords:
    """What a file calls its columns; empty of one that follows the contract."""

    sources: Mapping[str, OwnColumn] = field(default_factory=dict)  # by the contract's names

    def column(self, name: str) -> str:
        """Return a column of the contract as the file calls it, ours beside it; without it ours."""
        if name not in self:
            return name
        joint = _JOINT.fullmatch(name)
        ours = joint[1] if joint else "qw … qz" if name in _QUATERNION else name
        own = self.sources[name].name.split(", ")
        return f"{', '.join(f'`{part}`' for part in own)} (`{ours}`)"

    def joint(self, number: int) -> str:
        """Return the column of a joint, from 1."""
        names = [name for name in (f"q{number}_deg", f"q{number}_mm") if name in self]
        return self.column(names[0]) if names else f"q{number}"

    def __contains__(self, name: str) -> bool:
        return name in self.sources

    def text(self, text: str) -> str:
        """Return a text in which the file's own names stand beside those of the contract."""
        return re.sub(r"\w+", lambda match: self.column(match[0]), text)

    def key(self, name: str) -> str:
        """Return the key of campaign.yaml that maps a column of the contract; nothing for none."""
        return self.sources[name].key if name in self else ""

    def key_called(self, own: str) -> str:
        """Return the key that maps a column by the file's own name; nothing for none."""
        keys = (source.key for source in self.sources.values() if own in source.name.split(", "))
        return next(keys, "")

    def set_unit(self, name: str, unit: str, right: str) -> str:
        """Return the remedy for a column of the contract that is in another unit than is stated.

        It is in `unit`, as campaign.yaml calls it; that of the contract is `right`, in words.
        """
        if key := self.key(name):
            slides = key.endswith(".joints") and name.endswith("_mm")
            return f"set {key}.{'stroke_unit' if slides else 'unit'}: {unit}"
        return (
            f"convert the columns to {right}, or state their unit under columns in campaign.yaml: "
            f"unit: {unit}"
        )

    def set_names(self, names: Sequence[str]) -> str:
        """Return the remedy for columns of the contract that hold each other's numbers.

        They are in the order in which the file's columns should be named.
        """
        own = [self.sources[name].name for name in names if name in self]
        quoted = (
            name if _PLAIN.fullmatch(name) else "'{}'".format(name.replace("'", "''"))
            for name in own
        )
        return f"set {self.key(names[0])}.names: [{', '.join(quoted)}]"

    def contradicted_units(self, file: str) -> Iterator[str]:
        """Yield where a header says another unit than the column is read in, once a key."""
        said: set[str] = set()
        for name, own in self.sources.items():
            header = unit_of(own.name)
            known = any({header, own.unit} <= family.keys() for family in _FAMILIES)
            if known and header != own.unit and own.key not in said:
                said.add(own.key)
                yield (
                    f"{file}: {self.column(name)}: its header says {header}, and it is read in "
                    f"{own.unit}; {self.set_unit(name, header, own.unit)} if the header is right"
                )

    def called(self, own: str) -> str:
        """Return a column by the file's own name, ours beside it."""
        ours = [name for name, source in self.sources.items() if source.name == own]
        return self.column(ours[0]) if ours else f"`{own}`" if self.key_called(own) else own

    def remedy_of_rows(self, reason: str, listed: Sequence[Quarantined], *, most: bool) -> str:
        """Return what to do where rows are quarantined for a reason.

        It may have struck most rows, so that the others do not suffice.
        """
        column, key = "", ""
        if " = " in listed[0].value:
            column = listed[0].value.partition(" = ")[0]
            key = self.key_called(column)
        values = [row.value.partition(" = ")[2] for row in listed]
        if reason == REPEATED:
            return "remove the rows that stand there twice"
        if listed[0].value.endswith(COMMA):
            return (
                f"set {key.rpartition('.')[0]}.decimal: ','"
                if key
                else "export the file with decimal points, or state decimal: ',' under columns in "
                "campaign.yaml"
            )
        if key.endswith(".time"):
            words = [value.strip("'\"") for value in values]
            if all(words) and (how := format_of(words)[0]):
                return f"set {key}.format: '{how}'"
        if key.endswith(".kind"):
            return f"add {', '.join(dict.fromkeys(values))} to {key}.words, as grid or as holdout"
        look = f"look at column {self.called(column)} first; " if column else ""
        if reason.startswith("beyond the limits of joint"):
            return (
                f"{look}check robot in campaign.yaml, and the unit, order and signs of the joints"
            )
        rest = "" if most else ", or raise the setting if the other rows suffice"
        return f"{look}correct the file{rest}"


#: Of a file that follows the contract.
CONTRACT_WORDS = OwnWords()


def refuse_too_many(
    rows: Iterable[Quarantined],
    totals: Mapping[str, int],
    max_fraction: float,
    words: OwnWords = CONTRACT_WORDS,
) -> None:
    """Stop when more of a file's rows are quarantined than the settings allow, or all of them.

    At most `ingest.max_quarantined_fraction` of the total rows of a file may be; rows that
    campaign.yaml excludes do not count. The message names the file, the commonest reason and the
    first line it struck.
    """
    rows, totals = sorted(rows), dict(totals)
    for row in rows:
        totals[row.file] -= row.reason.startswith(EXCLUDED)  # as its user wants it
        if not totals[row.file]:
            raise RawDataError(
                "every row is excluded",
                where=row.file,
                allowed="at least some rows to calibrate with",
                remedy="correct exclude in campaign.yaml",
            )
    for name, total in totals.items():
        listed = [r for r in rows if r.file == name and not r.reason.startswith(EXCLUDED)]
        if len(listed) <= max_fraction * total and len(listed) < total:
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        struck = [row for row in listed if row.reason == reason]
        columns = Counter(row.value.partition(" = ")[0] for row in struck if " = " in row.value)
        column, in_column = columns.most_common(1)[0] if columns else ("", 0)
        if 2 * in_column > times:
            struck = [row for row in struck if row.value.startswith(f"{column} = ")]
        where = f"{name}:{struck[0].line}" + (f": {words.called(column)}" if column else "")
        remedy = words.remedy_of_rows(reason, struck, most=2 * len(listed) > total)
        raise RawDataError(
            f"{len(listed)} of {total} rows would be quarantined, {times} of them because: "
            f"{reason}",
            where=where,
            value=struck[0].value or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=remedy,
        )
