"""The displacement of the flange under finite joint errors, as a short row of matrix products.

Joint i turns all that lies beyond it about its axis ẑ by its error δ. If the joints further out
have displaced the flange by u, and v runs from the axis to the flange, joint i adds

    sin δ ẑ×(v + u) + (1 - cos δ) ẑ×(ẑ×(v + u)),

which is exact: nothing is linearised. From the tip to the base, so that u stays small and loses no
digits, this is for every joint a constant matrix times the rows (u, sin δ u, (1 - cos δ) u, sin δ,
1 - cos δ), and all that belongs to the pose is in that matrix. Three simplifications, all exact:

- consecutive joints with parallel axes act as one that turns by the sum of their errors; each link
  between them turns by a partial sum;
- the first joint turns the whole arm, and the length of a displacement does not change when
  everything is turned back by δ₁: then the joint moves only the constant nominal position;
- outermost joints whose axes pass through the flange do not move it (their errors are drawn all
  the same).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.montecarlo.small_turns import Turns, turns_of

Array = NDArray[np.float64]

#: Rows of the displacement so far and of its products with sin δ and 1 - cos δ.
STATE_ROWS = 3
PRODUCT_ROWS = 4

#: A joint that moves the flange by less than this per radian does not move it [m].
_STILL_M = 1e-13
#: Axes whose sine of the angle between is below this are parallel.
_PARALLEL = 1e-14

# (u, sin δ u_x, sin δ u_y, (1 - cos δ) u_x, (1 - cos δ) u_y) to the turned u, z along the axis.
_TURN = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, -1.0, -1.0, 0.0],
        [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, -1.0],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
_TURN_IS_SINE = np.array([False, False, False, True, True, False, False])
_TURN_IS_VERSINE = np.array([False, False, False, False, False, True, True])


@dataclass(frozen=True)
class JointMotion:
    """What each joint does to the flange at P positions of the arm.

    Attributes:
        axes: (P, n, 3) unit vectors of the joint axes, in the base frame.
        jacobian: (P, 3, n) velocity of the flange by each joint [m/rad], in the base frame.
    """

    axes: Array
    jacobian: Array


@dataclass(frozen=True)
class DisplacementPlan:
    """Everything constant in the displacement of the flange at P positions.

    Attributes:
        joints: n, all of which are drawn.
        groups: indices of joints with parallel axes that follow each other, from the base to the
            tip; the first group is the first joint alone. Joints that move nothing are left out.
        matrices: for every group but the first, the (P, 3, rows) matrix that takes its rows to the
            displacement in the frame of the group before it; the one of the second group holds
            the first joint's two columns in front. With one group there is one matrix, of the
            first joint.
        turns: how drawn normals become sines and cosines.
    """

    joints: int
    groups: tuple[tuple[int, ...], ...]
    matrices: tuple[Array, ...]
    turns: Turns


def joint_motion(chain: Chain, q_rad: Array) -> JointMotion:
    """Return axes and Jacobian at joint positions (P, n) of an arm whose joints all turn."""
    screws = chain.forward_with_screws(q_rad).screws[:, :, chain.joint_columns]
    return JointMotion(axes=screws[:, 3:].transpose(0, 2, 1), jacobian=screws[:, :3])


def plan_displacement(motion: JointMotion, sigma_rad: float) -> DisplacementPlan:
    """Lay out the displacement for joints that err by `sigma_rad` at the given positions."""
    groups = _groups(motion)
    turns = turns_of(sigma_rad, max(len(group) for group in groups))
    frames = [_frames(motion.axes[:, group[0]]) for group in groups]
    matrices = []
    for index in range(1, len(groups)):
        is_tip = index == len(groups) - 1
        R_base_group = frames[index]
        own = _own_columns(motion, groups[index], turns)
        carried = np.empty((*own.shape[:2], 0)) if is_tip else R_base_group @ _scaled_turn(turns)
        columns = np.concatenate([carried, own], axis=2)
        if index == 1:  # lengths do not care for the frame they are taken in: the base's
            columns = np.concatenate([_first_columns(motion, turns), columns], axis=2)
        else:
            columns = frames[index - 1].transpose(0, 2, 1) @ columns
        matrices.append(np.ascontiguousarray(columns))
    if not matrices:
        matrices.append(np.ascontiguousarray(_first_columns(motion, turns)))
    return DisplacementPlan(motion.axes.shape[1], groups, tuple(matrices), turns)


def _groups(motion: JointMotion) -> tuple[tuple[int, ...], ...]:
    """Split the joints that move the flange where neighbouring axes are not parallel."""
    moves = np.linalg.norm(motion.jacobian, axis=1).max(axis=0) > _STILL_M
    count = int(np.flatnonzero(moves).max(initial=0)) + 1
    across = np.cross(motion.axes[:, :-1], motion.axes[:, 1:])
    along = np.einsum("pik,pik->pi", motion.axes[:, :-1], motion.axes[:, 1:])
    parallel = (np.linalg.norm(across, axis=2) < _PARALLEL).all(axis=0) & (along > 0).all(axis=0)
    groups: list[tuple[int, ...]] = [(0,)]
    for joint in range(1, count):
        if joint > 1 and parallel[joint - 1]:
            groups[-1] = (*groups[-1], joint)
        else:
            groups.append((joint,))
    return tuple(groups)


def _frames(axis: Array) -> Array:
    """Return rotations (P, 3, 3) whose third column is the axis (P, 3)."""
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    x = np.cross(least, axis)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axis, x), axis], axis=2)


def _scaled_turn(turns: Turns) -> Array:
    scale = np.where(_TURN_IS_SINE, turns.sine_scale, 1.0)
    return _TURN * np.where(_TURN_IS_VERSINE, turns.versine_scale, scale)


def _own_columns(motion: JointMotion, group: tuple[int, ...], turns: Turns) -> Array:
    """Return (P, 3, 2r): what the group's partial sums do to its own links, in the base frame."""
    velocity = motion.jacobian[:, :, group]
    links = velocity - np.concatenate([velocity[:, :, 1:], 0.0 * velocity[:, :, :1]], axis=2)
    axis = motion.axes[:, group[0], :, None]
    columns = np.empty((*links.shape[:2], 2 * len(group)))
    columns[:, :, 0::2] = turns.sine_scale * links
    columns[:, :, 1::2] = turns.versine_scale * np.cross(axis, links, axis=1)
    return columns


def _first_columns(motion: JointMotion, turns: Turns) -> Array:
    """Return (P, 3, 2): v less v turned back by the first joint, in the base frame."""
    velocity = motion.jacobian[:, :, 0]
    columns = [
        turns.sine_scale * velocity,
        -turns.versine_scale * np.cross(motion.axes[:, 0], velocity),
    ]
    return np.stack(columns, axis=2)
