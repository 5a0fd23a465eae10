"""Poses as robot controllers read and show them: millimetres, and angles of their conventions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError

#: `ABC` of KUKA: about z, the new y, the new x; `rpy`: about fixed x, y, z (W, P, R of Fanuc);
#: `rotation_vector`: of Universal Robots.
Angles = Literal["ABC", "quaternion", "rpy", "rotation_vector"]


class _Convention(NamedTuple):
    """How an orientation is written as numbers."""

    columns: tuple[str, ...]  # 3 or 4 names
    write: Callable[[Rotation], Array]  # N rotations as (N, 3 or 4)
    read: Callable[[Array], Rotation]  # numbers (3 or 4,) as a rotation


_CONVENTIONS: dict[str, _Convention] = {
    "ABC": _Convention(
        ("A_deg", "B_deg", "C_deg"),
        lambda R: R.as_euler("ZYX", degrees=True),
        lambda abc: Rotation.from_euler("ZYX", abc, degrees=True),
    ),
    "quaternion": _Convention(
        ("qw", "qx", "qy", "qz"),
        lambda R: R.as_quat(canonical=True, scalar_first=True),
        lambda quaternion: Rotation.from_quat(quaternion, scalar_first=True),
    ),
    "rpy": _Convention(
        ("roll_deg", "pitch_deg", "yaw_deg"),
        lambda R: R.as_euler("ZYX", degrees=True)[:, ::-1],
        lambda rpy: Rotation.from_euler("ZYX", rpy[::-1], degrees=True),
    ),
    "rotation_vector": _Convention(
        ("rx_rad", "ry_rad", "rz_rad"),
        lambda R: R.as_rotvec(),
        lambda vector: Rotation.from_rotvec(vector),
    ),
}
_POSITION = ("x_mm", "y_mm", "z_mm")
#: Largest error of a quaternion's length by rounding: beyond it the numbers are no quaternion.
_UNIT_LENGTH = 1e-2


def controller_columns(T: Array, angles: Angles) -> dict[str, Array]:
    """Return poses (N, 4, 4) [m] in the form of a controller.

    Args:
        angles: `ABC`, intrinsic z-y-x in degrees; `quaternion`, scalar first; `rpy`, roll, pitch
            and yaw about fixed axes x, y, z in degrees; `rotation_vector`, axis times angle [rad].

    Returns:
        `x_mm`, `y_mm`, `z_mm` and the orientation's columns, (N,) each.

    Raises:
        ArmError: when the angle convention is unknown.
    """
    convention = _convention(angles)
    with warnings.catch_warnings():
        # At B = ±90 degrees A and C are not unique; scipy warns and sets one to zero.
        warnings.simplefilter("ignore")
        orientation = convention.write(Rotation.from_matrix(T[:, :3, :3]))
    values = np.column_stack([1e3 * T[:, :3, 3], orientation])
    return dict(zip((*_POSITION, *convention.columns), values.T, strict=True))


def controller_pose(values: Sequence[float], angles: Angles) -> Array:
    """Return the pose (4, 4) [m] of a controller's numbers, ordered as `controller_columns`.

    Raises:
        ArmError: when the angle convention is unknown, or the numbers are no pose in it.
    """
    convention = _convention(angles)
    names = (*_POSITION, *convention.columns)
    numbers = np.asarray(values, dtype=float)
    wrong = numbers.shape != (len(names),) or not np.isfinite(numbers).all()
    if not wrong and angles == "quaternion":
        wrong = abs(float(np.linalg.norm(numbers[3:])) - 1.0) > _UNIT_LENGTH
    if wrong:
        raise ArmError(
            "not the pose of a tool in the flange",
            where="tcp",
            value=list(values),
            allowed=" ".join(names),
            remedy=f"give {len(names)} numbers as the controller shows its TCP",
        )
    return homogeneous(convention.read(numbers[3:]).as_matrix(), 1e-3 * numbers[:3])


def _convention(angles: str) -> _Convention:
    if angles not in _CONVENTIONS:
        raise ArmError(
            "unknown angle convention",
            where="angles",
            value=angles,
            allowed=", ".join(get_args(Angles)),
            remedy="choose those of your controller",
        )
    return _CONVENTIONS[angles]
