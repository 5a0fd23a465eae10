"""Which links of a URDF an arm leads from and to, where nobody names them.

Files of known robots hold more than the arm: wheels below it, a gripper at its end, frames of
cameras, the controller's base beside the first link. The arm is the one long chain of joints; where
there are two, as of a humanoid, nothing is guessed.
"""

from __future__ import annotations

import re

from pa10cal.arm.urdf_reading import MOVING, UrdfJoint, UrdfTree, read_tree
from pa10cal.errors import ArmError

#: A chain of fewer joints is a gripper, a head or a wheel where there is a longer one beside it.
_FEWEST_JOINTS = 3
#: A joint of a hand, where the arm has ended, by words in its name or its link's.
_OF_A_HAND = re.compile(r"gripper|finger|jaw|hand|knuckle|claw", re.IGNORECASE)
#: What the frame at the end of an arm is called, the controller's own first.
_TIPS = (
    re.compile(r"(^|_)tool0$", re.IGNORECASE),
    re.compile(r"(^|_)flange$", re.IGNORECASE),
    re.compile(r"(^|_)(link_?eef?|eef?_link|end_?effector(_link)?)$", re.IGNORECASE),
)
#: What the base is called, towards the root from the first joint; the controller's own, `base`,
#: goes first.
_BASE = re.compile(r"(^|_)(base|base_?link|link_?base|link_?0)$")


def ends_of_arm(text: str, where: str) -> tuple[str, str]:
    """Return the links between which the one arm of a URDF is; messages call it by `where`.

    From the root, the longest chain of moving joints is followed: at least two joints longer than
    any other that branches off, and at least three. It ends where a hand begins. The tip is what
    the last joint carries: a fixed link called tool0, flange or end-effector, else the link itself.
    The base is a link called base that is fixed towards the root from the first joint, else what
    carries that joint.

    Raises:
        ArmError: when there is no such chain, or there are several, or it is no URDF.
    """
    tree = read_tree(text, where)
    chain: list[UrdfJoint] = []
    ahead = _next_moving(tree, tree.root)
    while ahead and not _begins_a_hand(tree, ahead, len(chain)):
        longest, next_longest = (*(_length(tree, joint) for joint in ahead), 0)[:2]
        if len(ahead) > 1 and not longest >= max(next_longest + 2, _FEWEST_JOINTS):
            raise _not_clear(tree)
        chain.append(ahead[0])
        ahead = _next_moving(tree, chain[-1].child)
    if len(chain) < 2:
        raise _not_clear(tree)
    return _base(tree, chain[0]), _tip(tree, chain[-1])


def _begins_a_hand(tree: UrdfTree, ahead: list[UrdfJoint], joints: int) -> bool:
    """Return whether the joints that move next are of a hand, by so many joints of the arm.

    So are those that are called so, and fingers: of the same length, and shorter than the arm.
    """
    if joints < _FEWEST_JOINTS:
        return False
    if any(_OF_A_HAND.search(joint.name) or _OF_A_HAND.search(joint.child) for joint in ahead):
        return True
    lengths = {_length(tree, joint) for joint in ahead}
    return len(ahead) > 1 and len(lengths) == 1 and max(lengths) < joints


def _not_clear(tree: UrdfTree) -> ArmError:
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
    """Return the joints that move next beyond a link or what is fixed to it, longest chain first.

    Of equal ones in the order of the file.
    """
    fixed = set(_fixed_beyond(tree, link))
    ahead = (joint for joint in tree.joints if joint.parent in fixed and joint.kind in MOVING)
    return sorted(ahead, key=lambda joint: -_length(tree, joint))


def _fixed_beyond(tree: UrdfTree, link: str) -> list[str]:
    """Return a link and those fixed to it, each after the one that carries it."""
    found = [link]
    for joint in tree.below(link):
        if joint.kind == "fixed" and joint.parent in found:
            found.append(joint.child)
    return found


def _length(tree: UrdfTree, joint: UrdfJoint) -> int:
    """Return the number of joints that move on the longest chain from a joint on."""
    lengths = {joint.child: 1}
    for beyond in tree.below(joint.child):
        lengths[beyond.child] = lengths[beyond.parent] + (beyond.kind in MOVING)
    return max(lengths.values())


def _base(tree: UrdfTree, first: UrdfJoint) -> str:
    carriers = [first.parent]  # towards the root
    for joint in reversed(tree.above(first.parent)):
        if joint.kind != "fixed":
            break
        carriers.append(joint.parent)
    if "base" in _fixed_beyond(tree, carriers[-1]):
        return "base"
    return next((link for link in carriers if _BASE.search(link)), first.parent)


def _tip(tree: UrdfTree, last: UrdfJoint) -> str:
    carried = _fixed_beyond(tree, last.child)
    for called in _TIPS:
        if named := [link for link in carried if called.search(link)]:
            return named[0]
    # The flange of some arms is the link of the next number: link7 carries link8.
    if number := re.search(r"(\d+)$", last.child):
        after = f"{last.child[: number.start()]}{int(number[0]) + 1}"
        if after in carried:
            return after
    return last.child
