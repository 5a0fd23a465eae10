"""The table of poses: measured configurations as Parquet, and back as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.state import PoseStates
from pa10cal.campaign.description import Campaign
from pa10cal.campaign.measured import MeasuredPoses
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.registry import instruments

Array = NDArray[np.float64]

SCHEMA = "pa10cal-poses/1"
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


def read_observations(path: Path, campaign: Campaign) -> Observations:
    """Read the table of poses as single readings of all kinds, in the order of the table.

    Args:
        path: the file.
        campaign: description of the campaign it must be of.

    Raises:
        RawDataError: when the file is missing, is no such table, or is of another campaign.
    """
    table = read_pose_table(path, campaign.name)
    return _observations({str(name): table[name].to_numpy() for name in table}, campaign)


def observations_of(poses: MeasuredPoses, campaign: Campaign) -> Observations:
    """Return measured configurations as single readings of all kinds, in order of time."""
    return _observations({name: np.asarray(x) for name, x in _columns(poses).items()}, campaign)


def _observations(columns: dict[str, NDArray[Any]], campaign: Campaign) -> Observations:
    n = sum(name.startswith("tau") and name.endswith("_u_Nm") for name in columns)
    slides = np.array([f"q{joint}_m" in columns for joint in range(1, n + 1)])

    def stacked(names: Sequence[str]) -> Array:
        return np.column_stack([columns[name] for name in names]).astype(float)

    states = PoseStates(
        q_rad=stacked(_position_columns(slides)),
        tau_Nm=stacked(_joint_columns("tau", n, "_Nm")),
        arrival=stacked(_joint_columns("s", n, "")),
        load_N=columns["load_N"].astype(float),
        temperature_C=columns["temperature_C"].astype(float),
        time_s=columns["time_s"].astype(float),
    )
    return Observations(
        pose=columns["pose"].astype(str),
        states=states,
        measured=instruments()[campaign.instrument.kind].from_columns(columns, campaign.stated),
        kind=columns["kind"].astype(str),
        repeat=columns["repeat"].astype(np.int64),
        readings=np.ones(len(columns["pose"]), dtype=np.int64),
        log=JointLog(
            stacked(_position_columns(slides, "_u")),
            stacked(_joint_columns("tau", n, "_u_Nm")),
            columns["dwell_samples"].astype(np.int64),
        ),
    )


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
