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
from pa10cal.errors import RawDataError, refusals_beside

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

_refusal = refusals_beside(__file__, RawDataError)


@dataclass(frozen=True, kw_only=True)
class JointList:
    """Joint positions as a file lists them."""

    ids: NDArray[np.str_]  # (N,) names of the rows
    # (N, n) joint positions [rad, m]; of targets those near which the answer should be, nan where
    # none are given
    q: Array
    load_N: Array  # (N,) external loads; nan where none is given
    arrival: Array  # (N, n) direction of arrival of each joint, -1, 0 or 1; nan where not given
    unused: tuple[str, ...] = ()  # columns that are not read


@dataclass(frozen=True, kw_only=True)
class TargetList(JointList):
    """Targets as a file lists them."""

    T: Array  # (N, 4, 4) poses [m]


def read_joints(path: Path, prismatic: NDArray[np.bool_]) -> JointList:
    """Read `id,q1_deg,…[,load_N][,arrival1,…]` (`qk_mm` of a joint that slides).

    Raises:
        RawDataError: naming file and line, when a column is missing or of another arm, or a row
            cannot be read.
    """
    _, listed = _read(path, prismatic, position_columns(prismatic))
    return listed


def read_targets(path: Path, prismatic: NDArray[np.bool_]) -> TargetList:
    """Read `id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,load_N][,q1_deg,…][,arrival1,…]`; seeds may be blank.

    Raises:
        RawDataError: see `read_joints`; also for an orientation that is none, and for metres.
    """
    raw, listed = _read(path, prismatic, [*_PLACE, *_QUATERNION])
    p_mm, quaternion = raw.numbers_of(_PLACE), raw.numbers_of(_QUATERNION)
    length = np.linalg.norm(quaternion, axis=1)
    off = np.abs(length - 1.0) > _UNIT
    if off.any():
        row = int(np.argmax(off))
        raise _refusal("quaternion", f"{path}:{raw.line[row]}", f"{length[row]:.6g}")
    if (furthest := float(np.abs(p_mm).max())) < _NEAREST_MM:
        raise _refusal("metres", f"{path}:{raw.line[0]}", furthest)
    T = np.tile(np.eye(4), (len(raw), 1, 1))
    T[:, :3, 3] = _MM * p_mm
    T[:, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return TargetList(**vars(listed), T=T)


def _read(
    path: Path, prismatic: NDArray[np.bool_], required: Sequence[str]
) -> tuple[RawRows, JointList]:
    """Read a list whose every row can be used: its rows, and what both kinds have in common."""
    joints = position_columns(prismatic)
    sides = [f"arrival{joint}" for joint in range(1, len(joints) + 1)]
    others = [name for name in column_names(path) if _JOINT.fullmatch(name) and name not in joints]
    together = () if joints[0] in required else joints
    raw = read_rows(path, ["id", *required], [_LOAD, *sides], together, repeats=True)
    if others:
        raise _refusal("other arm", f"{path}:1", others[0], ", ".join(joints))
    raw = raw.finite(required).finite([*together, _LOAD, *sides], may_be_blank=True)
    if raw.quarantined:
        first = min(raw.quarantined, key=lambda row: row.line)
        remedy = "correct the row, or remove it"
        if first.reason == CUT:
            remedy = "end it with a line break if it is whole"
        where = f"{path}:{first.line}"
        raise _refusal("row", where, first.value or None, first.reason, remedy)
    q, arrival = raw.numbers_of(joints), raw.numbers_of(sides)

    def refuse(kind: str, wrong: NDArray[np.bool_], values: Array, names: Sequence[str]) -> None:
        if wrong.any():
            row, joint = np.argwhere(wrong)[0]
            where = f"{path}:{raw.line[row]}"
            raise _refusal(kind, where, float(values[row, joint]), names[joint], _FARTHEST)

    given = np.isfinite(q)
    partly = given.any(axis=1) & ~given.all(axis=1)
    if partly.any():
        row = int(np.argmax(partly))
        raise _refusal("seed", f"{path}:{raw.line[row]}", joints[int(np.argmin(given[row]))])
    refuse("far", np.abs(q) > _FARTHEST, q, joints)
    wrong = ~np.isnan(arrival) & ~np.isin(arrival, (-1.0, 0.0, 1.0))
    refuse("arrival", wrong, arrival, sides)
    return raw, JointList(
        ids=raw.text_of("id"),
        q=in_radians(q, prismatic),
        load_N=raw.numbers_of([_LOAD])[:, 0],
        arrival=arrival,
        unused=raw.unused,
    )


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
        words += [_field(float(u)), _field(bool(within)), *([forced] if forced else [])]
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
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{float(value):.9f}"
    return str(value)
