"""Measured configurations as pictures need them: where the end-effector and the joints were."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RecordError
from pa10cal.figures.record_files import read_pose_table

Array = NDArray[np.float64]

_JOINT = re.compile(r"q(\d+)_(rad|m)")


@dataclass(frozen=True)
class Poses:
    """Measured configurations in order of time.

    Attributes:
        kind, pose: (N,) kind and label.
        load_N: (N,) external load.
        repeat: (N,) number of the repeat.
        p_instr_mm: (N, 3) end-effector in the instrument's frame.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    p_instr_mm: Array


@dataclass(frozen=True)
class JointPositions:
    """Where the joints stood in N measured configurations, in order of time.

    Attributes:
        kind, pose: (N,) kind and label.
        load_N: (N,) external load.
        q: (N, n) joint positions, rad; m of a joint that slides.
        slides: (n,) which joints slide.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    q: Array
    slides: NDArray[np.bool_]

    def of(self, configurations: Sequence[tuple[str, float]]) -> Array:
        """Return the joint positions (P, n) of poses at loads, the mean over their repeats.

        Raises:
            RecordError: when one of them is not among the measured configurations.
        """
        rows = {key: k for k, key in enumerate(dict.fromkeys(configurations))}
        number = [rows.get(key, -1) for key in zip(self.pose, self.load_N, strict=True)]
        group = np.array(number, dtype=np.intp)
        known = group >= 0
        count = np.bincount(group[known], minlength=len(rows))
        if not count.all():
            pose, load_N = list(rows)[int(np.argmin(count))]
            raise RecordError(
                "a pose of the results is not in the table of poses",
                where="ingest/poses.parquet",
                value=f"{pose} at {load_N:g} N",
                allowed="results of the poses that ingest wrote",
                remedy="run the calibrate and evaluate stages again",
            )
        total = np.zeros((len(rows), self.q.shape[1]))
        np.add.at(total, group[known], self.q[known])
        mean = total / count[:, None]
        return np.asarray(mean[[rows[key] for key in configurations]])


def read_poses(path: Path, campaign: str) -> Poses:
    """Read the end-effector's places of `ingest/poses.parquet`, in order of time."""
    place = ("ee_x_mm", "ee_y_mm", "ee_z_mm")
    columns = ("kind", "pose", "load_N", "repeat", "time_s", *place)
    rows = read_pose_table(path, columns, campaign).to_pydict()
    return Poses(
        kind=np.array(rows["kind"], dtype=np.str_),
        pose=np.array(rows["pose"], dtype=np.str_),
        load_N=np.array(rows["load_N"], dtype=np.float64),
        repeat=np.array(rows["repeat"], dtype=np.int64),
        p_instr_mm=np.column_stack([np.array(rows[name], dtype=np.float64) for name in place]),
    )


def read_joints(path: Path, campaign: str) -> JointPositions:
    """Read the joint positions of `ingest/poses.parquet`, in order of time."""
    table = read_pose_table(path, (), campaign)
    found = [_JOINT.fullmatch(name) for name in table.column_names]
    columns = sorted((int(name[1]), name[2], name[0]) for name in found if name)
    return JointPositions(
        kind=np.array(table["kind"].to_pylist(), dtype=np.str_),
        pose=np.array(table["pose"].to_pylist(), dtype=np.str_),
        load_N=table["load_N"].to_numpy(),
        q=np.column_stack([table[name].to_numpy() for _, _, name in columns]),
        slides=np.array([unit == "m" for _, unit, _ in columns]),
    )
