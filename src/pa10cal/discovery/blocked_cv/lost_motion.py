"""Lost motion of all joints together, tried after the search in the place of what a move leaves.

An arm with lost motion in every joint stops short of its log wherever it came from, and so does one
that is read early: `along_move` has one number for that, lost motion one for each joint, none of
which may help enough by itself. Predictions hold what is of the arm, and not what is of its log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.effect_set import as_good, surely_worse
from pa10cal.discovery.blocked_cv.interleaved_check import (
    InterleavedCheck,
    SquaresByBlock,
    proof_of,
)
from pa10cal.discovery.blocked_cv.judge import BlockPrediction, Judged
from pa10cal.discovery.finding import Rival
from pa10cal.terms.effects.arrivals import LostMotion
from pa10cal.terms.effects.context import CandidateContext, driven_joints, joint_of
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash


def stand_for_lost_motion(judged: Sequence[Judged]) -> tuple[Judged, ...]:
    """Return the effects found that lost motion of all joints may explain as well.

    Those of moves, and lost motion of single joints.
    """
    return tuple(each for each in judged if _is_judged_here(each.effect))


def _is_judged_here(effect: Effect) -> bool:
    """Return whether an effect is of moves, or lost motion of a joint."""
    return effect.of_moves or effect.id == Backlash.id


def lost_motion_instead(
    context: CandidateContext,
    check: InterleavedCheck,
    found: tuple[Judged, ...],
    candidates: Sequence[Effect],
) -> tuple[Judged, ...]:
    """Return what to name in the place of effects of moves and of lost motion that were found.

    Lost motion of all joints that need it is compared with the effects of moves found. Where there
    are none, the best candidate is tried, unless what was found is lost motion of one joint and
    that of all gains nothing significant: the search tried moves in its place. See `_against_moves`
    for what wins. The loser is a rival of the winner, with its score.

    Args:
        context: that of the campaign.
        check: about the model without what was found.
        found: what may stand for it, as `stand_for_lost_motion` returns it.
        candidates: the effects of moves that the campaign may show.
    """
    lost, with_found = _of_joints_that_need_it(context, check), _squares(check, found)
    without = check.squares()
    if _contradicts(without, lost.squares):
        return found
    gains = check.gains_a_share(without, lost.squares)
    if any(each.effect.of_moves for each in found):
        if not gains:
            return _with_rival(check, found, with_found, lost)
        return _against_moves(context, check, lost, found)
    more = gains and check.gains_significantly(with_found, lost.squares)
    if not (more or len(found) > 1):
        return _with_rival(check, found, with_found, lost)
    moves = _best_move(check, candidates)
    with_move = _squares(check, moves)
    move_helps = _helps(check, without, with_move)
    if not more:
        if not (move_helps and as_good(with_move.total, with_found.total)):
            return found
        joints = tuple(sorted(joint_of(each.effect.of) for each in found))
        lost = _LostMotion(LostMotion("arm", joints), with_found)
    if not move_helps:
        proof = proof_of(without, lost.squares)
        return _by_joint(check, lost, proof, _by_place(found), moves)
    return _against_moves(context, check, lost, moves, found)


def _against_moves(
    context: CandidateContext,
    check: InterleavedCheck,
    lost: _LostMotion,
    found: tuple[Judged, ...],
    before: tuple[Judged, ...] = (),
) -> tuple[Judged, ...]:
    """Return what to name of lost motion that helps, and of effects of moves.

    By how left-out poses are predicted, to within a standard error:

    =================================  ==========================================================
    they gain by moves beside it       moves; lost motion of each joint too, if they gain by that
    worse with the moves               lost motion of each joint
    worse with lost motion             what was found
    alike, a single joint's beside     the moves, and that
    alike                              the better of both, the other its alternative
    =================================  ==========================================================

    Args:
        context: that of the campaign.
        check: about the model without any of it.
        lost: lost motion of the joints that need it.
        found: effects of moves, and lost motion of single joints that stands beside them.
        before: lost motion of single joints that was found without any effect of moves.
    """
    moves = tuple(each for each in found if each.effect.of_moves)
    with_moves, with_found = _squares(check, moves), _squares(check, found)
    of_moves = [each.effect for each in moves]
    former = _by_place((*found, *before))
    if check.gains_a_share(lost.squares, check.squares([*of_moves, lost.effect])):
        beside = _of_joints_that_need_it(context, check, of_moves)
        if not _helps(check, with_moves, beside.squares):
            return _with_rival(check, found, with_found, lost)
        moves = _with_rival(check, moves, beside.squares, lost)
        proof = proof_of(with_moves, beside.squares)
        return (*moves, *_by_joint(check, beside, proof, former, ()))
    if not as_good(with_found.total, lost.squares.total):
        proof = proof_of(check.squares(), lost.squares)
        return _by_joint(check, lost, proof, former, found)
    if len(found) > 1 or not as_good(lost.squares.total, with_found.total):
        return _with_rival(check, found, with_found, lost)
    return (_either(check, found[0], with_found, lost),)


def _by_place(judged: Sequence[Judged]) -> dict[str, Judged]:
    """Return what was found by where it sits."""
    return {each.effect.of: each for each in judged}


def _squares(check: InterleavedCheck, judged: Sequence[Judged]) -> SquaresByBlock:
    """Return the squares of left-out poses with what was found in the model."""
    return check.squares([each.effect for each in judged])


def _best_move(check: InterleavedCheck, candidates: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return the effect of moves that predicts left-out poses best; none without candidates.

    The others are its rivals.
    """
    if not candidates:
        return ()
    squares = {each: check.squares([each]) for each in candidates}
    best, *others = sorted(squares, key=lambda each: float(squares[each].total.sum()))
    alternatives = (each for each in others if as_good(squares[each].total, squares[best].total))
    rivals = (Rival(each, check.nats(squares[best], squares[each])) for each in others)
    proof = proof_of(check.squares(), squares[best])
    return (Judged(best, proof, tuple(alternatives), tuple(rivals)),)


class _LostMotion(NamedTuple):
    """Lost motion of some joints, which may be none, tried on left-out poses."""

    effect: LostMotion
    squares: SquaresByBlock  # of left-out poses with it


def _of_joints_that_need_it(
    context: CandidateContext, check: InterleavedCheck, beside: Sequence[Effect] = ()
) -> _LostMotion:
    """Return lost motion of the joints that have it, whether or not they gain enough together.

    Where it would be negative, or left-out poses are predicted as well without it, a joint has
    none; the least needed one leaves first.
    """
    tried = _tried(check, driven_joints(context), beside)
    while tried.effect.joints:
        less = [_tried(check, _all_but(joint, tried), beside) for joint in tried.effect.joints]
        idle = [
            one
            for one, amount in zip(less, check.amounts(tried.effect, beside), strict=True)
            if amount <= 0.0 or as_good(one.squares.total, tried.squares.total)
        ]
        if not idle:
            break
        tried = min(idle, key=lambda one: float(one.squares.total.sum()))
    return tried


def _helps(check: InterleavedCheck, without: SquaresByBlock, squares: SquaresByBlock) -> bool:
    """Return whether left-out poses gain what the search requires, and neither kind loses."""
    return check.gains_a_share(without, squares) and not _contradicts(without, squares)


def _contradicts(without: SquaresByBlock, squares: SquaresByBlock) -> bool:
    """Return whether positions or orientations are predicted worse with something."""
    return any(map(surely_worse, without.by_kind - squares.by_kind))


def _tried(
    check: InterleavedCheck, joints: tuple[int, ...], beside: Sequence[Effect]
) -> _LostMotion:
    """Return lost motion of some joints, beside other effects."""
    effect = LostMotion("arm", joints)
    return _LostMotion(effect, check.squares([*beside, effect] if joints else beside))


def _all_but(joint: int, tried: _LostMotion) -> tuple[int, ...]:
    """Return the joints of what was tried but for one."""
    return tuple(other for other in tried.effect.joints if other != joint)


def _by_joint(
    check: InterleavedCheck,
    lost: _LostMotion,
    proof: BlockPrediction,
    former: Mapping[str, Judged],
    instead: Sequence[Judged],
) -> tuple[Judged, ...]:
    """Return lost motion joint by joint, each by the evidence of all.

    A joint that had lost motion before keeps the rivals and alternatives that it had, but for what
    is judged here: effects of moves, as they compare with lost motion of all, and lost motion of
    other joints, which is known now. Scores are those of the search. Beside lost motion of all
    others, most joints gain so little that what explains nothing would do as well in their place.

    Args:
        check: of the model without any of it.
        lost: lost motion of all the joints.
        proof: how left-out poses are predicted without it and with it.
        former: what was found before, by where it sits.
        instead: effects of moves that lost motion replaces, and what was found beside them.
    """
    found = []
    for effect in lost.effect.of_each:
        never_tried = Judged(effect, proof, alternatives=(), rivals=())
        own = former.get(effect.of, never_tried)
        # With the moves, less this joint's own lost motion.
        others = [each for each in instead if each.effect.of != effect.of]
        nats = check.nats(lost.squares, _squares(check, others))
        rivals = [each for each in own.rivals if not _is_judged_here(each.effect)]
        for move in others:
            if move.effect.of_moves:
                rivals += _with_its_rivals(move, nats)
        alternatives = tuple(e for e in own.alternatives if not _is_judged_here(e))
        found.append(Judged(effect, proof, alternatives, tuple(rivals)))
    return tuple(found)


def _with_its_rivals(move: Judged, nats: Array) -> list[Rival]:
    """Return an effect of moves and its rivals as rivals of lost motion.

    But for lost motion of single joints, which is a part of that.

    Args:
        move: the effect.
        nats: (B,) its score less that of lost motion.
    """
    others = [
        Rival(each.effect, each.by_block(len(nats)) + nats, each.prior_odds)
        for each in move.rivals
        if each.effect.id != Backlash.id
    ]
    return [Rival(move.effect, nats), *others]


def _with_rival(
    check: InterleavedCheck, judged: Sequence[Judged], squares: SquaresByBlock, lost: _LostMotion
) -> tuple[Judged, ...]:
    """Return what stands against lost motion of all joints, with that among its rivals.

    Lost motion of a joint stays a part of that of all, and is no rival of it.

    Args:
        check: of the model without any of it.
        judged: what stands.
        squares: of left-out poses with it.
        lost: what was tried.
    """
    if not lost.effect.joints:
        return tuple(judged)
    rival = Rival(lost.effect, check.nats(squares, lost.squares))
    return tuple(
        each if each.effect in lost.effect.of_each else replace(each, rivals=(*each.rivals, rival))
        for each in judged
    )


def _either(
    check: InterleavedCheck, move: Judged, with_move: SquaresByBlock, lost: _LostMotion
) -> Judged:
    """Return the better of an effect of moves and lost motion, the other its alternative."""
    if with_move.total.sum() <= lost.squares.total.sum():
        (move,) = _with_rival(check, [move], with_move, lost)
        return replace(move, alternatives=(*move.alternatives, lost.effect))
    rivals = _with_its_rivals(move, check.nats(lost.squares, with_move))
    proof = proof_of(check.squares(), lost.squares)
    others = (each for each in move.alternatives if each.id != Backlash.id)
    return Judged(lost.effect, proof, (move.effect, *others), tuple(rivals))
