"""Base and tip of the arm in a URDF, where nobody names them.

Files of known robots hold more than the arm: wheels below it, a gripper at its end, frames of
cameras, the controller's base beside the first link. The arm is the longest chain of joints; where
two are about as long, as of a humanoid, the file is refused.
"""

from __future__ import annotations

import re

from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_tree import MOVING, UrdfJoint, UrdfTree
from pa10cal.errors import ArmError

#: Where chains branch off, one of fewer joints is a wheel, a head, a camera or a finger; and an
#: arm has as many joints before its hand.
_FEWEST_JOINTS = 3
#: A word of a finger in a name (`left_finger`, `rjaw2`), and one of a hand (`hand_joint`, but not
#: `handling_link`). The arm ends before a joint of a hand.
_FINGER = "finger|jaw|knuckle|claw"
_OF_A_FINGER = re.compile(rf"(?<![a-z])(l|r|left|right)?({_FINGER})s?(?![a-z])")
_OF_A_HAND = re.compile(rf"(?<![a-z])(l|r|left|right)?({_FINGER}|gripper|hand)s?(?![a-z])")
#: Types of joints that no serial arm has: they carry a whole robot.
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
    longest is the arm's if it has three joints or more, and two more than any other. The arm ends
    where a hand begins. The tip is the link that the last joint carries, or one fixed to it that is
    called tool0, flange or end-effector. The base is a link fixed to the one that carries the first
    joint: one called `base`, or `left_base` beside `left_base_link`, or else one towards the root
    with another usual name of a base; the link that carries the first joint where there is none.

    Raises:
        ArmError: when there is no such chain, or there are several, or the text is no URDF.
    """
    tree = read_tree(text, where)
    chain: list[UrdfJoint] = []
    next_joints = _next_moving(tree, tree.root)
    while next_joints and not _begins_a_hand(tree, next_joints, chain):
        lengths = [_chain_length(tree, joint) for joint in next_joints]
        if len(lengths) > 1 and lengths[0] < max(lengths[1] + 2, _FEWEST_JOINTS):
            raise _ambiguous(tree, next_joints)
        chain.append(next_joints[0])
        next_joints = _next_moving(tree, chain[-1].child)
    if len(chain) < 2:
        raise _ambiguous(tree, chain)
    return _base_of(tree, chain[0]), _tip_of(tree, chain[-1])


def _begins_a_hand(tree: UrdfTree, next_joints: list[UrdfJoint], arm: list[UrdfJoint]) -> bool:
    """Return whether the next moving joints belong to a hand, after those of the arm so far."""
    if len(arm) < _FEWEST_JOINTS:
        return False
    if len(next_joints) == 1:
        return _is_of_a_hand(tree, next_joints[0], before=arm[-1])
    return _are_called_a_hand(next_joints) or _are_fingers(tree, next_joints)


def _is_of_a_hand(tree: UrdfTree, joint: UrdfJoint, before: UrdfJoint) -> bool:
    """Return whether a joint with no other beside it is called after a hand or moves a finger.

    The last joint of many an arm turns a link called after the hand (`wrist_roll` carries
    `gripper_link`): of links that turn, only the word of a finger counts. Where two joints or more
    follow in a single chain, or the joint `before` is called so too, it is an arm called after its
    hand (`l_hand_4`).
    """
    length = _chain_length(tree, joint)
    moving_beyond = sum(beyond.kind in MOVING for beyond in tree.below(joint.child))
    is_long = length > 2 and moving_beyond == length - 1
    if is_long or _has_word(_OF_A_HAND, before.name):
        return False
    of_link = _OF_A_HAND if joint.kind == "prismatic" else _OF_A_FINGER
    return _has_word(_OF_A_HAND, joint.name) or _has_word(of_link, joint.child)


def _are_called_a_hand(next_joints: list[UrdfJoint]) -> bool:
    """Return whether all joints or their links are called after a hand.

    One of them alone may be a camera called after the hand.
    """
    return all(
        _has_word(_OF_A_HAND, joint.name) or _has_word(_OF_A_HAND, joint.child)
        for joint in next_joints
    )


def _are_fingers(tree: UrdfTree, next_joints: list[UrdfJoint]) -> bool:
    """Return whether joints are three short chains or more of one length, or two that slide.

    Two that turn may be the last joint of the arm and a camera beside it.
    """
    lengths = {_chain_length(tree, joint) for joint in next_joints}
    all_slide = all(joint.kind == "prismatic" for joint in next_joints)
    short = len(lengths) == 1 and max(lengths) < _FEWEST_JOINTS
    return short and len(next_joints) > (1 if all_slide else 2)


def _has_word(word: re.Pattern[str], name: str) -> bool:
    """Return whether a name has a word; a capital letter begins one."""
    return word.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) is not None


def _ambiguous(tree: UrdfTree, next_joints: list[UrdfJoint]) -> ArmError:
    """Return the error that the arm is not clear, with the joints that begin the chains."""
    chains = ", ".join(f"{_chain_length(tree, joint)} from {joint.name}" for joint in next_joints)
    why, value = "no chain is longer than all others by two joints", f"number of joints: {chains}"
    if len(next_joints) == 1:
        why = "only one joint moves"
    elif not next_joints:
        free = [joint for joint in tree.joints if joint.kind in _FREE]
        why = f"the arm is beyond a {free[0].kind} joint" if free else "nothing moves"
        value = f"joint {free[0].name}" if free else "no joint that moves"
    return ArmError(
        f"which joints are the arm is not clear: {why}",
        where=tree.where,
        value=value,
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
        if link.lower() == "base" or (_OWN_BASE.search(link) and f"{link}_link" in carriers):
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
