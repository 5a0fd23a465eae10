"""Poses from an instrument that gives them directly (a 6-D tracker) to measured configurations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.campaign.description import Campaign
from pa10cal.campaign.grouping import configurations
from pa10cal.campaign.logs import TrackedPoses, read_tracked_poses
from pa10cal.campaign.measured import Ingested, MeasuredPoses
from pa10cal.campaign.outliers import (
    OFF_MODEL,
    OFF_REPEATS,
    OUT_OF_REACH,
    off_model,
    off_repeats,
    out_of_reach,
)
from pa10cal.campaign.plausibility import (
    OTHER_COMMAND,
    SAME_COMMAND_DEG,
    off_command,
    refuse_wrong_angle_unit,
    refuse_wrong_length_unit,
)
from pa10cal.campaign.quarantine import LeftOut, left_out, refuse_too_many
from pa10cal.settings import IngestSettings

Array = NDArray[np.float64]

#: An attitude without a stated uncertainty is as sure as targets this far apart make it.
TARGET_SPREAD_MM = 100.0
NO_TORQUES = "no torques logged: springs cannot be identified"


def poses_from_tracker(
    campaign: Campaign, arm: Arm, folder: Path, settings: IngestSettings
) -> Ingested:
    """Read a campaign of an instrument that gives positions and attitudes.

    Args:
        campaign: its description.
        arm: the nominal arm.
        folder: its folder.
        settings: the `ingest` section.

    Returns:
        One entry a row: no balls, no approach (arrivals are 0) and no dwell; what was not logged
        is nan.

    Raises:
        RawDataError: when the file, or too much of it, cannot be used.
    """
    path = folder / str(campaign.files.poses)
    rows, read = read_tracked_poses(path, arm.n, kind_stated=campaign.holdout is None)
    listed = list(read.left_out)
    _, first = np.unique(configurations(rows), return_index=True)
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    listed += left_out(read.file, rows.line[again], "this configuration was read before")
    rows = rows.take(~again)
    refuse_too_many(listed, {read.file: read.total}, settings.max_quarantined_fraction)
    rows, outliers = _without_outliers(rows, arm, path)
    listed += outliers
    q_rad = np.radians(rows.q_deg)
    off = off_command(rows.pose, q_rad) > SAME_COMMAND_DEG
    listed += left_out(read.file, rows.line[off], OTHER_COMMAND, rows.pose[off])
    refuse_too_many(listed, {read.file: read.total}, settings.max_quarantined_fraction)
    poses = _measured(rows, q_rad, campaign.instrument.uncertainty_mm).take(~off)
    notes = (*read.notes, NO_TORQUES) if np.isnan(poses.tau_Nm).all() else read.notes
    return Ingested(poses, tuple(listed), notes)


def _without_outliers(
    rows: TrackedPoses, arm: Arm, path: Path
) -> tuple[TrackedPoses, tuple[LeftOut, ...]]:
    """Refuse wrong units, and leave out single readings that cannot be of their pose."""
    far = out_of_reach(rows.p_cmm_ee_mm, arm)
    listed = left_out(path.name, rows.line[far], OUT_OF_REACH, _places(rows.take(far)))
    rows = rows.take(~far)
    log, places = (rows.time_s, rows.q_deg), (rows.time_s, rows.p_cmm_ee_mm)
    refuse_wrong_angle_unit(log, places, arm, 0.0, f"{path}: q1_deg … q{arm.n}_deg")
    nominal_mm = 1e3 * Chain.of(arm).forward(np.radians(rows.q_deg))[:, :3, 3]
    refuse_wrong_length_unit(rows.p_cmm_ee_mm, nominal_mm, f"{path}: x_mm, y_mm, z_mm")
    other = off_repeats(rows.p_cmm_ee_mm, rows.pose, rows.load_N)
    listed += left_out(path.name, rows.line[other], OFF_REPEATS, _places(rows.take(other)))
    rows, nominal_mm = rows.take(~other), nominal_mm[~other]
    stray = off_model(rows.p_cmm_ee_mm, nominal_mm)
    listed += left_out(path.name, rows.line[stray], OFF_MODEL, _places(rows.take(stray)))
    return rows.take(~stray), listed


def _places(rows: TrackedPoses) -> list[str]:
    return [f"x_mm, y_mm, z_mm = {x:g}, {y:g}, {z:g}" for x, y, z in rows.p_cmm_ee_mm]


def _measured(rows: TrackedPoses, q_rad: Array, uncertainty_mm: float) -> MeasuredPoses:
    count = len(rows)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows.quaternion, scalar_first=True).as_matrix()
    T[:, :3, 3] = rows.p_cmm_ee_mm
    return MeasuredPoses(
        kind=rows.kind,
        pose=rows.pose,
        load_N=rows.load_N,
        repeat=rows.repeat,
        time_s=rows.time_s,
        q_rad=q_rad,
        q_u_rad=np.radians(rows.q_u_deg),
        tau_Nm=rows.tau_Nm,
        tau_u_Nm=rows.tau_u_Nm,
        arrival=np.zeros_like(q_rad),
        temperature_C=rows.temperature_C,
        dwell_samples=np.zeros(count, dtype=np.int64),
        ball_names=(),
        p_cmm_balls_mm=np.zeros((count, 0, 3)),
        cov_balls_mm2=np.zeros((count, 0, 3, 3)),
        ball_touches=np.zeros((count, 0), dtype=np.int64),
        T_cmm_ee_mm=T,
        cov_ee_mm=_covariance(rows, uncertainty_mm),
    )


def _covariance(rows: TrackedPoses, uncertainty_mm: float) -> Array:
    """Return (C, 6, 6) from stated uncertainties, or from that of a centre where there are none.

    A small rotation w on the left changes the quaternion by half its product with it, so that w is
    twice the vector part of dq q*.
    """
    cov = np.zeros((len(rows), 6, 6))
    p_u_mm = np.where(np.isnan(rows.p_u_mm), uncertainty_mm, rows.p_u_mm)
    cov[:, range(3), range(3)] = p_u_mm**2
    scalar, vector = rows.quaternion[:, :1, None], rows.quaternion[:, 1:]
    cross = np.cross(vector[:, None, :], np.eye(3))  # rows v x e_k: the transpose of [v]x
    by_vector = scalar * np.eye(3) + np.swapaxes(cross, 1, 2)
    turning = 2.0 * np.concatenate([-vector[:, :, None], by_vector], axis=2)
    stated = turning @ (rows.quaternion_u[:, :, None] ** 2 * np.swapaxes(turning, 1, 2))
    unstated = np.isnan(rows.quaternion_u.sum(axis=1))
    assumed = (uncertainty_mm / TARGET_SPREAD_MM) ** 2 * np.eye(3)
    cov[:, 3:, 3:] = np.where(unstated[:, None, None], assumed, stated)
    return cov
