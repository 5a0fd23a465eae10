"""A calibrated arm as URDF: written from its chain, or a user's own URDF with new origins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from xml.etree import ElementTree

import numpy as np

from pa10cal.arm.chain import BASE, Chain, carried_frames, moved_frames
from pa10cal.arm.urdf_reading import as_comment, origin_of, parse_urdf, read_tree
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfTree
from pa10cal.arrays import Array
from pa10cal.errors import ArmError, visible

#: Largest difference of a URDF from the description of its arm [m, rad]: numbers may be rounded.
_SAME = 1e-5
FLANGE = "flange"


def urdf_text(
    chain: Chain,
    coordinates: Array,
    name: str,
    *comments: str,
    frames: Mapping[str, Array] | None = None,
) -> str:
    """Return the rigid geometry of a chain as the text of a URDF.

    URDF cannot hold deflection under torque, which is omitted; so are masses. The link `base` is
    the frame that the chain's base coordinates move; the link `flange` is the end of the chain.

    Args:
        coordinates: (m,) of the chain, at zero joint positions and torques.
        name: of the robot.
        comments: of the head of the file.
        frames: further links, by name, and their poses (4, 4) in the flange.

    Returns:
        Forward kinematics of the joints `joint_1` … `joint_n` is the chain's. Joints that follow
        another mimic it; the file cannot hold other couplings.
    """
    robot = ElementTree.Element("robot", name=name)
    for comment in comments:
        robot.append(ElementTree.Comment(as_comment(comment)))
    ElementTree.SubElement(robot, "link", name="base")
    joint_of_column = {int(column): joint for joint, column in enumerate(chain.joint_columns)}
    parent, constant = "base", np.eye(4)  # link, and the transform so far from its frame
    for column, motion in enumerate(chain.motions):
        if motion.coordinate in BASE:
            continue
        constant = constant @ chain.constants.get(column, np.eye(4))
        if column in joint_of_column:
            joint = joint_of_column[column]
            child = f"link_{joint + 1}"
            kind = "revolute" if motion.turns else "prismatic"
            element = _joint(robot, f"joint_{joint + 1}", kind, parent, child, constant)
            ElementTree.SubElement(element, "axis", xyz="0 0 1")
            lower, upper = chain.arm.joint_ranges_rad[joint]
            ElementTree.SubElement(
                element,
                "limit",
                lower=repr(float(lower)),
                upper=repr(float(upper)),
                effort=repr(float(np.nan_to_num(chain.arm.torque_limit_Nm[joint]))),
                velocity="1.0",  # required, and not known
            )
            coupling = chain.arm.coupling.leads(joint)
            if coupling is not None:
                leader, factor = f"joint_{coupling.by}", repr(coupling.factor)
                ElementTree.SubElement(element, "mimic", joint=leader, multiplier=factor)
            parent, constant = child, np.eye(4)
        constant = constant @ motion.frame_at(float(coordinates[column]))
    _joint(robot, "to_flange", "fixed", parent, "flange", constant)
    for link, T in (frames or {}).items():
        _joint(robot, f"to_{link}", "fixed", "flange", link, T)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, T: Array
) -> ElementTree.Element:
    """Add a link and the joint that carries it, at pose T in its parent; return the joint."""
    name, child = visible(name), visible(child)
    ElementTree.SubElement(robot, "link", name=child)
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "origin", origin_of(T))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


@dataclass(frozen=True)
class UrdfSource:
    """The URDF that an arm came from."""

    text: str  # its content
    where: str  # its name, for messages
    # base and tip: the links that are base and end of the arm
    base: str
    tip: str

    @property
    def tree(self) -> UrdfTree:
        """Return the robot, with the arm's base as its root where joints of the arm carry it."""
        return read_tree(self.text, self.where).seen_from(self.base, self.tip)

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the arm's moving joints that mimic no other, in order."""
        path = self.tree.path(self.base, self.tip)
        return tuple(
            joint.name
            for joint in path.joints
            if joint.kind in MOVING and joint.name not in path.leaders
        )


def patched_urdf(
    source: UrdfSource,
    chain: Chain,
    coordinates: Array,
    frames: Mapping[str, Array],
    *comments: str,
) -> str:
    """Return a URDF with calibrated origins, and links for flange, tool and targets added.

    Names, axes, limits, shapes and inertials stay. The link `flange` is that of the chain. An added
    link whose name the URDF uses already is called `<name>_pa10cal`, or `<name>_pa10cal_2`, ….

    Args:
        source: the URDF, which the arm of the chain was imported from.
        chain, coordinates, frames, comments: see `urdf_text`.

    Raises:
        ArmError: when the URDF cannot be read, or is of another arm.
    """
    tree = read_tree(source.text, source.where)
    path = tree.path(source.base, source.tip)
    # With all axes at zero a joint that mimics another is at the offset of its mimicry.
    at_zero = {name: leader.offset for name, leader in path.leaders.items()}
    T_base = _link_poses(tree, source.base, at_zero)
    joints = [joint for joint in path.joints if joint.kind in MOVING]
    T_base_joints = np.array([T_base[joint.child] for joint in joints])
    _refuse_another_arm(source, chain, joints, T_base_joints, T_base[source.tip])
    moved, T_base_flange = moved_frames(chain, coordinates, T_base_joints)
    wanted = {joint.child: T for joint, T in zip(joints, moved, strict=True)}
    if path.joints[-1].kind == "fixed":
        wanted[path.joints[-1].child] = T_base_flange
    origins, T = {}, T_base[path.joints[0].parent]
    for joint in path.joints:
        if joint.child in wanted:
            position = at_zero.get(joint.name, 0.0)
            motion = np.linalg.inv(joint.origin_at(0.0)) @ joint.origin_at(position)
            origins[joint.name] = np.linalg.inv(T) @ wanted[joint.child] @ np.linalg.inv(motion)
            T = wanted[joint.child]
        else:
            T = T @ joint.origin_at(0.0)
    file = parse_urdf(source.text, comments=True)
    _write_origins(file.robot, origins)
    used = {link.name for link in tree.links} | {joint.name for joint in tree.joints}
    # A link for the flange, unless the tip is it, and the further links fixed to it.
    T_tip_flange, flange = np.linalg.inv(T) @ T_base_flange, source.tip
    if flange != FLANGE or np.abs(T_tip_flange - np.eye(4)).max() > 0.0:
        flange = _add_fixed(file.robot, source.tip, FLANGE, T_tip_flange, used)
    for name, T_flange_link in frames.items():
        _add_fixed(file.robot, flange, name, T_flange_link, used)
    return file.text(*comments)


def _link_poses(tree: UrdfTree, base: str, positions: Mapping[str, float]) -> dict[str, Array]:
    """Return the poses (4, 4) of all links in `base`; joints without a position are at zero."""
    T_root = {tree.root: np.eye(4)}
    for joint in tree.below(tree.root):
        T = joint.origin_at(positions.get(joint.name, 0.0))
        T_root[joint.child] = T_root[joint.parent] @ T
    return {link: np.linalg.inv(T_root[base]) @ T for link, T in T_root.items()}


def _write_origins(robot: ElementTree.Element, origins: Mapping[str, Array]) -> None:
    """Set the origins of joints to poses (4, 4), by the joints' names."""
    for element in robot.findall("joint"):
        name = element.get("name", "")
        if name not in origins:
            continue
        origin = element.find("origin")
        if origin is None:
            origin = ElementTree.Element("origin")
            origin.tail = element.text
            element.insert(0, origin)
        origin.attrib.update(origin_of(origins[name]))


def _add_fixed(robot: ElementTree.Element, parent: str, name: str, T: Array, used: set[str]) -> str:
    """Add a link and the fixed joint that carries it at pose T; return the link's name.

    Names that are in use get a suffix; those added count as used from then on.
    """
    link, joint = _unused(name, used), _unused(f"to_{name}", used)
    used.update((link, joint))
    _joint(robot, joint, "fixed", parent, link, T).tail = "\n"
    robot[-2].tail = "\n  "
    return link


def _unused(name: str, used: set[str]) -> str:
    """Return a name, with the first suffix of `_pa10cal`, `_pa10cal_2`, … where it is in use."""
    if name not in used:
        return name
    suffixed = (f"{name}_pa10cal{f'_{number}' * (number > 1)}" for number in count(1))
    return next(each for each in suffixed if each not in used)


def _refuse_another_arm(
    source: UrdfSource,
    chain: Chain,
    joints: list[UrdfJoint],
    T_base_joints: Array,
    T_base_tip: Array,
) -> None:
    """Refuse a URDF whose joint axes or tip differ from those of the nominal chain."""
    off = np.inf
    if len(joints) == chain.arm.n:
        designed, T_base_flange = carried_frames(chain, chain.nominal)
        axes = np.array([joint.axis for joint in joints])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        axes = np.einsum("kij,kj->ki", T_base_joints[:, :3, :3], axes)
        offset = np.cross(T_base_joints[:, :3, 3] - designed[:, :3, 3], designed[:, :3, 2])
        offset[chain.arm.prismatic] = 0.0  # only the direction of a slide matters
        differences = (axes - designed[:, :3, 2], offset, T_base_tip - T_base_flange)
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
