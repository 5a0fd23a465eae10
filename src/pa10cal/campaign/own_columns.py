"""`columns` of campaign.yaml: how a user's own files are written, and what their columns are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    StringConstraints,
    model_validator,
)

from pa10cal.arrays import Mask
from pa10cal.campaign.csv_rows import REPEATED, Layout
from pa10cal.campaign.raw_rows import (
    COMMA,
    CONTRACT_COLUMNS,
    COUNTS,
    EXCLUDED,
    FACTORS,
    OFFSETS,
    QUATERNION,
    ColumnMap,
    OwnColumn,
    Quarantined,
    position_columns,
)
from pa10cal.campaign.sniffing import format_of
from pa10cal.errors import RawDataError
from pa10cal.options import Positive, Section

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


class FileColumns(Layout):
    """Layout of one file, and what its columns are. What is not mapped is not read."""

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

    @property
    def text(self) -> tuple[str, ...]:
        """Return the columns of text."""
        time = self.time if self.time is not None and self.time.format else None
        parts = (part.names for part in (self.kind, self.target, time) if part is not None)
        return tuple(chain(self.pose or (), self.ball or (), *parts))

    def sources(self, prismatic: Mask, section: str = "") -> Iterator[tuple[str, OwnColumn]]:
        """Yield the columns of the contract, and what each is read from.

        The section, such as columns.poses, is where campaign.yaml says it.
        """

        def at(key: str, names: tuple[str, ...], unit: str = "") -> OwnColumn:
            return OwnColumn(names, unit, FACTORS[unit], OFFSETS.get(unit, 0.0), f"{section}.{key}")

        if (time := self.time) is not None:
            yield "time_s", at("time", time.names, "" if time.format else time.unit)
        for key in ("pose", "repeat", "ball", "touch"):
            if (one := getattr(self, key)) is not None:
                yield key, at(key, one)
        if self.kind is not None:
            yield "kind", at("kind", self.kind.names)
        count = 0 if self.torques is None else len(self.torques.names)
        targets = ((f"targets.{name}", f"{name}_", each) for name, each in self.targets.items())
        # A row is of one target: the same columns hold the places of all.
        before = [""] if self.target is None else [f"{each}_" for each in self.target.targets]
        places = (*(("position", each, self.position) for each in before), *targets)
        mapped: list[tuple[str, Any, Sequence[str]]] = [
            ("load", self.load, ["load_N"]),
            ("temperature", self.temperature, ["temperature_C"]),
            ("joints", self.joints, position_columns(prismatic)),
            ("torques", self.torques, [f"tau{k}_Nm" for k in range(1, count + 1)]),
            *((key, each, [f"{name}{axis}_mm" for axis in "xyz"]) for key, name, each in places),
            ("distance", self.distance, ["d_mm"]),
        ]
        for key, part, ours in mapped:
            if getattr(part, "polar", None) is not None:
                yield from ((name, at(key, part.names)) for name in ours)
                continue
            for k, name in enumerate(ours if part is not None else ()):
                slides = key == "joints" and name.endswith("_mm")
                unit = part.stroke_unit if slides else part.unit
                factor, offset = (
                    part.scale(k) if unit == COUNTS else (FACTORS[unit], OFFSETS.get(unit, 0.0))
                )
                where = f"{section}.{key}"
                yield name, OwnColumn(part.names[k : k + 1], unit, factor, offset, where)
                if (u := getattr(part, "u", None)) is not None:
                    if (u_unit := getattr(part, "u_unit", None)) is not None:
                        unit, factor = u_unit, FACTORS[u_unit]
                    factor /= getattr(part, "coverage", 1.0)
                    yield f"u_{name}", OwnColumn(u[k : k + 1], unit, factor, 0.0, where)
        if (turned := self.rotation) is not None:
            for name in QUATERNION:
                yield name, at("rotation", turned.names)
                if turned.u is not None:
                    yield f"u_{name}", at("rotation", turned.u)

    def polar_places(self) -> Iterator[tuple[str, Position, Polar]]:
        """Yield positions that are polar readings, and how, by what stands before their axes."""
        targets = ((f"{name}_", each) for name, each in self.targets.items())
        for before, place in (("", self.position), *targets):
            if place is not None and place.polar is not None:
                yield before, place, place.polar


class OwnColumns(Section):
    """Which columns of the raw files hold what, file by file."""

    poses: FileColumns | None = None
    cmm: FileColumns | None = None
    resolver: FileColumns | None = None
    joints: FileColumns | None = None
    readings: FileColumns | None = None


# Rows that are not used, and too many of them.


def refuse_too_many(
    rows: Iterable[Quarantined],
    totals: Mapping[str, int],
    max_fraction: float,
    words: ColumnMap = CONTRACT_COLUMNS,
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
        remedy = _remedy_of_rows(words, reason, struck, most=2 * len(listed) > total)
        raise RawDataError(
            f"{len(listed)} of {total} rows would be quarantined, {times} of them because: "
            f"{reason}",
            where=where,
            value=struck[0].value or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=remedy,
        )


def _remedy_of_rows(
    words: ColumnMap, reason: str, listed: Sequence[Quarantined], *, most: bool
) -> str:
    """Return what to do where rows are quarantined for a reason.

    It may have struck most rows, so that the others do not suffice.
    """
    column, key = "", ""
    if " = " in listed[0].value:
        column = listed[0].value.partition(" = ")[0]
        key = words.key_called(column)
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
        texts = [value.strip("'\"") for value in values]
        if all(texts) and (how := format_of(texts)[0]):
            return f"set {key}.format: '{how}'"
    if key.endswith(".kind"):
        return f"add {', '.join(dict.fromkeys(values))} to {key}.words, as grid or as holdout"
    look = f"look at column {words.called(column)} first; " if column else ""
    if reason.startswith("beyond the limits of joint"):
        return f"{look}check robot in campaign.yaml, and the unit, order and signs of the joints"
    rest = "" if most else ", or raise the setting if the other rows suffice"
    return f"{look}correct the file{rest}"
