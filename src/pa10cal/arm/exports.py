"""A calibrated arm for other programs: URDF, a user's own URDF, poses to send."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, Chain, carried_frames, moved_frames
from pa10cal.arm.urdf_reading import MOVING, UrdfJoint, as_comment, origin_of, parse_urdf, read_tree
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError, visible


def urdf_text(
    chain: Chain,
    coordinates: Array,
    name: str,
    *comments: str,
    frames: Mapping[str, Array] | None = None,
) -> str:
    """Write the rigid geometry of a chain.

    Deflection under torque has no place in URDF and is omitted; so are masses. The frame that the
    chain's base coordinates place is the link `base`; the end of the chain is the link `flange`.

    Args:
        chain, coordinates: the chain, and (m,) where it stands at zero joint positions and torques.
        name, comments: of the robot, and what a reader should know above everything else.
        frames: further links, and their poses (4, 4) in the flange.

    Returns:
        The text of the file; forward kinematics of its joints `joint_1` … `joint_n` is the chain's.
        Joints that follow another mimic it; other couplings have no place in it.
    """
    robot = ElementTree.Element("robot", name=name)
    for comment in comments:
        robot.append(ElementTree.Comment(as_comment(comment)))
    ElementTree.SubElement(robot, "link", name="base")
    constant, joint, parent = np.eye(4), 0, "base"
    driven = {int(column): k for k, column in enumerate(chain.joint_columns)}
    for column, motion in enumerate(chain.motions):
        if motion.coordinate in BASE:
            continue
        value = float(coordinates[column])
        constant = constant @ chain.constants.get(column, np.eye(4))
        if column in driven:
            joint += 1
            child = f"link_{joint}"
            kind = "prismatic" if not motion.turns else "revolute"
            element = _joint(robot, f"joint_{joint}", kind, parent, child, constant)
            ElementTree.SubElement(element, "axis", xyz="0 0 1")
            lower, upper = chain.arm.joint_ranges_rad[driven[column]]
            ElementTree.SubElement(
                element,
                "limit",
                lower=repr(float(lower)),
                upper=repr(float(upper)),
                effort=repr(float(np.nan_to_num(chain.arm.torque_limit_Nm[driven[column]]))),
                velocity="1.0",
            )
            leads = chain.arm.coupling.leads(driven[column])
            if leads is not None:
                leader, factor = f"joint_{leads.by}", repr(leads.factor)
                ElementTree.SubElement(element, "mimic", joint=leader, multiplier=factor)
            constant, parent = np.eye(4), child
        constant = constant @ motion.frame_at(value)
    _joint(robot, "to_flange", "fixed", parent, "flange", constant)
    for link, T in (frames or {}).items():
        _joint(robot, f"to_{link}", "fixed", "flange", link, T)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, T: Array
) -> ElementTree.Element:
    """Add a link and the joint that carries it, at pose T in its parent."""
    name, child = visible(name), visible(child)
    ElementTree.SubElement(robot, "link", name=child)
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "origin", origin_of(T))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


# A user's own URDF with the origins of a calibrated arm; all else in it stays.

#: How far a URDF and the description of its arm may differ [m, rad]: its numbers may be rounded.
_SAME = 1e-5
FLANGE = "flange"


@dataclass(frozen=True)
class UrdfSource:
    """The URDF that an arm came from."""

    text: str  # its content
    where: str  # its name, for messages
    # base and tip: links between which the arm is
    base: str
    tip: str

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints with an axis of their own between the links, in order."""
        tree = read_tree(self.text, self.where)
        joints = tree.path(self.base, self.tip)[2]
        follow = tree.leaders(joints)
        return tuple(j.name for j in joints if j.kind in MOVING and j.name not in follow)


def patched_urdf(
    source: UrdfSource,
    chain: Chain,
    coordinates: Array,
    frames: Mapping[str, Array],
    *comments: str,
) -> str:
    """Return a URDF with calibrated origins, and links for flange, tool and targets added.

    Names, axes, limits, shapes and inertials stay. The link `flange` is that of the chain; where
    the URDF has another link of a name that is added, the one added is called `<name>_pa10cal`.
    The chain is that of the arm that came from it; for the other arguments see `urdf_text`.

    Raises:
        ArmError: when it cannot be read, or is of another arm.
    """
    tree = read_tree(source.text, source.where)
    _, _, path = tree.path(source.base, source.tip)
    joints = [joint for joint in path if joint.kind in MOVING]
    # All joints at zero, and those that follow one where they are then.
    at = {name: leader.offset for name, leader in tree.leaders(path).items()}
    T_root = {tree.root: np.eye(4)}
    for joint in tree.below(tree.root):
        T_root[joint.child] = T_root[joint.parent] @ joint.origin_at(at.get(joint.name, 0.0))
    T_base = {link: np.linalg.inv(T_root[source.base]) @ T for link, T in T_root.items()}
    own = np.array([T_base[joint.child] for joint in joints])
    _refuse_another_arm(source, chain, joints, own, T_base[source.tip])
    moved, T_base_flange = moved_frames(chain, coordinates, own)
    placed_at = {joint.child: T for joint, T in zip(joints, moved, strict=True)}
    if path[-1].kind == "fixed":
        placed_at[path[-1].child] = T_base_flange
    origins, T = {}, T_base[path[0].parent]
    for joint in path:
        if joint.child in placed_at:
            off = np.linalg.inv(joint.origin_at(0.0)) @ joint.origin_at(at.get(joint.name, 0.0))
            origins[joint.name] = np.linalg.inv(T) @ placed_at[joint.child] @ np.linalg.inv(off)
            T = placed_at[joint.child]
        else:
            T = T @ joint.origin_at(0.0)
    file = parse_urdf(source.text, comments=True)
    for element in file.robot.findall("joint"):
        if element.get("name") in origins:
            origin = element.find("origin")
            if origin is None:
                origin = ElementTree.Element("origin")
                origin.tail = element.text
                element.insert(0, origin)
            origin.attrib.update(origin_of(origins[str(element.get("name"))]))
    taken = {link.name for link in tree.links} | {joint.name for joint in tree.joints}

    def add_fixed(parent: str, name: str, T: Array) -> str:
        """Add a link and the fixed joint that carries it; return the link's name."""
        link, joint = (
            word if word not in taken else f"{word}_pa10cal" for word in (name, f"to_{name}")
        )
        taken.update((link, joint))
        _joint(file.robot, joint, "fixed", parent, link, T).tail = "\n"
        file.robot[-2].tail = "\n  "
        return link

    # The flange, where the tip is not its link, and further links fixed to it.
    T_tip_flange, flange = np.linalg.inv(T) @ T_base_flange, source.tip
    if flange != FLANGE or np.abs(T_tip_flange - np.eye(4)).max() > 0.0:
        flange = add_fixed(source.tip, FLANGE, T_tip_flange)
    for name, T_flange_link in frames.items():
        add_fixed(flange, name, T_flange_link)
    return file.text(*comments)


def _refuse_another_arm(
    source: UrdfSource, chain: Chain, joints: list[UrdfJoint], own: Array, T_base_tip: Array
) -> None:
    """Refuse a URDF whose joint axes or tip are not those of the chain as designed."""
    off = np.inf
    if len(joints) == chain.arm.n:
        designed, T_base_flange = carried_frames(chain, chain.nominal)
        axes = np.array([joint.axis for joint in joints])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        along = np.einsum("kij,kj->ki", own[:, :3, :3], axes)
        beside = np.cross(own[:, :3, 3] - designed[:, :3, 3], designed[:, :3, 2])
        beside[chain.arm.prismatic] = 0.0
        differences = (along - designed[:, :3, 2], beside, T_base_tip - T_base_flange)
        off = max(float(np.abs(difference).max()) for difference in differences)
    if off > _SAME:
        differs = f"{len(joints)} joints, {off:.1e} m or rad off"
        raise ArmError(
            "the URDF is not that of the arm",
            where=source.where,
            value=differs,
            allowed=f"the URDF from which {chain.arm.name} was imported",
            remedy="import the arm again from this URDF, or give the one it came from",
        )


# Poses as the controllers of robots write them.

#: A, B, C of KUKA turn about z, the new y, the new x; roll, pitch, yaw about fixed x, y, z (W, P, R
#: of Fanuc); a rotation vector is that of Universal Robots.
Angles = Literal["ABC", "quaternion", "rpy", "rotation_vector"]
#: Columns of an orientation, and it as numbers (..., 3 or 4) and back, by how it is written.
_ORIENTATION: dict[
    str, tuple[tuple[str, ...], Callable[[Rotation], Array], Callable[[Array], Rotation]]
] = {
    "ABC": (
        ("A_deg", "B_deg", "C_deg"),
        lambda R: R.as_euler("ZYX", degrees=True),
        lambda turn: Rotation.from_euler("ZYX", turn, degrees=True),
    ),
    "quaternion": (
        ("qw", "qx", "qy", "qz"),
        lambda R: R.as_quat(canonical=True, scalar_first=True),
        lambda turn: Rotation.from_quat(turn, scalar_first=True),
    ),
    "rpy": (
        ("roll_deg", "pitch_deg", "yaw_deg"),
        lambda R: R.as_euler("ZYX", degrees=True)[:, ::-1],
        lambda turn: Rotation.from_euler("ZYX", turn[::-1], degrees=True),
    ),
    "rotation_vector": (
        ("rx_rad", "ry_rad", "rz_rad"),
        lambda R: R.as_rotvec(),
        lambda turn: Rotation.from_rotvec(turn),
    ),
}
#: Quaternions are written with a few digits; further from length one they are something else.
_UNIT_LENGTH = 1e-2


def controller_columns(T: Array, angles: Angles) -> dict[str, Array]:
    """Return poses (N, 4, 4) [m] in the form of a controller.

    Args:
        angles: `ABC`, intrinsic z-y-x in degrees; `quaternion`, scalar first; `rpy`, roll, pitch
            and yaw about fixed axes x, y, z in degrees; `rotation_vector`, axis times angle [rad].

    Returns:
        `x_mm`, `y_mm`, `z_mm` and the orientation's columns, (N,) each.

    Raises:
        ArmError: when there are no such angles.
    """
    columns, written, _ = _orientation(angles)
    with warnings.catch_warnings():
        # At B = ±90 degrees A and C are not unique; one pair is as good as another.
        warnings.simplefilter("ignore")
        turned = written(Rotation.from_matrix(T[:, :3, :3]))
    values = np.column_stack([1e3 * T[:, :3, 3], turned])
    return dict(zip(("x_mm", "y_mm", "z_mm", *columns), values.T, strict=True))


def controller_pose(values: Sequence[float], angles: Angles) -> Array:
    """Return the pose (4, 4) [m] that a controller writes so; see `controller_columns`.

    Raises:
        ArmError: when there are no such angles, or not as many numbers as they need.
    """
    columns, _, read = _orientation(angles)
    names = ("x_mm", "y_mm", "z_mm", *columns)
    found = np.asarray(values, dtype=float)
    wrong = found.shape != (len(names),) or not np.isfinite(found).all()
    if not wrong and angles == "quaternion":
        wrong = abs(float(np.linalg.norm(found[3:])) - 1.0) > _UNIT_LENGTH
    if wrong:
        raise ArmError(
            "not the pose of a tool in the flange",
            where="tcp",
            value=list(values),
            allowed=" ".join(names),
            remedy=f"give {len(names)} numbers as the controller shows its TCP",
        )
    return homogeneous(read(found[3:]).as_matrix(), 1e-3 * found[:3])


def _orientation(
    angles: str,
) -> tuple[tuple[str, ...], Callable[[Rotation], Array], Callable[[Array], Rotation]]:
    if angles not in _ORIENTATION:
        raise ArmError(
            "unknown angle convention",
            where="angles",
            value=angles,
            allowed=", ".join(get_args(Angles)),
            remedy="choose those of your controller",
        )
    return _ORIENTATION[angles]
