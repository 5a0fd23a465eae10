"""The search of the blocked cross-validation, run, and what it found, judged.

`found_in`, at the end, does so in order: it searches; adds arrival errors, where a controller stops
joints short; gives error maps a prior variance for each band of frequencies, where that predicts
better; fits the amounts of base motion and of lagging orientations together with the effects. What
precedes it judges: evidence of each effect, its alternatives, the remaining error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydantic import Field
from typing_extensions import override

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array
from pa10cal.discovery.blocked_cv.bands import InBands, in_bands
from pa10cal.discovery.blocked_cv.family import (
    Candidate,
    Columns,
    EffectSet,
    as_good,
    below_detection_limit,
    both_kinds_agree,
    computable_shapes,
    family,
    surely_helps,
    surely_worse,
    within_bounds,
)
from pa10cal.discovery.blocked_cv.refit import Refit, noise_squares, refit, weighted_rows
from pa10cal.discovery.blocked_cv.search import Level, Search, level, refine_maps
from pa10cal.discovery.blocked_cv.survey import BlockedRows, ShapedEffect, Survey
from pa10cal.discovery.finding import Proof, Rival, UnknownBeside, Untestable, carrier_of, over_left
from pa10cal.discovery.linear import (
    by_effects,
    by_own_terms,
    error_mm,
    left_out,
    rms,
    standard_error,
)
from pa10cal.discovery.noise import AS_FOUND
from pa10cal.discovery.preparation import computable, sought
from pa10cal.discovery.rules import BLOCKS, MAPS, PROBABILITIES
from pa10cal.discovery.verdict import smooth_unknown
from pa10cal.observe.order import like_a_scan
from pa10cal.results.discovery import (
    BlockedCrossValidation,
    EvidenceByBlocks,
    Remaining,
    Tried,
    Unexplained,
)
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.arrivals import ArrivalError
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.structure import BaseDrift
from pa10cal.terms.effects.unnamed import DirectionMap


class BlockPrediction(BlockedCrossValidation, Proof):
    """How well held-out blocks are predicted without an effect and with it."""

    # what it takes of the weighed sum of squares over what is left beyond noise; 0 if not known
    over_left: float = Field(default=0.0, exclude=True)

    @property
    @override
    def explains(self) -> float:
        return self.gain

    @property
    @override
    def evidence(self) -> EvidenceByBlocks:
        return EvidenceByBlocks(cross_validation_over_blocks=self)

    @property
    @override
    def unknown(self) -> UnknownBeside:
        errors_mm = self.rms_without_mm, self.rms_with_mm
        return UnknownBeside(*errors_mm, *PROBABILITIES.known_effect, of_readings=self.over_left)


@dataclass(frozen=True)
class Judged:
    """An effect that was found, with what speaks for it."""

    effect: Effect  # as the search has it; maps may be finer in the model
    proof: BlockPrediction  # how well it predicts what was held out
    alternatives: tuple[Effect, ...]  # effects that predict that as well in its place
    rivals: tuple[Rival, ...] = ()  # all that was tried in its place


def prediction(
    gain: Array,
    whole: float,
    rms_mm: tuple[float, float],
    noise: float | None = None,
    carrier: str | None = None,
) -> BlockPrediction:
    """Return how well held-out blocks are predicted without an effect and with it.

    The weighed sum of squares, `whole` without the effect, comes down by the gain of each (B,).
    """
    part, std = float(gain.sum()) / whole, standard_error(gain) / whole
    return BlockPrediction(
        rms_without_mm=rms_mm[0],
        rms_with_mm=rms_mm[1],
        blocks=BLOCKS.blocks,
        improved=int(np.sum(gain > 0.0)),
        gain=part,
        gain_std=std,
        z=part / max(std, np.finfo(float).tiny),
        carrier=carrier,
        over_left=0.0 if noise is None else over_left(whole, (1.0 - part) * whole, noise),
    )


def judged_members(
    rows: BlockedRows, search: Search, chosen: EffectSet, with_rivals: EffectSet
) -> tuple[tuple[Judged, ...], Array]:
    """Return the evidence of each member, and the position errors (P,) [mm] of held-out blocks.

    Alternatives are judged with the rivals there: without them, whatever imitates a rival does as
    well as the member in its place.
    """
    solutions = np.stack(
        [chosen.solution, *(chosen.solution_without(k) for k in range(len(chosen.members)))]
    )
    count = rows.survey.block.size
    errors_mm, squares = np.empty((2, count, len(solutions)))
    for b in range(BLOCKS.blocks):
        x = np.zeros((len(chosen.total.projection), len(solutions)))
        x[chosen.at] = solutions[:, b].T
        here = rows.survey.block == b
        measured, left = rows.survey.poses.measured.take(here), rows.block_residual(b, x)
        errors_mm[here] = np.stack([error_mm(measured, each) for each in left.T.swapaxes(1, 2)], 1)
        whiteners = rows.weights.whiteners(np.flatnonzero(here))
        squares[here] = np.sum((whiteners @ left) ** 2, axis=1)
    rms = np.sqrt(np.mean(errors_mm**2, axis=0))
    others = search.others(with_rivals)
    beside = dict(zip(others, with_rivals.with_each(others), strict=True)) if others else {}
    labels, pose = np.unique(rows.survey.poses.pose, return_inverse=True)
    seen = int(rows.survey.poses.measured.components_seen.sum())
    found = []
    for k, without in enumerate(chosen.without_each()):
        gain = without - chosen.squares
        whole = float(gain.sum())  # with what uncertain weights would have to be
        by_pose = np.bincount(pose, squares[:, k + 1] - squares[:, 0])
        without_each = np.asarray(whole - by_pose, dtype=np.float64)
        carrier = carrier_of(labels, without_each, whole, search.least_gain)
        rms_mm = float(rms[k + 1]), float(rms[0])
        proof = prediction(gain, float(without.sum()), rms_mm, search.noise, carrier)
        member = chosen.members[k]
        place = with_rivals.members.index(member)
        found.append(
            Judged(member.effect, proof, *in_place_of(search, with_rivals, place, beside, seen))
        )
    return tuple(found), errors_mm[:, 0]


def remaining_error(
    rows: BlockedRows, errors_mm: Array, floor_mm: float, others: tuple[Tried, ...]
) -> Remaining:
    """Return the position error of held-out blocks, against noise, and what was tried on it."""
    means = np.array([errors_mm[rows.survey.block == b].mean() for b in range(BLOCKS.blocks)])
    mean_mm, std_mm = (float(errors_mm.mean()), float(means.std(ddof=1) / np.sqrt(BLOCKS.blocks)))
    return Remaining(
        mean_mm=mean_mm,
        std_mm=std_mm,
        rms_mm=rms(errors_mm),
        floor_mm=floor_mm,
        over_floor=over_floor(means, mean_mm, floor_mm),
        tried=others,
    )


def over_floor(means_mm: Array, mean_mm: float, floor_mm: float) -> bool:
    """Return whether blocks of means (B,) have more than noise, however far off one of them is.

    By their mean and its standard error, or by their median and what the median of normal deviates
    scatters by, taken from their median absolute deviation.
    """
    if mean_mm <= BLOCKS.over_floor * floor_mm:
        return False
    root = np.sqrt(len(means_mm))
    middle_mm = float(np.median(means_mm))
    scatter_mm = MEDIAN_TO_SIGMA * float(np.median(np.abs(means_mm - middle_mm)))
    usual_mm = BLOCKS.median_errors * scatter_mm / root
    surely = mean_mm - floor_mm > BLOCKS.over_floor_errors * means_mm.std(ddof=1) / root
    middle = (
        middle_mm > BLOCKS.over_floor * floor_mm
        and middle_mm - floor_mm > BLOCKS.over_floor_errors * usual_mm
    )
    return bool(surely or middle)


def in_place_of(
    search: Search, chosen: EffectSet, member: int, beside: Mapping[Candidate, Array], rows: int
) -> tuple[tuple[Effect, ...], tuple[Rival, ...]]:
    """Return the effects that predict as well in one's place, and how well everything does.

    Within a standard error. One that leaves it needed, by the squares with each other candidate
    `beside` the set, is no alternative; nor is the map of a joint, which can always do what a named
    form of it does. Scores are of so many rows, whose scatter is profiled.
    """
    own = chosen.members[member]
    less = chosen.reduced(member)
    if not beside:
        return (), ()
    variance = max(float(chosen.squares.sum()), search.noise) / rows
    close: dict[tuple[str, str], Effect] = {}
    best: dict[tuple[str, str], Rival] = {}
    for other, alone in zip(beside, less.with_each(tuple(beside)), strict=True):
        nats = 0.5 * (chosen.squares - alone) / variance / PROBABILITIES.blocks
        known = best.get(other.name)
        if known is None or nats.sum() > known.nats.sum():
            # Held-out squares hardly weigh that it can do more than a name, as evidence does.
            flexible = other.effect.generic or (other.is_map and not own.is_map)
            weight = PROBABILITIES.flexible if flexible else 1.0
            best[other.name] = Rival(other.effect, nats, weight)
        own_map = other.is_map and own.effect.coordinates == other.effect.coordinates
        if other.effect.generic or own_map or not as_good(alone, chosen.squares):
            continue
        if not search.helps(alone, beside[other]):
            close.setdefault(other.name, other.effect)
    return tuple(close.values()), tuple(best.values())


def tried(search: Search, chosen: EffectSet) -> tuple[Tried, ...]:
    """Return what each candidate not chosen would still gain."""
    others = search.others(chosen)
    if not others:
        return ()
    found = chosen.with_each(others)
    best: dict[tuple[str, str], Tried] = {}
    whole = float(chosen.squares.sum())
    for other, squares in zip(others, found, strict=True):
        gain = chosen.squares - squares
        helps = search.helps(chosen.squares, squares)
        ahead = chosen.extended(other) if helps else None
        entry = Tried(
            id=other.effect.id,
            of=other.effect.of,
            gain=float(gain.sum()) / whole,
            gain_std=standard_error(gain) / whole,
            helps=helps,
            positions_and_attitudes_agree=ahead and both_kinds_agree(chosen, ahead),
            physical=ahead and within_bounds(ahead),
        )
        known = best.get(other.name)
        if known is None or (entry.helps, entry.gain) > (known.helps, known.gain):
            best[other.name] = entry
    return tuple(sorted(best.values(), key=lambda entry: -entry.gain))


def unexplained(remaining: Remaining, nameless: Sequence[Effect]) -> tuple[Unexplained, ...]:
    """Return what remains without a name; nothing where noise explains it."""
    if not remaining.over_floor:
        return ()
    left_mm, others = remaining.mean_mm, remaining.tried
    helpful: dict[str, Tried] = {}  # the best of each place that helps and was not taken
    for entry in others:
        if entry.helps:
            helpful.setdefault(entry.of, entry)
    places = [smooth_unknown(each, left_mm, "held-out blocks") for each in nameless]
    places += [
        Unexplained(
            of=entry.of,
            form=entry.id,
            shared_error_mm=left_mm,
            why=f"{100 * entry.gain:.0f} % of the remaining error depends on {entry.id} of "
            f"{entry.of}, but {_why_not_taken(entry)}",
        )
        for entry in helpful.values()
    ]
    if places:
        return tuple(places)
    why = (
        f"held-out blocks have a mean error of {left_mm:.3f} mm where noise alone gives "
        f"{remaining.floor_mm:.3f} mm, and nothing that was tried significantly predicts it"
    )
    if others:
        nearest = others[0]
        why += (
            f"; the nearest is {nearest.id} of {nearest.of}, "
            f"({100 * nearest.gain:.1f} ± {100 * nearest.gain_std:.1f}) % of it"
        )
    return (Unexplained(of=None, form=None, shared_error_mm=left_mm, why=why),)


def _why_not_taken(entry: Tried) -> str:
    if entry.physical is False:
        return "with a sign or size that it physically cannot have: it is no effect of that name"
    if entry.positions_and_attitudes_agree is False:
        return "positions and orientations contradict each other: it is no effect of that name"
    return "what was found in its place predicts as much of it"


# Every tenth pose predicted from the others: for what the search's stretches of time hardly see.
#
# What is tried after the search is small, and goes with time or with the way that a joint came.
# Error maps stay as they were fitted: they go with angles.


@dataclass(frozen=True, eq=False)
class Squares:
    """Squared errors of held-out poses, weighed."""

    kinds: Array  # (2, B) of every block, of positions and of all else
    rms_mm: float  # root mean square of the position error

    @property
    def total(self) -> Array:
        """Return the squares of every block, (B,)."""
        return np.asarray(self.kinds.sum(axis=0))


class HoldoutCheck:
    """Every tenth pose held out in turn, about a model whose maps stay."""

    def __init__(self, survey: Survey, found: Refit, least_gain: float) -> None:
        """Take a survey, its model, and the sum of squares by which anything must help at least."""
        self._survey, self._at, self._least_gain = survey, found.at, least_gain
        self._block = np.arange(len(survey.poses)) % BLOCKS.blocks
        self._whiten, self._left = found.weights.whiteners(), -survey.net_residual(found.at)
        terms = found.model.terms
        own = [term for term in terms if not isinstance(term, JointErrorMap | BaseDrift)]
        self._own = by_own_terms(found.at, survey.poses, own, self._whiten)

    def squares(self, effects: Sequence[Effect] = (), *, lag: bool = True) -> Squares:
        """Return what is left of held-out poses with effects beside the model.

        Orientations may lag behind the motion, where the survey has them so, unless told otherwise.
        """
        left, poses, of_lag = self._left, self._survey.poses, self._survey.lag
        starts = [effect.starts[0] for effect in effects]
        added = by_effects(self._at, poses, effects, starts, self._whiten)
        if of_lag is not None and lag:
            added.append(self._whiten @ of_lag.columns(self._at, poses))
        elif of_lag is not None and of_lag.amounts is not None:
            left = left + of_lag.shift(self._survey.baseline, poses)
        columns = np.concatenate([*self._own, *added], axis=2).reshape(left.size, -1)
        data = (self._whiten @ left[:, :, None]).ravel()
        white = left_out(data, columns, np.repeat(self._block, left.shape[1])).reshape(left.shape)
        measured = poses.measured
        of_positions = np.isin(np.arange(left.shape[1]), measured.position_columns)
        kinds = (white[:, kind] ** 2 for kind in (of_positions, ~of_positions))
        left_m = np.asarray(np.linalg.solve(self._whiten, white[:, :, None]), np.float64)[:, :, 0]
        return Squares(
            np.stack([np.bincount(self._block, kind.sum(axis=1), BLOCKS.blocks) for kind in kinds]),
            rms(error_mm(measured, left_m)),
        )

    def helps(self, before: Squares, after: Squares) -> bool:
        """Return whether held-out poses come out enough better, as the search asks of an effect.

        By a part of the squared position errors: weights come from the scatter of residuals, so no
        share of noise is taken off.
        """
        least = BLOCKS.least_share * float(after.kinds[0].sum())
        return surely_helps(before.total - after.total, self._least_gain, least)

    def matters(self, before: Squares, after: Squares) -> bool:
        """Return whether they come out better by more than chance makes of it."""
        return surely_helps(before.total - after.total, self._least_gain)


def proof_of(before: Squares, after: Squares) -> BlockPrediction:
    """Return how well held-out poses are predicted without something and with it."""
    gain = before.total - after.total
    return prediction(gain, float(before.total.sum()), (before.rms_mm, after.rms_mm))


# A base that moved slowly and smoothly while a campaign lasted: too little to be a wander.
#
# A drift is known between poses, and not past a stretch of time, so every tenth pose is held out
# in turn. The search's blocks are stretches of time, which see hardly more of it than a constant
# rate.


def slow_drift(survey: Survey, held: HoldoutCheck, there: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return a slow drift beside the effects found, where it helps."""
    poses = survey.poses
    time_s = poses.states.time_s
    timed = len(np.unique(time_s)) > BLOCKS.own_times_share * len(poses)
    if survey.wander is not None or poses.states.campaign is not None or not timed:
        return ()
    if like_a_scan(poses) or not poses.states.tells_time:
        return ()
    drift = BaseDrift("base", float(time_s.min()), float(time_s.max()), BLOCKS.drift_waves)
    without, with_drift = held.squares(), held.squares([drift])
    if not held.helps(without, with_drift):
        return ()
    in_model = {effect.id for effect in there}
    of_time = (
        each
        for each in sought(survey.context, survey.baseline.model.terms)
        if each.goes_with_time and not each.generic and each.id not in in_model
    )
    logged = survey.torques_logged
    known, _ = computable(of_time, poses.states, logged=logged, weights=True)
    others = (each for each in known if as_good(held.squares([each]).total, with_drift.total))
    return (Judged(drift, proof_of(without, with_drift), tuple(others)),)


# What the search of a survey comes to, fitted; and what is found after it beside that.


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchOutcome:
    """What a survey comes to."""

    survey: Survey  # the campaign, with the motion of its base as these effects leave it
    rows: BlockedRows  # by which it was searched
    # the effects by linear least squares, maps with the finest knots that held-out blocks support
    linear_fit: Level
    # maps with a prior variance for each band of frequencies; None where none predicts better so
    bands: InBands | None = None
    judged: tuple[Judged, ...]  # each of the effects
    nameless: tuple[Effect, ...]  # generic effects that the search chose: not in the model
    tried: tuple[Tried, ...]  # what each candidate not chosen would still gain
    errors_mm: Array  # (P,) position errors of held-out blocks
    hidden: tuple[Untestable, ...]  # effects that these data cannot show
    below_detection_limit: tuple[Untestable, ...]
    candidates: int  # how many effects were tried
    least_gain: float  # sum of squares by which one must help at least

    @cached_property
    def extended(self) -> Refit:
        """Return the model with the effects, fitted."""
        effects = tuple(member.effect for member in self.linear_fit.members)
        _, amounts = self.linear_fit.fit()
        widening = AS_FOUND if self.bands is None else self.bands.widening
        return refit(self.survey, effects, amounts, self.rows.weights, widening)

    @property
    def holdout_check(self) -> HoldoutCheck:
        """Return every tenth pose, predicted by the model and weighed as its fit weighs them."""
        return HoldoutCheck(self.survey, self.extended, self.least_gain)


def found_in(survey: Survey) -> SearchOutcome:
    """Search a survey."""
    shaped, unknown = computable_shapes(survey)
    found = _searched(weighted_rows(survey, shaped, MAPS.spacings[-1][0]))
    found = _with_nuisance_amounts(replace(found, hidden=(*unknown, *found.hidden)))
    if survey.context.commanded:
        added = arrivals(survey, found.holdout_check, found.extended.effects)
        found = with_effects_added(found, added)
    bands = in_bands(found.rows, found.linear_fit)
    if bands is not None:
        found = replace(found, linear_fit=bands.level, bands=bands)
    found = _with_nuisance_amounts(found)
    held = found.holdout_check if survey.lag is not None else None
    if held is not None and not held.helps(held.squares(lag=False), held.squares()):
        found = replace(found, survey=replace(found.survey, lag=None))
    return found


def _searched(rows: BlockedRows) -> SearchOutcome:
    """Search, and judge what was found."""
    products = rows.products()
    known = family(rows, products)
    noise = noise_squares(rows, rows.survey.noise_about(rows.operating_point))
    error_rate = rows.survey.setup.options.error_rate
    search = Search(
        products,
        Columns(rows.baseline_columns, rows.baseline_sizes),
        known.shown,
        noise,
        error_rate,
        rows.survey.begins_with,
    )
    chosen = search.run()
    others = tried(search, chosen)
    with_rivals = chosen
    nameless = tuple(member.effect for member in chosen.members if member.effect.generic)
    for k in reversed(range(len(chosen.members))):
        if chosen.members[k].effect.generic:  # rivals are not in the model
            chosen = chosen.reduced(k)
    judged, errors_mm = judged_members(rows, search, chosen, with_rivals)
    members, effects, least_gain = chosen.members, search.effects, search.least_gain
    below = below_detection_limit(known, search.is_surely_found)
    del products, search, chosen, with_rivals  # they are large
    return SearchOutcome(
        survey=rows.survey,
        rows=rows,
        linear_fit=refine_maps(rows, members),
        judged=judged,
        nameless=nameless,
        tried=others,
        errors_mm=errors_mm,
        hidden=known.hidden,
        below_detection_limit=below,
        candidates=effects,
        least_gain=least_gain,
    )


def _with_nuisance_amounts(found: SearchOutcome) -> SearchOutcome:
    """Return what was found, with amounts of base motion and lag as fitted with the effects."""
    beside = sum(len(each.sizes) for each in found.survey.nuisances)
    if not beside:
        return found
    own, _ = found.linear_fit.fit()
    return replace(found, survey=found.survey.with_amounts(own[len(own) - beside :]))


def with_effects_added(found: SearchOutcome, more: Sequence[Judged]) -> SearchOutcome:
    """Return what was found with more effects; each takes the place of one of its id and place."""
    if not more:
        return found
    names = {(each.effect.id, each.effect.of) for each in more}
    stays = [k for k, each in enumerate(found.linear_fit.members) if each.name not in names]
    places = {each.effect.of for each in more if by_arrival(each.effect)}
    none = np.zeros(0, np.intp), np.zeros(0)
    members = (
        *(found.linear_fit.members[k] for k in stays),
        *(Candidate(*none, ShapedEffect(each.effect)) for each in more),
    )
    shaped = tuple(each.shaped for each in members if not each.is_map)
    in_time = any(each.effect.goes_with_time for each in more)
    return replace(
        found,
        judged=(*(found.judged[k] for k in stays), *more),
        # The same motion is not told twice.
        nameless=tuple(each for each in found.nameless if not (in_time and each.goes_with_time)),
        # Nor is what was tried in vain in the search, and helped after it, in any form.
        tried=tuple(
            each
            for each in found.tried
            if (each.id, each.of) not in names and not (by_arrival(each) and each.of in places)
        ),
        linear_fit=level(replace(found.rows, shaped=shaped), members),
    )


# A controller that stops every joint a little short: arrivals, each too small for the search.
#
# The search asks of an effect a part of what remains, lest a small one is named in the place of
# another that is missing. Nothing else goes with the way that a joint came, and a controller
# drives all joints: what all of them gain together has to be that part, and each has to matter.


def arrivals(survey: Survey, held: HoldoutCheck, there: Sequence[Effect]) -> tuple[Judged, ...]:
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


def _stays(held: HoldoutCheck, without: Squares, every: Squares) -> bool:
    """Return whether one matters beside the others, and neither kind loses much of the gain."""
    gains = without.kinds - every.kinds
    most_lost = -BLOCKS.most_lost_share * float(gains.sum())
    contradict = any(surely_worse(gain) and float(gain.sum()) < most_lost for gain in gains)
    return held.matters(without, every) and not contradict


def _without(held: HoldoutCheck, chosen: Sequence[Effect], one: Effect) -> Squares:
    return held.squares([each for each in chosen if each is not one])


def _instead(
    held: HoldoutCheck, chosen: Sequence[ArrivalError], one: ArrivalError, every: Squares
) -> tuple[Effect, ...]:
    """Return lost motion of the same joint, where that predicts held-out poses as well."""
    other = Backlash(one.of)
    instead = held.squares([other if each is one else each for each in chosen])
    return (other,) if as_good(instead.total, every.total) else ()
