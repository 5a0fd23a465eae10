"""A user's own URDF with the origins of a calibrated arm; all else in it stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from pa10cal.arm.attitude import placed
from pa10cal.arm.chain import Chain
from pa10cal.arm.joint_frames import carried_frames, moved_frames
from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfTree
from pa10cal.arm.urdf_xml import origin_of, parse_urdf
from pa10cal.arrays import Array
from pa10cal.errors import ArmError

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

    Args:
        source: the URDF.
        chain: chain of the arm that came from it.
        coordinates: (m,) calibrated coordinates at zero joint positions.
        frames: further links, and their poses (4, 4) in the flange.
        comments: what stands above all else.

    Raises:
        ArmError: when it cannot be read, or is of another arm.
    """
    tree = read_tree(source.text, source.where)
    _, _, path = tree.path(source.base, source.tip)
    joints = [joint for joint in path if joint.kind in MOVING]
    T_root = _links_at_zero(tree)
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
            origins[joint.name] = np.linalg.inv(T) @ placed_at[joint.child]
            T = placed_at[joint.child]
        else:
            T = T @ _origin(joint)
    file = parse_urdf(source.text, comments=True)
    for element in file.robot.findall("joint"):
        if element.get("name") in origins:
            _set_origin(element, origins[str(element.get("name"))])
    _add_links(file.robot, tree, source.tip, np.linalg.inv(T) @ T_base_flange, frames)
    return file.text(*comments)


def _links_at_zero(tree: UrdfTree) -> dict[str, Array]:
    """Return the poses of all links in the root, (4, 4) each, with all joints at zero."""
    found, open_ = {tree.root: np.eye(4)}, [tree.root]
    while open_:
        parent = open_.pop()
        for joint in tree.joints:
            if joint.parent == parent:
                found[joint.child] = found[parent] @ _origin(joint)
                open_.append(joint.child)
    return found


def _origin(joint: UrdfJoint) -> Array:
    return placed(np.array(joint.xyz), np.array(joint.rpy))


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
        raise ArmError(
            "the URDF is not that of the arm",
            where=source.where,
            value=f"{len(joints)} joints, {off:.1e} m or rad off",
            allowed=f"the URDF from which {chain.arm.name} was imported",
            remedy="import the arm again from this URDF, or give the one it came from",
        )


def _set_origin(joint: ElementTree.Element, T: Array) -> None:
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.Element("origin")
        origin.tail = joint.text
        joint.insert(0, origin)
    origin.attrib.update(origin_of(T))


def _add_links(
    robot: ElementTree.Element,
    tree: UrdfTree,
    tip: str,
    T_tip_flange: Array,
    frames: Mapping[str, Array],
) -> None:
    """Add the flange, where the tip is not its link, and further links fixed to it."""
    taken = {link.name for link in tree.links} | {joint.name for joint in tree.joints}
    flange = tip
    if tip != FLANGE or np.abs(T_tip_flange - np.eye(4)).max() > 0.0:
        flange = _add_fixed(robot, taken, tip, FLANGE, T_tip_flange)
    for name, T in frames.items():
        _add_fixed(robot, taken, flange, name, T)


def _add_fixed(
    robot: ElementTree.Element, taken: set[str], parent: str, name: str, T: Array
) -> str:
    """Add a link and the fixed joint that carries it; return the link's name."""
    link, joint = (
        each if each not in taken else f"{each}_pa10cal" for each in (name, f"to_{name}")
    )
    taken.update((link, joint))
    ElementTree.SubElement(robot, "link", name=link).tail = "\n  "
    element = ElementTree.SubElement(robot, "joint", name=joint, type="fixed")
    ElementTree.SubElement(element, "origin", origin_of(T))
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=link)
    element.tail = "\n"
    return link
