"""Arm descriptions, one YAML file each: those shipped with the package and those of a campaign."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, FiniteFloat

from pa10cal.arm.chain import placed, roll_pitch_yaw
from pa10cal.arm.description import NEARLY_PARALLEL_RAD, Arm, neighbouring_axes, with_hayati_rows
from pa10cal.arm.exports import UrdfSource
from pa10cal.arrays import Array
from pa10cal.errors import ALLOWED, ArmError, fits_a_folder
from pa10cal.files import arm_places, own_description
from pa10cal.files.output import write_text
from pa10cal.options import Positive, Section
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import parse_yaml, read_yaml

if TYPE_CHECKING:
    from pa10cal.arm.imported import ImportedArm

# One row of an arm's file: its keys, and what its figures give away of wrong units.

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

_FULL_TURN_DEG = 360.0
#: A length so much longer than the others of its arm, and than this, was meant in another unit.
_OUT_OF_PROPORTION = 20.0
_LONG_M = 2.0
#: No link is longer, and no centre of mass, slide or constant frame is further.
_FAR_M = 10.0
#: No link is heavier: whole arms that carry a ton weigh less than five.
_HEAVY_KG = 2000.0
#: How near a number of degrees lies to a quarter turn in radians that was written with few digits.
_QUARTER_TURN_DIGITS = 6e-4


class ArmRow(Section):
    """One row of Denavit-Hartenberg parameters and what is known of its joint and its link."""

    theta_deg: FiniteFloat = 0.0
    d_m: FiniteFloat = 0.0
    a_m: FiniteFloat = 0.0
    alpha_deg: FiniteFloat = 0.0
    beta_deg: FiniteFloat = 0.0
    hayati: bool | None = None
    prismatic: bool = False
    limits_deg: tuple[FiniteFloat, FiniteFloat] | None = None
    limits_m: tuple[FiniteFloat, FiniteFloat] | None = None
    gear_ratio: Positive | None = None
    torque_limit_Nm: Positive | None = None
    force_limit_N: Positive | None = None
    mass_kg: Annotated[float, Field(ge=0.0, le=_HEAVY_KG, allow_inf_nan=False)] | None = None
    com_m: Triple | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Joint limits in radians, or in metres for a prismatic joint."""
        if self.prismatic:
            return self.limits_m or (math.nan, math.nan)
        low, high = self.limits_deg or (-_FULL_TURN_DEG, _FULL_TURN_DEG)
        return math.radians(low), math.radians(high)

    @property
    def rated(self) -> float:
        """Rated torque [N m], or force [N] of a prismatic joint; nan where not stated."""
        stated = self.force_limit_N if self.prismatic else self.torque_limit_Nm
        return math.nan if stated is None else stated


def check_rows(rows: Sequence[ArmRow], where: str) -> None:
    """Refuse rows whose keys or figures cannot be meant.

    Args:
        rows: rows of one arm.
        where: its file.

    Raises:
        ArmError: naming row and key.
    """
    for number, row in enumerate(rows, start=1):
        _check_joint(row, f"{where}: row {number}")
        _check_angles(row, f"{where}: row {number}")
    _check_limits_are_degrees(rows, where)
    _check_proportions(rows, where)
    for number, row in enumerate(rows, start=1):
        for key, value_m in (("a_m", row.a_m), ("d_m", row.d_m)):
            refuse_far((value_m,), key, f"{where}: row {number}")
    _check_masses(rows, where)


def refuse_far(values_m: Sequence[float], key: str, where: str) -> None:
    """Refuse lengths that cannot be metres.

    Args:
        values_m: the lengths.
        key: their key.
        where: file and row, or file and frame.

    Raises:
        ArmError: naming the key.
    """
    if max(map(abs, values_m), default=0.0) > _FAR_M:
        raise ArmError(
            f"{key} exceeds {_FAR_M:g} m",
            where=where,
            value=values_m[0] if len(values_m) == 1 else list(values_m),
            allowed="metres",
            remedy="divide by 1000 if the lengths are in millimetres",
        )


def _check_joint(row: ArmRow, where: str) -> None:
    kind, other = ("slides", "turns") if row.prismatic else ("turns", "slides")
    foreign = {
        "slides": ("limits_deg", "torque_limit_Nm", "gear_ratio"),
        "turns": ("limits_m", "force_limit_N"),
    }
    own = "limits_m and force_limit_N" if row.prismatic else "limits_deg and torque_limit_Nm"
    for key in foreign[kind]:
        if getattr(row, key) is not None:
            raise ArmError(
                f"{key} is for a joint that {other}, and this one {kind}",
                where=where,
                value=getattr(row, key),
                allowed=own,
                remedy=f"correct the key, or set prismatic: {str(not row.prismatic).lower()}",
            )
    if row.prismatic and row.limits_m is None:
        raise ArmError(
            "a prismatic joint needs limits",
            where=where,
            allowed="limits_m: [lowest, highest], in metres",
            remedy="set limits_m",
        )
    key = "limits_m" if row.prismatic else "limits_deg"
    low, high = getattr(row, key) or (-_FULL_TURN_DEG, _FULL_TURN_DEG)
    if low >= high:
        raise ArmError(
            f"{key} allows the joint no motion",
            where=where,
            value=[low, high],
            allowed="the lower limit first, then a higher one",
            remedy=f"correct {key}",
        )
    lengths = {"limits_m": row.limits_m or (), "com_m": row.com_m or ()}
    for key, values in lengths.items():
        refuse_far(values, key, where)


def _check_angles(row: ArmRow, where: str) -> None:
    for key in ("theta_deg", "alpha_deg"):
        value = getattr(row, key)
        quarters = round(abs(value) / (math.pi / 2.0))
        if 1 <= quarters <= 4 and math.isclose(
            abs(value), quarters * math.pi / 2.0, rel_tol=_QUARTER_TURN_DIGITS
        ):
            raise ArmError(
                f"{key} looks like radians",
                where=where,
                value=value,
                allowed="degrees",
                remedy=f"write {math.copysign(90.0 * quarters, value):g}",
            )


def _check_limits_are_degrees(rows: Sequence[ArmRow], where: str) -> None:
    limits_deg = {number: row.limits_deg for number, row in enumerate(rows, 1) if row.limits_deg}
    if limits_deg and all(max(map(abs, pair)) < 6.3 for pair in limits_deg.values()):
        number = next(iter(limits_deg))
        raise ArmError(
            "limits_deg looks like radians, in this and every other row",
            where=f"{where}: row {number}",
            value=list(limits_deg[number]),
            allowed="degrees",
            remedy="multiply by 180/pi",
        )


def _check_proportions(rows: Sequence[ArmRow], where: str) -> None:
    lengths_m = [
        (abs(getattr(row, key)), number, key)
        for number, row in enumerate(rows, start=1)
        for key in ("d_m", "a_m")
        if getattr(row, key)
    ]
    for k, (length_m, number, key) in enumerate(lengths_m):
        others = [other for j, (other, _, _) in enumerate(lengths_m) if j != k]
        if length_m > _LONG_M and others and length_m > _OUT_OF_PROPORTION * median(others):
            raise ArmError(
                f"{key} is out of proportion to the other lengths",
                where=f"{where}: row {number}",
                value=getattr(rows[number - 1], key),
                allowed=f"metres, as the others are (their median is {median(others):g})",
                remedy="divide by 1000 if this one is in millimetres",
            )


def _check_masses(rows: Sequence[ArmRow], where: str) -> None:
    stated = [number for number, row in enumerate(rows, 1) if row.mass_kg is not None]
    for number, row in enumerate(rows, start=1):
        missing = [key for key in ("mass_kg", "com_m") if stated and getattr(row, key) is None]
        if missing or (row.com_m is not None and row.mass_kg is None):
            raise ArmError(
                f"{' and '.join(missing) or 'mass_kg'} is missing",
                where=f"{where}: row {number}",
                allowed="mass_kg and com_m in every row, or in none",
                remedy="complete the row, or remove all masses",
            )


_UNREADABLE = "the arm description cannot be read"


class _Frame(Section):
    """A constant frame: where it stands, and its turns about fixed axes x, y, z in that order."""

    xyz_m: Triple = (0.0, 0.0, 0.0)
    rpy_deg: Triple = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Array:
        return placed(np.array(self.xyz_m), np.radians(self.rpy_deg))


class _Urdf(Section):
    """The URDF that an arm came from: a file beside the description, and two links of it."""

    file: str
    base: str
    tip: str


class _ArmFile(Section):
    name: str
    title: str | None = None
    convention: Literal["standard", "modified"] = "standard"
    rows: tuple[Any, ...] = Field(min_length=1)
    base: _Frame = _Frame()
    tool: _Frame = _Frame()
    urdf: _Urdf | None = None


def arm_names() -> list[str]:
    """Return the names of the shipped arms."""
    folder = files("pa10cal.files").joinpath("arms")
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in folder.iterdir()
        if entry.name.endswith(".yaml")
    )


def load_arm(name: str, folder: Path | None = None, arms: Path | None = None) -> Arm:
    """Load an arm: `<name>.yaml` of a campaign's folder or of a folder of arms, else a shipped one.

    Args:
        name: name of the arm, as `campaign.yaml` gives it under `robot`.
        folder: the campaign's folder.
        arms: folder of arm descriptions; None for `arms` beside the campaign's folder.

    Raises:
        ArmError: when there is no arm of that name, or its file cannot be used.
        SettingsError: when a key of its file is unknown, missing or of the wrong kind.
    """
    if not fits_a_folder(name):
        raise ArmError(
            "no name of a robot",
            where="robot",
            value=name,
            allowed=ALLOWED,
            remedy="correct the name",
        )
    own = None if folder is None else own_description(name, folder, arms)
    if own is not None:
        return read_arm(own)
    if name not in arm_names():
        among = [] if folder is None else [str(each) for each in arm_places(folder, arms)]
        or_file = f", or {name}.yaml in {' or '.join(among)}" if among else ""
        raise ArmError(
            "unknown robot",
            where="robot",
            value=name,
            allowed=", ".join(arm_names()) + or_file,
            remedy="correct the name, or describe the arm in such a file"
            if among
            else f"correct the name, or give the file of a description, such as {name}.yaml",
        )
    text = files("pa10cal.files").joinpath("arms", f"{name}.yaml").read_text(encoding="utf-8")
    return parse_arm(parse_yaml(text), where=f"{name}.yaml")


def read_arm(path: Path) -> Arm:
    """Read an arm from its file.

    Raises:
        ArmError: when it cannot be read, is not named after the arm, or cannot be meant.
        SettingsError: when a key is unknown, missing or of the wrong kind.
    """
    arm = parse_arm(read_yaml(path, ArmError, what=_UNREADABLE), where=str(path))
    if arm.name != path.stem:
        raise ArmError(
            "the arm is not named after its file",
            where=str(path),
            value=arm.name,
            allowed=path.stem,
            remedy=f"set name: {path.stem}, or rename the file",
        )
    return arm


def copy_description(name: str, folder: Path, to: Path) -> None:
    """Copy a campaign's own description of its arm, and the URDF it names, to another folder.

    Nothing is copied where the arm is a shipped one.

    Raises:
        ArmError: when the description names a file that cannot be read.
        OutputError: when nothing can be written there.
    """
    own, source = own_description(name, folder), urdf_of_arm(name, folder)
    if own is not None:
        write_text(to / own.name, own.read_text(encoding="utf-8-sig"))
    if source is not None:
        write_text(to / Path(source.where).name, source.text)


def urdf_of_arm(name: str, folder: Path) -> UrdfSource | None:
    """Return the URDF that the arm of a campaign came from; None where it came from none.

    Args:
        name: name of the arm.
        folder: the campaign's folder, which holds its description or stands beside `arms`.

    Raises:
        ArmError: when the description names a file that cannot be read.
        SettingsError: when a key of the description is unknown, missing or of the wrong kind.
    """
    own = own_description(name, folder)
    if own is None:
        return None
    raw = read_yaml(own, ArmError, what=_UNREADABLE)
    source = parse_section(_ArmFile, raw, where=str(own)).urdf
    if source is None:
        return None
    path = own.parent / source.file
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ArmError(
            "the URDF that the arm came from cannot be read",
            where=f"{own}: urdf.file",
            value=f"{path}: {getattr(error, 'strerror', None) or error}",
            allowed="a file beside the description",
            remedy="copy it there, or remove the key urdf: names of its own are exported then",
        ) from None
    return UrdfSource(text, str(path), source.base, source.tip)


def parse_arm(raw: Any, *, where: str) -> Arm:
    """Build an arm from the content of its YAML file; docs/arms.md explains the keys.

    Raises:
        ArmError: naming file, row and key, when figures cannot be meant as they stand.
        SettingsError: when a key is unknown, missing or of the wrong kind.
    """
    content = parse_section(_ArmFile, raw, where=where)
    rows = [_row(row, f"{where}: row {number}") for number, row in enumerate(content.rows, start=1)]
    check_rows(rows, where)
    for key, frame in (("base", content.base), ("tool", content.tool)):
        refuse_far(frame.xyz_m, "xyz_m", f"{where}: {key}")
    arm = Arm(
        name=content.name,
        title=content.title or content.name,
        convention=content.convention,
        theta_rad=np.radians([row.theta_deg for row in rows]),
        d_m=np.array([row.d_m for row in rows]),
        a_m=np.array([row.a_m for row in rows]),
        alpha_rad=np.radians([row.alpha_deg for row in rows]),
        hayati=np.zeros(len(rows), dtype=bool),
        prismatic=np.array([row.prismatic for row in rows]),
        limits_rad=np.array([row.limits for row in rows]),
        gear_ratio=np.array([row.gear_ratio or math.nan for row in rows]),
        torque_limit_Nm=np.array([row.rated for row in rows]),
        mass_kg=_all_or_none([row.mass_kg for row in rows]),
        com_m=_all_or_none([row.com_m for row in rows]),
        beta_rad=np.radians([row.beta_deg for row in rows]),
        T_base_row1=content.base.pose,
        T_row_n_ee=content.tool.pose,
    )
    arm = with_hayati_rows(arm)
    _check_hayati(arm, [row.hayati for row in rows], where)
    return arm


def _row(raw: Any, where: str) -> ArmRow:
    if not isinstance(raw, dict) or not all(isinstance(key, str) for key in raw):
        raise ArmError(
            "a row is made of keys and values",
            where=where,
            value=raw,
            allowed="{a_m: 0.45, alpha_deg: -90, ...}",
            remedy="correct it; numbers have decimal points, not commas",
        )
    return parse_section(ArmRow, raw, where=where)


def _all_or_none(values: list[Any]) -> Array | None:
    return None if None in values else np.array(values)


def _check_hayati(arm: Arm, stated: list[bool | None], where: str) -> None:
    """Refuse a row that states Hayati's parameter against its axes."""
    axes_of = {axes.row: axes for axes in neighbouring_axes(arm)}
    for row, (given, found) in enumerate(zip(stated, arm.hayati, strict=True), start=1):
        if given is None or given == found:
            continue
        limit = f"{np.degrees(NEARLY_PARALLEL_RAD):g} deg"
        if row not in axes_of:
            why = "no two joint axes meet in this row"
        else:
            axes = axes_of[row]
            why = (
                f"the axes of joints {axes.joints[0]} and {axes.joints[1]} are "
                f"{np.degrees(axes.angle_rad):.3g} deg from parallel"
            )
        raise ArmError(
            f"hayati: {str(given).lower()} contradicts the row: {why}",
            where=f"{where}: row {row}",
            allowed=f"beta in place of d where neighbouring axes are within {limit} of parallel, "
            "and only there: elsewhere it says what theta says already, and without it a small "
            "tilt of parallel axes makes links of hundreds of metres",
            remedy="leave hayati out",
        )


# URDF files to import arms from.


def arm_from_urdf(
    path: Path, base: str | None = None, tip: str | None = None, name: str | None = None
) -> ImportedArm:
    """Import an arm from a URDF.

    Args:
        path: the file.
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        name: of the arm; the file's where None.

    Raises:
        ArmError: when the file cannot be read or used.
    """
    from pa10cal.arm.imported import arm_from_urdf_text  # late: it needs pinocchio

    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ArmError(
            "the URDF cannot be read",
            where=str(path),
            value=getattr(error, "strerror", None) or str(error),
            allowed="a URDF file, UTF-8",
            remedy="check the path",
        ) from None
    return arm_from_urdf_text(text, name or path.stem, base=base, tip=tip, where=str(path))


# An arm as the text of its YAML file, with every figure to the last digit.

#: Limits this near [rad, m] are one.
_SAME_LIMIT = 1e-9
_MOST_DECIMALS = 15


def arm_text(arm: Arm, comments: Iterable[str] = (), urdf: Mapping[str, str] | None = None) -> str:
    """Return the file of an arm, so that `parse_arm` gives the arm back.

    What the file may leave out and what is not known is omitted.

    Args:
        arm: the arm.
        comments: lines that stand first.
        urdf: where it came from: `file`, `base` and `tip`.
    """
    head: dict[str, Any] = {"name": arm.name, "title": arm.title, "convention": arm.convention}
    if urdf is not None:
        head["urdf"] = dict(urdf)
    lines = [f"# {line}".rstrip() for line in comments]
    lines += [f"{key}: {_flow(value)}" for key, value in head.items()]
    for key, T in (("base", arm.T_base_row1), ("tool", arm.T_row_n_ee)):
        if (np.eye(4) != T).any():
            lines.append(f"{key}: {_flow(_frame(T))}")
    lines.append("rows:")
    for row in range(arm.n):
        geometry, rest = _geometry(arm, row), _joint_and_link(arm, row)
        lines.append(f"  - {{{_flow(geometry)[1:-1]}," if geometry else "  - {")
        lines.append(f"     {_flow(rest)[1:-1]}}}")
    return "\n".join(lines) + "\n"


def with_short_limits(arm: Arm) -> Arm:
    """Return the arm with each limit the shortest number in the file that is within 1e-9 of it.

    What a URDF states in radians with a few digits has fourteen in degrees.
    """
    limits = [
        [_shortest(limit, _SAME_LIMIT, degrees=not slides) for limit in ends]
        for ends, slides in zip(arm.limits_rad, arm.prismatic, strict=True)
    ]
    turned = np.where(arm.prismatic[:, None], limits, np.radians(limits))
    return replace(arm, limits_rad=turned)


def _shortest(limit: float, within: float, *, degrees: bool) -> float | int:
    """Return a limit [deg or m] with the fewest decimals that is so near [rad or m]."""
    shown = float(np.degrees(limit)) if degrees else float(limit)
    for decimals in range(_MOST_DECIMALS):
        rounded = round(shown, decimals)
        if abs((np.radians(rounded) if degrees else rounded) - limit) <= within:
            return _number(rounded)
    return _number(shown)


def _geometry(arm: Arm, row: int) -> dict[str, Any]:
    values = {
        "theta_deg": np.degrees(arm.theta_rad[row]),
        "d_m": arm.d_m[row],
        "a_m": arm.a_m[row],
        "alpha_deg": np.degrees(arm.alpha_rad[row]),
        "beta_deg": np.degrees(arm.beta_rad[row]),
    }
    return {key: _number(value) for key, value in values.items() if value != 0.0}


def _joint_and_link(arm: Arm, row: int) -> dict[str, Any]:
    slides = bool(arm.prismatic[row])
    limits, rated = arm.limits_rad[row], arm.torque_limit_Nm[row]
    content: dict[str, Any] = {"prismatic": True} if slides else {}
    content["limits_m" if slides else "limits_deg"] = [
        _shortest(limit, 0.0, degrees=not slides) for limit in limits
    ]
    if not np.isnan(arm.gear_ratio[row]):
        content["gear_ratio"] = _number(arm.gear_ratio[row])
    if not np.isnan(rated):
        content["force_limit_N" if slides else "torque_limit_Nm"] = _number(rated)
    if arm.mass_kg is not None and arm.com_m is not None:
        content["mass_kg"] = _number(arm.mass_kg[row])
        content["com_m"] = _numbers(arm.com_m[row])
    return content


def _frame(T: Array) -> dict[str, Any]:
    return {"xyz_m": _numbers(T[:3, 3]), "rpy_deg": _numbers(np.degrees(roll_pitch_yaw(T[:3, :3])))}


def _numbers(values: Array) -> list[float | int]:
    return [_number(value) for value in values]


def _number(value: float) -> float | int:
    """Return a plain number, whole ones without a decimal point."""
    return int(value) if float(value).is_integer() else float(value)


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, width=10**6, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...")
