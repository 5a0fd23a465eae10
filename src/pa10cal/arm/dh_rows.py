"""Standard Denavit-Hartenberg rows through the joint axes of an arm.

A row leads from one joint's axis to the next along their common normal. Nearly parallel axes have
no definite one: there the next frame lies where the next axis meets the plane normal to the one
before, with d = 0 and Hayati's beta (paper, Section II.C).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import NEARLY_PARALLEL_RAD
from pa10cal.arrays import Array, homogeneous

#: Axes closer than this count as intersecting: far below any manufacturing tolerance [m].
_MEETING_M = 5e-11
#: A number this near, relative, to one of so many decimals is that one with round-off.
_ROUND_OFF = 1e-13
_DECIMALS = 9


@dataclass(frozen=True)
class DHRows:
    """Standard Denavit-Hartenberg rows, with the constant frames that they start and end with."""

    parameters: Array  # (n, 5) theta [rad], d [m], a [m], alpha [rad] and beta [rad] of each
    T_base_row1: Array  # (4, 4) frame the first row starts from, its z along the first axis [m]
    T_row_n_ee: Array  # (4, 4) end-effector in the frame of the last row [m]
    T_base_rows: Array  # (n, 4, 4) frames of the rows [m]

    @property
    def arm_fields(self) -> dict[str, Any]:
        """Return the geometry as fields of `Arm`, plain Denavit-Hartenberg parameters free."""
        names = ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
        return {
            "convention": "standard",
            **dict(zip(names, self.parameters.T, strict=True)),
            "hayati": np.zeros(len(self.parameters), dtype=bool),
            "T_base_row1": self.T_base_row1,
            "T_row_n_ee": self.T_row_n_ee,
        }


def rows_through(
    p_base_m: Array, axes: Array, T_base_ee: Array, parallel_rad: float = NEARLY_PARALLEL_RAD
) -> DHRows:
    """Return standard Denavit-Hartenberg rows through the axes of n joints, all at zero.

    Of the two directions of a common normal, that with theta of at most a quarter turn is taken.
    The last row has theta and d only; the constant frame `T_row_n_ee` leads on to the end-effector.

    Args:
        p_base_m: (n, 3) a point of each axis.
        axes: (n, 3) their directions, unit vectors.
        T_base_ee: (4, 4) end-effector.
        parallel_rad: neighbours closer to parallel than this get beta; others follow the common
            normal, however far away it is.
    """
    T_base_row1 = _first_frame(p_base_m[0], axes[0]).round(15) + 0.0  # 0 and 1 without round-off
    T, parameters, frames = T_base_row1, [], []
    for p_m, axis in zip(p_base_m[1:], axes[1:], strict=True):
        R = T[:3, :3]
        parameters.append(_row_to(R.T @ (p_m - T[:3, 3]), R.T @ axis, parallel_rad))
        T = T @ _motion(*parameters[-1])
        frames.append(T)
    # The last row turns x of its frame, or else y, into the direction of the end-effector's.
    end = np.linalg.inv(T) @ T_base_ee
    flat = end[:2, 0] if np.linalg.norm(end[:2, 0]) > 0.5 else end[:2, 1]
    turn = float(np.arctan2(flat[1], flat[0]))
    parameters.append(_neat_row(turn, float(end[2, 3]), 0.0, 0.0, 0.0))
    T = T @ _motion(*parameters[-1])
    T_row_n_ee = (np.linalg.inv(T) @ T_base_ee).round(15) + 0.0
    return DHRows(np.array(parameters), T_base_row1, T_row_n_ee, np.array([*frames, T]))


def rows_of_table(
    parameters: Array,
    convention: Literal["standard", "modified"],
    T_base_row1: Array,
    T_row_n_ee: Array,
) -> DHRows:
    """Return rows, with beta, of the same forward kinematics as a table (n, 5) of an arm.

    Tables calibrated without beta have lengths of hundreds of metres, which cancel, between axes
    that are nearly parallel.

    Args:
        parameters: theta [rad], d [m], a [m], alpha [rad] and beta [rad] of each row.
        convention, T_base_row1, T_row_n_ee: see `Arm`.
    """
    T, joint_frames = T_base_row1, []  # frames whose z is the axis of a joint
    for theta, d, a, alpha, beta in parameters:
        if convention == "modified":
            T = T @ _motion(0.0, 0.0, 0.0, 0.0, beta) @ _motion(0.0, 0.0, a, alpha, 0.0)
            joint_frames.append(T)
            T = T @ _motion(theta, d, 0.0, 0.0, 0.0)
        else:
            joint_frames.append(T)
            T = T @ _motion(theta, d, a, alpha, beta)
    axes = np.array(joint_frames)
    return rows_through(axes[:, :3, 3], axes[:, :3, 2], T @ T_row_n_ee)


def _first_frame(p_m: Array, axis: Array) -> Array:
    """Return a frame (4, 4) with z along an axis, its x near x of the base, or y.

    Its origin is in the base's xy plane where the axis is nearly vertical; else it is the point of
    the axis nearest to the base's origin.
    """
    upright = abs(axis[2]) > np.cos(NEARLY_PARALLEL_RAD)
    origin = p_m - axis * (p_m[2] / axis[2] if upright else p_m @ axis)
    along = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = along - axis * (axis @ along)
    x /= np.linalg.norm(x)
    return homogeneous(np.column_stack([x, np.cross(axis, x), axis]), origin)


def _row_to(p_m: Array, axis: Array, parallel_rad: float) -> Array:
    """Return theta, d, a, alpha, beta (5,) from the z axis to an axis through a point."""
    across = float(np.hypot(axis[0], axis[1]))
    if np.arctan2(across, abs(axis[2])) < parallel_rad:
        in_plane = p_m - axis * (p_m[2] / axis[2])
        theta, a, _ = _within_a_quarter(in_plane[0], in_plane[1])
        cos, sin = np.cos(theta), np.sin(theta)
        x, y, z = cos * axis[0] + sin * axis[1], cos * axis[1] - sin * axis[0], axis[2]
        return _neat_row(theta, 0.0, a, np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z)))
    theta, _, sign = _within_a_quarter(-axis[1], axis[0])
    a = p_m[0] * np.cos(theta) + p_m[1] * np.sin(theta)
    d = p_m[2] - axis[2] * (p_m[:2] @ axis[:2]) / across**2
    return _neat_row(theta, d, a, np.arctan2(sign * across, axis[2]), 0.0)


def _within_a_quarter(x: float, y: float) -> tuple[float, float, float]:
    """Return a vector as an angle of at most a quarter turn, a signed length, and its sign."""
    length = float(np.hypot(x, y))
    if length < _MEETING_M:
        return 0.0, 0.0, 1.0
    theta = float(np.arctan2(y, x))
    if abs(theta) <= np.pi / 2.0 + _ROUND_OFF:
        return theta, length, 1.0
    return theta - float(np.copysign(np.pi, theta)), -length, -1.0


def _neat_row(theta: float, d: float, a: float, alpha: float, beta: float) -> Array:
    """Return a row (5,) without round-off in its lengths, and in its angles in degrees."""
    theta, alpha, beta = np.radians(neat(np.degrees([theta, alpha, beta])))
    d, a = neat(np.array([d, 0.0 if abs(a) < _MEETING_M else a]))
    return np.array([theta, d, a, alpha, beta])


def neat(values: Array) -> Array:
    """Return values, those rounded that differ from nine decimals by round-off only."""
    rounded = np.round(values, _DECIMALS) + 0.0
    off = np.abs(rounded - values)
    return np.where(off < _ROUND_OFF * np.maximum(1.0, np.abs(rounded)), rounded, values)


def _motion(theta: float, d: float, a: float, alpha: float, beta: float) -> Array:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)."""
    R = Rotation.from_euler("ZXY", [theta, alpha, beta]).as_matrix()
    return homogeneous(R, np.array([a * np.cos(theta), a * np.sin(theta), d]))
