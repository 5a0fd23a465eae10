"""Lists of poses for a model: joint positions to predict, targets to compensate, and the answers.

Nothing of such a list is dropped: a row that cannot be read refuses the file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.campaign.csv_rows import CUT, column_names, read_rows
from pa10cal.campaign.raw_rows import RawRows, in_radians, position_columns
from pa10cal.errors import RawDataError

_PLACE = ("x_mm", "y_mm", "z_mm")
_QUATERNION = ("qw", "qx", "qy", "qz")
_LOAD = "load_N"
_MM = 1e-3
#: Quaternions are written with a few digits; further from length one they are something else.
_UNIT = 1e-2
#: Targets are no nearer to the base than this all together: they are in metres then [mm].
_NEAREST_MM = 10.0
#: No joint turns further [deg], nor slides [mm].
_FARTHEST = 1e5
_JOINT = re.compile(r"q\d+_\w+")


@dataclass(frozen=True)
class JointList:
    """Joint positions as a file lists them."""

    ids: NDArray[np.str_]  # (N,) names of the rows
    q: Array  # (N, n) joint positions [rad, m]
    load_N: Array  # (N,) external loads; nan where none is given
    arrival: Array  # (N, n) direction of arrival of each joint, -1, 0 or 1; nan where not given
    unused: tuple[str, ...] = ()  # columns that are not read


@dataclass(frozen=True)
class TargetList:
    """Targets as a file lists them."""

    ids: NDArray[np.str_]  # (N,) names of the rows
    T: Array  # (N, 4, 4) poses [m]
    load_N: Array  # (N,) external loads; nan where none is given
    arrival: Array  # (N, n) direction of arrival of each joint, -1, 0 or 1; nan where not given
    # (N, n) joint positions near which the answer should be [rad, m]; nan where none are
    seed: Array
    unused: tuple[str, ...] = ()  # columns that are not read


def read_joints(path: Path, prismatic: NDArray[np.bool_]) -> JointList:
    """Read `id,q1_deg,…[,load_N][,arrival1,…]` (`qk_mm` of a joint that slides).

    Raises:
        RawDataError: naming file and line, when a column is missing or of another arm, or a row
            cannot be read.
    """
    joints = position_columns(prismatic)
    raw = _rows(path, joints, ["id", *joints], [_LOAD, *_sides(joints)])
    positions = _finite(path, raw, joints)
    _refuse_far(path, raw, joints, positions)
    q = in_radians(positions, prismatic)
    arrival = _arrival(path, raw, joints)
    return JointList(raw.text_of("id"), q, _loads(path, raw), arrival, raw.unused)


def read_targets(path: Path, prismatic: NDArray[np.bool_]) -> TargetList:
    """Read `id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,load_N][,q1_deg,…][,arrival1,…]`; seeds may be blank.

    Raises:
        RawDataError: see `read_joints`; also for an orientation that is none, and for metres.
    """
    joints = position_columns(prismatic)
    pose = [*_PLACE, *_QUATERNION]
    raw = _rows(path, joints, ["id", *pose], [_LOAD, *_sides(joints)], together=joints)
    found = _finite(path, raw, pose)
    T = np.tile(np.eye(4), (len(found), 1, 1))
    T[:, :3, 3] = _MM * found[:, :3]
    length = np.linalg.norm(found[:, 3:], axis=1)
    off = np.abs(length - 1.0) > _UNIT
    if off.any():
        row = int(np.argmax(off))
        raise _refusal(
            path,
            int(raw.line[row]),
            "the quaternion is not of length one",
            f"{length[row]:.6g}",
            "qw, qx, qy, qz, whose squares add up to 1",
            "check the columns' order, or write more digits",
        )
    if np.abs(found[:, :3]).max() < _NEAREST_MM:
        raise _refusal(
            path,
            int(raw.line[0]),
            "x_mm, y_mm, z_mm: no target is further than a hundredth of a metre from the base",
            float(np.abs(found[:, :3]).max()),
            "millimetres in the robot's base frame",
            "multiply by 1000 if these are metres",
        )
    T[:, :3, :3] = Rotation.from_quat(found[:, 3:], scalar_first=True).as_matrix()
    seed = np.full((len(T), len(joints)), np.nan)
    if joints[0] in raw.columns:
        positions = _finite(path, raw, joints, may_be_blank=True)
        given = np.isfinite(positions)
        partly = given.any(axis=1) & ~given.all(axis=1)
        if partly.any():
            row = int(np.argmax(partly))
            raise _refusal(
                path,
                int(raw.line[row]),
                "the seed lacks joints",
                joints[int(np.argmin(given[row]))],
                "all joints, or none",
                "complete the row, or leave its joints blank",
            )
        _refuse_far(path, raw, joints, positions)
        seed = in_radians(positions, prismatic)
    arrival = _arrival(path, raw, joints)
    return TargetList(raw.text_of("id"), T, _loads(path, raw), arrival, seed, raw.unused)


def poses_text(
    ids: NDArray[np.str_],
    T: Array,
    u_mm: Array,
    inside: NDArray[np.bool_],
    forced: str | None = None,
) -> str:
    """Return poses (N, 4, 4) as `id,x_mm,y_mm,z_mm,qw,qx,qy,qz,u_mm,inside`; unknown u is blank.

    Where the model's grade was overruled, a last column `forced` names it.
    """
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    mark = ("forced",) if forced else ()
    lines = [",".join(["id", *_PLACE, *_QUATERNION, "u_mm", "inside", *mark])]
    for name, place, turn, u, within in zip(ids, T[:, :3, 3] / _MM, q, u_mm, inside, strict=True):
        words = [f"{value:.9f}" for value in place] + [f"{value:.12f}" for value in turn]
        words += [_known(u), _word(within), *([forced] if forced else [])]
        lines.append(",".join([str(name), *words]))
    return "\n".join(lines) + "\n"


def commands_text(
    ids: NDArray[np.str_],
    q: Array,
    prismatic: NDArray[np.bool_],
    columns: dict[str, NDArray[np.generic]],
) -> str:
    """Return joint positions (N, n) as `id,q1_deg,…` and further columns (N,)."""
    positions = np.where(prismatic, q / _MM, np.degrees(q))
    lines = [",".join(["id", *position_columns(prismatic), *columns])]
    for name, row, *rest in zip(ids, positions, *columns.values(), strict=True):
        words = [f"{value:.10f}" for value in row] + [_field(value) for value in rest]
        lines.append(",".join([str(name), *words]))
    return "\n".join(lines) + "\n"


def _field(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return _word(bool(value))
    return _known(float(value)) if isinstance(value, float | np.floating) else str(value)


def _known(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.9f}"


def _word(value: bool | np.bool_) -> str:
    return "true" if value else "false"


def _rows(
    path: Path,
    joints: list[str],
    required: list[str],
    optional: list[str],
    together: Sequence[str] = (),
) -> RawRows:
    """Read a list whose every row can be used."""
    others = [name for name in column_names(path) if _JOINT.fullmatch(name)]
    raw = read_rows(path, required, optional, together, repeats=True)
    others = [name for name in others if name not in joints]
    if others:
        raise _refusal(
            path,
            1,
            "a column of another arm, or in another unit",
            others[0],
            ", ".join(joints),
            "give a model of the same arm, or rename the column",
        )
    return _whole(path, raw)


def _whole(path: Path, raw: RawRows) -> RawRows:
    """Return rows of which none was set aside."""
    if raw.quarantined:
        first = min(raw.quarantined, key=lambda row: row.line)
        raise _refusal(
            path,
            first.line,
            first.reason,
            first.value or None,
            "rows that can all be used: none is dropped",
            "end it with a line break if it is whole"
            if first.reason == CUT
            else "correct the row, or remove it",
        )
    return raw


def _finite(path: Path, raw: RawRows, names: list[str], *, may_be_blank: bool = False) -> Array:
    return _whole(path, raw.finite(names, may_be_blank=may_be_blank)).numbers_of(names)


def _loads(path: Path, raw: RawRows) -> Array:
    if _LOAD not in raw.columns:
        return np.full(len(raw.line), np.nan)
    return _finite(path, raw, [_LOAD], may_be_blank=True)[:, 0]


def _sides(joints: list[str]) -> list[str]:
    return [f"arrival{joint}" for joint in range(1, len(joints) + 1)]


def _arrival(path: Path, raw: RawRows, joints: list[str]) -> Array:
    """Return directions of arrival (N, n), nan where none is given."""
    found = np.full((len(raw.line), len(joints)), np.nan)
    for joint, name in enumerate(_sides(joints)):
        if name in raw.columns:
            found[:, joint] = _finite(path, raw, [name], may_be_blank=True)[:, 0]
    wrong = ~np.isnan(found) & ~np.isin(found, (-1.0, 0.0, 1.0))
    if wrong.any():
        row, joint = np.argwhere(wrong)[0]
        raise _refusal(
            path,
            int(raw.line[row]),
            f"arrival{joint + 1} is no direction of arrival",
            float(found[row, joint]),
            "-1 or 1, the sign of the joint's last motion; 0 or blank where it is not known",
            "correct the value",
        )
    return found


def _refuse_far(path: Path, raw: RawRows, joints: list[str], positions: Array) -> None:
    far = np.abs(positions) > _FARTHEST
    if far.any():
        row, joint = np.argwhere(far)[0]
        raise _refusal(
            path,
            int(raw.line[row]),
            f"{joints[joint]} is no position of a joint",
            float(positions[row, joint]),
            f"up to {_FARTHEST:g}",
            "check the unit",
        )


def _refusal(
    path: Path, line: int, what: str, value: object, allowed: str, remedy: str
) -> RawDataError:
    return RawDataError(what, where=f"{path}:{line}", value=value, allowed=allowed, remedy=remedy)
