"""Arm descriptions, one YAML file each: those shipped with the package and those of a campaign."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field

from pa10cal.arm import description
from pa10cal.arm.chain import roll_pitch_yaw
from pa10cal.arm.description import Arm
from pa10cal.arm.urdf_writing import UrdfSource
from pa10cal.arrays import Array
from pa10cal.errors import NAME_RULE, ArmError, fits_a_folder, how_to_install, one_line, remedy_for
from pa10cal.files import arm_places, own_description
from pa10cal.files.arm_rows import ArmRow, Frame, check_rows, refuse_far, rows_through_far_ones
from pa10cal.files.coupling import StatedCoupling, coupled_joints, stated_coupling
from pa10cal.files.known_arms import PACKAGE, known_arm, known_arm_names, read_urdf_text
from pa10cal.files.output import write_text
from pa10cal.input_files import read_file, reason
from pa10cal.options import Section
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import MAX_BYTES, parse_yaml, read_yaml


class _Urdf(Section):
    """The URDF that an arm came from: a file beside the description, and two links of it."""

    file: str
    base: str
    tip: str


class _MakerCalibration(Section):
    """The rows are those that the maker calibrated, with which the controller computes."""

    of: str | None = None  # name of the arm as it was designed
    hash: str = ""  # by which the driver knows it


class _ArmFile(Section):
    """The keys of a description; rows are checked one by one."""

    name: str
    title: str | None = None
    convention: Literal["standard", "modified"] = "standard"
    rows: tuple[Any, ...] = Field(min_length=1, max_length=description.MOST_ROWS)
    base: Frame = Frame()
    tool: Frame = Frame()
    urdf: _Urdf | None = None
    maker_calibration: _MakerCalibration | None = None
    coupling: tuple[StatedCoupling, ...] = ()
    base_moves: bool = False


def arm_names() -> list[str]:
    """Return the names of the shipped arms."""
    folder = files("pa10cal.files").joinpath("arms")
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in folder.iterdir()
        if entry.name.endswith(".yaml")
    )


def load_arm(name: str, folder: Path | None = None, arms: Path | None = None) -> Arm:
    """Load an arm by its name.

    That is `<name>.yaml` of a campaign's folder or of a folder of arms, else a shipped arm, else
    one of the package robot_descriptions whose files are on the disk.

    Args:
        name: name of the arm, as `campaign.yaml` gives it under `robot`.
        folder: the campaign's folder.
        arms: folder of arm descriptions; None for `arms` beside the campaign's folder.

    Raises:
        ArmError: when there is no arm of that name, or its file cannot be used.
        MissingPackageError: when robot_descriptions has it, and what reads its file is missing.
        SettingsError: when a key of its file is unknown, missing or of the wrong kind.
    """
    if not fits_a_folder(name):
        raise ArmError(
            "no name of a robot",
            where="robot",
            value=name,
            allowed=NAME_RULE,
            remedy="correct the name",
        )
    own = None if folder is None else own_description(name, folder, arms)
    if own is not None:
        return read_arm(own, own.parent)
    if name not in arm_names():
        if (known := known_arm(name)) is not None:
            return known.imported.arm
        raise _unknown_robot(name, folder, arms)
    return _shipped_arm(name)


@cache
def _shipped_arm(name: str) -> Arm:
    """Return a shipped arm; a command asks for its arm many times."""
    text = files("pa10cal.files").joinpath("arms", f"{name}.yaml").read_text(encoding="utf-8")
    return parse_arm(parse_yaml(text), where=f"{name}.yaml")


def _unknown_robot(name: str, folder: Path | None, arms: Path | None) -> ArmError:
    """Return the refusal of a name, with where it was looked for and which name may be meant."""
    shipped, known = arm_names(), known_arm_names()
    allowed = ", ".join(shipped)
    describe = f"give the file of a description, such as {name.removesuffix('.yaml')}.yaml"
    if known:
        allowed += f", one of the {len(known)} robots of {PACKAGE}"
    else:
        describe += f", or install {PACKAGE}, which knows many arms: {how_to_install(PACKAGE)}"
    if folder is not None:
        allowed += f", or {name}.yaml in {' or '.join(map(str, arm_places(folder, arms)))}"
        describe = describe.replace("give the file of a description", "describe the arm in a file")
    candidates = [*shipped, *known]
    if any(letter.isdigit() for letter in name):
        # One digit more or less is another robot: only signs and capitals may differ.
        candidates = [each for each in candidates if _alphanumeric(each) == _alphanumeric(name)]
    meant = remedy_for(name, candidates, "correct the name, or")
    return ArmError(
        "unknown robot",
        where="robot",
        value=name,
        allowed=allowed,
        remedy=f"{meant.replace('?', '? If not,')} {describe}",
    )


def _alphanumeric(name: str) -> str:
    """Return the letters and digits of a name, in lower case."""
    return "".join(filter(str.isalnum, name.casefold()))


def arm_asked(robot: str, folder: Path | None = None) -> Arm:
    """Return the arm that a user asks for: by name, or by the file of its description (.yaml).

    Raises:
        ArmError, SettingsError: see `load_arm` and `read_arm`.
    """
    path = Path(robot)
    return read_arm(path) if path.suffix in (".yaml", ".yml") else load_arm(robot, folder)


def read_arm(path: Path, within: Path | None = None) -> Arm:
    """Read an arm from its file, which must lie `within` a folder where one is given.

    Raises:
        ArmError: when it cannot be read, is not named after the arm, or cannot be meant.
        SettingsError: when a key is unknown, missing or of the wrong kind.
    """
    arm = parse_arm(_read(path, within), where=str(path))
    if arm.name != path.stem:
        raise ArmError(
            "the arm is not named after its file",
            where=str(path),
            value=arm.name,
            allowed=path.stem,
            remedy=f"set name: {path.stem}, or rename the file",
        )
    return arm


def _read(path: Path, within: Path | None) -> Any:
    return read_yaml(path, ArmError, what="the arm description cannot be read", within=within)


def _own_file(path: Path) -> _ArmFile:
    """Read the keys of a campaign's own description."""
    return parse_section(_ArmFile, _read(path, path.parent), where=str(path))


def copy_description(name: str, folder: Path, to: Path) -> None:
    """Copy a campaign's own description of its arm, and the URDF it names, to another folder.

    Nothing is copied where the arm is a shipped one.

    Raises:
        ArmError: when the description names a file that cannot be read.
        OutputError: when nothing can be written there.
    """
    own, source = own_description(name, folder), urdf_of_arm(name, folder)
    if own is None:
        return
    text = read_file(own, MAX_BYTES, own.parent).decode("utf-8-sig")
    by_maker = maker_calibration(name, folder)
    if by_maker is not None and by_maker.designed is not None:
        copy_description(by_maker.designed.name, folder, to)
    if source is not None:
        file = Path(source.where).name
        if own.parent / file != Path(source.where):  # it lay in another folder than the description
            urdf = {"file": file, "base": source.base, "tip": source.tip}
            text = arm_text(read_arm(own, own.parent), urdf=urdf)
        write_text(to / file, source.text)
    write_text(to / own.name, text)


def joint_names(name: str, folder: Path, arms: Path | None = None) -> tuple[str, ...]:
    """Return the names of the joints in the URDF that an arm came from, in order.

    Empty where there is no such URDF, or it cannot be read: names only help to read other files,
    and the export of a model reports what is wrong with the URDF.
    """
    with suppress(ArmError):
        if (source := urdf_of_arm(name, folder, arms)) is not None:
            return source.joints
    return ()


def urdf_of_arm(name: str, folder: Path, arms: Path | None = None) -> UrdfSource | None:
    """Return the URDF that the arm of a campaign came from; None where it came from none.

    Descriptions are looked for as `load_arm` does.

    Raises:
        ArmError: when the description names a file that cannot be read.
        SettingsError: when a key of the description is unknown, missing or of the wrong kind.
    """
    own = own_description(name, folder, arms)
    if own is None:
        known = None if name in arm_names() else known_arm(name)
        return None if known is None else known.source
    source = _own_file(own).urdf
    if source is None:
        return None
    path = own.parent / source.file
    try:
        text = read_urdf_text(path, own.parent, folder)
    except (OSError, ValueError) as error:
        raise ArmError(
            f"the URDF that the arm came from cannot be read: {reason(error)}",
            where=f"{own}: urdf.file",
            value=source.file,
            allowed="a file beside the description, or in the campaign's folder",
            remedy="copy it there and name it so, or remove the key urdf: names of its own are "
            "exported then",
        ) from None
    return UrdfSource(text, str(path), source.base, source.tip)


@dataclass(frozen=True)
class MakerCalibration:
    """That the rows of an arm are those of its maker's calibration."""

    designed: Arm | None  # the arm as it was designed; None where it is not stated


def maker_calibration(name: str, folder: Path, arms: Path | None = None) -> MakerCalibration | None:
    """Return what is known of the maker's calibration of an arm; None if its rows are not of one.

    Descriptions are looked for as `load_arm` does.

    Raises:
        ArmError: when the arm as it was designed is not there, or its file cannot be used.
        SettingsError: when a key of a description is unknown, missing or of the wrong kind.
    """
    own = own_description(name, folder, arms)
    if own is None:
        return None
    stated = _own_file(own).maker_calibration
    if stated is None:
        return None
    return MakerCalibration(None if stated.of is None else load_arm(stated.of, folder, arms))


def parse_arm(raw: Any, *, where: str) -> Arm:
    """Build an arm from the content of its YAML file; docs/arms.md explains the keys.

    Raises:
        ArmError: naming file, row and key, when figures cannot be meant as they stand.
        SettingsError: when a key is unknown, missing or of the wrong kind.
    """
    content = parse_section(_ArmFile, raw, where=where)
    rows = _parsed_rows(content.rows, where)
    ends = content.base, content.tool
    laid_anew = rows_through_far_ones(rows, content.convention, ends, where)
    convention = content.convention
    if laid_anew is not None:
        rows, ends = laid_anew
        convention = "standard"
    base, tool = ends
    check_rows(rows, where)
    for key, frame in (("base", base), ("tool", tool)):
        refuse_far(frame.xyz_m, "xyz_m", rows, f"{where}: {key}")
    prismatic = np.array([row.prismatic for row in rows])
    arm = Arm(
        name=content.name,
        title=content.title or content.name,
        convention=convention,
        theta_rad=np.radians([row.theta_deg for row in rows]),
        d_m=np.array([row.d_m for row in rows]),
        a_m=np.array([row.a_m for row in rows]),
        alpha_rad=np.radians([row.alpha_deg for row in rows]),
        hayati=np.zeros(len(rows), dtype=bool),
        prismatic=prismatic,
        limits_rad=np.array([row.limits for row in rows]),
        gear_ratio=np.array([row.gear_ratio or math.nan for row in rows]),
        torque_limit_Nm=np.array([row.rated for row in rows]),
        mass_kg=_all_or_none([row.mass_kg for row in rows]),
        com_m=_all_or_none([row.com_m for row in rows]),
        beta_rad=np.radians([row.beta_deg for row in rows]),
        T_base_row1=base.pose,
        T_row_n_ee=tool.pose,
        base_moves=content.base_moves,
        coupled=coupled_joints(content.coupling, prismatic, where),
        remarks=() if laid_anew is None else (_laid_anew(content.name),),
    )
    if arm.reach_m < description.LEAST_REACH_M:
        raise ArmError(
            "the arm has no length: all its axes meet where its end is",
            where=where,
            value="0 in d_m, a_m, base and tool",
            allowed="a length in a row, or the place of its flange or plate under tool",
            remedy="state where its flange is, roughly, such as tool: {xyz_m: [0.5, 0, 0]}; of a "
            "URDF, name a tip further out",
        )
    arm = description.with_hayati_rows(arm)
    _check_hayati(rows, arm, where)
    return arm


def _parsed_rows(raw_rows: Iterable[Any], where: str) -> list[ArmRow]:
    rows = []
    for number, row in enumerate(raw_rows, start=1):
        place = f"{where}: row {number}"
        if not isinstance(row, dict) or not all(isinstance(key, str) for key in row):
            raise ArmError(
                "a row is made of keys and values",
                where=place,
                value=row,
                allowed="{a_m: 0.45, alpha_deg: -90, ...}",
                remedy="correct it; numbers have decimal points, not commas",
            )
        rows.append(parse_section(ArmRow, row, where=place))
    return rows


def _check_hayati(rows: Iterable[ArmRow], arm: Arm, where: str) -> None:
    """Refuse a row whose key `hayati` contradicts the angle between its axes."""
    axes_of = {axes.row: axes for axes in description.neighbouring_axes(arm)}
    for number, (row, hayati) in enumerate(zip(rows, arm.hayati, strict=True), start=1):
        if row.hayati is None or row.hayati == hayati:
            continue
        why = "no two joint axes meet in this row"
        if (axes := axes_of.get(number)) is not None:
            why = (
                f"the axes of joints {axes.joints[0]} and {axes.joints[1]} are "
                f"{np.degrees(axes.angle_rad):.3g} deg from parallel"
            )
        parallel_deg = np.degrees(description.NEARLY_PARALLEL_RAD)
        raise ArmError(
            f"hayati: {str(row.hayati).lower()} contradicts the row: {why}",
            where=f"{where}: row {number}",
            allowed=f"beta in place of d where neighbouring axes are within {parallel_deg:g} "
            "deg of parallel, and only there: elsewhere it says what theta says already, and "
            "without it a small tilt of parallel axes makes links of hundreds of metres",
            remedy="leave hayati out",
        )


def _laid_anew(name: str) -> str:
    """Return the remark on an arm whose rows are not those of its description."""
    return (
        f"rows of {name} are laid anew through its axes, with the same forward kinematics: between "
        "nearly parallel axes they were far too long"
    )


def _all_or_none(values: list[Any]) -> Array | None:
    return None if None in values else np.array(values)


# An arm as the text of its YAML file, with every figure to the last digit.

#: Limits that differ by less count as the same [rad, m].
_SAME_LIMIT = 1e-9
#: Decimals with which a limit is written at most.
_MOST_DECIMALS = 15


def arm_text(
    arm: Arm,
    comments: Iterable[str] = (),
    urdf: Mapping[str, str] | None = None,
    maker_calibration: Mapping[str, str] | None = None,
) -> str:
    """Return the file of an arm, so that `parse_arm` gives the arm back.

    Values that are zero or not known are omitted.

    Args:
        arm: the arm.
        comments: lines at the beginning.
        urdf: the URDF that the arm came from: `file`, `base` and `tip`; None for none.
        maker_calibration: of a calibration by the maker: the arm as designed, `of`, and `hash`.
    """
    head: dict[str, Any] = {"name": arm.name, "title": arm.title, "convention": arm.convention}
    for key, stated in (("urdf", urdf), ("maker_calibration", maker_calibration)):
        if stated is not None:
            head[key] = dict(stated)
    lines = [f"# {one_line(line)}".rstrip() for line in comments]
    lines += [f"{key}: {_flow(value)}" for key, value in head.items()]
    if arm.base_moves:
        lines.append("base_moves: true")
    for key, T in (("base", arm.T_base_row1), ("tool", arm.T_row_n_ee)):
        if (np.eye(4) != T).any():
            numbers = {"xyz_m": T[:3, 3], "rpy_deg": np.degrees(roll_pitch_yaw(T[:3, :3]))}
            frame = {name: list(map(_number, values)) for name, values in numbers.items()}
            lines.append(f"{key}: {_flow(frame)}")
    if arm.coupled:
        entries = [stated_coupling(each, arm.prismatic) for each in arm.coupled]
        lines.append(f"coupling: {_flow(entries)}")
    lines.append("rows:")
    columns = {
        "theta_deg": np.degrees(arm.theta_rad),
        "d_m": arm.d_m,
        "a_m": arm.a_m,
        "alpha_deg": np.degrees(arm.alpha_rad),
        "beta_deg": np.degrees(arm.beta_rad),
    }
    for row in range(arm.n):
        geometry = {key: _number(values[row]) for key, values in columns.items() if values[row]}
        # A mapping in braces over two lines: geometry, then joint and link.
        lines.append(f"  - {{{_flow(geometry)[1:-1]}," if geometry else "  - {")
        lines.append(f"     {_flow(_joint_and_link(arm, row))[1:-1]}}}")
    return "\n".join(lines) + "\n"


def with_short_limits(arm: Arm) -> Arm:
    """Return the arm with each limit rounded to the fewest decimals in the file, within 1e-9.

    A limit that a URDF states in radians with a few digits has fourteen in degrees.
    """
    limits = [
        [_rounded_limit(limit, _SAME_LIMIT, degrees=not slides) for limit in ends]
        for ends, slides in zip(arm.limits_rad, arm.prismatic, strict=True)
    ]
    return replace(arm, limits_rad=np.where(arm.prismatic[:, None], limits, np.radians(limits)))


def _rounded_limit(limit: float, tolerance: float, *, degrees: bool) -> float | int:
    """Return a limit in degrees or metres with the fewest decimals.

    Args:
        limit: in radians or metres.
        tolerance: how far the rounded limit may be from it [rad or m].
        degrees: whether the limit is an angle.
    """
    in_file = float(np.degrees(limit)) if degrees else float(limit)
    for decimals in range(_MOST_DECIMALS):
        rounded = round(in_file, decimals)
        if abs((np.radians(rounded) if degrees else rounded) - limit) <= tolerance:
            return _number(rounded)
    return _number(in_file)


def _joint_and_link(arm: Arm, row: int) -> dict[str, Any]:
    """Return the keys of a row that are of its joint and its link."""
    slides = bool(arm.prismatic[row])
    limits, rated = arm.limits_rad[row], arm.torque_limit_Nm[row]
    content: dict[str, Any] = {"prismatic": True} if slides else {}
    content["limits_m" if slides else "limits_deg"] = [
        _rounded_limit(limit, 0.0, degrees=not slides) for limit in limits
    ]
    if not np.isnan(arm.gear_ratio[row]):
        content["gear_ratio"] = _number(arm.gear_ratio[row])
    if not np.isnan(rated):
        content["force_limit_N" if slides else "torque_limit_Nm"] = _number(rated)
    if arm.mass_kg is not None and arm.com_m is not None:
        content["mass_kg"] = _number(arm.mass_kg[row])
        content["com_m"] = list(map(_number, arm.com_m[row]))
    return content


def _number(value: float) -> float | int:
    """Return a plain number, as an integer if it is whole."""
    return int(value) if float(value).is_integer() else float(value)


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, width=10**6, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...")
