"""A controller that stops every joint a little short: arrivals, each too small for the search.

The search asks of an effect a part of what remains, lest a small one is named in the place of
another that is missing. Nothing else goes with the way that a joint came, and a controller drives
all joints: what all of them gain together has to be that part, and each has to matter.
"""

from __future__ import annotations

from collections.abc import Sequence

from pa10cal.discovery.blocked_cv.candidate import standard_error, surely_worse
from pa10cal.discovery.blocked_cv.held_poses import FoundAfter, HeldPoses, Squares, proof_of
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_angle import ArrivalError, Backlash
from pa10cal.terms.effects.unnamed import DirectionMap

#: Part of what one gains that positions or attitudes may lose by it.
_MOST_LOST = 0.1


def arrivals(survey: Survey, held: HeldPoses, there: Sequence[Effect]) -> tuple[FoundAfter, ...]:
    """Return the arrival errors beside the effects found that help together.

    Args:
        survey: the campaign.
        held: its poses, predicted by the model found.
        there: the effects found.
    """
    taken = {effect.of for effect in there if by_arrival(effect)}
    chosen = [each for each in ArrivalError.everywhere(survey.context) if each.of not in taken]
    if not chosen:
        return ()
    nothing, every = held.squares(), held.squares(chosen)
    without = {each: _without(held, chosen, each) for each in chosen}
    while unfit := [each for each in chosen if not _stays(held, without[each], every)]:
        worst = min(unfit, key=lambda each: float((without[each].total - every.total).sum()))
        chosen.remove(worst)
        every = held.squares(chosen)
        without = {each: _without(held, chosen, each) for each in chosen}
    if not chosen or not held.helps(nothing, every):
        return ()
    return tuple(
        FoundAfter(each, proof_of(without[each], every), _instead(held, chosen, each, every))
        for each in chosen
    )


def by_arrival(effect: Effect) -> bool:
    """Return whether an effect goes with the way that a joint came."""
    return isinstance(effect, ArrivalError | Backlash | DirectionMap)


def _stays(held: HeldPoses, without: Squares, every: Squares) -> bool:
    """Return whether one matters beside the others, and neither kind loses much of the gain."""
    gains = [before - after for before, after in zip(without.kinds, every.kinds, strict=True)]
    whole = float(sum(gain.sum() for gain in gains))
    contradict = any(
        surely_worse(gain) and float(gain.sum()) < -_MOST_LOST * whole for gain in gains
    )
    return held.matters(without, every) and not contradict


def _without(held: HeldPoses, chosen: Sequence[Effect], one: Effect) -> Squares:
    return held.squares([each for each in chosen if each is not one])


def _instead(
    held: HeldPoses, chosen: Sequence[ArrivalError], one: ArrivalError, every: Squares
) -> tuple[Effect, ...]:
    """Return lost motion of the same joint, where that predicts held-out poses as well."""
    other = Backlash(one.of)
    lost = held.squares([other if each is one else each for each in chosen]).total - every.total
    return (other,) if lost.sum() <= standard_error(lost) else ()
