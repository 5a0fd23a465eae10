"""Links and joints of a URDF, checked: what cannot be meant is refused with its place."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from xml.etree import ElementTree
from xml.parsers import expat

from pa10cal.arm.chain import roll_pitch_yaw
from pa10cal.arrays import Array
from pa10cal.errors import ArmError, refusals_beside, remedy_for

# XML of a URDF as robots have it: prefixes need no declaration, and comments may be kept.


@dataclass(frozen=True)
class UrdfText:
    """A URDF as elements."""

    robot: ElementTree.Element  # the outermost element
    before: tuple[str, ...]  # comments that stand before it, such as a licence

    def text(self, *comments: str) -> str:
        """Return the file, further comments first."""
        lines = [f"<!--{as_comment(comment)}-->" for comment in (*comments, *self.before)]
        body = ElementTree.tostring(self.robot, encoding="unicode")
        return "\n".join(['<?xml version="1.0"?>', *lines, body]) + "\n"


def parse_urdf(text: str, *, comments: bool = False) -> UrdfText:
    """Read the text of a URDF; comments stay where they are, or are dropped.

    Raises:
        ValueError: when it is not XML, saying where.
    """
    builder = ElementTree.TreeBuilder(insert_comments=comments)
    before: list[str] = []
    inside: list[ElementTree.Element] = []  # the elements that are open
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = lambda *element: inside.append(builder.start(*element))
    parser.EndElementHandler = lambda tag: inside.remove(builder.end(tag))
    parser.CharacterDataHandler = builder.data
    parser.CommentHandler = lambda said: builder.comment(said) if inside else before.append(said)
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from None
    return UrdfText(builder.close(), tuple(before))


def origin_of(T: Array) -> dict[str, str]:
    """Return the attributes of an origin at a pose (4, 4), to the last digit."""
    return {"xyz": words(T[:3, 3]), "rpy": words(roll_pitch_yaw(T[:3, :3]))}


def words(values: Iterable[float]) -> str:
    """Return numbers as text, to the last digit."""
    return " ".join(repr(float(value)) for value in values)


def as_comment(text: str) -> str:
    """Return a text as the content of a comment, which has no two hyphens in a row."""
    while "--" in text:
        text = text.replace("--", "- -")
    return f" {text} " if text[:1].strip() else text


# A URDF as a tree of links and joints, and the serial path through it.

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
#: No joint of an arm is further from the one before.
_FAR_M = 10.0
_NOWHERE = (0.0, 0.0, 0.0)
_refusal = refusals_beside(__file__, ArmError)


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as the file has it."""

    name: str
    kind: str  # its type
    # parent and child: the links it joins
    parent: str
    child: str
    follows: str  # the joint it mimics, or an empty text
    # xyz and rpy: place [m] and turns about fixed axes [rad] of its frame in the parent
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]  # direction in which it moves, in its own frame
    limits: tuple[float, float]  # lower and upper [rad or m]; nan where they are not stated
    effort: float  # rated torque [N m] or force [N]; nan where it is not stated


@dataclass(frozen=True)
class UrdfLink:
    """One link as the file has it."""

    name: str
    mass_kg: float  # its mass; 0 where it is not stated
    com_m: tuple[float, ...]  # centre of mass in its own frame


@dataclass(frozen=True)
class UrdfTree:
    """Links and joints of one robot."""

    where: str  # the file
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]  # all joints, each below another or below the root
    root: str  # the link that no joint carries

    def path(self, base: str | None, tip: str | None) -> tuple[str, str, tuple[UrdfJoint, ...]]:
        """Return base and tip and the joints between them, fixed ones too.

        Args:
            base: link to start from; None for the root.
            tip: link to end at; None where there is but one.

        Raises:
            ArmError: for unknown links, several tips, or joints that no chain can follow.
        """
        base = self.root if base is None else self._known(base, "--base")
        # What a fixed joint carries moves with what it is fixed to: the base may be a side branch.
        fixed = takewhile(lambda joint: joint.kind == "fixed", reversed(self.above(base)))
        with_base = [base, *(joint.parent for joint in fixed)]
        tip = self._only_tip(with_base[-1]) if tip is None else self._known(tip, "--tip")
        up = takewhile(lambda joint: joint.child not in with_base, reversed(self.above(tip)))
        joints = list(up)[::-1]
        if tip not in with_base and (not joints or joints[0].parent not in with_base):
            beyond = ", ".join(self._beyond(with_base[-1])) or "none"
            raise _refusal("beyond", self.where, tip, f"{base}: {beyond}")
        if not any(joint.kind in MOVING for joint in joints):
            raise _refusal("still", self.where, f"{base} to {tip}")
        for joint in joints:
            place = f"{self.where}: joint {joint.name}"
            if joint.kind not in (*MOVING, "fixed"):
                raise _refusal("serial", place, joint.kind)
            if joint.follows:
                raise _refusal("mimic", place, None, joint.follows)
        return base, tip, tuple(joints)

    def above(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints that carry a link, from the root on."""
        carriers = {joint.child: joint for joint in self.joints}
        found: list[UrdfJoint] = []
        while link in carriers:
            found.append(carriers[link])
            link = carriers[link].parent
        return tuple(reversed(found))

    def _known(self, name: str, option: str) -> str:
        names = [link.name for link in self.links]
        if name not in names:
            remedy = remedy_for(name, names, f"name one of these links for {option}")
            raise _refusal("name", self.where, name, option, ", ".join(names), remedy)
        return name

    def _beyond(self, base: str) -> list[str]:
        """Return the links beyond a link, in the order of the file."""
        names = [link.name for link in self.links]
        return [name for name in names if any(j.parent == base for j in self.above(name))]

    def _only_tip(self, base: str) -> str:
        parents = {joint.parent for joint in self.joints}
        before = len(self.above(base))
        tips = [
            link
            for link in self._beyond(base)
            if link not in parents
            and any(joint.kind != "fixed" for joint in self.above(link)[before:])
        ]
        if len(tips) > 1:
            raise _refusal("branches", self.where, f"{len(tips)} tips", ", ".join(tips))
        return tips[0] if tips else base


def read_tree(text: str, where: str) -> UrdfTree:
    """Read links and joints of the text of a URDF, which messages call by `where`.

    Raises:
        ArmError: naming what cannot be used, and its place.
    """
    try:
        robot = parse_urdf(text).robot
    except ValueError as error:
        raise _refusal("xml", where, str(error)) from None
    if robot.tag != "robot":
        raise _refusal("urdf", where, robot.tag)
    for element in robot.iter():
        # Of xacro, or an expression that it would work out. What stands in a comment was worked out
        # already: the parser has dropped it.
        words = (element.text or "", *element.attrib.values())
        if "xacro" in element.tag or any("${" in word or "$(" in word for word in words):
            raise _refusal("xacro", where)
    links = tuple(_link(element, where) for element in robot.findall("link"))
    joints = tuple(_joint(element, where) for element in robot.findall("joint"))
    return UrdfTree(where, links, joints, _root(links, joints, where))


def _root(links: tuple[UrdfLink, ...], joints: tuple[UrdfJoint, ...], where: str) -> str:
    names = [link.name for link in links]
    for what, seen in (("link", names), ("joint", [joint.name for joint in joints])):
        if twice := sorted({name for name in seen if seen.count(name) > 1}):
            raise _refusal("twice", where, twice[0], what)
    children = [joint.child for joint in joints]
    for joint in joints:
        place = f"{where}: joint {joint.name}"
        for link in (joint.parent, joint.child):
            if link not in names:
                raise _refusal("link", place, link, ", ".join(names) or "no links")
        if children.count(joint.child) > 1:
            raise _refusal("child", place, joint.child)
    roots = [name for name in names if name not in children]
    if len(roots) != 1:
        none = "no root: the joints form a loop, or there are no links"
        raise _refusal("tree", where, ", ".join(roots) or none)
    reached = {roots[0]}
    for _ in joints:
        reached |= {joint.child for joint in joints if joint.parent in reached}
    if apart := [name for name in names if name not in reached]:
        raise _refusal("loop", where, ", ".join(apart), roots[0])
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
        raise _refusal("mass", place, mass_kg)
    return UrdfLink(name, mass_kg, com_m)


def _joint(element: ElementTree.Element, where: str) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    place = f"{where}: joint {name}"
    if kind not in KINDS:  # the others of a URDF are read, but no chain can follow them
        raise _refusal("type", place, kind, remedy_for(kind, KINDS, "correct the type"))
    mimic, origin, limit = (element.find(tag) for tag in ("mimic", "origin", "limit"))
    xyz = _numbers(origin, "xyz", _NOWHERE, f"{place}: origin")
    if max(map(abs, xyz)) > _FAR_M:
        raise _refusal("far", place, xyz, _FAR_M)
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{place}: axis")
    (lower,), (upper,) = (
        _numbers(limit, key, (0.0,), f"{place}: limit") for key in ("lower", "upper")
    )
    limits = lower, upper
    if kind == "continuous" or lower == upper == 0.0:
        limits = math.nan, math.nan  # a file that states none stands for no limits
    elif lower >= upper:
        raise _refusal("limits", place, limits)
    if kind in MOVING and math.hypot(*axis) < 1e-9:
        raise _refusal("axis", place, axis)
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_end(element, "parent", place),
        child=_end(element, "child", place),
        follows="" if mimic is None else mimic.get("joint", "another"),
        xyz=xyz,
        rpy=_numbers(origin, "rpy", _NOWHERE, f"{place}: origin"),
        axis=axis,
        limits=limits,
        effort=_numbers(limit, "effort", (0.0,), f"{place}: limit")[0] or math.nan,
    )


def _end(element: ElementTree.Element, end: str, where: str) -> str:
    found = element.find(end)
    link = "" if found is None else found.get("link", "")
    if not link:
        raise _refusal("end", where, None, end)
    return link


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
        count = f"{len(default)} number{'s' if len(default) > 1 else ''},"
        raise _refusal("number", where, text, key, count)
    return values
