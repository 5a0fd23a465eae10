"""Import of an arm from a URDF: joint axes, limits and masses as Denavit-Hartenberg rows.

Pinocchio computes the joint axes, through which the rows are laid; its forward kinematics at random
joint positions then verifies them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from pa10cal.arm.chain import Chain, pose_distances
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm, neighbouring_axes, with_hayati_rows
from pa10cal.arm.dh_rows import DHRows, neat, rows_through
from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_tree import MOVING, Leader, UrdfJoint, UrdfTree
from pa10cal.arrays import Array
from pa10cal.errors import ArmError

#: Number and seed of the random joint positions at which forward kinematics is verified, and how
#: far it may differ there [m, rad].
_CHECKS, _SEED = 300, 20080427
_TOLERANCE = 1e-9
#: Limits of a revolute joint that states none: either way [rad].
_FULL_TURN_RAD = 2.0 * np.pi


@dataclass(frozen=True)
class ImportedArm:
    """An arm from a URDF."""

    arm: Arm  # standard rows; gear ratios are not in a URDF
    # base and tip: links the arm leads from and to
    base: str
    tip: str
    joints: tuple[str, ...]  # names of its moving joints
    forward_kinematics_difference_m: float  # largest distance between its end and pinocchio's
    forward_kinematics_difference_rad: float  # largest angle between them
    notes: tuple[str, ...]  # what the URDF does not contain or was omitted, a sentence each


def arm_from_urdf_text(
    text: str, name: str, *, base: str | None = None, tip: str | None = None, where: str
) -> ImportedArm:
    """Build an arm from the serial path between two links of a URDF.

    Joints off the path are held at zero; their links count to the link that carries them. Where
    joints of the path carry the base, gravity turns with it: the arm then has no masses.

    Args:
        base: link that is the arm's base; the root where None.
        tip: link that is the end-effector; the only tip where None.
        where: name of the file, for messages.

    Raises:
        ArmError: when the URDF cannot be used, or forward kinematics would differ by over 1e-9.
    """
    tree = read_tree(text, where).seen_from(base, tip)
    path = tree.path(base, tip)
    joints, leaders = [joint for joint in path.joints if joint.kind in MOVING], path.leaders
    model = _PinocchioArm(tree, joints, path.base, path.tip, leaders)
    T_base_joints, axes = model.at_zero(joints)
    rows = rows_through(T_base_joints[:, :3, 3], axes, model.T_base_ee(np.zeros(len(joints))))
    limits, notes = _limits(joints, where, leaders)
    names = [joint.name for joint in joints]
    coupled = tuple(
        CoupledJoint(
            names.index(name) + 1, names.index(leader.name) + 1, leader.multiplier, follows=True
        )
        for name, leader in leaders.items()
    )
    against = [name for name in names if name in tree.turned]
    mass_kg, com_m = (None, None) if against else model.masses(T_base_joints, rows)
    arm = Arm(
        name=name,
        title=name,
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
        limits_rad=limits,
        gear_ratio=np.full(len(joints), np.nan),
        torque_limit_Nm=np.array([joint.effort for joint in joints]),
        mass_kg=mass_kg,
        com_m=com_m,
        base_moves=bool(against),
        coupled=coupled,
        **rows.arm_fields,
    )
    arm = with_hayati_rows(arm)
    # Some files state limits of many turns for none, at which rounding would be all that shows.
    bound = np.where(arm.prismatic, np.inf, _FULL_TURN_RAD)
    low, high = np.clip(arm.limits_rad.T, -bound, bound)
    q = np.random.default_rng(_SEED).uniform(low, high, (_CHECKS, arm.n))
    expected = np.array([model.T_base_ee(positions) for positions in q])
    off_m, off_rad = (
        float(off.max()) for off in pose_distances(Chain.of(arm).forward(q), expected)
    )
    if max(off_m, off_rad) > _TOLERANCE:
        raise ArmError(
            "the rows do not reproduce forward kinematics of the URDF",
            where=where,
            value=f"{off_m:.1e} m, {off_rad:.1e} rad",
            allowed=f"{_TOLERANCE:g} m and rad",
            remedy="report it with the file; describe the arm by hand meanwhile",
        )
    if against:
        notes.append(
            f"joints that carry {path.base}, and lead from it here: {', '.join(against)}; gravity "
            "turns with it, so masses are left out, and gravity_m_s2 is to be [0, 0, 0]"
        )
    notes += [*_omitted(tree, path.joints, arm), *_one_motor(arm, names, leaders)]
    return ImportedArm(arm, path.base, path.tip, tuple(names), off_m, off_rad, tuple(notes))


class _PinocchioArm:
    """The serial path as a model of pinocchio, all other joints held at zero."""

    def __init__(
        self,
        tree: UrdfTree,
        moving: list[UrdfJoint],
        base: str,
        tip: str,
        leaders: Mapping[str, Leader],
    ) -> None:
        self._model = pin.Model()
        # By link: the joint of pinocchio that carries it, and the link's pose on that joint.
        carried = {tree.root: (0, pin.SE3.Identity())}
        moves = {joint.name for joint in moving}
        for joint in tree.below(tree.root):
            carrier, T = carried[joint.parent]
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
            carried[joint.child] = carrier, T
        for link in tree.links:
            body = pin.Inertia(link.mass_kg, np.array(link.com_m), np.eye(3))
            carrier, T = carried[link.name]
            self._model.appendBodyToJoint(carrier, body, T)
        self._data = self._model.createData()
        self._base, self._tip = carried[base], carried[tip]

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
    """Return the limits (n, 2) of the joints, and notes on those that state none.

    Limits of a joint that others follow are narrowed to those of its followers.
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
        follower, led_by = names.index(name), names.index(leader.name)
        limits[follower] -= leader.offset
        low, high = np.sort(limits[follower] / leader.multiplier)
        limits[led_by] = max(limits[led_by, 0], low), min(limits[led_by, 1], high)
        if limits[led_by, 0] >= limits[led_by, 1]:
            raise ArmError(
                f"the limits of joint {name}, which follows it, allow the joint no motion",
                where=f"{where}: joint {leader.name}",
                value=limits[led_by].tolist(),
                allowed="limits that overlap, multiplier and offset of the mimicry taken off",
                remedy="correct the limits",
            )
    return limits, notes


def _one_motor(arm: Arm, names: list[str], leaders: Mapping[str, Leader]) -> Iterator[str]:
    """Yield notes on joints that follow others, and on parallel slides that one motor may drive."""
    for coupled in arm.coupled:
        name = names[coupled.joint - 1]
        yield (
            f"joint {coupled.joint} ({name}) follows joint {coupled.by} ({leaders[name].name}), "
            f"{coupled.factor:g} times: it has no axis of its own, and files have no column of it"
        )
    parallel = {axes.joints[0] for axes in neighbouring_axes(arm) if axes.parallel}
    following = {coupled.joint for coupled in arm.coupled}
    first = 1
    while first <= arm.n:
        last = first
        while last in parallel and arm.prismatic[last - 1] and arm.prismatic[last]:
            last += 1
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
    """Return notes on what was not imported, and on what the URDF does not contain."""
    notes = []
    held = [joint.name for joint in tree.joints if joint.kind != "fixed" and joint not in path]
    if held:
        notes.append(f"off the path, and held at zero: {', '.join(held)}")
    if arm.mass_kg is None and not arm.base_moves:
        notes.append("no link has a mass: weights are assumed from the lengths of the links")
    elif arm.mass_kg is not None and not arm.mass_kg.all():
        massless = [str(row) for row in np.flatnonzero(arm.mass_kg == 0.0) + 1]
        notes.append(f"no mass of links {', '.join(massless)}")
    unrated = [str(row) for row in np.flatnonzero(np.isnan(arm.torque_limit_Nm)) + 1]
    if unrated:
        notes.append(f"no rated torque (effort) of joints {', '.join(unrated)}")
    notes.append("gear ratios are not in a URDF: add gear_ratio to test transmission errors")
    return notes
