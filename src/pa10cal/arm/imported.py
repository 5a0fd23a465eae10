"""An arm from a URDF, by way of pinocchio: its joint axes, limits and masses as rows.

The rows are laid through the axes as pinocchio has them, and its forward kinematics is the check.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm, neighbouring_axes, with_hayati_rows
from pa10cal.arm.dh_rows import DHRows, neat, rows_through
from pa10cal.arm.urdf_reading import MOVING, Leader, UrdfJoint, UrdfTree, read_tree
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
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        where: name of the file, for messages.

    Raises:
        ArmError: when the URDF cannot be used, or forward kinematics would differ by over 1e-9.
    """
    tree = read_tree(text, where)
    base, tip, path = tree.path(base, tip)
    joints = [joint for joint in path if joint.kind in MOVING]
    leaders = tree.leaders(path)
    posed = _Posed(tree, joints, base, tip, leaders)
    T_base_joints, axes = posed.at_zero(joints)
    rows = rows_through(T_base_joints[:, :3, 3], axes, posed.T_base_ee(np.zeros(len(joints))))
    limits, notes = _limits(joints, where, leaders)
    names = [joint.name for joint in joints]
    coupled = tuple(
        CoupledJoint(names.index(name) + 1, names.index(of.name) + 1, of.multiplier, follows=True)
        for name, of in leaders.items()
    )
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
        coupled=coupled,
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
    notes += [*_omitted(tree, path, arm), *_one_motor(arm, names, leaders)]
    return ImportedArm(
        arm, base, tip, tuple(joint.name for joint in joints), off_m, off_rad, tuple(notes)
    )


class _Posed:
    """The serial path in pinocchio, all other joints held at zero."""

    def __init__(
        self,
        tree: UrdfTree,
        moving: list[UrdfJoint],
        base: str,
        tip: str,
        leaders: Mapping[str, Leader],
    ) -> None:
        self._model = pin.Model()
        # Which joint of pinocchio carries each link, and where the link is on it.
        at = {tree.root: (0, pin.SE3.Identity())}
        moves = {joint.name for joint in moving}
        for joint in tree.below(tree.root):
            carrier, T = at[joint.parent]
            T = T * pin.SE3(pin.rpy.rpyToMatrix(np.array(joint.rpy)), np.array(joint.xyz))
            if joint.name in leaders:  # counted from where it is when its leader is at zero
                T = T * pin.SE3(
                    np.linalg.inv(joint.origin_at(0.0))
                    @ joint.origin_at(leaders[joint.name].offset)
                )
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


def _limits(
    joints: list[UrdfJoint], where: str, leaders: Mapping[str, Leader]
) -> tuple[Array, list[str]]:
    """Return the limits (n, 2), a full turn either way where a revolute joint states none.

    Those of a joint that others follow are no wider than theirs.
    """
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
    names = [joint.name for joint in joints]
    for name, leader in leaders.items():
        own, other = names.index(name), names.index(leader.name)
        limits[own] -= leader.offset
        low, high = np.sort(limits[own] / leader.multiplier)
        limits[other] = max(limits[other, 0], low), min(limits[other, 1], high)
        if limits[other, 0] >= limits[other, 1]:
            raise ArmError(
                f"the limits of joint {name}, which follows it, allow the joint no motion",
                where=f"{where}: joint {leader.name}",
                value=limits[other].tolist(),
                allowed="limits that overlap, multiplier and offset of the mimicry taken off",
                remedy="correct the limits",
            )
    return limits, notes


def _one_motor(arm: Arm, names: list[str], leaders: Mapping[str, Leader]) -> Iterator[str]:
    """Yield joints that one motor drives, and those that may be: slides along one direction."""
    for each in arm.coupled:
        own = names[each.joint - 1]
        yield (
            f"joint {each.joint} ({own}) follows joint {each.by} ({leaders[own].name}), "
            f"{each.factor:g} times: it has no axis of its own, and files have no column of it"
        )
    parallel = {axes.joints[0] for axes in neighbouring_axes(arm) if axes.parallel}
    first = 1
    while first <= arm.n:
        last = first
        while last in parallel and arm.prismatic[last - 1] and arm.prismatic[last]:
            last += 1
        following = {each.joint for each in arm.coupled}
        if last > first and not following & set(range(first, last + 1)):
            coupling = ", ".join(
                f"{{joint: {joint}, by: {first}, factor: 1, follows: true}}"
                for joint in range(first + 1, last + 1)
            )
            yield (
                f"joints {first} to {last} ({names[first - 1]} … {names[last - 1]}) slide along "
                "one direction, as the stages of a telescope: if one motor drives them, set "
                f"coupling: [{coupling}]"
            )
        first = last + 1


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
