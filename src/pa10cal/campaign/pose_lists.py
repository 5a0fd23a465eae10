"""Lists of poses for a model: joint positions to predict, targets to compensate, the answers.

Nothing of such a list is dropped: a row that cannot be read refuses the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Mask
from pa10cal.campaign.column_map import QUATERNION
from pa10cal.campaign.csv_rows import CUT, column_names, read_rows
from pa10cal.campaign.joint_positions import in_radians, position_columns
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.errors import RawDataError
from pa10cal.files.table_cells import csv_line, csv_text

_PLACE = ("x_mm", "y_mm", "z_mm")
_OF_POSE = ("load_N", "temperature_C", "time_s")
_MM = 1e-3
#: A quaternion may differ from length one by this, as few digits are written.
_UNIT = 1e-2
#: Targets that are all nearer to the base than this are in metres [mm].
_NEAREST_MM = 10.0
#: Largest position of a joint [deg, mm].
_FARTHEST = 1e5
_JOINT = re.compile(r"q\d+_\w+")


@dataclass(frozen=True, kw_only=True)
class JointList:
    """Joint positions as a file lists them."""

    ids: NDArray[np.str_]  # (N,) names of the rows
    q: Array  # (N, n) joint positions [rad, m]; of targets seeds of the solution, nan where none
    load_N: Array  # (N,) external loads; nan where none is given
    arrival: Array  # (N, n) direction of arrival of each joint, -1, 0 or 1; nan where not given
    temperature_C: Array  # (N,) temperatures; nan where none is given
    time_s: Array  # (N,) times on the campaign's clock; nan where none is given
    unused: tuple[str, ...] = ()  # columns that are not read


@dataclass(frozen=True, kw_only=True)
class TargetList(JointList):
    """Targets as a file lists them."""

    T: Array  # (N, 4, 4) poses [m]


def read_joints(path: Path, prismatic: Mask) -> JointList:
    """Read `id,q1_deg,…` (`qk_mm` for a prismatic joint), and the state of each pose.

    `load_N`, `temperature_C`, `time_s` and `arrival1`, … are optional, and may be blank.

    Raises:
        RawDataError: naming file and line, when a column is missing or of another arm, or a row
            cannot be read.
    """
    _, listed = _read(path, prismatic, position_columns(prismatic))
    return listed


def read_targets(path: Path, prismatic: Mask) -> TargetList:
    """Read `id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,q1_deg,…]`; seeds may be blank; see `read_joints`.

    Raises:
        RawDataError: as `read_joints`; also for a quaternion not of length one, and for metres.
    """
    raw, listed = _read(path, prismatic, [*_PLACE, *QUATERNION])
    p_mm, quaternion = raw.numbers_of(_PLACE), raw.numbers_of(QUATERNION)
    length = np.linalg.norm(quaternion, axis=1)
    off = np.abs(length - 1.0) > _UNIT
    if off.any():
        row = int(np.argmax(off))
        raise RawDataError(
            "the quaternion is not of length one",
            where=f"{path}:{raw.line[row]}",
            value=f"{length[row]:.6g}",
            allowed="qw, qx, qy, qz, whose squares add up to 1",
            remedy="check the columns' order, or write more digits",
        )
    if (furthest := float(np.abs(p_mm).max())) < _NEAREST_MM:
        raise RawDataError(
            "x_mm, y_mm, z_mm: no target is further than a hundredth of a metre from the base",
            where=f"{path}:{raw.line[0]}",
            value=furthest,
            allowed="millimetres in the robot's base frame",
            remedy="multiply by 1000 if these are metres",
        )
    T = np.tile(np.eye(4), (len(raw), 1, 1))
    T[:, :3, 3] = _MM * p_mm
    T[:, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return TargetList(**vars(listed), T=T)


def _read(path: Path, prismatic: Mask, required: Sequence[str]) -> tuple[RawRows, JointList]:
    """Read a list of joints or targets: its rows, and what both kinds of list hold."""
    joints = position_columns(prismatic)
    sides = [f"arrival{joint}" for joint in range(1, len(joints) + 1)]
    _refuse_other_names(path, joints, ["id", *required])
    together = () if joints[0] in required else joints
    raw = read_rows(path, ["id", *required], [*_OF_POSE, *sides], together, repeats=True)
    raw = raw.finite(required).finite([*together, *_OF_POSE, *sides], may_be_blank=True)
    if raw.quarantined:
        first = min(raw.quarantined, key=lambda row: row.line)
        remedy = "correct the row, or remove it"
        if first.reason == CUT:
            remedy = "end it with a line break if it is whole"
        raise RawDataError(
            first.reason,
            where=f"{path}:{first.line}",
            value=first.value or None,
            allowed="rows that can all be used: none is dropped",
            remedy=remedy,
        )
    q, arrival = raw.numbers_of(joints), raw.numbers_of(sides)

    given = np.isfinite(q)
    partly = given.any(axis=1) & ~given.all(axis=1)
    if partly.any():
        row = int(np.argmax(partly))
        raise RawDataError(
            "the seed lacks joints",
            where=f"{path}:{raw.line[row]}",
            value=joints[int(np.argmin(given[row]))],
            allowed="all joints, or none",
            remedy="complete the row, or leave its joints blank",
        )
    if len(far := np.argwhere(np.abs(q) > _FARTHEST)):
        row, joint = far[0]
        raise RawDataError(
            f"{joints[joint]} is no position of a joint",
            where=f"{path}:{raw.line[row]}",
            value=float(q[row, joint]),
            allowed=f"up to {_FARTHEST:g}",
            remedy="check the unit",
        )
    if len(wrong := np.argwhere(~np.isnan(arrival) & ~np.isin(arrival, (-1.0, 0.0, 1.0)))):
        row, joint = wrong[0]
        raise RawDataError(
            f"{sides[joint]} is no direction of arrival",
            where=f"{path}:{raw.line[row]}",
            value=float(arrival[row, joint]),
            allowed="-1 or 1, the sign of the joint's last motion; 0 or blank where it is not "
            "known",
            remedy="correct the value",
        )
    return raw, JointList(
        ids=raw.text_of("id"),
        q=in_radians(q, prismatic),
        arrival=arrival,
        **dict(zip(_OF_POSE, raw.numbers_of(_OF_POSE).T, strict=True)),
        unused=raw.unused,
    )


def _refuse_other_names(path: Path, joints: Sequence[str], required: Sequence[str]) -> None:
    """Refuse columns of joints that the arm does not have, and a campaign's name of the labels."""
    names = column_names(path)
    if others := [name for name in names if _JOINT.fullmatch(name) and name not in joints]:
        raise RawDataError(
            "a column of another arm, or in another unit",
            where=f"{path}:1",
            value=others[0],
            allowed=", ".join(joints),
            remedy="give a model of the same arm, or its joints, each in the unit of its name",
        )
    if "id" not in names and "pose" in names:
        raise RawDataError(
            "missing column id",
            where=f"{path}:1",
            value=", ".join(names),
            allowed=", ".join(required),
            remedy="rename pose to id",
        )


def poses_text(
    ids: NDArray[np.str_], T: Array, columns: Mapping[str, NDArray[Any]], *, header: bool = True
) -> str:
    """Return poses (N, 4, 4) as `id,x_mm,y_mm,z_mm,qw,qx,qy,qz` and further columns (N,).

    Rows that follow others have no header.
    """
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    numbers = [
        (name, values, ".9f") for name, values in zip(_PLACE, T[:, :3, 3].T / _MM, strict=True)
    ]
    numbers += [(name, values, ".12f") for name, values in zip(QUATERNION, q.T, strict=True)]
    return _answers(ids, numbers, columns, header=header)


def commands_text(
    ids: NDArray[np.str_],
    q: Array,
    prismatic: Mask,
    columns: Mapping[str, NDArray[Any]],
    *,
    header: bool = True,
) -> str:
    """Return joint positions (N, n) as `id,q1_deg,…` and further columns (N,).

    Rows that follow others have no header.
    """
    positions, names = np.where(prismatic, q / _MM, np.degrees(q)), position_columns(prismatic)
    numbers = [(name, values, ".10f") for name, values in zip(names, positions.T, strict=True)]
    return _answers(ids, numbers, columns, header=header)


def _answers(
    ids: NDArray[np.str_],
    numbers: Sequence[tuple[str, Array, str]],
    columns: Mapping[str, NDArray[Any]],
    *,
    header: bool = True,
) -> str:
    """Return a table with a row for each id, whose cell is quoted where necessary."""
    cells = [[format(value, form) for value in values] for _, values, form in numbers]
    cells += [list(map(_field, values)) for values in columns.values()]
    names = ["id", *(name for name, _, _ in numbers), *columns]
    rows = zip(map(str, ids), *cells, strict=True)
    return csv_text(names, rows) if header else "".join(map(csv_line, rows))


def _field(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{float(value):.9f}"
    return str(value)
