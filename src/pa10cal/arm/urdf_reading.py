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
from pa10cal.errors import ArmError, remedy_for

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
    """Read a URDF.

    Args:
        text: the file's content.
        comments: whether comments stay where they are.

    Raises:
        ValueError: when it is not XML, saying where.
    """
    builder = ElementTree.TreeBuilder(insert_comments=comments)
    before: list[str] = []
    depth = [0]
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        depth[0] += 1
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        depth[0] -= 1
        builder.end(tag)

    def comment(content: str) -> None:
        if depth[0]:
            builder.comment(content)
        else:
            before.append(content)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, comment
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
            beyond = self._beyond(with_base[-1])
            raise ArmError(
                "the tip is not beyond the base",
                where=self.where,
                value=tip,
                allowed=f"a link beyond {base}: {', '.join(beyond) or 'none'}",
                remedy="name another base or tip",
            )
        self._check(joints, base, tip)
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
            raise ArmError(
                f"{option} names no link",
                where=self.where,
                value=name,
                allowed=", ".join(names),
                remedy=remedy_for(name, names, f"name one of these links for {option}"),
            )
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
            raise ArmError(
                "the robot branches, and no tip is named",
                where=self.where,
                value=f"{len(tips)} tips",
                allowed=", ".join(tips),
                remedy="name the end of the arm with --tip",
            )
        return tips[0] if tips else base

    def _check(self, joints: list[UrdfJoint], base: str, tip: str) -> None:
        """Refuse a path without a moving joint, or with one that does not move by itself."""
        if not any(joint.kind in MOVING for joint in joints):
            raise ArmError(
                "no joint moves between base and tip",
                where=self.where,
                value=f"{base} to {tip}",
                allowed="at least one joint of type " + ", ".join(MOVING),
                remedy="name another base or tip",
            )
        for joint in joints:
            if joint.kind not in (*MOVING, "fixed"):
                raise ArmError(
                    "a joint of this type is not in a serial arm",
                    where=f"{self.where}: joint {joint.name}",
                    value=joint.kind,
                    allowed=", ".join((*MOVING, "fixed")),
                    remedy="name a base beyond this joint with --base",
                )
            if joint.follows:
                raise ArmError(
                    f"the joint follows joint {joint.follows} (mimic)",
                    where=f"{self.where}: joint {joint.name}",
                    allowed="independent joints",
                    remedy="name a base beyond this joint, or a tip before it",
                )


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
    reached = {roots[0]}
    for _ in joints:
        reached |= {joint.child for joint in joints if joint.parent in reached}
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
