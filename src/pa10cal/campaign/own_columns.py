"""`columns` of campaign.yaml: the layout of a user's own files, and what their columns hold."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
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
from pa10cal.campaign.column_map import COUNTS, FACTORS, OFFSETS, QUATERNION, OwnColumn
from pa10cal.campaign.csv_rows import Layout
from pa10cal.campaign.joint_positions import position_columns
from pa10cal.options import Positive, Section

#: Conventions of orientations: kinds, and sequences of axes.
_ROTATION = re.compile(
    r"quaternion_(wxyz|xyzw)|rotation_vector|matrix|rpy|euler_[XYZ]{3}|fixed_[xyz]{3}"
)


def _as_names(value: object) -> object:
    """Return a tuple of names, of one name too; numbers as text, as in files without a header."""
    listed = value if isinstance(value, list | tuple) else [value]
    return tuple(str(name) if isinstance(name, int) else name for name in listed)


def _as_tuple(value: object) -> object:
    """Return a tuple, of one number too."""
    return value if isinstance(value, list | tuple) else (value,)


def _with_text_keys(value: object) -> object:
    """Return a mapping with whole numbers among its keys as text, as the file has them."""
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
Names = Annotated[tuple[Name, ...], BeforeValidator(_as_names), Field(min_length=1)]
Three = Annotated[tuple[Name, ...], BeforeValidator(_as_names), Field(min_length=3, max_length=3)]
LengthUnit = Literal["mm", "cm", "m", "um", "in"]
TimeUnit = Literal["s", "ms", "us", "ns", "min", "d"]
One = Annotated[tuple[Name], BeforeValidator(_as_names)]
# No single u: it marks columns of uncertainties.
Target = Annotated[str, StringConstraints(pattern=r"^([A-Za-tv-z0-9]|[A-Za-z0-9]{2,})$")]


class Time(Section):
    """When a row was taken."""

    names: Names = Field(description="one column, or two with date and time of day")
    unit: Annotated[tuple[TimeUnit, ...], BeforeValidator(_as_tuple)] = Field(
        ("s",), description="d: days, as in workbooks; [s, ns] of two columns that are added"
    )
    format: Name | None = Field(
        default=None,
        description="of dates and times: iso, or such as %d.%m.%Y %H:%M:%S; without it, numbers",
    )

    @model_validator(mode="after")
    def _a_unit_each(self) -> Self:
        if len(self.unit) != (1 if self.format else len(self.names)):
            raise ValueError("one unit for each column of numbers, such as [s, ns]; else format")
        return self


class Joints(Section):
    """Joint positions, in the order of the arm's joints."""

    names: Names
    unit: Literal["deg", "rad", "mrad", "gon", "turns", "counts"] = "deg"
    stroke_unit: LengthUnit = "mm"
    counts_per_turn: Annotated[tuple[Positive, ...], BeforeValidator(_as_tuple)] | None = Field(
        default=None,
        description="of unit counts: how many a turn of the joint; one number, or one a joint",
    )
    zero_count: Annotated[tuple[FiniteFloat, ...], BeforeValidator(_as_tuple)] = Field(
        default=(0.0,), description="count at which the joint is at zero; one, or one a joint"
    )
    u: Names | None = Field(default=None, description="standard uncertainties, in the same unit")

    @model_validator(mode="after")
    def _counted(self) -> Joints:
        if (self.unit == COUNTS) != (self.counts_per_turn is not None):
            raise ValueError("counts_per_turn with unit: counts, and only with it")
        for numbers in (self.counts_per_turn or (1.0,), self.zero_count):
            if len(numbers) not in (1, len(self.names)):
                raise ValueError("one number of counts, or one for each joint")
        return self

    def scale(self, joint: int) -> tuple[float, float]:
        """Return the degrees per count of a joint, numbered from 0, and the degrees at count 0."""
        of_joints, zeros = self.counts_per_turn or (1.0,), self.zero_count
        per_turn = of_joints[joint if len(of_joints) > 1 else 0]
        zero = zeros[joint if len(zeros) > 1 else 0]
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
    deviation: Three | None = Field(
        default=None,
        description="columns of what was measured less names, a stated place: both are added",
    )
    deviation_unit: LengthUnit | None = Field(default=None, description="where it is another")
    deviation_sign: Literal[1, -1] = Field(
        default=1, description="-1 where the file has the stated place less what was measured"
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
        if self.polar is not None and self.deviation is not None:
            raise ValueError("deviation of x, y and z alone")
        return self

    def terms(self, axis: int) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """Return the columns whose sum is a coordinate, and the weight of each, in `unit`."""
        deviation = () if self.deviation is None else self.deviation[axis : axis + 1]
        factor = FACTORS[self.deviation_unit or self.unit] / FACTORS[self.unit]
        weights = (1.0, self.deviation_sign * factor)
        return (self.names[axis], *deviation), weights[: 1 + len(deviation)]


class DistanceColumns(Section):
    """A measured distance."""

    names: One
    unit: LengthUnit = "mm"
    u: One | None = None
    u_unit: LengthUnit | None = Field(default=None, description="of u, where it is another")
    coverage: Positive = Field(
        default=1.0, description="what u is divided by: 2 of expanded uncertainties, U(95)"
    )


#: What an orientation is the inverse of: nothing, itself alone, or a pose with its position.
Inverse = bool | Literal["pose"]


class RotationColumns(Section):
    """A measured orientation, the target in the instrument's frame."""

    names: Names
    convention: Annotated[str, AfterValidator(_rotation)]
    unit: Literal["deg", "rad", "mrad", "gon"] = "deg"
    inverse: Inverse = Field(
        default=False,
        description="the columns hold the inverse rotation; pose: and the position, too, is that "
        "of the instrument in the target's frame",
    )
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
    words: Annotated[dict[Name, Target], BeforeValidator(_with_text_keys)] = Field(
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
        """Return the label of the pose in a field, and its target; empty for no stated target."""
        if self.words:
            return field, self.words.get(field, "")
        pose = without_ending(field, self.endings)
        return pose, self.endings.get(field[len(pose) :], "")


def without_ending(label: str, endings: Iterable[str]) -> str:
    """Return a label without the longest of the endings that it has."""
    matching = [ending for ending in endings if label.endswith(ending)]
    return label.removesuffix(max(matching, key=len, default=""))


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
        """Yield the columns of the contract, each with its source.

        `section` is the section of campaign.yaml, such as columns.poses.
        """

        def source(key: str, names: tuple[str, ...], unit: str = "") -> OwnColumn:
            return OwnColumn(names, unit, FACTORS[unit], OFFSETS.get(unit, 0.0), f"{section}.{key}")

        if self.time is not None:
            unit = "" if self.time.format or len(self.time.unit) > 1 else self.time.unit[0]
            yield "time_s", source("time", self.time.names, unit)
        for key in ("pose", "repeat", "ball", "touch"):
            if (names := getattr(self, key)) is not None:
                yield key, source(key, names)
        if self.kind is not None:
            yield "kind", source("kind", self.kind.names)
        torque_count = 0 if self.torques is None else len(self.torques.names)
        # With one target a row the same columns hold the places of all targets.
        targets = [""] if self.target is None else [f"{name}_" for name in self.target.targets]
        places: list[tuple[str, str, Position | None]] = [
            *(("position", target, self.position) for target in targets),
            *((f"targets.{name}", f"{name}_", place) for name, place in self.targets.items()),
        ]
        mapped: list[tuple[str, Any, Sequence[str]]] = [
            ("load", self.load, ["load_N"]),
            ("temperature", self.temperature, ["temperature_C"]),
            ("joints", self.joints, position_columns(prismatic)),
            ("torques", self.torques, [f"tau{k}_Nm" for k in range(1, torque_count + 1)]),
            *(
                (key, place, [f"{target}{axis}_mm" for axis in "xyz"])
                for key, target, place in places
            ),
            ("distance", self.distance, ["d_mm"]),
        ]
        for key, part, ours in mapped:
            if getattr(part, "polar", None) is not None:
                yield from ((name, source(key, part.names)) for name in ours)
                continue
            for k, name in enumerate(ours if part is not None else ()):
                slides = key == "joints" and name.endswith("_mm")
                unit = part.stroke_unit if slides else part.unit
                factor, offset = (
                    part.scale(k) if unit == COUNTS else (FACTORS[unit], OFFSETS.get(unit, 0.0))
                )
                where = f"{section}.{key}"
                names, weights = part.names[k : k + 1], (1.0,)
                if getattr(part, "deviation", None) is not None:
                    names, weights = part.terms(k)
                yield name, OwnColumn(names, unit, factor, offset, where, weights=weights)
                if (u := getattr(part, "u", None)) is not None:
                    if (u_unit := getattr(part, "u_unit", None)) is not None:
                        unit, factor = u_unit, FACTORS[u_unit]
                    factor /= getattr(part, "coverage", 1.0)
                    yield f"u_{name}", OwnColumn(u[k : k + 1], unit, factor, 0.0, where)
        if self.rotation is not None:
            for name in QUATERNION:
                yield name, source("rotation", self.rotation.names)
                if self.rotation.u is not None:
                    yield f"u_{name}", source("rotation", self.rotation.u)

    def polar_places(self) -> Iterator[tuple[str, Position, Polar]]:
        """Yield positions that are polar readings: prefix of their columns, and how they count."""
        targets = ((f"{name}_", place) for name, place in self.targets.items())
        for prefix, place in (("", self.position), *targets):
            if place is not None and place.polar is not None:
                yield prefix, place, place.polar


class OwnColumns(Section):
    """Which columns of the raw files hold what, file by file."""

    poses: FileColumns | None = None
    cmm: FileColumns | None = None
    resolver: FileColumns | None = None
    joints: FileColumns | None = None
    readings: FileColumns | None = None

    @property
    def inverse_poses(self) -> bool:
        """Return whether measured poses are those of the instrument in the target's frame."""
        files = (self.poses, self.readings)
        rotations = (each.rotation for each in files if each is not None)
        return any(each is not None and each.inverse == "pose" for each in rotations)
