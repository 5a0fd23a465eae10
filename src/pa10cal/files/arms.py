"""Arm descriptions, one YAML file each: those shipped with the package and those of a campaign."""

from __future__ import annotations

import math
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from pa10cal.arm.attitude import placed
from pa10cal.arm.description import Arm
from pa10cal.arm.parallel import NEARLY_PARALLEL_RAD, neighbouring_axes, with_hayati_rows
from pa10cal.arm.urdf_patch import UrdfSource
from pa10cal.arrays import Array
from pa10cal.errors import ArmError
from pa10cal.files.arm_rows import ArmRow, Triple, check_rows, refuse_far
from pa10cal.files.output import write_text
from pa10cal.names import ALLOWED, fits_a_folder
from pa10cal.settings_reading import parse_section
from pa10cal.settings_section import Section
from pa10cal.yaml_file import parse_yaml, read_yaml

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


def load_arm(name: str, folder: Path | None = None) -> Arm:
    """Load an arm: `<name>.yaml` of a campaign's folder where it is there, else a shipped one.

    Args:
        name: name of the arm, as `campaign.yaml` gives it under `robot`.
        folder: the campaign's folder.

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
    own = None if folder is None else folder / f"{name}.yaml"
    if own is not None and own.is_file():
        return read_arm(own)
    if name not in arm_names():
        raise ArmError(
            "unknown robot",
            where="robot",
            value=name,
            allowed=", ".join(arm_names()) + ("" if own is None else f", or a file {own}"),
            remedy="correct the name, or describe the arm in such a file"
            if own is not None
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
    own, source = folder / f"{name}.yaml", urdf_of_arm(name, folder)
    if own.is_file():
        write_text(to / own.name, own.read_text(encoding="utf-8-sig"))
    if source is not None:
        write_text(to / Path(source.where).name, source.text)


def urdf_of_arm(name: str, folder: Path) -> UrdfSource | None:
    """Return the URDF that the arm of a campaign came from; None where it came from none.

    Args:
        name: name of the arm.
        folder: the campaign's folder, which holds its description.

    Raises:
        ArmError: when the description names a file that cannot be read.
        SettingsError: when a key of the description is unknown, missing or of the wrong kind.
    """
    own = folder / f"{name}.yaml"
    if not own.is_file():
        return None
    raw = read_yaml(own, ArmError, what=_UNREADABLE)
    source = parse_section(_ArmFile, raw, where=str(own)).urdf
    if source is None:
        return None
    path = folder / source.file
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
