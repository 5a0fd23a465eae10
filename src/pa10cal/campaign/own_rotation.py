"""Attitudes in a user's own convention to quaternions, with their uncertainties."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.campaign.own_columns import RotationColumns

#: How many columns a convention takes; three where it is not here.
COLUMNS = {"quaternion_wxyz": 4, "quaternion_xyzw": 4, "matrix": 9}
#: A matrix may differ from a rotation by so much in an element of its product with its transpose.
NOT_ORTHONORMAL = 0.02
#: Step of each number for the derivative of the quaternion by it, of numbers of order one.
_STEP = 1e-6


def quaternions(values: Array, columns: RotationColumns) -> Array:
    """Return quaternions (N, 4), scalar first, of the numbers (N, k) that the columns hold.

    Quaternions keep their length, so that what reads them can tell those that are none.
    """
    word = columns.convention
    if word.startswith("quaternion"):
        found = values if word.endswith("wxyz") else values[:, [3, 0, 1, 2]]
        return np.where([True, *3 * [not columns.inverse]], found, -found)
    rotation = _read(values, word, degrees=columns.unit == "deg")
    rotation = rotation.inv() if columns.inverse else rotation
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def no_rotation(values: Array, columns: RotationColumns) -> NDArray[np.bool_]:
    """Return the rows (N,) of a matrix that is no rotation."""
    if columns.convention != "matrix":
        return np.zeros(len(values), dtype=bool)
    R = values.reshape(-1, 3, 3)
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray((off > NOT_ORTHONORMAL) | (np.linalg.det(R) < 0.0))


def quaternion_uncertainty(values: Array, u: Array, columns: RotationColumns) -> Array:
    """Return the standard uncertainties (N, 4) of the quaternions' components.

    The numbers err independently of each other.

    Args:
        values: (N, k) numbers of the columns.
        u: (N, k) their standard uncertainties, in the same unit.
        columns: what they are.
    """
    square = np.zeros((len(values), 4))
    for k in range(values.shape[1]):
        square += (_derivative(lambda x: quaternions(x, columns), values, k) * u[:, [k]]) ** 2
    return np.sqrt(square)


def _derivative(of: Callable[[Array], Array], values: Array, k: int) -> Array:
    step = np.zeros(values.shape[1])
    step[k] = _STEP
    ahead, behind = of(values + step), of(values - step)
    # A quaternion and its negative are one rotation.
    same = np.where(np.sum(ahead * behind, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.asarray((ahead - same * behind) / (2.0 * _STEP))


def _read(values: Array, word: str, *, degrees: bool) -> Rotation:
    if word == "matrix":
        return Rotation.from_matrix(values.reshape(-1, 3, 3))
    if word == "rotation_vector":
        return Rotation.from_rotvec(values, degrees=degrees)
    sequence = "xyz" if word == "rpy" else word.rpartition("_")[2]
    # Capitals turn along, as SciPy has it too.
    return Rotation.from_euler(sequence, values, degrees=degrees)
