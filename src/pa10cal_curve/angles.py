"""Joint angles between links, and back: two turns about axes that are square to each other.

With the next direction d in the frame before it, `zy` of docs/curve.md has a = atan2(d_y, d_x),
b = atan2(-d_z, hypot(d_x, d_y)); `yz` has b = atan2(-d_z, d_x), a = atan2(d_y, hypot(d_x, d_z)).
The axis of the second turn is then square to the directions before and after the first: it is all
of the frame that has to be carried along the chain. Directions are unit vectors (n, 3) along the
links.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import CurveError

Order = Literal["zy", "yz"]

#: A second turn nearer to 90 degrees leaves the first one open, but for rounding.
_OPEN = 1e-14
#: The first bend larger than this defines roll zero.
_BENT = 1e-6


@dataclass(frozen=True)
class JointAngles:
    """Angles of the joints between n links."""

    order: Order  # which turn comes first
    a_rad: Array  # (n - 1,) turns about z
    b_rad: Array  # (n - 1,) turns about y
    # (n - 1,) where the second turn is a right angle, so that the first could be any; it is that
    # of the joint before
    open: NDArray[np.bool_]
    axes: Array  # (n, 3, 3) frames of the links, x, y, z as columns

    @property
    def turns_rad(self) -> Array:
        """Turns about z, then about y, (2, n - 1)."""
        return np.stack([self.a_rad, self.b_rad])


def first_axes(directions: Array, roll_rad: float, z_at_zero: Array | None = None) -> Array:
    """Return the frame (3, 3) of the first link at a roll about itself.

    At roll zero z is square to the first bend, so that a chain in a plane turns about z alone.

    Args:
        roll_rad: turn about the link's own direction.
        z_at_zero: (3,) what z is nearest to at roll zero, instead.

    Raises:
        CurveError: when there is no link.
    """
    refuse_no_link(len(directions), "there is no link to turn", "take shorter links")
    x = directions[0]
    z = _square_to(x, _normal_of_first_bend(directions) if z_at_zero is None else z_at_zero)
    y = np.cross(z, x)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([x, cos * y + sin * z, cos * z - sin * y], axis=1)


def joint_angles(directions: Array, axes_first: Array, order: Order = "zy") -> JointAngles:
    """Compute the joint angles that lay links along directions, the first in a frame (3, 3)."""
    along, turns = _carry(directions, axes_first[:, 1 if order == "zy" else 2])
    cos, sin, length = turns.T
    is_open = length <= _OPEN
    other = np.cross(directions, along)  # z of `zy`; of `yz` -y
    off = np.einsum("ki,ki->k", other[:-1], directions[1:])
    turned, lifted = np.arctan2(sin, cos), np.arctan2(off, length)
    if order == "zy":
        axes = np.stack([directions, along, other], axis=2)
        return JointAngles(order, turned, -lifted, is_open, axes)
    axes = np.stack([directions, -other, along], axis=2)
    return JointAngles(order, -lifted, -turned, is_open, axes)


def chain_points(
    a_rad: Array, b_rad: Array, order: Order, axes_first: Array, p_first_m: Array, link_m: float
) -> Array:
    """Return where links join (n + 1, 3) by forward kinematics of their joint angles.

    The first link begins at a point (3,) [m] in a frame (3, 3).
    """
    in_order = [a_rad, b_rad] if order == "zy" else [b_rad, a_rad]
    turns = Rotation.from_euler(order.upper(), np.stack(in_order, axis=1)).as_matrix()
    axes = axes_first
    directions = [axes[:, 0]]
    for turn in turns:
        axes = axes @ turn
        directions.append(axes[:, 0])
    steps = np.vstack([p_first_m, link_m * np.array(directions)])
    return np.asarray(np.cumsum(steps, axis=0))


def _carry(directions: Array, along_first: Array) -> tuple[Array, Array]:
    """Carry the axis of the second turn along the chain.

    A loop of plain numbers, as each depends on the one before: with x the last direction, u the
    next one and w the axis, the next axis is (u.x) w - (u.w) x, made a unit vector. The turns are
    taken from the same numbers, so that near a right angle of the second one, where they are mostly
    rounding, they still lead to the axis that is carried on.

    Returns:
        The axes (n, 3), and for every joint cosine and sine of its first turn and the length of
        the next direction across the axis of that turn, (n - 1, 3).
    """
    x0, x1, x2 = directions[0].tolist()
    w0, w1, w2 = along_first.tolist()
    cos, sin = 1.0, 0.0
    carried: list[float] = []  # flat: lists within lists keep the garbage collector busy
    for u0, u1, u2 in zip(*directions[1:].T.tolist(), strict=True):
        on_x = u0 * x0 + u1 * x1 + u2 * x2
        on_w = u0 * w0 + u1 * w1 + u2 * w2
        length = (on_x * on_x + on_w * on_w) ** 0.5
        if length > _OPEN:  # else the turn before is kept
            cos, sin = on_x / length, on_w / length
        w0, w1, w2 = cos * w0 - sin * x0, cos * w1 - sin * x1, cos * w2 - sin * x2
        x0, x1, x2 = u0, u1, u2
        carried += (w0, w1, w2, cos, sin, length)
    table = np.array(carried).reshape(-1, 6)
    return np.vstack([along_first, table[:, :3]]), table[:, 3:]


def _normal_of_first_bend(directions: Array) -> Array:
    """Return the normal of the plane of the first bend, any axis where there is none."""
    normals = np.cross(directions[:-1], directions[1:])
    bent = np.flatnonzero(np.linalg.norm(normals, axis=1) > _BENT)
    return normals[bent[0]] if len(bent) else np.array([0.0, 0.0, 1.0])


def _square_to(x: Array, direction: Array) -> Array:
    """Return the unit vector square to x that is nearest to a direction."""
    off = direction - (direction @ x) * x
    if np.linalg.norm(off) < _BENT * max(1e-300, float(np.linalg.norm(direction))):
        off = np.eye(3)[np.argmin(np.abs(x))]
        off = off - (off @ x) * x
    off = off / np.linalg.norm(off)
    off = off - (off @ x) * x  # once more, against rounding
    return np.asarray(off / np.linalg.norm(off))


def refuse_no_link(
    links: int, what: str = "there is no link", remedy: str = "request more links"
) -> None:
    """Refuse a chain without links.

    Raises:
        CurveError: saying what is refused and what to do.
    """
    if links < 1:
        raise CurveError(what, where="links", value=links, allowed="one or more", remedy=remedy)


# The chain of links as a serial arm of this project: two joints a link, and how they stand.

#: The base of the chain may be this far from where a link begins, as a part of the link.
_AT_BASE = 1e-9


def chain_arm(name: str, links: int, link_m: float, limit_rad: float) -> Arm:
    """Describe a chain of links as an arm of two revolute joints a link.

    The base frame is that of a link before the first: its x points along a straight chain. Rows
    alternate: R_z(a), no length, to the second axis; R_y(b), the link's length, back to the first.

    Args:
        limit_rad: how far every joint turns, either way.

    Raises:
        CurveError: when there is no link.
        ArmError: when a link is longer than an arm's may be.
    """
    refuse_no_link(links)
    joints = 2 * links
    unknown = np.full(joints, np.nan)
    return Arm(
        name=name,
        title=f"chain of {links} links on joints of two axes",
        convention="standard",
        theta_rad=np.zeros(joints),
        d_m=np.zeros(joints),
        a_m=np.tile([0.0, link_m], links),
        alpha_rad=np.tile([-np.pi / 2.0, np.pi / 2.0], links),
        hayati=np.zeros(joints, dtype=bool),
        prismatic=np.zeros(joints, dtype=bool),
        limits_rad=np.tile([-limit_rad, limit_rad], (joints, 1)),
        gear_ratio=unknown,
        torque_limit_Nm=unknown,
        mass_kg=None,
        com_m=None,
    )


def arm_on_first_link(
    name: str, links: int, link_m: float, limits_rad: Array, order: Order = "zy"
) -> Arm:
    """Describe a chain as an arm that stands on its first link, which is its base.

    Its joint positions are the angles between the links, those of the first turn first: of `zy`
    a_1, b_1, a_2 …; base frame and end-effector are the frames of the first link and, at its end,
    of the last.

    Args:
        limits_rad: (2, 2) least and most of the turns about z, then of those about y.

    Raises:
        CurveError: when there are fewer than two links.
        ArmError: when it has more joints than an arm may have, or longer links.
    """
    refuse_no_link(links - 1, "there is no joint between links", "request more links")
    arm = chain_arm(name, links - 1, link_m, np.pi)
    alpha_rad, T_base = arm.alpha_rad, np.eye(4)
    T_base[0, 3] = link_m
    if order == "yz":
        # Rows begin where z is the y of the link, and go back after the last joint.
        alpha_rad = -alpha_rad
        alpha_rad[-1] = 0.0
        T_base[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
        limits_rad = limits_rad[::-1]
    return replace(
        arm,
        title=f"chain of {links} links, from the first on",
        alpha_rad=alpha_rad,
        T_base_row1=T_base,
        limits_rad=np.tile(limits_rad, (links - 1, 1)),
    )


def arm_posture(p_m: Array, T_base: Array, link_m: float) -> Array:
    """Return the joint positions (2 n,) that lay the arm of a chain along points [rad].

    Args:
        p_m: (n + 1, 3) where links join [m]; the first at the base.
        T_base: (4, 4) the arm's base where the points are given [m].

    Raises:
        CurveError: when the points do not begin at the base, or are not a link apart.
    """
    chords = np.diff(p_m, axis=0)
    lengths = np.linalg.norm(chords, axis=1)
    off = np.append(lengths - link_m, np.linalg.norm(p_m[0] - T_base[:3, 3]))
    if np.abs(off).max() > _AT_BASE * link_m:
        raise CurveError(
            "the points do not fit the arm",
            where="points",
            value=f"{np.abs(off).max():.3g} m off",
            allowed=f"from the base on, {link_m:g} m apart",
            remedy="lay links of the arm's length along a curve that begins at its base",
        )
    directions = np.vstack([T_base[:3, 0], chords / lengths[:, None]])
    joints = joint_angles(directions, T_base[:3, :3])
    return np.stack([joints.a_rad, joints.b_rad], axis=1).ravel()
