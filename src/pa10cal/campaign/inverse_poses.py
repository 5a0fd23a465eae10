"""Poses of the instrument in the target's frame, as a camera on the flange sees a board.

A target's pose in the instrument's frame is (R, p), and the inverse one (R', -R' p). Which of both
a file holds is decided by the nominal arm: base and target fitted, only one of them agrees with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, spread
from pa10cal.campaign.conventions import (
    AGREES_RAD,
    ENOUGH,
    EXPECTED_M,
    MOST,
    NEARER,
    attitude_misfit,
    puts_right,
)
from pa10cal.campaign.nominal_fit import placed_at_least_distances
from pa10cal.campaign.own_columns import Inverse, RotationColumns
from pa10cal.campaign.raw_file import quaternions


class OtherInverse(NamedTuple):
    """What else than stated is inverse of measured poses, if only that agrees with the arm."""

    inverse: Inverse  # as `rotation.inverse` states it
    as_read_m: float  # median misfit of the positions to the nominal arm, base and target fitted
    would_leave_m: float  # the same if the poses are read so


def inverse_poses(p_m: Array, R: Array) -> tuple[Array, Array]:
    """Return positions (P, 3) and orientations (P, 3, 3) of the inverse poses."""
    R_inverse = np.swapaxes(R, 1, 2)
    return -(R_inverse @ p_m[:, :, None])[:, :, 0], R_inverse


def other_inverse(T_base_ee: Array, p_m: Array, R: Array, stated: Inverse) -> OtherInverse | None:
    """Return which of the poses (P, 3), (P, 3, 3) of a target is inverse, if not as stated.

    None where positions are as of right data as read, or where nothing else makes them so, with
    orientations that agree.
    """
    some = spread(len(p_m), MOST)
    T_base_ee, p_m, R = T_base_ee[some], p_m[some], R[some]
    as_read = pose_misfit(T_base_ee, p_m, R)
    if len(p_m) < ENOUGH or (as_read is not None and puts_right(as_read[0], EXPECTED_M)):
        return None
    as_read_m = np.inf if as_read is None else as_read[0]
    if stated == "pose":
        p_inverse_m, R_inverse = inverse_poses(p_m, R)
        tried: dict[Inverse, tuple[Array, Array]] = {
            False: (p_inverse_m, R_inverse),
            True: (p_inverse_m, R),
        }
    else:
        tried = {"pose": inverse_poses(p_m, np.swapaxes(R, 1, 2) if stated else R)}
    for inverse, pose in tried.items():
        misfit = pose_misfit(T_base_ee, *pose)
        if misfit is None or misfit[1] > AGREES_RAD or not puts_right(misfit[0], EXPECTED_M):
            continue
        if NEARER * misfit[0] < as_read_m:
            return OtherInverse(inverse, as_read_m, misfit[0])
    return None


def way_of_inverse_poses(
    T_base_ee: Array, p_m: Array, values: Array, ways: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any] | None:
    """Return the way of reading orientations with which inverse poses agree with the nominal arm.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        p_m: (P, 3) positions of the instrument in the target's frame.
        values: (P, k) numbers of the orientations.
        ways: columns of the orientation, `inverse: pose` in each.
    """
    best: tuple[float, Mapping[str, Any]] | None = None
    for way in ways:
        wxyz = quaternions(values, RotationColumns.model_validate(way))
        R = Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
        misfit = pose_misfit(T_base_ee, -(R @ p_m[:, :, None])[:, :, 0], R)
        if misfit is None or misfit[1] > AGREES_RAD or not puts_right(misfit[0], EXPECTED_M):
            continue
        if best is None or misfit[0] < best[0]:
            best = misfit[0], way
    return None if best is None else best[1]


def pose_misfit(T_base_ee: Array, p_m: Array, R: Array) -> tuple[float, float] | None:
    """Return the median misfits of positions [m] and of orientations [rad].

    Base and target are fitted to the positions; None where these do not determine them.
    """
    located = placed_at_least_distances(T_base_ee, p_m[:, None])
    if located is None:
        return None
    off_m = np.linalg.norm(p_m - located.targets(T_base_ee)[:, 0, :3, 3], axis=1)
    R_ee = located.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]
    return float(np.median(off_m)), attitude_misfit(R_ee, R).median_rad
