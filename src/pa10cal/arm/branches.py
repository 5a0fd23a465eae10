"""All joint positions at which a six-joint arm as designed reaches a pose, in closed form.

Two layouts cover nearly all arms of industry: the last three axes meet in a point, and the second
and third are parallel; or the second to fourth are parallel, and the last two meet. Each pose then
falls apart into turns of one joint (Paden and Kahan; Elias and Wen 2024), with eight branches. The
axes may be off by rounding: what is found is where a search on the calibrated arm starts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain, end_pose, frames
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

#: How far axes that are said to be parallel or to meet may be from it [rad], [m].
_PARALLEL_RAD = 2e-3
_MEETING_M = 2e-3
#: Cosine of half the angle by which two branches stay apart at least: a search that starts in the
#: singularity between them goes to neither.
_APART = float(np.cos(0.01))


@dataclass(frozen=True)
class _Axes:
    """Joint axes at position zero, in the base."""

    h: Array  # (6, 3) directions in which the joints turn
    p: Array  # (6, 3) a point of each; where axes meet, that point
    T_ee_base: Array  # (4, 4) the base in the end-effector at position zero


def branches_of(arm: Arm) -> Callable[[Array], Array] | None:
    """Return what gives all branches of an arm as designed; None where no closed form is known.

    The function takes end-effector poses T_base_ee (P, 4, 4) and returns joint positions
    (P, 8, 6), between -pi and pi [rad]. Of a pose out of reach, or within a hundredth of a radian
    of a singularity, these come near it.
    """
    if arm.n != 6 or arm.prismatic.any():
        return None
    chain = Chain.of(arm)
    zero = chain.coordinates(np.zeros((1, 6)))
    joints = frames(chain, zero).T_base_joints[:, 0]
    h, p = joints[:, :3, 2], joints[:, :3, 3]
    T_ee_base = np.linalg.inv(end_pose(chain, zero)[0])
    if not _parallel(h[1], h[2]):
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
    moved = (T_base_ee @ axes.T_ee_base)[:, None]  # what moves the end from where it is at zero
    R = moved[..., :3, :3]
    centre = _turned(R, p[3]) + moved[..., :3, 3]
    q1 = -_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[3] - p[0]))
    v = _about(h[0], -q1, centre - p[0]) + p[0]
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], np.linalg.norm(v - p[1], axis=-1))
    q1, v, q3 = _pairs(q1, q3), _pairs(v, q3), q3.reshape(len(q3), -1)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], v - p[1])
    R_123 = _rotation(h[0], q1) @ _rotation(h[1], q2) @ _rotation(h[2], q3)
    wrist = np.swapaxes(R_123, -1, -2) @ R
    q5 = _onto_plane(h[4], h[5], h[3], _turned(wrist, h[5]) @ h[3])
    q1, q2, q3, wrist = (_pairs(each, q5) for each in (q1, q2, q3, wrist))
    q5 = q5.reshape(len(q5), -1)
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
    q1 = -_onto_plane(h[0], centre - p[0], h[1], h[1] @ (p[4] - p[0]))
    R_rest = np.swapaxes(_rotation(h[0], q1), -1, -2) @ R
    q5 = _onto_plane(h[4], h[5], h[1], _turned(R_rest, h[5]) @ h[1])
    q1, R_rest = _pairs(q1, q5), _pairs(R_rest, q5)
    q5 = q5.reshape(len(q5), -1)
    back = np.swapaxes(R_rest, -1, -2)
    q6 = -_between(h[5], _about(h[4], -q5, h[1]), _turned(back, h[1]))
    R_56 = _rotation(h[4], q5) @ _rotation(h[5], q6)
    R_234 = R_rest @ np.swapaxes(R_56, -1, -2)
    across = _across(h[1])
    sum_234 = _between(h[1], across, _turned(R_234, across))
    # Where joints 5 and 6, turned back, leave the fourth axis.
    fourth = centre + _turned(R @ np.swapaxes(R_56, -1, -2), p[3] - p[4])
    v = _about(h[0], -q1, fourth - p[0]) + p[0]
    q3 = _at_distance(h[2], p[3] - p[2], p[2] - p[1], np.linalg.norm(v - p[1], axis=-1))
    q1, q5, q6, v, sum_234 = (_pairs(each, q3) for each in (q1, q5, q6, v, sum_234))
    q3 = q3.reshape(len(q3), -1)
    q2 = _between(h[1], _about(h[2], q3, p[3] - p[2]) + p[2] - p[1], v - p[1])
    q4 = (sum_234 - q2 - np.sign(h[1] @ h[2]) * q3) * np.sign(h[1] @ h[3])
    return _within_turn(np.stack([q1, q2, q3, q4, q5, q6], axis=-1))


def _onto_plane(k: Array, p: Array, h: Array, d: Array | float) -> Array:
    """Return both turns about k that bring p (..., 3) to h · p = d, or as near as they can.

    Returns:
        (..., 2) of the last two axes (P, B) where p or d has them; a single leading B is dropped.
    """
    cos, sin = p @ h - (p @ k) * (h @ k), np.cross(k, p) @ h
    return _two(cos, sin, d - (p @ k) * (h @ k))


def _at_distance(k: Array, p: Array, a: Array, d: Array) -> Array:
    """Return both turns about k at which a plus p turned is d (P, B) long, (P, B, 2)."""
    cos, sin = p @ a - (p @ k) * (a @ k), np.cross(k, p) @ a
    return _two(cos, sin, (d**2 - a @ a - p @ p) / 2.0 - (p @ k) * (a @ k))


def _two(cos: Array, sin: Array, value: Array | float) -> Array:
    """Solve cos x cos + sin x sin = value for both x: (P, B, 2), and (P, 2) of a single B."""
    size = np.maximum(np.hypot(cos, sin), np.finfo(float).tiny)
    half = np.arccos(np.clip(value / size, -_APART, _APART))
    middle = np.broadcast_to(np.arctan2(sin, cos), half.shape)
    both = np.stack([middle + half, middle - half], axis=-1)
    return both[:, 0] if both.shape[1] == 1 else both


def _between(k: Array, p: Array, q: Array) -> Array:
    """Return the turn about k from p to q."""
    turn: Array = np.arctan2(
        np.cross(p, q) @ k, np.sum(p * q, axis=-1) - (np.asarray(p) @ k) * (q @ k)
    )
    return turn


def _pairs(values: Array, of: Array) -> Array:
    """Return values (P, B, ...) twice, B after B, as the pairs (P, B, 2) of the next joint are."""
    return np.repeat(values, 2, axis=1) if of.ndim == 3 else values


def _rotation(k: Array, angle: Array) -> Array:
    """Return rotations about k by angles (P, B), (P, B, 3, 3)."""
    x, y, z = k
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    found: Array = np.eye(3) + sin * K + (1.0 - cos) * (K @ K)
    return found


def _about(k: Array, angle: Array, p: Array) -> Array:
    """Return p (..., 3) turned about k by angles (P, B)."""
    return _turned(_rotation(k, angle), p)


def _turned(R: Array, p: Array) -> Array:
    turned: Array = (R @ np.asarray(p)[..., None])[..., 0]
    return turned


def _across(k: Array) -> Array:
    """Return a unit vector square to k."""
    square = np.cross(k, np.eye(3)[np.abs(k).argmin()])
    return np.asarray(square / np.linalg.norm(square))


def _parallel(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(np.cross(one, other)) < _PARALLEL_RAD)


def _meeting(h: Array, p: Array) -> Array | None:
    """Return the point in which neighbouring axes meet; None where they do not."""
    if any(_parallel(one, other) for one, other in zip(h[1:], h[:-1], strict=True)):
        return None
    squares = np.eye(3) - h[:, :, None] * h[:, None, :]
    point = np.linalg.solve(squares.sum(axis=0), np.einsum("kij,kj->i", squares, p))
    off_m = np.linalg.norm(np.einsum("kij,kj->ki", squares, point - p), axis=1)
    return point if off_m.max() < _MEETING_M else None


def _within_turn(q: Array) -> Array:
    return np.asarray(np.remainder(q + np.pi, 2.0 * np.pi) - np.pi)
