"""A calibrated arm as URDF: of its chain alone, or a user's own URDF with calibrated origins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from pa10cal.arm.chain import BASE, Chain, carried_frames, moved_frames
from pa10cal.arm.urdf_reading import (
    MOVING,
    UrdfJoint,
    UrdfTree,
    as_comment,
    origin_of,
    parse_urdf,
    read_tree,
)
from pa10cal.arrays import Array
from pa10cal.errors import ArmError, visible

#: How far a URDF and the description of its arm may differ [m, rad]: its numbers may be rounded.
_SAME = 1e-5
FLANGE = "flange"


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
    # Position of each joint with all axes at zero: that of a follower is the offset of its mimicry.
    at_zero = {name: leader.offset for name, leader in tree.leaders(path).items()}
    T_base = _link_poses(tree, source.base, at_zero)
    joints = [joint for joint in path if joint.kind in MOVING]
    T_base_joints = np.array([T_base[joint.child] for joint in joints])
    _refuse_another_arm(source, chain, joints, T_base_joints, T_base[source.tip])
    moved, T_base_flange = moved_frames(chain, coordinates, T_base_joints)
    wanted = {joint.child: T for joint, T in zip(joints, moved, strict=True)}
    if path[-1].kind == "fixed":
        wanted[path[-1].child] = T_base_flange
    origins, T = {}, T_base[path[0].parent]
    for joint in path:
        if joint.child in wanted:
            motion = np.linalg.inv(joint.origin_at(0.0)) @ joint.origin_at(
                at_zero.get(joint.name, 0.0)
            )
            origins[joint.name] = np.linalg.inv(T) @ wanted[joint.child] @ np.linalg.inv(motion)
            T = wanted[joint.child]
        else:
            T = T @ joint.origin_at(0.0)
    file = parse_urdf(source.text, comments=True)
    _write_origins(file.robot, origins)
    used = {link.name for link in tree.links} | {joint.name for joint in tree.joints}
    # The flange, where the tip is not its link, and further links fixed to it.
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
    link, joint = (word if word not in used else f"{word}_pa10cal" for word in (name, f"to_{name}"))
    used.update((link, joint))
    _joint(robot, joint, "fixed", parent, link, T).tail = "\n"
    robot[-2].tail = "\n  "
    return link


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
        along = np.einsum("kij,kj->ki", T_base_joints[:, :3, :3], axes)
        beside = np.cross(T_base_joints[:, :3, 3] - designed[:, :3, 3], designed[:, :3, 2])
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
