"""Links and joints of a URDF, checked: what cannot be meant is refused with its place."""

from __future__ import annotations

import math
from xml.etree import ElementTree

from pa10cal.arm.urdf_tree import KINDS, MOVING, UrdfJoint, UrdfLink, UrdfTree
from pa10cal.arm.urdf_xml import parse_urdf
from pa10cal.errors import ArmError
from pa10cal.near_miss import remedy_for

_NOWHERE = (0.0, 0.0, 0.0)
#: No joint of an arm is further from the one before.
_FAR_M = 10.0


def read_tree(text: str, where: str) -> UrdfTree:
    """Read links and joints of a URDF.

    Args:
        text: the file's content.
        where: its name, for messages.

    Raises:
        ArmError: naming what cannot be used, and its place.
    """
    try:
        robot = parse_urdf(text).robot
    except ValueError as error:
        raise _refusal(
            "it is not XML", where, str(error), "a URDF file", "check the file"
        ) from None
    if robot.tag != "robot":
        raise _refusal(
            "it is not a URDF",
            where,
            robot.tag,
            "<robot> as the outermost element",
            "check the file",
        )
    if any(_is_macro(element) for element in robot.iter()):
        raise _refusal(
            "xacro macros are not expanded",
            where,
            None,
            "plain URDF",
            "run xacro on it first: xacro robot.urdf.xacro > robot.urdf",
        )
    links = tuple(_link(element, where) for element in robot.findall("link"))
    joints = tuple(_joint(element, where) for element in robot.findall("joint"))
    return UrdfTree(where, links, joints, _root(links, joints, where))


def _is_macro(element: ElementTree.Element) -> bool:
    """Return whether an element is of xacro, or has an expression that xacro would work out.

    What stands in a comment was worked out already: the parser has dropped it.
    """
    written = (element.text or "", *element.attrib.values())
    return "xacro" in element.tag or any("${" in each or "$(" in each for each in written)


def _refusal(what: str, where: str, value: object, allowed: str, remedy: str) -> ArmError:
    return ArmError(what, where=where, value=value, allowed=allowed, remedy=remedy)


def _root(links: tuple[UrdfLink, ...], joints: tuple[UrdfJoint, ...], where: str) -> str:
    names = [link.name for link in links]
    for what, seen in (("link", names), ("joint", [joint.name for joint in joints])):
        twice = sorted({name for name in seen if seen.count(name) > 1})
        if twice:
            raise _refusal(
                f"two {what}s have one name", where, twice[0], "each name once", "rename one"
            )
    children = [joint.child for joint in joints]
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in names:
                raise _refusal(
                    "the joint names a link that is not there",
                    f"{where}: joint {joint.name}",
                    link,
                    ", ".join(names) or "no links",
                    "correct the name",
                )
        if children.count(joint.child) > 1:
            raise _refusal(
                "two joints have the same child link: the arm is not serial",
                f"{where}: joint {joint.name}",
                joint.child,
                "one joint for each link",
                "cut the loop",
            )
    roots = [name for name in names if name not in children]
    if len(roots) != 1:
        raise _refusal(
            "the links do not form a single tree",
            where,
            ", ".join(roots) or "no root: the joints form a loop, or there are no links",
            "exactly one link without a parent joint",
            "join the parts, or open the loop",
        )
    reached, open_ = {roots[0]}, [roots[0]]
    while open_:
        parent = open_.pop()
        beyond = [joint.child for joint in joints if joint.parent == parent]
        reached.update(beyond)
        open_ += beyond
    apart = [name for name in names if name not in reached]
    if apart:
        raise _refusal(
            "joints form a loop",
            where,
            ", ".join(apart),
            f"links connected by joints from {roots[0]} on",
            "cut the circle",
        )
    return roots[0]


def _link(element: ElementTree.Element, where: str) -> UrdfLink:
    name = element.get("name", "")
    place = f"{where}: link {name}"
    inertial = element.find("inertial")
    if inertial is None:
        return UrdfLink(name, 0.0, _NOWHERE)
    (mass_kg,) = _numbers(inertial.find("mass"), "value", (0.0,), f"{place}: mass")
    com_m = _numbers(inertial.find("origin"), "xyz", _NOWHERE, f"{place}: inertial origin")
    if mass_kg < 0.0:
        raise _refusal("the mass is negative", place, mass_kg, "0 kg or more", "correct it")
    return UrdfLink(name, mass_kg, com_m)


def _joint(element: ElementTree.Element, where: str) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    place = f"{where}: joint {name}"
    if kind not in KINDS:
        # The others of a URDF are read, but no chain can follow them.
        taken = (*MOVING, "fixed")
        remedy = remedy_for(kind, KINDS, "correct the type")
        raise _refusal("unknown type of joint", place, kind, ", ".join(taken), remedy)
    mimic, origin, limit = (element.find(tag) for tag in ("mimic", "origin", "limit"))
    xyz = _numbers(origin, "xyz", _NOWHERE, f"{place}: origin")
    if max(map(abs, xyz)) > _FAR_M:
        raise _refusal(
            f"the joint is further than {_FAR_M:g} m from the one before",
            place,
            xyz,
            "metres",
            "divide by 1000 if these are millimetres",
        )
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{place}: axis")
    if kind in MOVING and math.hypot(*axis) < 1e-9:
        raise _refusal("the axis has no direction", place, axis, "not all zero", "correct it")
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_end(element, "parent", place),
        child=_end(element, "child", place),
        follows="" if mimic is None else mimic.get("joint", "another"),
        xyz=xyz,
        rpy=_numbers(origin, "rpy", _NOWHERE, f"{place}: origin"),
        axis=axis,
        limits=_limits(limit, kind, place),
        effort=_numbers(limit, "effort", (0.0,), f"{place}: limit")[0] or math.nan,
    )


def _end(element: ElementTree.Element, end: str, where: str) -> str:
    found = element.find(end)
    link = "" if found is None else found.get("link", "")
    if not link:
        raise _refusal(f"the joint has no {end}", where, None, "a link", f"give its {end}")
    return link


def _limits(limit: ElementTree.Element | None, kind: str, where: str) -> tuple[float, float]:
    """Return lower and upper limit, nan where a file that states none stands for no limits."""
    (lower,) = _numbers(limit, "lower", (0.0,), f"{where}: limit")
    (upper,) = _numbers(limit, "upper", (0.0,), f"{where}: limit")
    if kind == "continuous" or lower == upper == 0.0:
        return math.nan, math.nan
    if lower >= upper:
        raise _refusal(
            "the limits allow the joint no motion",
            where,
            (lower, upper),
            "the lower limit first, then a higher one",
            "correct the limits",
        )
    return lower, upper


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(map(math.isfinite, values)):
        raise _refusal(
            f"{key} cannot be read",
            where,
            text,
            f"{len(default)} number{'s' if len(default) > 1 else ''}, with decimal points",
            "correct it",
        )
    return values
