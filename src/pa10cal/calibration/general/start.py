"""Where base, tool and targets are before the fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.campaign.seen import SeenPoints, SeenPoses, Sightings
from pa10cal.frame.hand_eye import hand_eye_from_points, hand_eye_from_poses
from pa10cal.frame.ranging import range_from_distances

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """Frames about where they are.

    Attributes:
        T_instr_base: (4, 4) base in the instrument's frame [m].
        p_ee_target_m: (3,) origin of the tool frame in the end-effector frame, where the
            instrument gives poses.
        R_ee_target: (3, 3) attitude of that frame; measured attitudes are turned by it, so that
            what is left of the tool's attitude is small.
        places_m: (t,) places of targets in the end-effector frame, x, y, z of each.
    """

    T_instr_base: Array
    p_ee_target_m: Array
    R_ee_target: Array
    places_m: Array


def turned(sightings: Sightings, start: Start) -> Sightings:
    """Return the sightings with attitudes of the end-effector in place of those of the target."""
    if not isinstance(sightings.seen, SeenPoses):
        return sightings
    T = sightings.seen.T_instr_target.copy()
    T[:, :3, :3] = T[:, :3, :3] @ start.R_ee_target.T
    return replace(sightings, seen=replace(sightings.seen, T_instr_target=T))


def find_start(arm: Arm, sightings: Sightings) -> Start:
    """Find frames and targets by the nominal arm, from any place of instrument and target.

    Raises:
        CalibrationError: when the poses do not fix them.
    """
    seen = sightings.seen
    T_base_ee = Chain.of(arm).forward(sightings.states.q_rad)
    if isinstance(seen, SeenPoses):
        found = hand_eye_from_poses(T_base_ee, seen.T_instr_target)
        T_ee_target = found.T_ee_targets[0]
        return Start(found.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], np.zeros(0))
    if isinstance(seen, SeenPoints):
        found = hand_eye_from_points(
            T_base_ee, seen.p_instr_m, seen.p_ee_stated_m, names=seen.names
        )
        places_m = found.T_ee_targets[:, :3, 3].ravel()
        return Start(found.T_instr_base, np.zeros(3), np.eye(3), places_m)
    ranged = range_from_distances(T_base_ee, seen.d_m)
    T_instr_base = np.eye(4)
    T_instr_base[:3, 3] = -ranged.p_base_point_m
    return Start(T_instr_base, np.zeros(3), np.eye(3), ranged.p_ee_target_m)
