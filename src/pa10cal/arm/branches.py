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
#: The two angles of a joint are kept at least 0.02 rad apart, this the cosine of half of that. They
#: are one angle in a singularity, from which a search would go to neither branch.
_BRANCH_COSINE = float(np.cos(0.01))


@dataclass(frozen=True)
class _Axes:
    """Joint axes at zero joint positions, in the base."""

    h: Array  # (6, 3) directions of the axes, unit vectors
    p: Array  # (6, 3) a point of each axis; where axes meet, that point
    T_ee_base: Array  # (4, 4) the base in the end-effector


def branches_of(arm: Arm) -> Callable[[Array], Array] | None:
    """Return a function for all branches of a nominal arm; None where no closed form is known.

    The function takes end-effector poses T_base_ee (P, 4, 4) and returns joint positions
    (P, 8, 6), between -pi and pi [rad]. For a pose out of reach, or within a hundredth of a radian
    of a singularity, they reach a pose near it.
    """
    if arm.n != 6 or arm.prismatic.any():
        return None
    chain = Chain.of(arm)
    zero = chain.coordinates(np.zeros((1, 6)))
    joints = frames(chain, zero).T_base_joints[:, 0]
    h, p = joints[:, :3, 2], joints[:, :3, 3]
    T_ee_base = np.linalg.inv(end_pose(chain, zero)[0])
    # Parallel to the second, the first axis leaves the plane in which joints 2 and 3 move a point
    # as it is, and that plane does not give its angle.
    if not _parallel(h[1], h[2]) or _parallel(h[0], h[1]):
        return None
    wrist = _meeting(h[3:], p[3:])
    if wrist is not None:
        axes = _Axes(h, np.vstack([p[:3], np.tile(wrist, (3, 1))]), T_ee_base)
        return lambda T_base_ee: _with_spherical_wrist(axes, T_base_ee)
    wrist = _meeting(h[4:], p[4:])
    if wrist is not None and _parallel(h[1], h[3]):
        axes = _Axes(h, np.vstack([p[:4], np.tile(wrist, (2, 1))]), T_ee_base)
        return lambda T_base_ee: _with_three_parallel(axes, T_base_ee)
    return None


def _with_spherical_wrist(axes: _Axes, T_base_ee: Array) -> Array:
    """Solve arms whose axes 4, 5, 6 meet, and whose axes 2 and 3 are parallel."""
    h, p = axes.h, axes.p
    moved = (T_base_ee @ axes.T_ee_base)[:, None]  # motion of the end from zero joint positions
    R = moved[..., :3, :3]
    centre = _turned(R, p[3]) + moved[..., :3, 3]  # of the wrist; it depends on joints 1 to 3 only
    # Joints 2 and 3 move the centre in a plane, and joint 1 turns that plane with it: turning the
    # centre back by the negative of its angle brings it into the plane of zero joint positions.
    q1 = -_in_one_row(_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[3] - p[0])))
    v = _about(h[0], -q1, centre - p[0]) + p[0]
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], np.linalg.norm(v - p[1], axis=-1))
    q1, v, q3 = _pairs(q1), _pairs(v), _in_one_row(q3)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], v - p[1])
    R_123 = _rotation(h[0], q1) @ _rotation(h[1], q2) @ _rotation(h[2], q3)
    wrist = np.swapaxes(R_123, -1, -2) @ R
    q5 = _onto_plane(h[4], h[5], h[3], _turned(wrist, h[5]) @ h[3])
    q1, q2, q3, wrist = (_pairs(each) for each in (q1, q2, q3, wrist))
    q5 = _in_one_row(q5)
    q4 = _between(h[3], _about(h[4], q5, h[5]), _turned(wrist, h[5]))
    across = _across(h[5])
    rest = np.swapaxes(_rotation(h[3], q4) @ _rotation(h[4], q5), -1, -2) @ wrist
    q6 = _between(h[5], across, _turned(rest, across))
    return _within_turn(np.stack([q1, q2, q3, q4, q5, q6], axis=-1))


def _with_three_parallel(axes: _Axes, T_base_ee: Array) -> Array:
    """Solve arms whose axes 2, 3, 4 are parallel, and whose axes 5 and 6 meet."""
    h, p = axes.h, axes.p
    moved = (T_base_ee @ axes.T_ee_base)[:, None]
    R = moved[..., :3, :3]
    centre = _turned(R, p[4]) + moved[..., :3, 3]
    # As above: joints 2 to 4 move the centre in a plane, which joint 1 turns.
    q1 = -_in_one_row(_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[4] - p[0])))
    R_rest = np.swapaxes(_rotation(h[0], q1), -1, -2) @ R
    q5 = _onto_plane(h[4], h[5], h[1], _turned(R_rest, h[5]) @ h[1])
    q1, R_rest, q5 = _pairs(q1), _pairs(R_rest), _in_one_row(q5)
    back = np.swapaxes(R_rest, -1, -2)
    q6 = -_between(h[5], _about(h[4], -q5, h[1]), _turned(back, h[1]))
    R_56 = _rotation(h[4], q5) @ _rotation(h[5], q6)
    R_234 = R_rest @ np.swapaxes(R_56, -1, -2)
    across = _across(h[1])
    sum_234 = _between(h[1], across, _turned(R_234, across))
    # A point of the fourth axis, where joints 1 to 3 have to bring it.
    fourth = centre + _turned(R @ np.swapaxes(R_56, -1, -2), p[3] - p[4])
    v = _about(h[0], -q1, fourth - p[0]) + p[0]
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], np.linalg.norm(v - p[1], axis=-1))
    q1, q5, q6, v, sum_234 = (_pairs(each) for each in (q1, q5, q6, v, sum_234))
    q3 = _in_one_row(q3)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], v - p[1])
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
    """Solve `cos` cos(x) + `sin` sin(x) = value (P, B) for both x, (P, B, 2)."""
    size = np.maximum(np.hypot(cos, sin), np.finfo(float).tiny)
    half = np.arccos(np.clip(value / size, -_BRANCH_COSINE, _BRANCH_COSINE))
    middle = np.broadcast_to(np.arctan2(sin, cos), half.shape)
    return np.stack([middle + half, middle - half], axis=-1)


def _between(k: Array, p: Array, q: Array) -> Array:
    """Return the angle about k that rotates p to q."""
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


def _across(k: Array) -> Array:
    """Return a unit vector perpendicular to k."""
    square = np.cross(k, np.eye(3)[np.abs(k).argmin()])
    return np.asarray(square / np.linalg.norm(square))


def _parallel(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(np.cross(one, other)) < _PARALLEL_RAD)


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
