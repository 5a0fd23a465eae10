"""An arm from a URDF, by way of pinocchio: its joint axes, limits and masses as rows.

The rows are laid through the axes as pinocchio has them, and its forward kinematics is the check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import NEARLY_PARALLEL_RAD, Arm, with_hayati_rows
from pa10cal.arm.urdf_reading import MOVING, UrdfJoint, UrdfTree, read_tree
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError

#: Random joint positions of the check, and how far forward kinematics may differ there.
_CHECKS = 300
_SEED = 20080427
_TOLERANCE = 1e-9
_FULL_TURN_RAD = 2.0 * np.pi


@dataclass(frozen=True)
class ImportedArm:
    """An arm from a URDF."""

    arm: Arm  # standard rows; gear ratios are not in a URDF
    # base and tip: links the arm leads from and to
    base: str
    tip: str
    joints: tuple[str, ...]  # names of its joints
    forward_kinematics_difference_m: float  # largest distance between its end and pinocchio's
    forward_kinematics_difference_rad: float  # largest angle between them
    notes: tuple[str, ...]  # what the URDF does not contain or was omitted, a sentence each


def arm_from_urdf_text(
    text: str, name: str, *, base: str | None = None, tip: str | None = None, where: str
) -> ImportedArm:
    """Build an arm from the serial path between two links of a URDF.

    Joints off the path are held at zero; their links count to the link that carries them.

    Args:
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        where: name of the file, for messages.

    Raises:
        ArmError: when the URDF cannot be used, or forward kinematics would differ by over 1e-9.
    """
    tree = read_tree(text, where)
    base, tip, path = tree.path(base, tip)
    joints = [joint for joint in path if joint.kind in MOVING]
    posed = _Posed(tree, joints, base, tip)
    T_base_joints, axes = posed.at_zero(joints)
    rows = rows_through(T_base_joints[:, :3, 3], axes, posed.T_base_ee(np.zeros(len(joints))))
    limits, notes = _limits(joints, where)
    mass_kg, com_m = posed.masses(T_base_joints, rows)
    theta_rad, d_m, a_m, alpha_rad, beta_rad = rows.parameters.T
    arm = Arm(
        name=name,
        title=name,
        convention="standard",
        theta_rad=theta_rad,
        d_m=d_m,
        a_m=a_m,
        alpha_rad=alpha_rad,
        hayati=np.zeros(len(joints), dtype=bool),
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
        limits_rad=limits,
        gear_ratio=np.full(len(joints), np.nan),
        torque_limit_Nm=np.array([joint.effort for joint in joints]),
        mass_kg=mass_kg,
        com_m=com_m,
        beta_rad=beta_rad,
        T_base_row1=rows.T_base_row1,
        T_row_n_ee=rows.T_row_n_ee,
    )
    arm = with_hayati_rows(arm)
    low, high = arm.limits_rad.T
    q = np.random.default_rng(_SEED).uniform(low, high, (_CHECKS, arm.n))
    found = Chain.of(arm).forward(q)
    expected = np.array([posed.T_base_ee(positions) for positions in q])
    off_m = float(np.linalg.norm(found[:, :3, 3] - expected[:, :3, 3], axis=1).max())
    # Twice the sine of half the angle between two orientations, over the square root of two.
    apart = np.linalg.norm(found[:, :3, :3] - expected[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    off_rad = float(2.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0)).max())
    if max(off_m, off_rad) > _TOLERANCE:
        raise ArmError(
            "the rows do not reproduce forward kinematics of the URDF",
            where=where,
            value=f"{off_m:.1e} m, {off_rad:.1e} rad",
            allowed=f"{_TOLERANCE:g} m and rad",
            remedy="report it with the file; describe the arm by hand meanwhile",
        )
    notes += _omitted(tree, path, arm)
    return ImportedArm(
        arm, base, tip, tuple(joint.name for joint in joints), off_m, off_rad, tuple(notes)
    )


class _Posed:
    """The serial path in pinocchio, all other joints held at zero."""

    def __init__(self, tree: UrdfTree, moving: list[UrdfJoint], base: str, tip: str) -> None:
        self._model = pin.Model()
        # Which joint of pinocchio carries each link, and where the link is on it.
        at = {tree.root: (0, pin.SE3.Identity())}
        moves = {joint.name for joint in moving}
        for joint in tree.below(tree.root):
            carrier, T = at[joint.parent]
            T = T * pin.SE3(pin.rpy.rpyToMatrix(np.array(joint.rpy)), np.array(joint.xyz))
            if joint.name in moves:
                slides = joint.kind == "prismatic"
                kind = (
                    pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
                )
                carrier = self._model.addJoint(carrier, kind(_direction(joint)), T, joint.name)
                T = pin.SE3.Identity()
            at[joint.child] = carrier, T
        for link in tree.links:
            body = pin.Inertia(link.mass_kg, np.array(link.com_m), np.eye(3))
            self._model.appendBodyToJoint(at[link.name][0], body, at[link.name][1])
        self._data = self._model.createData()
        self._base, self._tip = at[base], at[tip]

    def T_base_ee(self, q: Array) -> Array:
        """Return the end-effector in the base (4, 4) at joint positions (n,)."""
        pin.forwardKinematics(self._model, self._data, q)
        base, tip = (self._data.oMi[joint] * T for joint, T in (self._base, self._tip))
        T_base_ee: Array = base.actInv(tip).homogeneous
        return T_base_ee

    def at_zero(self, joints: list[UrdfJoint]) -> tuple[Array, Array]:
        """Return the frames of all joints (n, 4, 4) and their axes (n, 3), in the base, at zero."""
        self.T_base_ee(np.zeros(len(joints)))
        T_base_world = (self._data.oMi[self._base[0]] * self._base[1]).inverse()
        T_base_joints = np.array([(T_base_world * T).homogeneous for T in self._data.oMi[1:]])
        along = np.array([_direction(joint) for joint in joints])
        return T_base_joints, np.einsum("kij,kj->ki", T_base_joints[:, :3, :3], along)

    def masses(self, T_base_joints: Array, rows: DHRows) -> tuple[Array | None, Array | None]:
        """Return masses (n,) and centres of mass (n, 3) in the rows; None where none has a mass."""
        bodies: list[Any] = self._model.inertias[1:]
        mass_kg = np.array([body.mass for body in bodies])
        if not mass_kg.any():
            return None, None
        com_m = np.array([body.lever for body in bodies])
        T_row_joint = np.linalg.inv(rows.T_base_rows) @ T_base_joints
        com_m = np.einsum("kij,kj->ki", T_row_joint[:, :3, :3], com_m) + T_row_joint[:, :3, 3]
        return mass_kg, np.where(mass_kg[:, None] > 0.0, neat(com_m), 0.0)


def _direction(joint: UrdfJoint) -> Array:
    """Return the unit vector along which or about which a joint moves, in its own frame."""
    return np.asarray(np.array(joint.axis) / np.linalg.norm(joint.axis))


def _limits(joints: list[UrdfJoint], where: str) -> tuple[Array, list[str]]:
    """Return the limits (n, 2), a full turn either way where a revolute joint states none."""
    limits, notes = np.array([joint.limits for joint in joints]), []
    for row, joint in enumerate(joints):
        if np.isfinite(limits[row]).all():
            continue
        if joint.kind == "prismatic":
            raise ArmError(
                "a prismatic joint has no limits",
                where=f"{where}: joint {joint.name}",
                allowed="<limit lower=… upper=…>, in metres",
                remedy="add them to the URDF",
            )
        limits[row] = -_FULL_TURN_RAD, _FULL_TURN_RAD
        why = "turns without limit" if joint.kind == "continuous" else "states no limits"
        notes.append(f"joint {joint.name} {why}: -360 to 360 degrees are taken")
    return limits, notes


def _omitted(tree: UrdfTree, path: tuple[UrdfJoint, ...], arm: Arm) -> list[str]:
    """Return what was not taken over, or is not there to take over."""
    notes = []
    held = [joint.name for joint in tree.joints if joint.kind != "fixed" and joint not in path]
    if held:
        notes.append(f"off the path, and held at zero: {', '.join(held)}")
    if arm.mass_kg is None:
        notes.append("no link has a mass: weights are assumed from the lengths of the links")
    elif not arm.mass_kg.all():
        massless = [str(row) for row in np.flatnonzero(arm.mass_kg == 0.0) + 1]
        notes.append(f"no mass of links {', '.join(massless)}")
    unrated = [str(row) for row in np.flatnonzero(np.isnan(arm.torque_limit_Nm)) + 1]
    if unrated:
        notes.append(f"no rated torque (effort) of joints {', '.join(unrated)}")
    notes.append("gear ratios are not in a URDF: add gear_ratio to test transmission errors")
    return notes


# Denavit-Hartenberg rows through joint axes that are given as lines in space.
#
# A row leads from one joint's axis to the next along their common normal. Axes that are nearly
# parallel have theirs anywhere; there the next frame sits where the axis meets the plane across
# the one before, with d = 0 and Hayati's beta (paper, Section II.C).

#: Axes closer than this count as meeting; far below what an arm can be built to.
_MEETING_M = 5e-11
#: Sums of exact figures are off by this, and are written as the figures they stand for.
_ROUND_OFF = 1e-13
_DECIMALS = 9


@dataclass(frozen=True)
class DHRows:
    """Standard Denavit-Hartenberg rows, with the constant frames that they start and end with."""

    parameters: Array  # (n, 5) theta [rad], d [m], a [m], alpha [rad] and beta [rad] of each
    T_base_row1: Array  # (4, 4) frame the first row starts from, its z along the first axis [m]
    T_row_n_ee: Array  # (4, 4) end-effector in the frame of the last row [m]
    T_base_rows: Array  # (n, 4, 4) frames of the rows [m]


def rows_through(p_base_m: Array, axes: Array, T_base_ee: Array) -> DHRows:
    """Lay standard Denavit-Hartenberg rows through the axes of n joints, all at zero.

    Of the two directions of a common normal the one is taken that turns theta by less than a
    quarter. The last row only turns and shifts along its axis; what is left to the end-effector
    is the constant frame after it. Axes are given by a point and a unit vector each, (n, 3).
    """
    T_base_row1 = _first_frame(p_base_m[0], axes[0]).round(15) + 0.0  # no round-off beside 0 and 1
    T, parameters, frames = T_base_row1, [], []
    for p_m, axis in zip(p_base_m[1:], axes[1:], strict=True):
        R = T[:3, :3]
        parameters.append(_row_to(R.T @ (p_m - T[:3, 3]), R.T @ axis))
        T = T @ _motion(*parameters[-1])
        frames.append(T)
    # The last row brings its frame under the end-effector, x in line where it can be.
    end = np.linalg.inv(T) @ T_base_ee
    flat = end[:2, 0] if np.linalg.norm(end[:2, 0]) > 0.5 else end[:2, 1]
    turn = float(np.arctan2(flat[1], flat[0]))
    parameters.append(_neat_row(turn, float(end[2, 3]), 0.0, 0.0, 0.0))
    T = T @ _motion(*parameters[-1])
    T_row_n_ee = (np.linalg.inv(T) @ T_base_ee).round(15) + 0.0
    return DHRows(np.array(parameters), T_base_row1, T_row_n_ee, np.array([*frames, T]))


def _first_frame(p_m: Array, axis: Array) -> Array:
    """Return a frame with z along an axis: level with the base where the axis stands upright."""
    upright = abs(axis[2]) > np.cos(NEARLY_PARALLEL_RAD)
    origin = p_m - axis * (p_m[2] / axis[2] if upright else p_m @ axis)
    along = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = along - axis * (axis @ along)
    x /= np.linalg.norm(x)
    return homogeneous(np.column_stack([x, np.cross(axis, x), axis]), origin)


def _row_to(p_m: Array, axis: Array) -> Array:
    """Return theta, d, a, alpha, beta (5,) from the z axis to an axis through a point."""
    across = float(np.hypot(axis[0], axis[1]))
    if np.arctan2(across, abs(axis[2])) < NEARLY_PARALLEL_RAD:
        meets = p_m - axis * (p_m[2] / axis[2])
        theta, a, _ = _within_a_quarter(meets[0], meets[1])
        cos, sin = np.cos(theta), np.sin(theta)
        x, y, z = cos * axis[0] + sin * axis[1], cos * axis[1] - sin * axis[0], axis[2]
        return _neat_row(theta, 0.0, a, np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z)))
    theta, _, sign = _within_a_quarter(-axis[1], axis[0])
    a = p_m[0] * np.cos(theta) + p_m[1] * np.sin(theta)
    d = p_m[2] - axis[2] * (p_m[:2] @ axis[:2]) / across**2
    return _neat_row(theta, d, a, np.arctan2(sign * across, axis[2]), 0.0)


def _within_a_quarter(x: float, y: float) -> tuple[float, float, float]:
    """Return the angle, at most a quarter turn, the signed length and its sign of a vector."""
    length = float(np.hypot(x, y))
    if length < _MEETING_M:
        return 0.0, 0.0, 1.0
    theta = float(np.arctan2(y, x))
    if abs(theta) <= np.pi / 2.0 + _ROUND_OFF:
        return theta, length, 1.0
    return theta - float(np.copysign(np.pi, theta)), -length, -1.0


def _neat_row(theta: float, d: float, a: float, alpha: float, beta: float) -> Array:
    theta, alpha, beta = np.radians(neat(np.degrees([theta, alpha, beta])))
    d, a = neat(np.array([d, 0.0 if abs(a) < _MEETING_M else a]))
    return np.array([theta, d, a, alpha, beta])


def neat(values: Array) -> Array:
    """Return the figures of few decimals that values are but for round-off; others as they are."""
    few = np.round(values, _DECIMALS) + 0.0
    tidy: Array = np.where(
        np.abs(few - values) < _ROUND_OFF * np.maximum(1.0, np.abs(few)), few, values
    )
    return tidy


def _motion(theta: float, d: float, a: float, alpha: float, beta: float) -> Array:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)."""
    R = Rotation.from_euler("ZXY", [theta, alpha, beta]).as_matrix()
    return homogeneous(R, np.array([a * np.cos(theta), a * np.sin(theta), d]))
