"""A URDF read from its text: XML, links and joints, checked one by one, and the ends of its arm.

Files of known robots hold more than the arm: wheels below it, a gripper at its end, frames of
cameras, the controller's base beside the first link. Where nobody names base and tip, the arm is
the longest chain of joints; where two are about as long, as of a humanoid, the file is refused.
"""

from __future__ import annotations

import math
import re
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
    for element in robot.iter():
        # Elements of xacro, or expressions that it evaluates. In comments, which the parser has
        # dropped, they are of no effect.
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
        follows="" if mimic is None else mimic.get("joint", "another"),
        multiplier=_numbers(mimic, "multiplier", (1.0,), f"{place}: mimic")[0],
        offset=_numbers(mimic, "offset", (0.0,), f"{place}: mimic")[0],
        xyz=xyz,
        rpy=_numbers(origin, "rpy", _ZERO, f"{place}: origin"),
        axis=axis,
        limits=limits,
        effort=_numbers(limit, "effort", (0.0,), f"{place}: limit")[0] or math.nan,
    )


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
    readable = all(len(number) <= _MOST_LETTERS for number in numbers)
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


# Which links are base and tip of the arm, where nobody names them.

#: Where chains branch off, one of fewer joints is a wheel, a head, a camera or a finger; and an
#: arm has as many joints before its hand.
_FEWEST_JOINTS = 3
#: A word in the name of a joint, or of the link that it carries, of a hand: the arm ends before it.
_OF_A_HAND = re.compile(
    r"(?<![a-z])(l|r|left|right)?(gripper|finger|jaw|hand|knuckle|claw)s?(?![a-z])"
)
#: Usual names of the frame at the end of an arm, the controller's own first.
_TIPS = (
    re.compile(r"(^|_)tool0$", re.IGNORECASE),
    re.compile(r"(^|_)flange$", re.IGNORECASE),
    re.compile(r"(^|_)(link_?eef?|eef?_link|end_?effector(_link)?)$", re.IGNORECASE),
)
#: Usual names of the base; the controller's own, `base`, is preferred to the others.
_BASE = re.compile(r"(^|_)(base|base_?link|link_?base|link_?0)$", re.IGNORECASE)


def ends_of_arm(text: str, where: str) -> tuple[str, str]:
    """Return base and tip of the one arm in a URDF; `where` is its name in messages.

    From the root the moving joints are followed. Where several chains of them branch off, the
    longest is the arm's if it has three joints or more, and two more than any other. The arm ends
    where a hand begins. The tip is the link that the last joint carries, or one fixed to it that is
    called tool0, flange or end-effector. The base is a link fixed to the one that carries the first
    joint: one called `base`, or else one towards the root with another usual name of a base; the
    link that carries the first joint where there is none.

    Raises:
        ArmError: when there is no such chain, or there are several, or the text is no URDF.
    """
    tree = read_tree(text, where)
    chain: list[UrdfJoint] = []
    next_joints = _next_moving(tree, tree.root)
    while next_joints and not _begins_a_hand(tree, next_joints, len(chain)):
        lengths = [_chain_length(tree, joint) for joint in next_joints]
        if len(lengths) > 1 and lengths[0] < max(lengths[1] + 2, _FEWEST_JOINTS):
            raise _ambiguous(tree, next_joints)
        chain.append(next_joints[0])
        next_joints = _next_moving(tree, chain[-1].child)
    if len(chain) < 2:
        raise _ambiguous(tree, chain)
    return _base_of(tree, chain[0]), _tip_of(tree, chain[-1])


def _begins_a_hand(tree: UrdfTree, next_joints: list[UrdfJoint], joints_so_far: int) -> bool:
    """Return whether the next moving joints belong to a hand, after so many joints of the arm.

    They do if the names of all say so; one alone may be a camera called after the hand. They also
    do as fingers: three short chains or more of one length, or two that slide. Two that turn may be
    the last joint of the arm and a camera beside it.
    """
    if joints_so_far < _FEWEST_JOINTS:
        return False
    if all(_is_of_a_hand(joint) for joint in next_joints):
        return True
    lengths = {_chain_length(tree, joint) for joint in next_joints}
    all_slide = all(joint.kind == "prismatic" for joint in next_joints)
    short = len(lengths) == 1 and max(lengths) < _FEWEST_JOINTS
    return short and len(next_joints) > (1 if all_slide else 2)


def _is_of_a_hand(joint: UrdfJoint) -> bool:
    """Return whether a word in the name of a joint, or of its link, is that of a hand."""
    words = (re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name) for name in (joint.name, joint.child))
    return any(_OF_A_HAND.search(name.lower()) for name in words)


def _ambiguous(tree: UrdfTree, next_joints: list[UrdfJoint]) -> ArmError:
    """Return the error that the arm is not clear, with the joints that begin the chains."""
    chains = ", ".join(f"{_chain_length(tree, joint)} from {joint.name}" for joint in next_joints)
    return ArmError(
        "which joints are the arm is not clear: no chain is longer than all others by two joints",
        where=tree.where,
        value=f"number of joints: {chains}" if chains else "no joint that moves",
        allowed="one serial arm, with wheels, head or gripper of fewer joints",
        remedy="name its ends: pa10cal import_arm … --base LINK --tip LINK --out my_arm.yaml, "
        "and use my_arm",
    )


def _next_moving(tree: UrdfTree, link: str) -> list[UrdfJoint]:
    """Return the next moving joints beyond a link and those fixed to it, longest chain first.

    Chains of equal length are in the order of the file.
    """
    fixed = set(_fixed_beyond(tree, link))
    moving = (joint for joint in tree.joints if joint.parent in fixed and joint.kind in MOVING)
    return sorted(moving, key=lambda joint: -_chain_length(tree, joint))


def _fixed_beyond(tree: UrdfTree, link: str) -> list[str]:
    """Return a link and those fixed to it, each after the one that carries it."""
    links = [link]
    for joint in tree.below(link):  # every joint after the one that carries its parent
        if joint.kind == "fixed" and joint.parent in links:
            links.append(joint.child)
    return links


def _chain_length(tree: UrdfTree, joint: UrdfJoint) -> int:
    """Return the number of moving joints on the longest chain that begins with a joint."""
    lengths = {joint.child: 1}
    for beyond in tree.below(joint.child):
        lengths[beyond.child] = lengths[beyond.parent] + (beyond.kind in MOVING)
    return max(lengths.values())


def _base_of(tree: UrdfTree, first: UrdfJoint) -> str:
    """Return the base of an arm by its first joint."""
    carriers = [first.parent]  # towards the root
    for joint in reversed(tree.above(first.parent)):
        if joint.kind != "fixed":
            break
        carriers.append(joint.parent)
    for link in _fixed_beyond(tree, carriers[-1]):
        if link.lower() == "base":
            return link
    return next((link for link in carriers if _BASE.search(link)), first.parent)


def _tip_of(tree: UrdfTree, last: UrdfJoint) -> str:
    """Return the tip of an arm by its last joint."""
    carried = _fixed_beyond(tree, last.child)
    for pattern in _TIPS:
        if named := [link for link in carried if pattern.search(link)]:
            return named[0]
    # The flange of some arms is the link of the next number: link7 carries link8.
    if number := re.search(r"(\d+)$", last.child):
        after = f"{last.child[: number.start()]}{int(number[0]) + 1:0{len(number[0])}d}"
        if after in carried:
            return after
    return last.child
