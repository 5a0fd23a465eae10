"""Lost motion of all joints together, tried after the search in the place of what a move leaves.

An arm with lost motion in every joint stops short of its log wherever it came from, and so does one
that is read early: `along_move` has one number for that, lost motion one for each joint, none of
which may help enough by itself. Predictions hold what is of the arm, and not what is of its log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from pa10cal.discovery.blocked_cv.effect_set import as_good, surely_worse
from pa10cal.discovery.blocked_cv.interleaved_check import (
    InterleavedCheck,
    SquaresByBlock,
    proof_of,
)
from pa10cal.discovery.blocked_cv.judge import BlockPrediction, Judged
from pa10cal.discovery.finding import Rival
from pa10cal.terms.effects.arrivals import AlongMove, LostMotion
from pa10cal.terms.effects.effect import CandidateContext, Effect, driven_joints
from pa10cal.terms.effects.joint import Backlash


def stand_for_lost_motion(judged: Sequence[Judged]) -> tuple[Judged, ...]:
    """Return the effects found that lost motion of all joints may explain as well.

    Those of moves, and lost motion of single joints.
    """
    return tuple(each for each in judged if isinstance(each.effect, AlongMove | Backlash))


def lost_motion_instead(
    context: CandidateContext, check: InterleavedCheck, found: tuple[Judged, ...]
) -> tuple[Judged, ...]:
    """Return lost motion in the place of what may stand for it, if left-out poses gain by that.

    Where it and an effect of moves predict them alike, to within a standard error, the better of
    the two has the other as an alternative.

    Args:
        context: that of the campaign.
        check: about the model without what was found.
        found: what may stand for it, as `stand_for_lost_motion` returns it.
    """
    alone = _of_joints_that_need_it(context, check)
    if alone is None:
        return found
    with_found = check.squares([each.effect for each in found])
    in_place = _by_joint(alone.effect, proof_of(check.squares(), alone.squares))
    moves = tuple(each for each in found if isinstance(each.effect, AlongMove))
    if not moves:
        return in_place if check.gains_significantly(with_found, alone.squares) else found
    of_moves = [each.effect for each in moves]
    if check.gains_a_share(alone.squares, check.squares([*of_moves, alone.effect])):
        beside = _of_joints_that_need_it(context, check, of_moves)
        if beside is None:
            return found
        proof = proof_of(check.squares(of_moves), beside.squares)
        return (*moves, *_by_joint(beside.effect, proof))
    if not as_good(with_found.total, alone.squares.total):
        return in_place
    if len(found) > 1 or not as_good(alone.squares.total, with_found.total):
        return found
    return (_either(check, found[0], with_found, alone),)


class _Tried(NamedTuple):
    effect: LostMotion
    squares: SquaresByBlock  # of left-out poses with it


def _of_joints_that_need_it(
    context: CandidateContext, check: InterleavedCheck, beside: Sequence[Effect] = ()
) -> _Tried | None:
    """Return lost motion of the joints that have it; None where all together gain too little.

    Where it would be negative, or left-out poses are predicted as well without it, a joint has
    none; the least needed one leaves first.
    """
    without = check.squares(beside)
    tried = _tried(check, driven_joints(context), beside)
    while tried.effect.joints:
        less = [_tried(check, _all_but(joint, tried), beside) for joint in tried.effect.joints]
        idle = [
            one
            for one, amount in zip(less, check.amounts(tried.effect, beside), strict=True)
            if amount <= 0.0 or as_good(one.squares.total, tried.squares.total)
        ]
        if not idle:
            contradict = any(map(surely_worse, without.by_kind - tried.squares.by_kind))
            helps = check.gains_a_share(without, tried.squares) and not contradict
            return tried if helps else None
        tried = min(idle, key=lambda one: float(one.squares.total.sum()))
    return None


def _tried(check: InterleavedCheck, joints: tuple[int, ...], beside: Sequence[Effect]) -> _Tried:
    """Return lost motion of some joints, which may be none, tried on left-out poses."""
    effect = LostMotion("arm", joints)
    return _Tried(effect, check.squares([*beside, effect] if joints else beside))


def _all_but(joint: int, tried: _Tried) -> tuple[int, ...]:
    """Return the joints of what was tried but for one."""
    return tuple(other for other in tried.effect.joints if other != joint)


def _by_joint(effect: LostMotion, proof: BlockPrediction) -> tuple[Judged, ...]:
    """Return lost motion joint by joint, each by the evidence of all."""
    return tuple(Judged(each, proof, ()) for each in effect.of_each)


def _either(
    check: InterleavedCheck, move: Judged, with_move: SquaresByBlock, tried: _Tried
) -> Judged:
    """Return the better of an effect of moves and lost motion, the other its alternative."""
    if with_move.total.sum() <= tried.squares.total.sum():
        rival = Rival(tried.effect, check.nats(with_move, tried.squares))
        alternatives = (*move.alternatives, tried.effect)
        return replace(move, alternatives=alternatives, rivals=(*move.rivals, rival))
    rival = Rival(move.effect, check.nats(tried.squares, with_move))
    proof = proof_of(check.squares(), tried.squares)
    return Judged(tried.effect, proof, (move.effect,), (rival,))
