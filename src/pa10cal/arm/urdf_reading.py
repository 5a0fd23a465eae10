"""Links and joints of a URDF, checked: what cannot be meant is refused with its place."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import placed, roll_pitch_yaw
from pa10cal.arm.description import MOST_ROWS
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError, remedy_for, visible

# XML of a URDF as robots have it: prefixes need no declaration, and comments may be kept.

#: Far beyond any robot: the largest that was seen has 2 000 elements, 12 deep.
_MOST_DEPTH, _MOST_ELEMENTS = 100, 100_000


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
    parser.CommentHandler = lambda said: builder.comment(said) if depth else before.append(said)
    # What stands for other text may grow without end, and no robot needs it.
    parser.EntityDeclHandler = lambda *_: refuse("it defines entities, which a URDF does not need")
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
    text = visible(text)  # XML has no sign for the others
    while "--" in text:
        text = text.replace("--", "- -")
    return f" {text} " if text[:1].strip() or text.endswith("-") else text


# A URDF as a tree of links and joints, and the serial path through it.

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
#: No joint of an arm is further from the one before.
_FAR_M = 10.0
_NOWHERE = (0.0, 0.0, 0.0)
#: A whole cell has some hundred links; a number has no more letters than this.
_MOST_LINKS, _MOST_LETTERS = 5000, 64


@dataclass(frozen=True)
class UrdfJoint:
    """One joint as the file has it."""

    name: str
    kind: str  # its type
    # parent and child: the links it joins
    parent: str
    child: str
    follows: str  # the joint it mimics, or an empty text
    # multiplier and offset: it is at multiplier times the position of that joint, and offset
    multiplier: float
    offset: float  # [rad or m]
    # xyz and rpy: place [m] and turns about fixed axes [rad] of its frame in the parent
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]  # direction in which it moves, in its own frame
    limits: tuple[float, float]  # lower and upper [rad or m]; nan where they are not stated
    effort: float  # rated torque [N m] or force [N]; nan where it is not stated

    def origin_at(self, position: float) -> Array:
        """Return the pose (4, 4) of its child in its parent at a position [rad or m]."""
        T = placed(np.array(self.xyz), np.array(self.rpy))
        along = np.array(self.axis) / max(np.linalg.norm(self.axis), 1e-300) * position
        if self.kind == "prismatic":
            return T @ homogeneous(np.eye(3), along)
        return T @ homogeneous(Rotation.from_rotvec(along).as_matrix(), np.zeros(3))


@dataclass(frozen=True)
class Leader:
    """The joint that another mimics, at the end of all mimicry."""

    name: str
    # the follower is at multiplier times its position, and offset [rad or m]
    multiplier: float
    offset: float


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
            raise ArmError(
                "the tip is not beyond the base",
                where=self.where,
                value=tip,
                allowed=f"a link beyond {base}: {beyond}",
                remedy="name another base or tip",
            )
        moving = sum(joint.kind in MOVING for joint in joints)
        if not moving:
            raise ArmError(
                "no joint moves between base and tip",
                where=self.where,
                value=f"{base} to {tip}",
                allowed="at least one joint of type revolute, continuous, prismatic",
                remedy="name another base or tip",
            )
        if moving > MOST_ROWS:
            raise ArmError(
                "too many joints move between base and tip",
                where=self.where,
                value=moving,
                allowed=f"at most {MOST_ROWS}",
                remedy="name another base or tip",
            )
        for joint in joints:
            place = f"{self.where}: joint {joint.name}"
            if joint.kind not in (*MOVING, "fixed"):
                raise ArmError(
                    "a joint of this type is not in a serial arm",
                    where=place,
                    value=joint.kind,
                    allowed="revolute, continuous, prismatic, fixed",
                    remedy="name a base beyond this joint with --base",
                )
        self.leaders(joints)
        return base, tip, tuple(joints)

    def leaders(self, path: Sequence[UrdfJoint]) -> dict[str, Leader]:
        """Return what joints of a path mimic, by their names.

        Raises:
            ArmError: when one of them mimics a joint that is not on the path, or itself.
        """
        on_path = {joint.name: joint for joint in path if joint.kind in MOVING}
        found = {}
        for joint in on_path.values():
            leader, multiplier, offset, seen = joint, 1.0, 0.0, {joint.name}
            while leader.follows:
                multiplier, offset = (
                    multiplier * leader.multiplier,
                    offset + multiplier * leader.offset,
                )
                if leader.follows in seen or leader.follows not in on_path or multiplier == 0.0:
                    raise ArmError(
                        f"the joint follows joint {leader.follows} (mimic)",
                        where=f"{self.where}: joint {joint.name}",
                        value=f"multiplier {multiplier:g}" if multiplier == 0.0 else None,
                        allowed="a joint that moves between base and tip, which it follows by more "
                        "than nothing",
                        remedy="name a base beyond this joint, or a tip before it",
                    )
                leader = on_path[leader.follows]
                seen.add(leader.name)
            if leader is not joint:
                found[joint.name] = Leader(leader.name, multiplier, offset)
        return found

    def above(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints that carry a link, from the root on."""
        found: list[UrdfJoint] = []
        while link in self._carriers:
            found.append(self._carriers[link])
            link = self._carriers[link].parent
        return tuple(reversed(found))

    def below(self, link: str) -> Iterator[UrdfJoint]:
        """Yield the joints beyond a link, each after the one that carries it."""
        links = [link]
        while links:
            for joint in self._carried.get(links.pop(), ()):
                yield joint
                links.append(joint.child)

    @cached_property
    def _carriers(self) -> Mapping[str, UrdfJoint]:
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def _carried(self) -> Mapping[str, list[UrdfJoint]]:
        carried: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints:
            carried.setdefault(joint.parent, []).append(joint)
        return carried

    def _known(self, name: str, option: str) -> str:
        names = [link.name for link in self.links]
        if name not in names:
            remedy = remedy_for(name, names, f"name one of these links for {option}")
            raise ArmError(
                f"{option} names no link",
                where=self.where,
                value=name,
                allowed=", ".join(names),
                remedy=remedy,
            )
        return name

    def _beyond(self, base: str) -> list[str]:
        """Return the links beyond a link, in the order of the file."""
        beyond = {joint.child for joint in self.below(base)}
        return [link.name for link in self.links if link.name in beyond]

    def _only_tip(self, base: str) -> str:
        moves = {base: False}
        for joint in self.below(base):
            moves[joint.child] = moves[joint.parent] or joint.kind != "fixed"
        beyond = (link.name for link in self.links if moves.get(link.name))
        tips = [link for link in beyond if link not in self._carried]
        if len(tips) > 1:
            raise ArmError(
                "the robot branches, and no tip is named",
                where=self.where,
                value=f"{len(tips)} tips",
                allowed=", ".join(tips),
                remedy="name the end of the arm with --tip",
            )
        return tips[0] if tips else base


def read_tree(text: str, where: str) -> UrdfTree:
    """Read links and joints of the text of a URDF, which messages call by `where`.

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
    for element in robot.iter():
        # Of xacro, or an expression that it would work out. What stands in a comment was worked out
        # already: the parser has dropped it.
        words = (element.text or "", *element.attrib.values())
        if "xacro" in element.tag or any("${" in word or "$(" in word for word in words):
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


def _tree(links: tuple[UrdfLink, ...], joints: tuple[UrdfJoint, ...], where: str) -> UrdfTree:
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
    if apart := [name for name in names if name not in reached]:
        raise ArmError(
            "joints form a loop",
            where=where,
            value=", ".join(apart),
            allowed=f"links connected by joints from {roots[0]} on",
            remedy="cut the circle",
        )
    return tree


def _link(element: ElementTree.Element, where: str) -> UrdfLink:
    name = element.get("name", "")
    place = f"{where}: link {name}"
    inertial = element.find("inertial")
    if inertial is None:
        return UrdfLink(name, 0.0, _NOWHERE)
    (mass_kg,) = _numbers(inertial.find("mass"), "value", (0.0,), f"{place}: mass")
    com_m = _numbers(inertial.find("origin"), "xyz", _NOWHERE, f"{place}: inertial origin")
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
    if kind not in KINDS:  # the others of a URDF are read, but no chain can follow them
        raise ArmError(
            "unknown type of joint",
            where=place,
            value=kind,
            allowed="revolute, continuous, prismatic, fixed",
            remedy=remedy_for(kind, KINDS, "correct the type"),
        )
    mimic, origin, limit = (element.find(tag) for tag in ("mimic", "origin", "limit"))
    xyz = _numbers(origin, "xyz", _NOWHERE, f"{place}: origin")
    if max(map(abs, xyz)) > _FAR_M:
        raise ArmError(
            f"the joint is further than {_FAR_M:g} m from the one before",
            where=place,
            value=xyz,
            allowed="metres",
            remedy="divide by 1000 if these are millimetres",
        )
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{place}: axis")
    (lower,), (upper,) = (
        _numbers(limit, key, (0.0,), f"{place}: limit") for key in ("lower", "upper")
    )
    limits = lower, upper
    if kind == "continuous" or lower == upper == 0.0:
        limits = math.nan, math.nan  # a file that states none stands for no limits
    elif lower >= upper:
        raise ArmError(
            "the limits allow the joint no motion",
            where=place,
            value=limits,
            allowed="the lower limit first, then a higher one",
            remedy="correct the limits",
        )
    if kind in MOVING and math.hypot(*axis) < 1e-9:
        raise ArmError(
            "the axis has no direction",
            where=place,
            value=axis,
            allowed="not all zero",
            remedy="correct it",
        )
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_end(element, "parent", place),
        child=_end(element, "child", place),
        follows="" if mimic is None else mimic.get("joint", "another"),
        multiplier=_numbers(mimic, "multiplier", (1.0,), f"{place}: mimic")[0],
        offset=_numbers(mimic, "offset", (0.0,), f"{place}: mimic")[0],
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
        raise ArmError(
            f"the joint has no {end}", where=where, allowed="a link", remedy=f"give its {end}"
        )
    return link


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...], where: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        numbers = text.split(maxsplit=len(default))
        fit = all(len(number) <= _MOST_LETTERS for number in numbers)
        values = tuple(map(float, numbers)) if fit else ()
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
