"""A URDF read from its text: XML, links and joints, checked one by one."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

from pa10cal.arm.chain import roll_pitch_yaw
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfLink, UrdfTree
from pa10cal.arrays import Array
from pa10cal.errors import ArmError, remedy_for, visible

#: Nesting and number of elements, far beyond any robot: the largest seen has 2000, 12 deep.
_MOST_DEPTH, _MOST_ELEMENTS = 100, 100_000
#: Number of links, and of characters of a number: a whole cell has some hundred links.
_MOST_LINKS, _MOST_LETTERS = 5000, 64
#: Types of joints in a URDF. No serial chain contains the last two.
_KINDS = (*MOVING, "fixed", "floating", "planar")
_ZERO = (0.0, 0.0, 0.0)
#: The joint that a joint mimics where none is named: no joint is called so.
_NOT_NAMED = "<not named>"
_WITHOUT_LIMIT = ("inf", "+inf", "infinity", "+infinity")


@dataclass(frozen=True)
class UrdfText:
    """A URDF as elements."""

    robot: ElementTree.Element  # the outermost element
    before: tuple[str, ...]  # comments that precede it, such as a licence

    def text(self, *comments: str) -> str:
        """Return the text of the file, further comments first."""
        lines = [f"<!--{as_comment(comment)}-->" for comment in (*comments, *self.before)]
        body = ElementTree.tostring(self.robot, encoding="unicode")
        return "\n".join(['<?xml version="1.0"?>', *lines, body]) + "\n"


def parse_urdf(text: str, *, comments: bool = False) -> UrdfText:
    """Read the XML of a URDF, in which prefixes need no declaration.

    Args:
        comments: whether comments are kept where they are; else they are dropped.

    Raises:
        ValueError: when it is not XML, defines entities, nests deeper than 100 elements or has more
            than 100 000 of them, saying where.
    """
    builder = ElementTree.TreeBuilder(insert_comments=comments)
    before: list[str] = []
    depth = count = 0
    parser = expat.ParserCreate("utf-8")  # the text is decoded, whatever it says of itself
    parser.buffer_text = True

    def refuse(what: str) -> None:
        raise ValueError(f"line {parser.CurrentLineNumber}: {what}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MOST_DEPTH:
            refuse(f"elements are nested deeper than {_MOST_DEPTH}")
        if count > _MOST_ELEMENTS:
            refuse(f"more than {_MOST_ELEMENTS} elements")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.CommentHandler = lambda text: builder.comment(text) if depth else before.append(text)
    # Entities may expand without limit, and no robot needs them.
    parser.EntityDeclHandler = lambda *_: refuse("it defines entities, which a URDF does not need")
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from None
    return UrdfText(builder.close(), tuple(before))


def origin_of(T: Array) -> dict[str, str]:
    """Return a pose (4, 4) as the attributes of an origin, to the last digit."""
    parts = {"xyz": T[:3, 3], "rpy": roll_pitch_yaw(T[:3, :3])}
    return {name: " ".join(map(repr, part.tolist())) for name, part in parts.items()}


def as_comment(text: str) -> str:
    """Return a text as the content of a comment, which has no two hyphens in a row."""
    text = visible(text)  # XML cannot hold other characters
    while "--" in text:
        text = text.replace("--", "- -")
    return f" {text} " if text[:1].strip() or text.endswith("-") else text


def read_tree(text: str, where: str) -> UrdfTree:
    """Read links and joints from the text of a URDF; `where` is its name in messages.

    Raises:
        ArmError: naming what cannot be used, and its place.
    """
    try:
        robot = parse_urdf(text).robot
    except ValueError as error:
        raise ArmError(
            "it is not XML",
            where=where,
            value=str(error),
            allowed="a URDF file",
            remedy="check the file",
        ) from None
    if robot.tag != "robot":
        raise ArmError(
            "it is not a URDF",
            where=where,
            value=robot.tag,
            allowed="<robot> as the outermost element",
            remedy="check the file",
        )
    if _needs_xacro(robot):
        raise ArmError(
            "xacro macros are not expanded",
            where=where,
            allowed="plain URDF",
            remedy="run xacro on it first: xacro robot.urdf.xacro > robot.urdf",
        )
    if (count := len(robot.findall("link"))) > _MOST_LINKS:
        raise ArmError(
            "there are too many links",
            where=where,
            value=count,
            allowed=f"at most {_MOST_LINKS} links",
            remedy="cut out the arm, with what carries it",
        )
    links = tuple(_link(element, where) for element in robot.findall("link"))
    joints = tuple(_joint(element, where) for element in robot.findall("joint"))
    return _tree(links, joints, where)


def _needs_xacro(robot: ElementTree.Element) -> bool:
    """Return whether there are elements of xacro, or links or joints with expressions for it.

    Elsewhere, as in what a simulator reads (`<gazebo>`), an expression may be meant for others.
    """
    if any("xacro" in element.tag for element in robot.iter()):
        return True
    used = (
        part for tag in ("link", "joint") for each in robot.iterfind(tag) for part in each.iter()
    )
    words = (word for part in used for word in (part.text or "", *part.attrib.values()))
    return any("${" in word or "$(" in word for word in words)


def _tree(links: tuple[UrdfLink, ...], joints: tuple[UrdfJoint, ...], where: str) -> UrdfTree:
    """Return the tree of links and joints; refuse what is no single tree of distinct names."""
    names = [link.name for link in links]
    for what, seen in (("link", names), ("joint", [joint.name for joint in joints])):
        if twice := sorted(name for name, times in Counter(seen).items() if times > 1):
            raise ArmError(
                f"two {what}s have one name",
                where=where,
                value=twice[0],
                allowed="each name once",
                remedy="rename one",
            )
    known, children = set(names), Counter(joint.child for joint in joints)
    for joint in joints:
        place = f"{where}: joint {joint.name}"
        for link in (joint.parent, joint.child):
            if link not in known:
                raise ArmError(
                    "the joint names a link that is not there",
                    where=place,
                    value=link,
                    allowed=", ".join(names) or "no links",
                    remedy="correct the name",
                )
        if children[joint.child] > 1:
            raise ArmError(
                "two joints have the same child link: the arm is not serial",
                where=place,
                value=joint.child,
                allowed="one joint for each link",
                remedy="cut the loop",
            )
    roots = [name for name in names if name not in children]
    if len(roots) != 1:
        none = "no root: the joints form a loop, or there are no links"
        raise ArmError(
            "the links do not form a single tree",
            where=where,
            value=", ".join(roots) or none,
            allowed="exactly one link without a parent joint",
            remedy="join the parts, or open the loop",
        )
    tree = UrdfTree(where, links, joints, roots[0])
    reached = {roots[0], *(joint.child for joint in tree.below(roots[0]))}
    if unreached := [name for name in names if name not in reached]:
        raise ArmError(
            "joints form a loop",
            where=where,
            value=", ".join(unreached),
            allowed=f"links connected by joints from {roots[0]} on",
            remedy="cut the circle",
        )
    return tree


def _link(element: ElementTree.Element, where: str) -> UrdfLink:
    name = element.get("name", "")
    place = f"{where}: link {name}"
    inertial = element.find("inertial")
    if inertial is None:
        return UrdfLink(name, 0.0, _ZERO)
    (mass_kg,) = _numbers(inertial.find("mass"), "value", (0.0,), f"{place}: mass")
    com_m = _numbers(inertial.find("origin"), "xyz", _ZERO, f"{place}: inertial origin")
    if mass_kg < 0.0:
        raise ArmError(
            "the mass is negative",
            where=place,
            value=mass_kg,
            allowed="0 kg or more",
            remedy="correct it",
        )
    return UrdfLink(name, mass_kg, com_m)


def _joint(element: ElementTree.Element, where: str) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    place = f"{where}: joint {name}"
    if kind not in _KINDS:
        raise ArmError(
            "unknown type of joint",
            where=place,
            value=kind,
            allowed="revolute, continuous, prismatic, fixed",
            remedy=remedy_for(kind, _KINDS, "correct the type"),
        )
    mimic, origin, limit = (element.find(tag) for tag in ("mimic", "origin", "limit"))
    xyz = _numbers(origin, "xyz", _ZERO, f"{place}: origin")
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{place}: axis")
    (lower,), (upper,) = (
        _numbers(limit, key, (0.0,), f"{place}: limit") for key in ("lower", "upper")
    )
    limits = lower, upper
    if kind == "continuous" or lower == upper == 0.0:
        limits = math.nan, math.nan  # equal zeros are the format's default: no limits are stated
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_end(element, "parent", place),
        child=_end(element, "child", place),
        follows="" if mimic is None else mimic.get("joint") or _NOT_NAMED,
        multiplier=_numbers(mimic, "multiplier", (1.0,), f"{place}: mimic")[0],
        offset=_numbers(mimic, "offset", (0.0,), f"{place}: mimic")[0],
        xyz=xyz,
        rpy=_numbers(origin, "rpy", _ZERO, f"{place}: origin"),
        axis=axis,
        limits=limits,
        effort=_effort(limit, f"{place}: limit"),
    )


def _effort(limit: ElementTree.Element | None, where: str) -> float:
    """Return the effort of a joint; nan where it is not stated: zero, or without limit."""
    if limit is not None and limit.get("effort", "").strip().lower() in _WITHOUT_LIMIT:
        return math.nan
    return _numbers(limit, "effort", (0.0,), where)[0] or math.nan


def _end(element: ElementTree.Element, end: str, where: str) -> str:
    """Return the link that a joint names as its `parent` or `child`."""
    named = element.find(end)
    link = "" if named is None else named.get("link", "")
    if not link:
        raise ArmError(
            f"the joint has no {end}", where=where, allowed="a link", remedy=f"give its {end}"
        )
    return link


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    """Return the finite numbers of an attribute, as many as the default has, or the default."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    numbers = text.split(maxsplit=len(default))
    # Python reads 1_0 as 10.
    readable = all(len(number) <= _MOST_LETTERS and "_" not in number for number in numbers)
    try:
        values = tuple(map(float, numbers)) if readable else ()
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(map(math.isfinite, values)):
        count = f"{len(default)} number{'s' if len(default) > 1 else ''},"
        raise ArmError(
            f"{key} cannot be read",
            where=where,
            value=text,
            allowed=f"{count} with decimal points",
            remedy="correct it",
        )
    return values
