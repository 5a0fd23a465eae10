"""Poses drawn over large sweeps of all joints, and a path through them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from pa10cal.arm.description import Arm
from pa10cal.cell.apparatus import BALLS_DESIGN_M
from pa10cal.cell.mechanism import Mechanism
from pa10cal.errors import SimulationError

Array = NDArray[np.float64]

#: Joint angles lie within this part of the range between the limits, about its middle ...
RANGE_USED = 0.8
#: ... and within this of zero.
LARGEST_ANGLE_RAD = np.radians(150.0)
#: Flange and balls stay this far above the base's origin, and this far off the base's axis.
FLOOR_M = 0.15
COLUMN_M = 0.25
_MOST_DRAWS = 1000  #: for each pose wanted


def joint_bounds(arm: Arm) -> tuple[Array, Array]:
    """Return the (n,) least and largest positions drawn [rad, or m of a sliding joint]."""
    low, high = arm.limits_rad.T
    unused = 0.5 * (1.0 - RANGE_USED) * (high - low)
    largest = np.where(arm.prismatic, np.inf, LARGEST_ANGLE_RAD)
    return np.maximum(low + unused, -largest), np.minimum(high - unused, largest)


def draw_wide(arm: Arm, nominal: Mechanism, count: int, rng: np.random.Generator) -> Array:
    """Draw poses evenly in joint space, and keep those in which the tool is clear of the robot.

    Whether links, rods and measuring machine collide otherwise is not looked at.

    Args:
        arm: gives the joint limits.
        nominal: the arm with the geometry its maker describes.
        count: P, how many.
        rng: draws them.

    Returns:
        (P, n) joint angles, in the order in which they were drawn.

    Raises:
        SimulationError: when hardly any posture is clear.
    """
    low, high = joint_bounds(arm)
    found: list[Array] = []
    for _ in range(_MOST_DRAWS * count):
        if len(found) == count:
            break
        q_rad = rng.uniform(low, high)
        if _is_clear(nominal.T_base_ee(q_rad)):
            found.append(q_rad)
    if len(found) < count:
        raise SimulationError(
            "the arm cannot hold its tool clear of floor and column",
            where="poses.layout",
            value=f"{len(found)} of {count} poses after {_MOST_DRAWS * count} draws",
            allowed=f"flange and balls {FLOOR_M:g} m above the base, {COLUMN_M:g} m off its axis",
            remedy="set poses.layout: grid for this arm",
        )
    return np.array(found).reshape(count, arm.n)


def neighbours_path(q_rad: Array) -> Array:
    """Return the poses (P, n) in an order that goes on to the nearest one not yet visited.

    It starts at the first pose; near means the root of the summed squares of joint angles.
    """
    distance = cdist(q_rad, q_rad)
    order = [0]
    for _ in range(len(q_rad) - 1):
        distance[:, order[-1]] = np.inf
        order.append(int(np.argmin(distance[order[-1]])))
    path: Array = q_rad[order]
    return path


def _is_clear(T_base_ee: Array) -> bool:
    """Tell whether flange and balls are clear of the floor and of the robot's column."""
    in_ee_m = np.vstack([np.zeros(3), BALLS_DESIGN_M])
    points_m = in_ee_m @ T_base_ee[:3, :3].T + T_base_ee[:3, 3]
    off_axis_m = np.hypot(points_m[:, 0], points_m[:, 1])
    return bool(points_m[:, 2].min() > FLOOR_M and off_axis_m.min() >= COLUMN_M)
