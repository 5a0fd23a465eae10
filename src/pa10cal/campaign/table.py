"""The table of poses: measured configurations as Parquet, and back as arrays."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.state import PoseStates
from pa10cal.campaign.averages import average_repeats, repeat_scatter, with_scatter
from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.campaign.observations import PoseObservations
from pa10cal.errors import RawDataError
from pa10cal.frame.rigid_fit import pose_by_source

Array = NDArray[np.float64]

SCHEMA = "pa10cal-poses/1"
MM = 1e-3
AXES = "xyz"
QUATERNION = ("ee_qw", "ee_qx", "ee_qy", "ee_qz")
COVARIANCE = tuple(f"ee_cov_{i}{j}" for i in range(6) for j in range(i, 6))


def write_pose_table(path: Path, poses: MeasuredPoses, campaign: str) -> None:
    """Write measured configurations as a Parquet table, the same bytes for the same poses.

    Args:
        path: where to write.
        poses: the configurations.
        campaign: name of the campaign, kept in the file's metadata.
    """
    table = pa.table(_columns(poses))
    table = table.replace_schema_metadata({"schema": SCHEMA, "campaign": campaign})
    pq.write_table(table, path, compression="zstd")


def read_pose_table(path: Path, campaign: str | None = None) -> pd.DataFrame:
    """Read the table of poses; see the column list in docs/architecture.md.

    The name of the campaign is in `table.attrs["campaign"]`.

    Args:
        path: the file.
        campaign: name of the campaign it must be of; None for any.

    Raises:
        RawDataError: when the file is missing, is no such table, or is of another campaign.
    """
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise _not_a_table(path, " ".join(str(error).split())) from None
    metadata = table.schema.metadata or {}
    schema = metadata.get(b"schema", b"none").decode()
    if schema != SCHEMA:
        raise _not_a_table(path, f"schema {schema}")
    frame: pd.DataFrame = table.to_pandas()
    found = frame.attrs["campaign"] = metadata[b"campaign"].decode()
    if campaign is not None and found != campaign:
        raise RawDataError(
            "the table of poses is of another campaign",
            where=str(path),
            value=found,
            allowed=f"campaign {campaign!r}",
            remedy="give the table that ingest made of this campaign",
        )
    return frame


def observations(
    table: pd.DataFrame,
    kind: str = "grid",
    loads: Sequence[float] | None = None,
    average: bool = True,
    covariance: Literal["repeats", "instrument"] = "repeats",
) -> PoseObservations:
    """Return the poses of one kind in metres and radians, ordered by pose and load.

    Args:
        table: from `read_pose_table`.
        kind: `grid`, `holdout`, `line_x` or `line_y`.
        loads: external loads wanted [N]; None for all.
        average: whether repeats of the same pose and load become one row (see `average_repeats`).
        covariance: where `cov_ee` comes from. `repeats`: the scatter of repeats, pooled over all
            poses and loads of this kind along the end-effector's axes (the instrument's where too
            little is repeated); `instrument`: its stated uncertainty, propagated. Either is
            divided by the repeats averaged.

    Returns:
        P poses; none when the table holds no such rows.

    Raises:
        RawDataError: when the instrument saw points or distances, and no poses.
    """
    if "ee_x_mm" not in table.columns:
        raise RawDataError(
            "the instrument did not see the end-effector's pose",
            where=f"table of poses of {table.attrs.get('campaign')}",
            allowed="a campaign of kind touch_trigger_cmm or pose",
            remedy="calibrate this campaign with its general model",
        )
    every = _single(table[table["kind"] == kind])
    single = every if loads is None else every.take(np.isin(every.states.load_N, list(loads)))
    poses = average_repeats(single) if average else single
    scatter = repeat_scatter(every)
    if covariance == "repeats" and scatter.is_known:
        return with_scatter(poses, scatter)
    return poses


def _single(rows: pd.DataFrame) -> PoseObservations:
    """Return every row as an observation with the instrument's covariance."""
    rows = in_order(rows)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, 3] = MM * _numbers(rows, [f"ee_{axis}_mm" for axis in AXES])
    T[:, :3, :3] = Rotation.from_quat(_numbers(rows, QUATERNION), scalar_first=True).as_matrix()
    upper = np.triu_indices(6)
    cov_ee = np.zeros((len(rows), 6, 6))
    cov_ee[:, upper[0], upper[1]] = cov_ee[:, upper[1], upper[0]] = _numbers(rows, COVARIANCE)
    scale = np.array([MM, MM, MM, 1.0, 1.0, 1.0])
    return PoseObservations(
        pose=rows["pose"].to_numpy(dtype=str),
        states=states_of(rows),
        T_instr_ee=T,
        cov_ee=cov_ee * np.outer(scale, scale),
        by_apparatus=_by_apparatus(rows, T),
        repeats=np.ones(len(rows), dtype=np.int64),
    )


def in_order(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows of the table in the order of all observations: pose, load, time."""
    return rows.sort_values(["pose", "load_N", "time_s"], kind="stable")


def states_of(rows: pd.DataFrame) -> PoseStates:
    """Return the state of the arm in every row of the table."""
    n = sum(name.startswith("tau") and name.endswith("_u_Nm") for name in rows.columns)
    slides = np.array([f"q{joint}_m" in rows.columns for joint in range(1, n + 1)])
    return PoseStates(
        q_rad=_numbers(rows, _position_columns(slides)),
        tau_Nm=_numbers(rows, _joint_columns("tau", n, "_Nm")),
        arrival=_numbers(rows, _joint_columns("s", n, "")),
        load_N=_numbers(rows, ["load_N"])[:, 0],
        temperature_C=_numbers(rows, ["temperature_C"])[:, 0],
        time_s=_numbers(rows, ["time_s"])[:, 0],
    )


def target_names(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the names of the balls or other targets whose centres the table holds."""
    held = (re.fullmatch(r"ball(\w+)_x_mm", str(name)) for name in table.columns)
    return tuple(found.group(1) for found in held if found)


def targets_m(rows: pd.DataFrame) -> tuple[Array, Array]:
    """Return the centres (P, B, 3) [m] of the targets, and their covariances (P, B, 3, 3)."""
    names = target_names(rows)
    p_instr_mm = np.zeros((len(rows), len(names), 3))
    cov_mm2 = np.zeros((len(rows), len(names), 3, 3))
    for b, name in enumerate(names):
        p_instr_mm[:, b] = _numbers(rows, [f"ball{name}_{axis}_mm" for axis in AXES])
        for i in range(3):
            for j in range(i, 3):
                column = _numbers(rows, [f"ball{name}_c{AXES[i]}{AXES[j]}_mm2"])[:, 0]
                cov_mm2[:, b, i, j] = cov_mm2[:, b, j, i] = column
    return MM * p_instr_mm, MM**2 * cov_mm2


def distances_m(rows: pd.DataFrame) -> tuple[Array, Array]:
    """Return the distances (P,) [m] and their standard uncertainties (P,)."""
    d_m, u_m = MM * _numbers(rows, ["d_mm", "d_u_mm"]).T
    return d_m, u_m


def _by_apparatus(rows: pd.DataFrame, T_instr_ee: Array) -> Array:
    """Return how each measured pose answers to the balls' places on the apparatus."""
    if not target_names(rows):
        return np.zeros((len(rows), 6, 0))
    return pose_by_source(T_instr_ee, *targets_m(rows))


def _numbers(rows: pd.DataFrame, names: Sequence[str]) -> Array:
    return np.array(rows[list(names)], dtype=float)


def _position_columns(slides: NDArray[np.bool_], uncertainty: str = "") -> list[str]:
    """Return the names of the joint positions' columns: q1_rad …, or q1_m of one that slides."""
    units = np.where(slides, "m", "rad")
    return [f"q{joint}{uncertainty}_{unit}" for joint, unit in enumerate(units, start=1)]


def _joint_columns(prefix: str, joints: int, suffix: str) -> list[str]:
    """Return the names of a joint quantity's columns, such as q1_rad … q6_rad."""
    return [f"{prefix}{joint}{suffix}" for joint in range(1, joints + 1)]


def _columns(poses: MeasuredPoses) -> dict[str, object]:
    n = poses.q_rad.shape[1]
    columns: dict[str, object] = {
        "kind": poses.kind.astype(object),
        "pose": poses.pose.astype(object),
        "load_N": poses.load_N,
        "repeat": poses.repeat,
        "time_s": poses.time_s,
    }
    for names, values in (
        (_position_columns(poses.slides), poses.q_rad),
        (_position_columns(poses.slides, "_u"), poses.q_u_rad),
        (_joint_columns("tau", n, "_Nm"), poses.tau_Nm),
        (_joint_columns("tau", n, "_u_Nm"), poses.tau_u_Nm),
        (_joint_columns("s", n, ""), poses.arrival.astype(np.int8)),
    ):
        columns |= dict(zip(names, values.T, strict=True))
    columns["temperature_C"] = poses.temperature_C
    columns["dwell_samples"] = poses.dwell_samples
    for b, name in enumerate(poses.ball_names):
        for k, axis in enumerate(AXES):
            columns[f"ball{name}_{axis}_mm"] = poses.p_instr_balls_mm[:, b, k]
        for i in range(3):
            for j in range(i, 3):
                columns[f"ball{name}_c{AXES[i]}{AXES[j]}_mm2"] = poses.cov_balls_mm2[:, b, i, j]
        columns[f"ball{name}_touches"] = poses.ball_touches[:, b]
    if poses.T_instr_ee_mm is not None and poses.cov_ee_mm is not None:
        columns |= _pose_columns(poses.T_instr_ee_mm, poses.cov_ee_mm)
    if poses.d_mm is not None:
        columns |= {"d_mm": poses.d_mm, "d_u_mm": poses.d_u_mm}
    return columns


def _pose_columns(T_instr_ee_mm: Array, cov_ee_mm: Array) -> dict[str, object]:
    columns: dict[str, object] = {
        f"ee_{axis}_mm": T_instr_ee_mm[:, k, 3] for k, axis in enumerate(AXES)
    }
    quaternion = Rotation.from_matrix(T_instr_ee_mm[:, :3, :3]).as_quat(
        canonical=True, scalar_first=True
    )
    columns |= dict(zip(QUATERNION, quaternion.T, strict=True))
    upper = cov_ee_mm[:, *np.triu_indices(6)]
    return columns | dict(zip(COVARIANCE, upper.T, strict=True))


def _not_a_table(path: Path, value: str) -> RawDataError:
    return RawDataError(
        "the table of poses cannot be read",
        where=str(path),
        value=value,
        allowed=f"a Parquet file of schema {SCHEMA}",
        remedy="run the ingest stage again",
    )
