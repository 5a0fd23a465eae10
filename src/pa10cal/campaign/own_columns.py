"""`columns` of campaign.yaml: what the columns of a user's own files are, in their own words."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints

from pa10cal.options import Section

#: What one unit of a column is of the contract's unit: mm, degrees, N m, seconds.
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4}
ANGLES = {"deg": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232}
TORQUES = {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "d": 86400.0}
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
ISO = "iso"


def _some(value: object) -> object:
    """Take one name for a list of one; a number for a name, as files without a header have."""
    listed = value if isinstance(value, list | tuple) else [value]
    return tuple(str(each) if isinstance(each, int) else each for each in listed)


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
One = Annotated[tuple[Name], BeforeValidator(_some)]
Target = Annotated[str, StringConstraints(pattern=r"^([A-Za-tv-z0-9]|[A-Za-z0-9]{2,})$")]


class Time(Section):
    """When a row was taken."""

    names: Names = Field(description="one column, or two with date and time of day")
    unit: Literal["s", "ms", "us", "min", "d"] = Field("s", description="d: days, as in workbooks")
    format: Name | None = Field(
        default=None,
        description="of dates and times: iso, or such as %d.%m.%Y %H:%M:%S; without it, numbers",
    )


class Joints(Section):
    """Joint positions, in the order of the arm's joints."""

    names: Names
    unit: Literal["deg", "rad", "mrad"] = "deg"
    stroke_unit: Literal["mm", "cm", "m", "um", "in"] = "mm"
    u: Names | None = Field(default=None, description="standard uncertainties, in the same unit")


class Torques(Section):
    """Joint torques, in the order of the arm's joints."""

    names: Names
    unit: Literal["Nm", "Nmm", "kNm"] = "Nm"
    u: Names | None = None


class Position(Section):
    """A measured position: x, y, z in the instrument's frame."""

    names: Three
    unit: Literal["mm", "cm", "m", "um", "in"] = "mm"
    u: Three | None = None


class Distance(Section):
    """A measured distance."""

    names: One
    unit: Literal["mm", "cm", "m", "um", "in"] = "mm"
    u: One | None = None


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


class Kind(Section):
    """Which rows are to calibrate with, and which are held out."""

    names: One
    words: dict[str, Literal["grid", "holdout", "line_x", "line_y"]] = Field(
        default_factory=dict, description="what each of the file's own words stands for"
    )


class FileColumns(Section):
    """Layout of one file, and what its columns are. What is not mapped is not read."""

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
    kind: Kind | None = None
    pose: One | None = None
    load: Load | None = None
    repeat: One | None = None
    joints: Joints | None = None
    torques: Torques | None = None
    temperature: Temperature | None = None
    position: Position | None = None
    rotation: RotationColumns | None = None
    distance: Distance | None = None
    targets: dict[Target, Position] = Field(default_factory=dict)
    ball: One | None = None
    touch: One | None = None


class OwnColumns(Section):
    """Which columns of the raw files hold what, file by file."""

    poses: FileColumns | None = None
    cmm: FileColumns | None = None
    resolver: FileColumns | None = None
    joints: FileColumns | None = None
    readings: FileColumns | None = None
