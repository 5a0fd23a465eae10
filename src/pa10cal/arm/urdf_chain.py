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

#: A chain of fewer joints is a gripper, a head or a wheel where there is a longer one beside it.
_FEWEST_JOINTS = 3
#: Words in the name of a joint, or of the link that it carries, of a hand: the arm ends before it.
_OF_A_HAND = re.compile(r"gripper|finger|jaw|hand|knuckle|claw", re.IGNORECASE)
#: Usual names of the frame at the end of an arm, the controller's own first.
_TIPS = (
    re.compile(r"(^|_)tool0$", re.IGNORECASE),
    re.compile(r"(^|_)flange$", re.IGNORECASE),
    re.compile(r"(^|_)(link_?eef?|eef?_link|end_?effector(_link)?)$", re.IGNORECASE),
)
#: Usual names of the base; the controller's own, `base`, is preferred to these.
_BASE = re.compile(r"(^|_)(base|base_?link|link_?base|link_?0)$")


def ends_of_arm(text: str, where: str) -> tuple[str, str]:
    """Return base and tip of the one arm in a URDF; `where` is its name in messages.

    From the root, the longest chain of moving joints is followed: at least two joints longer than
    any other that branches off, and at least three. It ends where a hand begins. The tip is the
    link that the last joint carries, or one fixed to it that is called tool0, flange or
    end-effector. The base is the link that carries the first joint, or one fixed to it towards the
    root that is called base.

    Raises:
        ArmError: when there is no such chain, or there are several, or the text is no URDF.
    """
    tree = read_tree(text, where)
    chain: list[UrdfJoint] = []
    ahead = _next_moving(tree, tree.root)
    while ahead and not _begins_a_hand(tree, ahead, len(chain)):
        lengths = [_length(tree, joint) for joint in ahead]
        if len(lengths) > 1 and lengths[0] < max(lengths[1] + 2, _FEWEST_JOINTS):
            raise _ambiguous(tree)
        chain.append(ahead[0])
        ahead = _next_moving(tree, chain[-1].child)
    if len(chain) < 2:
        raise _ambiguous(tree)
    return _base(tree, chain[0]), _tip(tree, chain[-1])


def _begins_a_hand(tree: UrdfTree, ahead: list[UrdfJoint], arm_joints: int) -> bool:
    """Return whether the next moving joints belong to a hand, after so many joints of the arm.

    They do by their names, or as fingers: several chains of one length, shorter than the arm.
    """
    if arm_joints < _FEWEST_JOINTS:
        return False
    if any(_OF_A_HAND.search(joint.name) or _OF_A_HAND.search(joint.child) for joint in ahead):
        return True
    lengths = {_length(tree, joint) for joint in ahead}
    return len(ahead) > 1 and len(lengths) == 1 and max(lengths) < arm_joints


def _ambiguous(tree: UrdfTree) -> ArmError:
    moving = [joint.name for joint in tree.joints if joint.kind in MOVING]
    return ArmError(
        "which joints are the arm is not clear: no chain is longer than all others by two joints",
        where=tree.where,
        value=", ".join(moving) or "no joint that moves",
        allowed="one serial arm, with wheels, head or gripper of fewer joints",
        remedy="name its ends: pa10cal import_arm … --base LINK --tip LINK --out my_arm.yaml, "
        "and use my_arm",
    )


def _next_moving(tree: UrdfTree, link: str) -> list[UrdfJoint]:
    """Return the next moving joints beyond a link and those fixed to it, longest chain first.

    Chains of equal length are in the order of the file.
    """
    fixed = set(_fixed_beyond(tree, link))
    ahead = (joint for joint in tree.joints if joint.parent in fixed and joint.kind in MOVING)
    return sorted(ahead, key=lambda joint: -_length(tree, joint))


def _fixed_beyond(tree: UrdfTree, link: str) -> list[str]:
    """Return a link and those fixed to it, each after the one that carries it."""
    links = [link]
    for joint in tree.below(link):
        if joint.kind == "fixed" and joint.parent in links:
            links.append(joint.child)
    return links


def _length(tree: UrdfTree, joint: UrdfJoint) -> int:
    """Return the number of moving joints on the longest chain that begins with a joint."""
    lengths = {joint.child: 1}
    for beyond in tree.below(joint.child):
        lengths[beyond.child] = lengths[beyond.parent] + (beyond.kind in MOVING)
    return max(lengths.values())


def _base(tree: UrdfTree, first: UrdfJoint) -> str:
    """Return the base of an arm by its first joint."""
    carriers = [first.parent]  # towards the root
    for joint in reversed(tree.above(first.parent)):
        if joint.kind != "fixed":
            break
        carriers.append(joint.parent)
    if "base" in _fixed_beyond(tree, carriers[-1]):
        return "base"
    return next((link for link in carriers if _BASE.search(link)), first.parent)


def _tip(tree: UrdfTree, last: UrdfJoint) -> str:
    """Return the tip of an arm by its last joint."""
    carried = _fixed_beyond(tree, last.child)
    for pattern in _TIPS:
        if named := [link for link in carried if pattern.search(link)]:
            return named[0]
    # The flange of some arms is the link of the next number: link7 carries link8.
    if number := re.search(r"(\d+)$", last.child):
        after = f"{last.child[: number.start()]}{int(number[0]) + 1}"
        if after in carried:
            return after
    return last.child
