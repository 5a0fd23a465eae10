"""Denavit-Hartenberg rows through joint axes that are given as lines in space.

A row leads from one joint's axis to the next along their common normal. Axes that are nearly
parallel have theirs anywhere; there the next frame sits where the axis meets the plane across the
one before, with d = 0 and Hayati's beta (paper, Section II.C).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.parallel import NEARLY_PARALLEL_RAD
from pa10cal.arrays import Array

#: Axes closer than this count as meeting; far below what an arm can be built to.
_MEETING_M = 5e-11
#: Sums of exact figures are off by this, and are written as the figures they stand for.
_ROUND_OFF = 1e-13
_DECIMALS = 9


@dataclass(frozen=True)
class Rows:
    """Standard Denavit-Hartenberg rows, with the constant frames that they start and end with."""

    # theta_rad, d_m, a_m, alpha_rad and beta_rad: (n,) parameters
    theta_rad: Array
    d_m: Array
    a_m: Array
    alpha_rad: Array
    beta_rad: Array
    T_base_row1: Array  # (4, 4) frame the first row starts from, its z along the first axis [m]
    T_row_n_ee: Array  # (4, 4) end-effector in the frame of the last row [m]
    T_base_rows: Array  # (n, 4, 4) frames of the rows [m]


def rows_through(p_base_m: Array, axes: Array, T_base_ee: Array) -> Rows:
    """Lay standard Denavit-Hartenberg rows through the axes of n joints, all at zero.

    Of the two directions of a common normal the one is taken that turns theta by less than a
    quarter. The last row only turns and shifts along its axis; what is left to the end-effector
    is the constant frame after it.

    Args:
        p_base_m: (n, 3) a point on each axis.
        axes: (n, 3) direction of each axis, of length one.
        T_base_ee: (4, 4) end-effector.
    """
    T_base_row1 = _tidy(_first_frame(p_base_m[0], axes[0]))
    T, parameters, frames = T_base_row1, [], []
    for p_m, axis in zip(p_base_m[1:], axes[1:], strict=True):
        R = T[:3, :3]
        parameters.append(_row_to(R.T @ (p_m - T[:3, 3]), R.T @ axis))
        T = T @ _motion(*parameters[-1])
        frames.append(T)
    parameters.append(_last_row(np.linalg.inv(T) @ T_base_ee))
    T = T @ _motion(*parameters[-1])
    theta, d, a, alpha, beta = np.array(parameters).T
    return Rows(
        theta_rad=theta,
        d_m=d,
        a_m=a,
        alpha_rad=alpha,
        beta_rad=beta,
        T_base_row1=T_base_row1,
        T_row_n_ee=_tidy(np.linalg.inv(T) @ T_base_ee),
        T_base_rows=np.array([*frames, T]),
    )


def _first_frame(p_m: Array, axis: Array) -> Array:
    """Return a frame with z along an axis: level with the base where the axis stands upright."""
    upright = abs(axis[2]) > np.cos(NEARLY_PARALLEL_RAD)
    origin = p_m - axis * (p_m[2] / axis[2] if upright else p_m @ axis)
    along = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = along - axis * (axis @ along)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(axis, x), axis, origin])
    return T


def _row_to(p_m: Array, axis: Array) -> tuple[float, float, float, float, float]:
    """Return theta, d, a, alpha, beta from the z axis to an axis through a point."""
    across = float(np.hypot(axis[0], axis[1]))
    if np.arctan2(across, abs(axis[2])) < NEARLY_PARALLEL_RAD:
        meets = p_m - axis * (p_m[2] / axis[2])
        theta, a, _ = _within_a_quarter(meets[0], meets[1])
        d = 0.0
        cos, sin = np.cos(theta), np.sin(theta)
        turned = np.array([cos * axis[0] + sin * axis[1], cos * axis[1] - sin * axis[0], axis[2]])
        alpha = float(np.arctan2(-turned[1], turned[2]))
        beta = float(np.arctan2(turned[0], np.hypot(turned[1], turned[2])))
    else:
        theta, _, sign = _within_a_quarter(-axis[1], axis[0])
        a = float(p_m[0] * np.cos(theta) + p_m[1] * np.sin(theta))
        d = float(p_m[2] - axis[2] * (p_m[:2] @ axis[:2]) / across**2)
        alpha = float(np.arctan2(sign * across, axis[2]))
        beta = 0.0
    return _neat_row(theta, d, 0.0 if abs(a) < _MEETING_M else a, alpha, beta)


def _within_a_quarter(x: float, y: float) -> tuple[float, float, float]:
    """Return the angle, at most a quarter turn, the signed length and its sign of a vector."""
    length = float(np.hypot(x, y))
    if length < _MEETING_M:
        return 0.0, 0.0, 1.0
    theta = float(np.arctan2(y, x))
    if abs(theta) <= np.pi / 2.0 + _ROUND_OFF:
        return theta, length, 1.0
    return theta - float(np.copysign(np.pi, theta)), -length, -1.0


def _last_row(T: Array) -> tuple[float, float, float, float, float]:
    """Return the row that brings a frame under the end-effector, x in line where it can be."""
    flat = T[:2, 0] if np.linalg.norm(T[:2, 0]) > 0.5 else T[:2, 1]
    return _neat_row(float(np.arctan2(flat[1], flat[0])), float(T[2, 3]), 0.0, 0.0, 0.0)


def _neat_row(
    theta: float, d: float, a: float, alpha: float, beta: float
) -> tuple[float, float, float, float, float]:
    theta, alpha, beta = np.radians(neat(np.degrees([theta, alpha, beta])))
    d, a = neat(np.array([d, a]))
    return float(theta), float(d), float(a), float(alpha), float(beta)


def neat(values: Array) -> Array:
    """Return the figures of few decimals that values are but for round-off; others as they are."""
    few = np.round(values, _DECIMALS) + 0.0
    tidy: Array = np.where(
        np.abs(few - values) < _ROUND_OFF * np.maximum(1.0, np.abs(few)), few, values
    )
    return tidy


def _tidy(T: Array) -> Array:
    """Return a pose without the round-off that stands in place of zeros and ones."""
    tidy: Array = np.round(T, 15) + 0.0
    return tidy


def _motion(theta: float, d: float, a: float, alpha: float, beta: float) -> Array:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)."""
    turn, twist, tilt = np.eye(4), np.eye(4), np.eye(4)
    turn[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    twist[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    tilt[:3:2, :3:2] = [[np.cos(beta), np.sin(beta)], [-np.sin(beta), np.cos(beta)]]
    turn[2, 3], twist[0, 3] = d, a
    T: Array = turn @ twist @ tilt
    return T
