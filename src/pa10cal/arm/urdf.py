"""A chain as URDF: the geometry of a calibrated arm for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, Chain
from pa10cal.arm.urdf_xml import as_comment, origin_of
from pa10cal.arrays import Array


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
        chain: the chain.
        coordinates: (m,) chain coordinates at zero joint positions and torques.
        name: name of the robot.
        comments: what a reader should know, above everything else.
        frames: further links, and their poses (4, 4) in the flange.

    Returns:
        The text of the file; forward kinematics of its joints `joint_1` … `joint_n` is the chain's.
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
            lower, upper = chain.arm.limits_rad[driven[column]]
            ElementTree.SubElement(
                element,
                "limit",
                lower=repr(float(lower)),
                upper=repr(float(upper)),
                effort=repr(float(np.nan_to_num(chain.arm.torque_limit_Nm[driven[column]]))),
                velocity="1.0",
            )
            constant, parent = np.eye(4), child
        constant = constant @ _elementary(motion.axis, motion.turns, value)
    _joint(robot, "to_flange", "fixed", parent, "flange", constant)
    for link, T in (frames or {}).items():
        _joint(robot, f"to_{link}", "fixed", "flange", link, T)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, T: Array
) -> ElementTree.Element:
    """Add a link and the joint that carries it, at pose T in its parent."""
    ElementTree.SubElement(robot, "link", name=child)
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "origin", origin_of(T))
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    return joint


def _elementary(axis: int, turns: bool, value: float) -> Array:
    T = np.eye(4)
    if turns:
        T[:3, :3] = Rotation.from_euler("xyz"[axis], value).as_matrix()
    else:
        T[axis, 3] = value
    return T
