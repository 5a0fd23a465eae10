"""Attitudes as roll, pitch and yaw about fixed axes x, y and z, as URDF and arm files hold them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array


def roll_pitch_yaw(R: Array) -> Array:
    """Return angles (3,) [rad] that give a rotation (3, 3) back to the last digit.

    At a pitch of 90 degrees roll and yaw are not unique; any yaw will do there, because roll is
    the rotation that remains after pitch and yaw.
    """
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    left = Rotation.from_euler("xyz", [0.0, pitch, yaw]).as_matrix().T @ R
    roll = np.arctan2(left[2, 1] - left[1, 2], left[1, 1] + left[2, 2])
    return np.array([roll, pitch, yaw])


def placed(p: Array, rpy: Array) -> Array:
    """Return the pose (4, 4) of a frame at p (3,) with roll, pitch and yaw (3,) [rad]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = p
    return T
