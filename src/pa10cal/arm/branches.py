"""Inverse kinematics of nominal six-joint arms in closed form, all branches of a pose.

Two layouts cover nearly all industrial arms: the last three axes meet in a point, and the second
and third are parallel (a spherical wrist); or the second to fourth are parallel, and the last two
meet. Each pose then decomposes into rotations about one axis at a time (Paden and Kahan; Elias and
Wen 2024), with up to eight branches. Axes may deviate by rounding: the solutions are starts for a
search on the calibrated arm.

The arrays of a solution have an axis B of branches: the two values of each further joint double it,
B to 2 B (`_in_one_row`), and `_pairs` repeats what belongs to the joints before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain, end_pose, frames
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

#: Largest deviation of axes that count as parallel [rad], and as meeting [m].
_PARALLEL_RAD = 2e-3
_MEETING_M = 2e-3
#: The two angles of a joint are kept at least 0.02 rad apart, this the cosine of half of that. At a
#: singularity both coincide; a search started there would reach neither branch.
_BRANCH_COSINE = float(np.cos(0.01))


@dataclass(frozen=True)
class _Axes:
    """Joint axes at zero joint positions, in the base."""

    direction: Array  # (6, 3) unit vectors
    point: Array  # (6, 3) a point of each axis; where axes meet, that point
    T_ee_base: Array  # (4, 4) the base in the end-effector


def branches_of(arm: Arm) -> Callable[[Array], Array] | None:
    """Return a function for all branches of a nominal arm; None where no closed form is known.

    The function takes end-effector poses T_base_ee (P, 4, 4) and returns joint positions
    (P, 8, 6), between -pi and pi [rad]. A row reaches its pose where that branch exists and is not
    within a hundredth of a radian of a singularity. Other rows miss it, by up to decimetres: all
    for a pose out of reach, and with three parallel axes some for every fifth pose within. Forward
    kinematics shows which.
    """
    if arm.n != 6 or arm.prismatic.any():
        return None
    chain = Chain.of(arm)
    zero = chain.coordinates(np.zeros((1, 6)))
    joints = frames(chain, zero).T_base_joints[:, 0]
    h, p = joints[:, :3, 2], joints[:, :3, 3]  # directions and points of the axes
    T_ee_base = np.linalg.inv(end_pose(chain, zero)[0])
    # Parallel to the second, the first axis leaves the plane in which joints 2 and 3 move a point
    # as it is, and that plane does not give its angle.
    if not _parallel(h[1], h[2]) or _parallel(h[0], h[1]):
        return None
    # Where axes 2 and 3 are one, or joint 3 turns about what it has to move, it moves nothing.
    if _off_axis(h[1], p[2] - p[1]) < _MEETING_M:
        return None
    wrist = _meeting(h[3:], p[3:])
    if wrist is not None:
        if _off_axis(h[2], wrist - p[2]) < _MEETING_M:
            return None
        axes = _Axes(h, np.vstack([p[:3], np.tile(wrist, (3, 1))]), T_ee_base)
        return lambda T_base_ee: _with_spherical_wrist(axes, T_base_ee)
    wrist = _meeting(h[4:], p[4:])
    # The angle of joint 5 is that between axis 6 and axes 2 to 4, which it must change.
    three_parallel = _parallel(h[1], h[3]) and _off_axis(h[2], p[3] - p[2]) >= _MEETING_M
    if wrist is not None and three_parallel and not _parallel(h[3], h[4]):
        axes = _Axes(h, np.vstack([p[:4], np.tile(wrist, (2, 1))]), T_ee_base)
        return lambda T_base_ee: _with_three_parallel(axes, T_base_ee)
    return None


def _with_spherical_wrist(axes: _Axes, T_base_ee: Array) -> Array:
    """Solve arms whose axes 4, 5, 6 meet, and whose axes 2 and 3 are parallel."""
    h, p = axes.direction, axes.point
    motion = (T_base_ee @ axes.T_ee_base)[:, None]  # of the end from zero joint positions
    R = motion[..., :3, :3]
    centre = _turned(R, p[3]) + motion[..., :3, 3]  # of the wrist, by joints 1 to 3 only
    # Joints 2 and 3 move the centre in a plane, and joint 1 turns that plane with it: `back` are
    # the angles that turn the centre back into the plane of zero joint positions.
    back = _in_one_row(_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[3] - p[0])))
    q1, centre_back = -back, _about(h[0], back, centre - p[0]) + p[0]
    reach = np.linalg.norm(centre_back - p[1], axis=-1)
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], reach)
    q1, centre_back, q3 = _pairs(q1), _pairs(centre_back), _in_one_row(q3)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], centre_back - p[1])
    R_123 = _rotation(h[0], q1) @ _rotation(h[1], q2) @ _rotation(h[2], q3)
    R_456 = np.swapaxes(R_123, -1, -2) @ R
    q5 = _onto_plane(h[4], h[5], h[3], _turned(R_456, h[5]) @ h[3])
    q1, q2, q3, R_456 = (_pairs(each) for each in (q1, q2, q3, R_456))
    q5 = _in_one_row(q5)
    q4 = _between(h[3], _about(h[4], q5, h[5]), _turned(R_456, h[5]))
    R_6 = np.swapaxes(_rotation(h[3], q4) @ _rotation(h[4], q5), -1, -2) @ R_456
    q6 = _angle_of(R_6, h[5])
    return _within_turn(np.stack([q1, q2, q3, q4, q5, q6], axis=-1))


def _with_three_parallel(axes: _Axes, T_base_ee: Array) -> Array:
    """Solve arms whose axes 2, 3, 4 are parallel, and whose axes 5 and 6 meet."""
    h, p = axes.direction, axes.point
    motion = (T_base_ee @ axes.T_ee_base)[:, None]  # of the end from zero joint positions
    R = motion[..., :3, :3]
    centre = _turned(R, p[4]) + motion[..., :3, 3]  # where axes 5 and 6 meet
    # As above: joints 2 to 4 move the centre in a plane, which joint 1 turns.
    back = _in_one_row(_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[4] - p[0])))
    q1, R_23456 = -back, _rotation(h[0], back) @ R
    q5 = _onto_plane(h[4], h[5], h[1], _turned(R_23456, h[5]) @ h[1])
    q1, R_23456, q5 = _pairs(q1), _pairs(R_23456), _in_one_row(q5)
    # Joints 2 to 4 leave h[1] as it is: joints 5 and 6 turn what is turned back to h[1].
    back_h = _turned(np.swapaxes(R_23456, -1, -2), h[1])
    q6 = -_between(h[5], _about(h[4], -q5, h[1]), back_h)
    R_56 = _rotation(h[4], q5) @ _rotation(h[5], q6)
    R_234 = R_23456 @ np.swapaxes(R_56, -1, -2)
    sum_234 = _angle_of(R_234, h[1])
    # A point of the fourth axis, where joints 1 to 3 have to bring it; then turned back by joint 1.
    fourth = centre + _turned(R @ np.swapaxes(R_56, -1, -2), p[3] - p[4])
    fourth_back = _about(h[0], -q1, fourth - p[0]) + p[0]
    reach = np.linalg.norm(fourth_back - p[1], axis=-1)
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], reach)
    q1, q5, q6, fourth_back, sum_234 = map(_pairs, (q1, q5, q6, fourth_back, sum_234))
    q3 = _in_one_row(q3)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], fourth_back - p[1])
    # Axes 3 and 4 may point against axis 2.
    q4 = (sum_234 - q2 - np.sign(h[1] @ h[2]) * q3) * np.sign(h[1] @ h[3])
    return _within_turn(np.stack([q1, q2, q3, q4, q5, q6], axis=-1))


def _onto_plane(k: Array, p: Array, h: Array, d: Array | float) -> Array:
    """Return both angles (P, B, 2) about k that rotate p (P, B, 3) into the plane h · p = d.

    Where none does, both rotate it as near to that plane as possible.
    """
    cos, sin = p @ h - (p @ k) * (h @ k), np.cross(k, p) @ h
    return _both_angles(cos, sin, d - (p @ k) * (h @ k))


def _at_distance(k: Array, p: Array, a: Array, d: Array) -> Array:
    """Return both angles (P, B, 2) about k at which |a + rotated p| = d (P, B)."""
    cos, sin = p @ a - (p @ k) * (a @ k), np.cross(k, p) @ a
    return _both_angles(cos, sin, (d**2 - a @ a - p @ p) / 2.0 - (p @ k) * (a @ k))


def _both_angles(cos: Array, sin: Array, value: Array | float) -> Array:
    """Solve `cos` cos(x) + `sin` sin(x) = value (P, B) for both x, (P, B, 2).

    Where there is no x, as for poses out of reach, or both are nearly one, as in a singularity,
    they are those nearest to it that are 0.02 rad apart.
    """
    size = np.maximum(np.hypot(cos, sin), np.finfo(float).tiny)
    half = np.arccos(np.clip(value / size, -_BRANCH_COSINE, _BRANCH_COSINE))
    middle = np.broadcast_to(np.arctan2(sin, cos), half.shape)
    return np.stack([middle + half, middle - half], axis=-1)


def _between(k: Array, p: Array, q: Array) -> Array:
    """Return the angles (P, B) about k that rotate p to q, (3,) or (P, B, 3) each.

    Components along k do not count: where they differ, or lengths do, p is rotated towards q.
    """
    sin = np.cross(p, q) @ k
    cos = np.sum(p * q, axis=-1) - (np.asarray(p) @ k) * (q @ k)
    return np.asarray(np.arctan2(sin, cos))


def _in_one_row(angles: Array) -> Array:
    """Return both angles (P, B, 2) of each branch as those of twice as many branches (P, 2 B)."""
    return angles.reshape(len(angles), 2 * angles.shape[1])


def _pairs(values: Array) -> Array:
    """Return values (P, B, ...), each twice: once for each angle of the next joint."""
    return np.repeat(values, 2, axis=1)


def _rotation(k: Array, angle: Array) -> Array:
    """Return rotations about k by angles (P, B), (P, B, 3, 3), by Rodrigues' formula."""
    x, y, z = k
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.asarray(np.eye(3) + sin * K + (1.0 - cos) * (K @ K))


def _about(k: Array, angle: Array, p: Array) -> Array:
    """Return p (..., 3) rotated about k by angles (P, B)."""
    return _turned(_rotation(k, angle), p)


def _turned(R: Array, p: Array) -> Array:
    """Return vectors p (..., 3) rotated by R (..., 3, 3)."""
    return np.asarray((R @ np.asarray(p)[..., None])[..., 0])


def _angle_of(R: Array, k: Array) -> Array:
    """Return the angles (P, B) of rotations (P, B, 3, 3) about k."""
    square = np.cross(k, np.eye(3)[np.abs(k).argmin()])
    across = square / np.linalg.norm(square)  # a unit vector perpendicular to k
    return _between(k, across, _turned(R, across))


def _parallel(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(np.cross(one, other)) < _PARALLEL_RAD)


def _off_axis(k: Array, p: Array) -> float:
    """Return how far p (3,) is from an axis k through the origin [m]."""
    return float(np.linalg.norm(np.cross(k, p)))


def _meeting(h: Array, p: Array) -> Array | None:
    """Return the point in which axes (k, 3) of directions h through p meet; None where they do not.

    It is the point of the least sum of squared distances from the axes.
    """
    if any(_parallel(one, other) for one, other in zip(h[1:], h[:-1], strict=True)):
        return None
    squares = np.eye(3) - h[:, :, None] * h[:, None, :]
    point = np.linalg.solve(squares.sum(axis=0), np.einsum("kij,kj->i", squares, p))
    off_m = np.linalg.norm(np.einsum("kij,kj->ki", squares, point - p), axis=1)
    return point if off_m.max() < _MEETING_M else None


def _within_turn(q: Array) -> Array:
    """Return angles between -pi and pi."""
    return np.asarray(np.remainder(q + np.pi, 2.0 * np.pi) - np.pi)
