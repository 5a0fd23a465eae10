"""Base and tip of the arm in a URDF, where nobody names them.

Files of known robots hold more than the arm: wheels below it, a gripper at its end, frames of
cameras, the controller's base beside the first link. The arm is the longest chain of joints; where
two are about as long, as of a humanoid, the file is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfTree
from pa10cal.errors import ArmError

#: Where chains branch off, one of fewer joints is a wheel, a head, a camera or a finger; and an
#: arm has as many joints before its hand.
_FEWEST_JOINTS = 3
#: Joints of the longest finger: a thumb, with the joint that turns it against the palm.
_MOST_OF_A_FINGER = 5
#: A word of a finger in a name (`left_finger`, `leftfinger`, `rjaw2`), one of a hand (`hand_joint`,
#: but not `handling_link`), and one that is of a finger where others are beside it (`ring`).
_FINGER = "finger|jaw|knuckle|claw|thumb|pinky"
_HAND = f"{_FINGER}|gripper|hand|palm|suction|vacuum|cup"
_OF_A_FINGER, _OF_A_HAND, _AMONG_FINGERS, _OFF_THE_ARM = (
    re.compile(rf"(?<![a-z])(l|r|left|right)?({words})s?(?![a-z])")
    for words in (_FINGER, _HAND, f"{_HAND}|index|middle|ring|little", f"{_HAND}|cam|camera")
)
#: Types of joints that end a chain: they carry a whole robot, and no serial arm has them.
_FREE = ("floating", "planar")
#: Usual names of the frame at the end of an arm, the controller's own first.
_TIPS = (
    re.compile(r"(^|_)tool0$", re.IGNORECASE),
    re.compile(r"(^|_)flange$", re.IGNORECASE),
    re.compile(r"(^|_)(link_?eef?|eef?_link|end_?effector(_link)?)$", re.IGNORECASE),
)
#: The controller's own base, and usual names of bases, to which it is preferred.
_OWN_BASE = re.compile(r"(^|_)base$", re.IGNORECASE)
_BASE = re.compile(r"(^|_)(base|base_?link|link_?base|link_?0)$", re.IGNORECASE)


def ends_of_arm(text: str, where: str) -> tuple[str, str]:
    """Return base and tip of the one arm in a URDF; `where` is its name in messages.

    From the root the moving joints are followed. Where several chains of them branch off, the
    longest is the arm's if it has three joints or more, and two more than any other; joints of a
    hand do not count. The arm ends where a hand begins. The tip is the link that the last joint
    carries, or one fixed to it that is called tool0, flange or end-effector: of several the first
    with the arm's own prefix, and none of a gripper or camera. The base is a link fixed to the one
    that carries the first joint: one called `base`, or `left_base` beside `left_base_link`, or else
    one towards the root with another usual name of a base; the link that carries the first joint
    where there is none.

    Raises:
        ArmError: when there is no such chain, or there are several, or the text is no URDF.
    """
    tree = read_tree(text, where)
    next_joints = _first_joints(tree)
    chain: list[_Moving] = []
    while next_joints and not (chain and chain[-1].carries_hand):
        _refuse_unless_one_is_the_arm(tree, next_joints, len(chain))
        chain.append(next_joints[0])
        next_joints = chain[-1].next_joints
    if len(chain) < 2:
        raise _too_few_joints(tree, chain)
    return _base_of(tree, chain[0].joint), _tip_of(tree, chain[-1].joint)


# Moving joints, and how long the chains are that begin with them.


@dataclass(frozen=True, eq=False)
class _Moving:
    """A moving joint, and the chains of moving joints that begin with it."""

    joint: UrdfJoint
    next_joints: tuple[_Moving, ...]  # those that follow it, that of the longest arm first
    length: int  # joints of the longest chain
    count: int  # joints of all chains
    carries_hand: bool  # whether the joints that follow are those of a hand
    arm_length: int  # joints of the longest chain up to where a hand begins


def _first_joints(tree: UrdfTree) -> tuple[_Moving, ...]:
    """Return the first moving joints beyond the root, that of the longest arm first.

    Chains of equal length are in the order of the file.
    """
    place_in_file = {joint.child: k for k, joint in enumerate(tree.joints)}
    following: dict[str, list[UrdfJoint]] = {}  # moving joints that follow, by link
    before = {tree.root: 0}  # moving joints that carry a link, by link
    links = [tree.root]
    for link in links:  # each after the one that carries it
        carried = (joint for fixed in _fixed_beyond(tree, link) for joint in tree.carried_by(fixed))
        moving = (joint for joint in carried if joint.kind in MOVING)
        following[link] = sorted(moving, key=lambda joint: place_in_file[joint.child])
        for joint in following[link]:
            before[joint.child] = before[link] + 1
            links.append(joint.child)
    next_joints: dict[str, tuple[_Moving, ...]] = {}
    for link in reversed(links):
        made = [
            _moving(each, before[each.child], next_joints[each.child]) for each in following[link]
        ]
        next_joints[link] = tuple(sorted(made, key=lambda each: -each.arm_length))
    return next_joints[tree.root]


def _moving(joint: UrdfJoint, number: int, next_joints: tuple[_Moving, ...]) -> _Moving:
    """Return a moving joint with its chains; `number` counts it among those from the root on."""
    ends = not next_joints or (number >= _FEWEST_JOINTS and _begin_a_hand(joint, next_joints))
    return _Moving(
        joint,
        next_joints,
        length=1 + max((each.length for each in next_joints), default=0),
        count=1 + sum(each.count for each in next_joints),
        carries_hand=ends and bool(next_joints),
        arm_length=1 if ends else 1 + max(each.arm_length for each in next_joints),
    )


def _refuse_unless_one_is_the_arm(
    tree: UrdfTree, next_joints: Sequence[_Moving], before: int
) -> None:
    """Refuse joints of which none clearly is the arm's next; `before` is the number of its others.

    Raises:
        ArmError: with the joints that begin the chains.
    """
    if len(next_joints) < 2:
        return
    lengths = [each.arm_length for each in next_joints]
    chains = ", ".join(f"{each.arm_length} from {each.joint.name}" for each in next_joints)
    if lengths[0] < max(lengths[1] + 2, _FEWEST_JOINTS):
        why = "no chain is longer than all others by two joints"
        raise _unclear(tree, why, f"number of joints: {chains}")
    long_ones = sum(length > 1 for length in lengths)
    if before >= _FEWEST_JOINTS and long_ones > 2 and lengths[0] <= _MOST_OF_A_FINGER:
        why = "three chains or more branch off as fingers do"
        raise _unclear(tree, why, f"number of joints: {chains}")


def _too_few_joints(tree: UrdfTree, chain: Sequence[_Moving]) -> ArmError:
    """Return the error that fewer than two joints move before the chain ends."""
    free = next((joint for joint in tree.joints if joint.kind in _FREE), None)
    if free is not None:
        return _unclear(tree, f"the arm is beyond a {free.kind} joint", f"joint {free.name}")
    if chain:
        value = f"number of joints: 1 from {chain[0].joint.name}"
        return _unclear(tree, "only one joint moves", value)
    return _unclear(tree, "nothing moves", "no joint that moves")


def _unclear(tree: UrdfTree, why: str, value: str) -> ArmError:
    """Return the error that it is not clear which joints are the arm."""
    return ArmError(
        f"which joints are the arm is not clear: {why}",
        where=tree.where,
        value=value,
        allowed="one serial arm, with wheels, head or gripper of fewer joints",
        remedy="name its ends: pa10cal import_arm … --base LINK --tip LINK --out my_arm.yaml, "
        "and use my_arm",
    )


# Where a hand begins.


def _begin_a_hand(before: UrdfJoint, next_joints: Sequence[_Moving]) -> bool:
    """Return whether the joints that follow another, `before`, belong to a hand."""
    if len(next_joints) == 1:
        return _is_of_a_hand(next_joints[0], before)
    return _are_called_a_hand(next_joints) or _are_fingers(next_joints)


def _is_of_a_hand(moving: _Moving, before: UrdfJoint) -> bool:
    """Return whether a joint with no other beside it is called after a hand or moves a finger.

    The last joint of many an arm turns a link called after the hand (`wrist_roll` carries
    `gripper_link`): of links that turn, only the word of a finger counts. Where two joints or more
    follow in a single chain, or the joint `before` is called so too, it is an arm called after its
    hand (`l_hand_4`).
    """
    joint = moving.joint
    is_long = moving.length > 2 and moving.count == moving.length
    if is_long or _has_word(_OF_A_HAND, before.name):
        return False
    of_link = _OF_A_HAND if joint.kind == "prismatic" else _OF_A_FINGER
    return _has_word(_OF_A_HAND, joint.name) or _has_word(of_link, joint.child)


def _are_called_a_hand(next_joints: Sequence[_Moving]) -> bool:
    """Return whether all joints or their links are called after a hand or its fingers.

    One of them alone may be a camera called after the hand.
    """
    return all(
        _has_word(_AMONG_FINGERS, each.joint.name) or _has_word(_AMONG_FINGERS, each.joint.child)
        for each in next_joints
    )


def _are_fingers(next_joints: Sequence[_Moving]) -> bool:
    """Return whether joints are three short chains or more of one length, or two that slide.

    Two that turn may be the last joint of the arm and a camera beside it.
    """
    lengths = {each.length for each in next_joints}
    all_slide = all(each.joint.kind == "prismatic" for each in next_joints)
    fewest = 2 if all_slide else 3
    return len(lengths) == 1 and max(lengths) < _FEWEST_JOINTS and len(next_joints) >= fewest


def _has_word(word: re.Pattern[str], name: str) -> bool:
    """Return whether a name has a word; a capital letter begins one."""
    return word.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) is not None


# The links at the ends.


def _fixed_beyond(
    tree: UrdfTree, link: str, *, without: re.Pattern[str] | None = None
) -> list[str]:
    """Return a link and those fixed to it, each after the one that carries it.

    Args:
        without: links beyond it with such a word are left out, and what they carry.
    """
    found, open_ends = [link], [link]
    while open_ends:
        for joint in tree.carried_by(open_ends.pop()):
            if joint.kind == "fixed" and not (without and _has_word(without, joint.child)):
                found.append(joint.child)
                open_ends.append(joint.child)
    return found


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
        beside_its_link = f"{link}_link" in carriers  # `left_base` beside `left_base_link`
        if _OWN_BASE.search(link) and beside_its_link:
            return link
    return next((link for link in carriers if _BASE.search(link)), first.parent)


def _tip_of(tree: UrdfTree, last: UrdfJoint) -> str:
    """Return the tip of an arm by its last joint."""
    carried = _fixed_beyond(tree, last.child, without=_OFF_THE_ARM)
    for pattern in _TIPS:
        found = [match for link in carried if (match := pattern.search(link))]
        # That of the arm has the prefix of its last link: `left_tool0` beside `left_wrist`.
        own = [each for each in found if last.child.startswith(each.string[: each.start()])]
        if found:
            return (own or found)[0].string
    # The flange of some arms is the link of the next number: link7 carries link8.
    if number := re.search(r"(\d+)$", last.child):
        after = f"{last.child[: number.start()]}{int(number[0]) + 1:0{len(number[0])}d}"
        if after in carried:
            return after
    return last.child
