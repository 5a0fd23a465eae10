"""Poses as if an instrument had measured them, from arrays."""

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose


def measured_poses(
    pose, states: PoseStates, T_instr_ee, cov, by_apparatus=None, readings=None
) -> Observations[Pose]:
    """Return poses to fit, single readings unless their number is given."""
    count = len(pose)
    apart = np.zeros((count, 6, 0)) if by_apparatus is None else by_apparatus
    ones = np.ones(count, dtype=np.int64)
    return Observations(
        np.asarray(pose),
        states,
        Pose(T_instr_ee, cov, apart),
        np.full(count, "grid"),
        ones,
        ones if readings is None else np.asarray(readings),
    )


def shifted(readings, shift_m, rows=slice(None)):
    """Return readings of which some are seen elsewhere, by (P, 3) or (3,)."""
    T = readings.measured.T_instr_target.copy()
    T[rows, :3, 3] += shift_m
    return readings.with_measured(T_instr_target=T)
