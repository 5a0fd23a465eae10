"""What the search of a survey comes to, fitted; and what is found after it beside that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.bands import InBands, in_bands
from pa10cal.discovery.blocked_cv.family import (
    SPACINGS,
    Candidate,
    below_detection_limit,
    family,
    surely_worse,
)
from pa10cal.discovery.blocked_cv.judge import (
    HeldPoses,
    Judged,
    Squares,
    judged_members,
    proof_of,
    tried,
    without_rivals,
)
from pa10cal.discovery.blocked_cv.refit import Refit, noise_squares, refit, weighted_rows
from pa10cal.discovery.blocked_cv.search import Level, Search, Step, finest, level
from pa10cal.discovery.blocked_cv.survey import Rows, ShapedEffect, Survey
from pa10cal.discovery.finding import NotTestable
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.noise import AS_FOUND, noise_of_near_poses, with_torque_noise
from pa10cal.results.discovery import Tried
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_angle import ArrivalError, Backlash
from pa10cal.terms.effects.unnamed import DirectionMap


@dataclass(frozen=True, eq=False)
class Found:
    """What a survey comes to."""

    survey: Survey  # the campaign, with the motion of its base as these effects leave it
    rows: Rows  # by which it was searched
    searched: Searched  # what the search found
    fine: Level  # the effects, by linear least squares
    finer_steps: tuple[Step, ...]  # steps to finer maps
    bands: InBands | None = None  # of maps that have one; None where none has

    @cached_property
    def extended(self) -> Refit:
        """Return the model with the effects, fitted."""
        effects = tuple(member.effect for member in self.fine.members)
        _, amounts = self.fine.fit()
        widening = AS_FOUND if self.bands is None else self.bands.widening
        return refit(self.survey, effects, amounts, self.rows.weights, widening)

    @property
    def held_poses(self) -> HeldPoses:
        """Return every tenth pose, predicted by the model and weighed as its fit weighs them."""
        return HeldPoses(self.survey, self.extended, self.searched.least_gain)


def found_in(judged: Survey, shaped: tuple[ShapedEffect, ...]) -> Found:
    """Search a survey."""
    rows = weighted_rows(judged, shaped, SPACINGS[-1][0])
    searched, members = searched_rows(rows)
    found = _settled(Found(judged, rows, searched, *finest(rows, members)))
    if judged.context.commanded:
        found = with_more(found, arrivals(judged, found.held_poses, found.extended.effects))
    found = _settled(_with_bands(found))
    held = found.held_poses if judged.lag is not None else None
    if held is not None and not held.helps(held.squares(lag=False), held.squares()):
        found = replace(found, survey=replace(found.survey, lag=None))
    return found


def _with_bands(found: Found) -> Found:
    """Return what was found with maps in the bands that the data have, where they have some."""
    bands = in_bands(found.rows, found.fine)
    if bands is None:
        return found
    before, after = bands.of_time.T
    step = Step(bands.level.members, found.fine.squares * after / before)
    steps = (*found.finer_steps, step)
    return replace(found, fine=bands.level, finer_steps=steps, bands=bands)


def _settled(found: Found) -> Found:
    """Return what was found, what its survey has beside the model as these effects leave it."""
    beside = sum(len(each.sizes) for each in found.survey.nuisances)
    if not beside:
        return found
    own, _ = found.fine.fit()
    return replace(found, survey=found.survey.with_amounts(own[len(own) - beside :]))


def with_more(found: Found, more: Sequence[Judged]) -> Found:
    """Return what was found with effects beside it; a slow drift takes the place of a constant."""
    if not more:
        return found
    searched, names = found.searched, {(each.effect.id, each.effect.of) for each in more}
    stays = [k for k, each in enumerate(found.fine.members) if each.name not in names]
    places = {each.effect.of for each in more if by_arrival(each.effect)}
    none = np.zeros(0, np.intp), np.zeros(0)
    members = (
        *(found.fine.members[k] for k in stays),
        *(Candidate(*none, ShapedEffect(each.effect)) for each in more),
    )
    shaped = tuple(each.shaped for each in members if not each.is_map)
    fine = level(replace(found.rows, shaped=shaped), members)
    in_time = any(each.effect.goes_with_time for each in more)
    return replace(
        found,
        searched=replace(
            searched,
            judged=(*(searched.judged[k] for k in stays), *more),
            # The same motion is not told twice.
            nameless=tuple(
                each for each in searched.nameless if not (in_time and each.goes_with_time)
            ),
            # Nor is what was tried in vain in the search, and helped after it, in any form.
            tried=tuple(
                each
                for each in searched.tried
                if (each.id, each.of) not in names and not (by_arrival(each) and each.of in places)
            ),
        ),
        fine=fine,
        finer_steps=(*found.finer_steps, Step(members, fine.squares)),
    )


# A controller that stops every joint a little short: arrivals, each too small for the search.
#
# The search asks of an effect a part of what remains, lest a small one is named in the place of
# another that is missing. Nothing else goes with the way that a joint came, and a controller
# drives all joints: what all of them gain together has to be that part, and each has to matter.

#: Part of what one gains that positions or orientations may lose by it.
_MOST_LOST = 0.1


def arrivals(survey: Survey, held: HeldPoses, there: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return the arrival errors beside the effects found that help together."""
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
        Judged(each, proof_of(without[each], every), _instead(held, chosen, each, every))
        for each in chosen
    )


def by_arrival(effect: Effect | EffectName) -> bool:
    """Return whether an effect goes with the way that a joint came."""
    return effect.id in (ArrivalError.id, Backlash.id, DirectionMap.id)


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


# A search by held-out blocks, and what is known of everything it found.


@dataclass(frozen=True, eq=False)
class Searched:
    """What the search found, without its products, which are large."""

    judged: tuple[Judged, ...]
    nameless: tuple[Effect, ...]
    tried: tuple[Tried, ...]
    errors_mm: Array
    hidden: tuple[NotTestable, ...]
    below_detection_limit: tuple[NotTestable, ...]
    steps: tuple[Step, ...]
    candidates: int
    least_gain: float


def searched_rows(rows: Rows) -> tuple[Searched, tuple[Candidate, ...]]:
    """Search, and judge what was found: return it, and the members of the search."""
    products = rows.products()
    known = family(rows, products)
    poses = rows.survey.poses
    of_readings = noise_of_near_poses(poses, rows.survey.left_by(rows.place))
    if rows.survey.torques_logged:
        payload = rows.survey.setup.payload
        of_readings = with_torque_noise(of_readings, rows.place, poses, payload)
    noise = noise_squares(rows, of_readings)
    error_rate = rows.survey.setup.options.error_rate
    search = Search(products, rows.own, known.shown, noise, error_rate, rows.own_sizes)
    chosen = search.run()
    others = tried(search, chosen)
    nameless = tuple(member.effect for member in chosen.members if member.effect.generic)
    chosen = without_rivals(chosen)
    judged, errors_mm = judged_members(rows, search, chosen)
    found = Searched(
        judged=judged,
        nameless=nameless,
        tried=others,
        errors_mm=errors_mm,
        hidden=known.hidden,
        below_detection_limit=below_detection_limit(known, search.is_surely_found),
        steps=tuple(search.steps),
        candidates=search.effects,
        least_gain=search.least_gain,
    )
    return found, chosen.members
