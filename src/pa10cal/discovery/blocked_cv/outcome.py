"""The search of a survey, its judged effects, and what is fitted together with these.

`search_survey` does so in order: it searches; adds arrival errors, if a controller stops joints
short; gives maps a prior variance for each band of frequencies, if that predicts better; fits the
amounts of base motion and of lagging orientations together with the effects. `search_with_motion`
repeats that with lines of gears, wobbling axes, and motion in time that its residuals show.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pa10cal.discovery.blocked_cv.bands import InBands, in_bands
from pa10cal.discovery.blocked_cv.block_rows import (
    BlockedRows,
    ShapedEffect,
    noise_squares,
    weighted_rows,
)
from pa10cal.discovery.blocked_cv.effect_set import Columns
from pa10cal.discovery.blocked_cv.family import below_detection_limit, computable_shapes, family
from pa10cal.discovery.blocked_cv.interleaved_check import (
    InterleavedCheck,
    arrivals,
    by_arrival,
    slow_drift,
    steady_courses,
)
from pa10cal.discovery.blocked_cv.judge import Judged, gains_of_others, judged_members
from pa10cal.discovery.blocked_cv.linear_fit import (
    HeldOut,
    LinearFit,
    held_out,
    linear_fit,
    refine_maps,
)
from pa10cal.discovery.blocked_cv.lost_motion import lost_motion_instead, stand_for_lost_motion
from pa10cal.discovery.blocked_cv.refit import Refit, refit
from pa10cal.discovery.blocked_cv.search import Search
from pa10cal.discovery.blocked_cv.survey import LEAST_FOR_BLOCKS, Survey, interleaved_blocks
from pa10cal.discovery.changed import NO_OTHER_CAUSES, Change, OtherCauses, change_of, other_causes
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.gear_lines import gear_lines
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.joint_steps import JointSteps, joint_steps_of
from pa10cal.discovery.nuisances import NO_MOTION, TimeFindings
from pa10cal.discovery.pose_scatter import AS_FOUND, PoseWeights, weights_with_joints
from pa10cal.discovery.preparation import sought
from pa10cal.discovery.rules import LINES, MAPS
from pa10cal.discovery.target_wander import target_wander
from pa10cal.discovery.warm_ups import warm_ups_shown
from pa10cal.discovery.wobbles import wobbles
from pa10cal.observe.points import keep_their_distances
from pa10cal.results.discovery import Tried
from pa10cal.terms.effects.effect import Effect, is_effect
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.structure import AxisWobble


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchOutcome:
    """What the search of a survey found."""

    survey: Survey  # the campaign, its nuisances fitted together with these effects
    rows: BlockedRows  # by which it was searched
    linear_fit: LinearFit  # of the effects, maps as fine as held-out blocks support
    # maps with a prior variance for each band of frequencies; None where none predicts better so
    bands: InBands | None = None
    judged: tuple[Judged, ...]  # each of the effects
    nameless: tuple[Effect, ...]  # generic effects that the search chose: not in the model
    tried: tuple[Tried, ...]  # what each candidate that was not chosen would still gain
    held_out: HeldOut  # position errors of poses, by a model with these effects
    hidden: tuple[Untestable, ...]  # effects that these data cannot show
    below_detection_limit: tuple[Untestable, ...]
    candidates: int  # how many effects were tried
    least_gain: float  # sum of squares by which an effect must help at least

    @cached_property
    def extended(self) -> Refit:
        """Return the model with the effects, fitted."""
        effects = tuple(member.effect for member in self.linear_fit.members)
        widening = AS_FOUND if self.bands is None else self.bands.widening
        starts = self.linear_fit.effect_parameters
        return refit(self.survey, effects, starts, self.rows.weights, widening)

    @cached_property
    def weights_with_joints(self) -> PoseWeights:
        """Return weights of poses about the fitted model, in which joints scatter, too."""
        survey, fitted = self.rows.survey, self.extended
        residual = survey.net_residual(fitted.at)
        return weights_with_joints(fitted.weights, fitted.at, survey.poses, residual)

    @property
    def interleaved_check(self) -> InterleavedCheck:
        """Return the check by every tenth pose, about the fitted model and with its weights."""
        return InterleavedCheck(self.survey, self.extended, self.least_gain)


def search_survey(survey: Survey) -> SearchOutcome:
    """Search a survey, and fit what was found."""
    shaped, unknown = computable_shapes(survey)
    found = _searched(weighted_rows(survey, shaped, MAPS.spacings[-1][0]))
    found = _with_nuisance_amounts(replace(found, hidden=(*unknown, *found.hidden)))
    if survey.context.commanded:
        check = found.interleaved_check
        added = arrivals(survey, check, found.extended.effects)
        found = with_effects_added(found, added)
        found = _without_idle_lag(found, check, [each.effect for each in added])
    elif stand_ins := stand_for_lost_motion(found.judged):
        rest = _without_effects(found, stand_ins)
        moves = [e.effect for e in found.rows.shaped if e.effect.of_moves]
        instead = lost_motion_instead(survey.context, rest.interleaved_check, stand_ins, moves)
        found = found if instead == stand_ins else with_effects_added(rest, instead)
    bands = in_bands(found.rows, found.linear_fit)
    if bands is not None:
        found = replace(found, linear_fit=bands.fit, bands=bands)
    found = _with_nuisance_amounts(found)
    if survey.lag is not None and not survey.context.commanded:
        found = _without_idle_lag(found, found.interleaved_check)
    return found


def _without_idle_lag(
    found: SearchOutcome, check: InterleavedCheck, added: Sequence[Effect] = ()
) -> SearchOutcome:
    """Return the outcome without a lag of orientations by which left-out poses gain too little.

    Args:
        found: the outcome.
        check: of a model with the lag, less the effects that were added since.
        added: these.
    """
    if found.survey.lag is None:
        return found
    if check.gains_a_share(check.squares(added, lag=False), check.squares(added)):
        return found
    return replace(found, survey=replace(found.survey, lag=None))


def _searched(rows: BlockedRows) -> SearchOutcome:
    """Search among the candidates of weighted rows, and judge what was found."""
    equations = rows.normal_equations()
    known = family(rows, equations)
    search = Search(
        equations,
        Columns(rows.baseline_columns, rows.baseline_sizes),
        known.shown,
        noise_squares(rows, rows.survey.noise_about(rows.operating_point)),
        rows.survey.setup.options.error_rate,
        rows.survey.begins_with,
    )
    with_rivals = search.run()
    others = gains_of_others(search, with_rivals)
    nameless = tuple(each.effect for each in with_rivals.members if each.effect.generic)
    chosen = with_rivals
    for k in reversed(range(len(with_rivals.members))):
        if with_rivals.members[k].effect.generic:  # rivals are not in the model
            chosen = chosen.without_member(k)
    judged, errors_mm = judged_members(rows, search, chosen, with_rivals)
    errors = HeldOut.of(rows.survey, errors_mm, chosen.squares_of_estimates)
    members = tuple(member.shaped for member in chosen.members)
    effect_count, least_gain = search.effect_count, search.least_gain
    below = below_detection_limit(known, search.is_surely_found)
    del equations, search, chosen, with_rivals  # they are large
    return SearchOutcome(
        survey=rows.survey,
        rows=rows,
        linear_fit=refine_maps(rows, members),
        judged=judged,
        nameless=nameless,
        tried=others,
        held_out=errors,
        hidden=known.hidden,
        below_detection_limit=below,
        candidates=effect_count,
        least_gain=least_gain,
    )


def _with_nuisance_amounts(found: SearchOutcome) -> SearchOutcome:
    """Return the outcome with the nuisances as fitted together with the effects."""
    count = found.survey.nuisance_count
    if not count:
        return found
    amounts = found.linear_fit.model_amounts
    return replace(found, survey=found.survey.with_amounts(amounts[len(amounts) - count :]))


def _without_effects(found: SearchOutcome, removed: Sequence[Judged]) -> SearchOutcome:
    """Return the outcome without some of its effects."""
    kept = [k for k, each in enumerate(found.judged) if each not in removed]
    members = tuple(found.linear_fit.members[k] for k in kept)
    judged = tuple(found.judged[k] for k in kept)
    return replace(found, judged=judged, linear_fit=linear_fit(found.rows, members))


def with_effects_added(found: SearchOutcome, added: Sequence[Judged]) -> SearchOutcome:
    """Return the outcome with more effects; each replaces one of the same name that was found.

    What held-out poses are off is that of the model with them.
    """
    if not added:
        return found
    names = {(each.effect.id, each.effect.of) for each in added}
    places = {place for each in added for place in _places_of_arrival(each.effect)}
    in_time = any(each.effect.depends_on for each in added)
    kept = [k for k, each in enumerate(found.linear_fit.members) if each.name not in names]
    members = (
        *(found.linear_fit.members[k] for k in kept),
        *(ShapedEffect(each.effect) for each in added),
    )

    def is_still_tried(each: Tried) -> bool:
        """Return whether it is no form of what was added: that was tried in vain, and helped."""
        return (each.id, each.of) not in names and not (by_arrival(each) and each.of in places)

    def is_still_nameless(each: Effect) -> bool:
        """Return whether nothing that was added is the cause of a generic effect."""
        of_arrival = by_arrival(each) and each.of in places
        return not (of_arrival or (in_time and each.depends_on))

    rows = found.rows.with_effects_of(members)
    fit = linear_fit(rows, members)
    if in_time:  # stretches of time that are left out hardly show it
        interleaved = replace(rows.survey, block=interleaved_blocks(len(rows.survey.poses)))
        rows = replace(rows, survey=interleaved)
    return replace(
        found,
        judged=(*(found.judged[k] for k in kept), *added),
        nameless=tuple(filter(is_still_nameless, found.nameless)),
        tried=tuple(filter(is_still_tried, found.tried)),
        linear_fit=fit,
        held_out=held_out(rows, fit),
    )


def _places_of_arrival(effect: Effect) -> Collection[str]:
    """Return the joints, such as `joint 2`, that arrive elsewhere by an effect."""
    return [f"joint {joint}" for joint in effect.arriving]


class SearchWithMotion(NamedTuple):
    """The outcome of a search that knows of motion in time."""

    outcome: SearchOutcome
    in_time: TimeFindings  # what the residuals of the search without motion show of time
    causes: OtherCauses  # what else explains its jumps


def search_with_motion(survey: Survey) -> SearchWithMotion:
    """Search a survey, again with what moved or changed in time, then for a slow drift.

    For the latter not where readings of single targets wander as much, each by itself. Neither in
    fewer poses than suffice whatever the instrument: where an arm lacks much, 76 poses of a
    measured one on a rail showed a step of the base that all 233 do not.
    """
    searched = _with_warm_ups(_with_lines_and_wobbles(survey))
    if len(survey.poses) < LEAST_FOR_BLOCKS:
        return SearchWithMotion(searched, NO_MOTION, NO_OTHER_CAUSES)
    found = _with_steady_course(searched, _with_motion_shown(searched))
    outcome, of_targets = found.outcome, found.in_time.of_targets
    survey, at = outcome.survey, outcome.extended.at
    if of_targets is None and survey.wander is None:
        of_targets = target_wander(at, survey.poses, survey.net_residual(at))
    if of_targets is not None:
        return found._replace(in_time=replace(found.in_time, of_targets=of_targets))
    drift = slow_drift(survey, outcome.interleaved_check, outcome.extended.effects)
    return found._replace(outcome=with_effects_added(outcome, drift))


def _with_motion_shown(found: SearchOutcome) -> SearchWithMotion:
    """Search again with changes at rows, else with a base that moved, where residuals show any."""
    survey, fitted = found.rows.survey, found.extended  # the survey begins with what was added
    poses, logged = survey.poses, survey.torques_logged
    whiteners = found.weights_with_joints.whiteners()
    effects = tuple(sought(survey.context, survey.baseline.model.terms))
    change: Change | JointSteps | None = joint_steps_of(
        fitted.at, poses, whiteners, fitted.weights.whiteners(), effects, logged=logged
    ) or change_of(fitted.at, poses, whiteners, effects, logged=logged)
    if change is not None:
        return SearchWithMotion(search_survey(survey.changing(change)), NO_MOTION, NO_OTHER_CAUSES)
    # An effect of time that was found is one explanation among those of a base that moved.
    others = (
        term
        for term in fitted.model.terms
        if not (is_effect(term) and term.depends_on) or term in survey.begins_with
    )
    still = replace(fitted.at, covariance=None).only(*others)
    in_time = in_time_of(still, poses, whiteners, effects, logged=logged, weights=True)
    if in_time.wander is None:
        return SearchWithMotion(found, in_time, NO_OTHER_CAUSES)
    causes = other_causes(in_time.wander, still, poses, whiteners, logged=logged)
    return SearchWithMotion(search_survey(survey.moving(in_time.wander)), in_time, causes)


def _with_steady_course(searched: SearchOutcome, found: SearchWithMotion) -> SearchWithMotion:
    """Search again with a steady drift or with growth, where that leaves no other motion in time.

    Not where something changed or moved at once. A walk takes up what is steady as well, with far
    more parameters, and stretches of time that are left out may hide it.
    """
    moved, of_targets = found.outcome.survey, found.in_time.of_targets
    at_once = moved.change is not None or (moved.wander is not None and moved.wander.jumps)
    if at_once or of_targets is not None:
        return found
    survey, fitted = searched.rows.survey, searched.extended
    check, moves = searched.interleaved_check, found.outcome is not searched
    for effect in steady_courses(searched.survey, check, fitted.effects, moves=moves):
        ahead = search_survey(survey.settling((effect,)))
        if effect in ahead.extended.effects:
            with_effect = _with_motion_shown(ahead)
            if with_effect.outcome is ahead:
                return with_effect
    return found


def _with_lines_and_wobbles(survey: Survey) -> SearchOutcome:
    """Search a survey, again with the lines of gears and wobbling axes that its residuals show.

    As long as the search keeps some of what it begins with.
    """
    found = search_survey(survey)
    tried: list[Effect] = []
    for _ in range(LINES.most_rounds):
        shown, added = _lines_and_wobbles(found, tried)
        if not shown:
            break
        tried += shown
        if not added:
            continue
        begins_with = (*survey.begins_with, *added)
        baseline = survey.baseline.bending_as(added)
        longer = replace(survey, baseline=baseline, begins_with=begins_with)
        ahead = search_survey(longer)
        if not {*added} & {*ahead.extended.effects}:
            break
        survey, found = longer, ahead
    return found


def _with_warm_ups(found: SearchOutcome) -> SearchOutcome:
    """Search again with joints and links that warm up, where the residuals show any.

    In interleaved blocks: a block of the first poses would be predicted from all that came later.
    """
    survey, fitted = found.rows.survey, found.extended
    weights = found.weights_with_joints
    # Of readings that are right nothing is taken away.
    right = keep_their_distances(survey.poses.measured)
    weights = replace(weights, weight=np.where(right, 1.0, weights.weight))
    rows = survey.whitened(fitted.at, weights.whiteners())
    shown = warm_ups_shown(rows, survey.context, logged=survey.torques_logged)
    if not shown:
        return found
    ahead = search_survey(survey.settling(shown))
    return ahead if {*shown} & {*ahead.extended.effects} else found


def _lines_and_wobbles(
    found: SearchOutcome, tried: Sequence[Effect]
) -> tuple[Sequence[Effect], Sequence[Effect]]:
    """Return the lines of gears, and the axis that wobbles most, in the residuals of a search.

    At joints where none was tried. Then those of them by which left-out poses gain, so that another
    search may keep them. A line in what a map of its joint predicts may take its place, unless the
    errors of joints fill a band: that only a search can tell.
    """
    survey, fitted = found.rows.survey, found.extended
    places = {
        kind: [each.of for each in (*survey.begins_with, *tried) if each.id == kind]
        for kind in (GearLine.id, AxisWobble.id)
    }
    setup, rate = survey.setup, survey.setup.options.error_rate
    rows = survey.whitened(fitted.at, fitted.weights.whiteners())
    lines = gear_lines(rows, rate, places[GearLine.id])
    axes = wobbles(rows, survey.context, setup.payload, rate, places[AxisWobble.id])
    if not (lines or axes):
        return (), ()
    bent = replace(fitted, at=fitted.at.bending_as((*lines, *axes)))
    check = InterleavedCheck(survey, bent, found.least_gain)
    without = check.squares()

    def gains(added: Effect) -> bool:
        return check.gains_a_share(without, check.squares([added]))

    follows = {each.of: each.highest_order for each in fitted.effects if is_error_map(each)}
    mapped = [each for each in lines if each.order < follows.get(each.of, 0)]
    others = [each for each in (*lines, *axes) if each not in mapped]
    in_map = mapped if found.bands is None else []
    return (*lines, *axes), (*in_map, *filter(gains, others))
