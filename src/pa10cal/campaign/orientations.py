"""Orientations and polar readings in a user's own convention, as quaternions and places."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Mask
from pa10cal.campaign.column_map import ANGLES, ANGLES_OF_POLAR, LENGTHS
from pa10cal.campaign.own_columns import Polar, RotationColumns

#: Number of columns by convention; three for all others.
COLUMNS = {"quaternion_wxyz": 4, "quaternion_xyzw": 4, "matrix": 9}
#: Largest element of R R' - I of a matrix R that is taken for a rotation.
NOT_ORTHONORMAL = 0.02
#: Step of the central differences of a quaternion by the numbers that state it.
_STEP = 1e-6


def quaternions(values: Array, columns: RotationColumns) -> Array:
    """Return quaternions (N, 4), scalar first, of the numbers (N, k) in the columns.

    Stated quaternions keep their length, so that those not of unit length can be refused later.
    """
    word = columns.convention
    if word.startswith("quaternion"):
        wxyz = values if word.endswith("wxyz") else values[:, [3, 0, 1, 2]]
        return np.where([True, *3 * [not columns.inverse]], wxyz, -wxyz)  # conjugate if inverse
    degrees = values * ANGLES[columns.unit]
    if word == "matrix":
        rotation = Rotation.from_matrix(values.reshape(-1, 3, 3))
    elif word == "rotation_vector":
        rotation = Rotation.from_rotvec(degrees, degrees=True)
    else:
        # As in SciPy capitals are rotations about moving axes, small letters about fixed ones.
        sequence = "xyz" if word == "rpy" else word.rpartition("_")[2]
        rotation = Rotation.from_euler(sequence, degrees, degrees=True)
    rotation = rotation.inv() if columns.inverse else rotation
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def no_rotation(values: Array, columns: RotationColumns) -> Mask:
    """Return the rows (N,) whose stated matrix is no rotation."""
    if columns.convention != "matrix":
        return np.zeros(len(values), dtype=bool)
    R = values.reshape(-1, 3, 3)
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray((off > NOT_ORTHONORMAL) | (np.linalg.det(R) < 0.0))


def quaternion_uncertainty(values: Array, u: Array, columns: RotationColumns) -> Array:
    """Return the standard uncertainties (N, 4) of the quaternions' components.

    The numbers (N, k) have independent standard uncertainties u (N, k) in the same unit.
    """
    square = np.zeros((len(values), 4))
    for k in range(values.shape[1]):
        step = np.zeros(values.shape[1])
        step[k] = _STEP
        ahead, behind = quaternions(values + step, columns), quaternions(values - step, columns)
        # A quaternion and its negative are one rotation.
        sign = np.where(np.sum(ahead * behind, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        square += ((ahead - sign * behind) / (2.0 * _STEP) * u[:, [k]]) ** 2
    return np.sqrt(square)


def polar_to_xyz(values: Array, polar: Polar, unit: str) -> Array:
    """Return places (N, 3) [mm], x along a horizontal angle of 0, z up.

    The values (N, 3) are horizontal angle, vertical angle, and distance in a unit of lengths.
    """
    horizontal, vertical = np.radians(ANGLES_OF_POLAR[polar.unit]) * values[:, :2].T
    azimuth = -horizontal if polar.horizontal == "clockwise" else horizontal
    zenith = 0.5 * np.pi - vertical if polar.vertical == "horizon" else vertical
    flat = values[:, 2] * np.sin(zenith)
    return LENGTHS[unit] * np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), values[:, 2] * np.cos(zenith)]
    )
