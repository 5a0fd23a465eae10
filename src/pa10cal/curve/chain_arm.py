"""The chain of links as a serial arm of this project: two joints a link, and how they stand."""

from __future__ import annotations

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.curve.angles import joint_angles
from pa10cal.errors import CurveError

#: The base of the chain may be this far from where a link begins, as a part of the link.
_AT_BASE = 1e-9


def chain_arm(name: str, links: int, link_m: float, limit_rad: float) -> Arm:
    """Describe a chain of links as an arm of two revolute joints a link.

    The base frame is that of a link before the first: its x points along a straight chain. Rows
    alternate: R_z(a), no length, to the second axis; R_y(b), the link's length, back to the first.

    Args:
        name: the arm's name.
        links: how many.
        link_m: length of a link.
        limit_rad: how far every joint turns, either way.

    Raises:
        CurveError: when there is no link.
        ArmError: when a link is longer than an arm's may be.
    """
    if links < 1:
        raise CurveError(
            "there is no link",
            where="links",
            value=links,
            allowed="one or more",
            remedy="request more links",
        )
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


def arm_posture(p_m: Array, T_base: Array, link_m: float) -> Array:
    """Return the joint positions (2 n,) that lay the arm of a chain along points [rad].

    Args:
        p_m: (n + 1, 3) where links join [m]; the first at the base.
        T_base: (4, 4) the arm's base where the points are given [m].
        link_m: length of a link.

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
