"""The difference of two poses as six numbers, and its derivative.

Orientation is compared by twice the vector part of the quaternion of the difference: its length is
2 sin(angle / 2), the chord of the angle, so that the sum of squares is the one that orthogonal
Procrustes minimises in closed form; it is smooth, and departs from the angle by angle^3 / 24.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array


@dataclass(frozen=True)
class PoseError:
    """Difference of predicted and measured poses, along the measuring frame's axes."""

    position_m: Array  # (P, 3) predicted minus measured
    chord: Array  # (P, 3) orientation difference: axis times 2 sin(angle / 2)
    by_rotation: Array  # (P, 3, 3) derivative of `chord` by a small left rotation of the prediction


def pose_error(T_predicted: Array, T_measured: Array) -> PoseError:
    """Compare poses (P, 4, 4) given in the same frame."""
    difference = T_predicted[:, :3, :3] @ T_measured[:, :3, :3].transpose(0, 2, 1)
    quaternion = Rotation.from_matrix(difference).as_quat(canonical=True)
    vector, scalar = quaternion[:, :3], quaternion[:, 3]
    by_rotation = scalar[:, None, None] * np.eye(3) - cross_matrix(vector)
    return PoseError(T_predicted[:, :3, 3] - T_measured[:, :3, 3], 2.0 * vector, by_rotation)


def angle_rad(error: PoseError) -> Array:
    """Return the angle of the orientation difference, (P,)."""
    half_chord: Array = np.linalg.norm(error.chord, axis=1) / 2.0
    return 2.0 * np.arcsin(np.minimum(half_chord, 1.0))


def cross_matrix(vector: Array) -> Array:
    """Return the matrices [v]x (..., 3, 3) with [v]x u = v × u."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix
