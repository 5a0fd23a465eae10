"""An arm from a URDF, by way of pinocchio: its joint axes, limits and masses as rows.

The rows are laid through the axes as pinocchio has them, and its forward kinematics is the check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.joint_axes import Rows, neat, rows_through
from pa10cal.arm.parallel import with_hayati_rows
from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfTree
from pa10cal.arrays import Array
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
        text: content of the file.
        name: of the arm.
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        where: name of the file, for messages.

    Raises:
        ArmError: when the URDF cannot be used, or forward kinematics would differ by over 1e-9.
    """
    tree = read_tree(text, where)
    base, tip, path = tree.path(base, tip)
    joints = [joint for joint in path if joint.kind in MOVING]
    posed = _Posed(tree, [joint.name for joint in joints], base, tip)
    T_base_joints, axes = posed.at_zero(joints)
    rows = rows_through(T_base_joints[:, :3, 3], axes, posed.T_base_ee(np.zeros(len(joints))))
    limits, notes = _limits(joints, where)
    mass_kg, com_m = posed.masses(T_base_joints, rows)
    arm = Arm(
        name=name,
        title=name,
        convention="standard",
        theta_rad=rows.theta_rad,
        d_m=rows.d_m,
        a_m=rows.a_m,
        alpha_rad=rows.alpha_rad,
        hayati=np.zeros(len(joints), dtype=bool),
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
        limits_rad=limits,
        gear_ratio=np.full(len(joints), np.nan),
        torque_limit_Nm=np.array([joint.effort for joint in joints]),
        mass_kg=mass_kg,
        com_m=com_m,
        beta_rad=rows.beta_rad,
        T_base_row1=rows.T_base_row1,
        T_row_n_ee=rows.T_row_n_ee,
    )
    arm = with_hayati_rows(arm)
    off_m, off_rad = _differences(arm, posed)
    if max(off_m, off_rad) > _TOLERANCE:
        raise ArmError(
            "the rows do not reproduce forward kinematics of the URDF",
            where=where,
            value=f"{off_m:.1e} m, {off_rad:.1e} rad",
            allowed=f"{_TOLERANCE:g} m and rad",
            remedy="report it with the file; describe the arm by hand meanwhile",
        )
    notes += _left_out(tree, path, arm)
    return ImportedArm(
        arm, base, tip, tuple(joint.name for joint in joints), off_m, off_rad, tuple(notes)
    )


class _Posed:
    """The serial path as pinocchio has it, all other joints held at zero."""

    def __init__(self, tree: UrdfTree, joints: list[str], base: str, tip: str) -> None:
        whole = pin.buildModelFromXML(_kinematics_text(tree))
        kept = {_joint_name(name) for name in joints}
        held = [whole.getJointId(name) for name in whole.names[1:] if name not in kept]
        self._model = pin.buildReducedModel(whole, held, pin.neutral(whole))
        self._data = self._model.createData()
        self._base, self._tip = self._model.getFrameId(base), self._model.getFrameId(tip)
        self._turns = [self._model.joints[k + 1].nq == 2 for k in range(len(joints))]

    def T_base_ee(self, q: Array) -> Array:
        """Return the end-effector in the base (4, 4) at joint positions (n,)."""
        pin.framesForwardKinematics(self._model, self._data, self._configuration(q))
        T_base_ee: Array = self._data.oMf[self._base].actInv(self._data.oMf[self._tip]).homogeneous
        return T_base_ee

    def at_zero(self, joints: list[UrdfJoint]) -> tuple[Array, Array]:
        """Return the frames of all joints (n, 4, 4) and their axes (n, 3), in the base, at zero."""
        self.T_base_ee(np.zeros(len(joints)))
        T_base_world = self._data.oMf[self._base].inverse()
        T_base_joints = np.array(
            [(T_base_world * T_world_joint).homogeneous for T_world_joint in self._data.oMi[1:]]
        )
        own = np.array([joint.axis for joint in joints])
        own /= np.linalg.norm(own, axis=1, keepdims=True)
        axes: Array = np.einsum("kij,kj->ki", T_base_joints[:, :3, :3], own)
        return T_base_joints, axes

    def masses(self, T_base_joints: Array, rows: Rows) -> tuple[Array | None, Array | None]:
        """Return masses (n,) and centres of mass (n, 3) in the rows; None where none has a mass."""
        bodies: list[Any] = self._model.inertias[1:]
        mass_kg = np.array([body.mass for body in bodies])
        if not mass_kg.any():
            return None, None
        com_m = np.array([body.lever for body in bodies])
        T_row_joint = np.linalg.inv(rows.T_base_rows) @ T_base_joints
        com_m = np.einsum("kij,kj->ki", T_row_joint[:, :3, :3], com_m) + T_row_joint[:, :3, 3]
        return mass_kg, np.where(mass_kg[:, None] > 0.0, neat(com_m), 0.0)

    def _configuration(self, q: Array) -> Array:
        """Return what pinocchio takes: cosine and sine where a joint turns without limit."""
        parts = [
            [np.cos(value), np.sin(value)] if turns else [value]
            for value, turns in zip(q, self._turns, strict=True)
        ]
        return np.concatenate(parts)


def _kinematics_text(tree: UrdfTree) -> str:
    """Return a URDF of placements, axes and masses alone, with nothing for a reader to stumble on.

    Shapes are omitted, and the limits that URDF requires of some joints are placeholders.
    """
    robot = ElementTree.Element("robot", name="robot")
    for link in tree.links:
        element = ElementTree.SubElement(robot, "link", name=link.name)
        if link.mass_kg:
            inertial = ElementTree.SubElement(element, "inertial")
            ElementTree.SubElement(inertial, "origin", xyz=_words(link.com_m))
            ElementTree.SubElement(inertial, "mass", value=repr(link.mass_kg))
            moments = dict.fromkeys(("ixx", "iyy", "izz"), "1") | dict.fromkeys(
                ("ixy", "ixz", "iyz"), "0"
            )
            ElementTree.SubElement(inertial, "inertia", moments)
    for joint in tree.joints:
        name = _joint_name(joint.name)
        element = ElementTree.SubElement(robot, "joint", name=name, type=joint.kind)
        ElementTree.SubElement(element, "origin", xyz=_words(joint.xyz), rpy=_words(joint.rpy))
        ElementTree.SubElement(element, "parent", link=joint.parent)
        ElementTree.SubElement(element, "child", link=joint.child)
        ElementTree.SubElement(element, "axis", xyz=_words(joint.axis))
        form = dict.fromkeys(("effort", "velocity", "upper"), "1") | {"lower": "-1"}
        ElementTree.SubElement(element, "limit", form)
    return ElementTree.tostring(robot, encoding="unicode")


def _joint_name(name: str) -> str:
    """Return a joint's name apart from those of links, of which one may be the same.

    Pinocchio looks for both among its frames.
    """
    return f"joint {name}"


def _words(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))


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


def _differences(arm: Arm, posed: _Posed) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] from pinocchio's, over random positions."""
    low, high = arm.limits_rad.T
    q = np.random.default_rng(_SEED).uniform(low, high, (_CHECKS, arm.n))
    found = Chain.of(arm).forward(q)
    expected = np.array([posed.T_base_ee(positions) for positions in q])
    off_m = np.linalg.norm(found[:, :3, 3] - expected[:, :3, 3], axis=1).max()
    # Twice the sine of half the angle between two attitudes, over the square root of two.
    apart = np.linalg.norm(found[:, :3, :3] - expected[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    return float(off_m), float(2.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0)).max())


def _left_out(tree: UrdfTree, path: tuple[UrdfJoint, ...], arm: Arm) -> list[str]:
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
