"""The verdict by the evidence of repeats: from single readings to an extended model.

The campaign is prepared with the noise of its repeats, without motion in time if there is any
(`_with_time`), the set of effects of the greatest evidence is sought and judged, and the scorer of
the verdict (`ByRepeats`) fits the model again with other effects. Given effects are fitted
under the same noise models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.calibration.two_level_fit import check_torques
from pa10cal.discovery import preparation
from pa10cal.discovery.changed import load_between_repeats, other_causes
from pa10cal.discovery.evidence.candidates import split_testable
from pa10cal.discovery.evidence.channel_tests import channel_tests, evidence_lack_of_fit
from pa10cal.discovery.evidence.confirmation import WhitenedRows, whitened_rows
from pa10cal.discovery.evidence.fit import (
    EvidenceFit,
    covariance_of,
    fit,
    targets_off_m,
)
from pa10cal.discovery.evidence.judge import (
    Judgement,
    judge,
    noise_floor_mm,
    noise_floor_of_mm,
    shared_error_mm,
)
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR, SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem, prepare
from pa10cal.discovery.evidence.search import (
    EndOfSearch,
    evidence_about,
    refit,
    resized,
    search_with_errors_of_joints,
)
from pa10cal.discovery.finding import Finding, Untestable
from pa10cal.discovery.gap import PairedErrors, errors_of, gap
from pa10cal.discovery.gross_errors import moved_between_repeats
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.joint_steps import JointSteps, joint_steps_of, likely_joint_steps
from pa10cal.discovery.next_poses import separating_poses, unresolved_pairs
from pa10cal.discovery.nuisances import TimeFindings, motion_unexplained
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.short_forms import FormComparison
from pa10cal.discovery.target_wander import in_words
from pa10cal.discovery.verdict import Plan, Scorer, Verdict
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.time_order import spread_over_time
from pa10cal.results.analysis import LackOfFit, PureErrorTest
from pa10cal.results.discovery import SearchByRepeats, SharedError
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.forms.form import Form
from pa10cal.terms.offsets import motion_of_base
from pa10cal.terms.statement_faults import is_fault
from pa10cal.terms.term import shows_torque

#: Times by which averaged poses differ less than this are the same [s] (computing).
_SAME_TIME_S = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class ByRepeats(Scorer):
    """Judges effects by the evidence that the scatter of repeated poses allows."""

    problem: EvidenceProblem  # the campaign, with noise and weights about the extended model
    start: EvidenceFit  # the baseline, fitted under the same noise models
    judgement: Judgement  # of the effects that the search ended with
    extended: EvidenceFit  # the model with the named effects alone

    method: ClassVar[str] = "evidence of repeats"

    @property
    @override
    def searched_from(self) -> FittedModel:
        return self.problem.baseline

    @property
    @override
    def torque_test(self) -> PureErrorTest | None:
        _, of_torques = channel_tests(self.problem, self.extended)
        if of_torques is None or not self.problem.torques_logged:
            return None
        return of_torques.pure_error

    @property
    @override
    def searched(self) -> tuple[Effect, ...]:
        return self.judgement.ended.fit.effects

    @override
    def targets_off_m(self, stated: int) -> Array:
        del stated  # their number is that of the problem's targets
        return targets_off_m(self.problem, self.extended)

    @override
    def judged_states(self, fitted: Observations) -> PoseStates:
        del fitted  # cells were judged, which are finer than averages
        return self.judgement.ended.problem.cells.states

    @override
    def refitted(self, effects: tuple[Effect, ...], known: Sequence[Finding]) -> ByRepeats:
        # From the end of the search, which has generic effects besides: under the variances of the
        # errors that poses share there, fits with other effects compare with each other.
        ended, size = self.judgement.ended, self.extended.size_of
        for finding in known:
            for other in finding.alternatives:
                size.setdefault(other, size[finding.effect])
        sizes = tuple(size[effect] for effect in effects)
        extended = fit(self.problem, effects, sizes, ended.score.variances, ended.fit)
        return replace(self, extended=extended, covariance=covariance_of(self.problem, extended))

    @override
    def fitted_poses(self, campaign: preparation.Prepared) -> Observations:
        return average_repeats(campaign.trusted)

    @override
    def gap_on(self, poses: Observations, before: PairedErrors | None = None) -> PairedErrors:
        problem, searched = self.problem, self.judgement.ended.fit
        poses = preparation.complete(poses, problem.baseline, problem.setup, self.extended.at)
        floor, after = noise_floor_of_mm(problem, poses.readings), _exported(problem, self.extended)
        T_moved = self._base_motion(poses.states.time_s)
        errors = gap(poses, problem.baseline, after, floor, T_moved=T_moved)
        if not any(effect.generic for effect in searched.effects):
            return errors
        # The model at the end of the search has generic effects, too.
        poses = preparation.complete(poses, problem.baseline, problem.setup, searched.at)
        return replace(errors, with_rivals=errors_of(_exported(problem, searched), poses))

    def _base_motion(self, times_s: Array) -> Array | None:
        """Return the motion of the base at averaged poses (P, 4, 4), by their times; None at rest.

        Poses of the fit are averages: their motion is the mean of those of the readings.
        """
        single_s, wander = self.problem.readings.states.time_s, self.problem.in_time.wander
        if wander is None:
            return None
        group = reading_groups(self.problem.readings)
        fitted_s = group_means(single_s, group)
        # No relative tolerance: times may count from 1970.
        of_fit = len(fitted_s) == len(times_s) and np.allclose(
            fitted_s, times_s, rtol=0.0, atol=_SAME_TIME_S
        )
        if of_fit:
            return motion_of_base(group_means(wander.motions(single_s), group))
        return motion_of_base(wander.motions(times_s))

    @override
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        # From the extended model, of which this is a part: so what an effect adds is what changes.
        problem, extended = self.problem, self.extended
        sizes = tuple(extended.size_of[effect] for effect in effects)
        return _exported(problem, fit(problem, effects, sizes, extended.variances, extended))

    @override
    def comparison(self, held: Sequence[Effect], most_poses: int | None = None) -> FormComparison:
        del most_poses  # of repeated poses there are few
        ended = _uncached(self.judgement.ended)
        if not held:
            ended = _without_shared_error_of_poses(ended)
        rows = whitened_rows(ended.problem, ended, ())
        at_held = _columns_of_members(rows, [ended.fit.effects.index(effect) for effect in held])
        _, pose = np.unique(ended.problem.cells.pose, return_inverse=True)

        def columns_of(forms: Sequence[Form]) -> list[Array]:
            return list(whitened_rows(ended.problem, ended, tuple(forms)).family)

        return FormComparison(
            data=rows.data,
            own=np.delete(rows.own, at_held, axis=1),
            block=(pose % EVIDENCE.form_folds)[rows.cell],
            held=rows.own[:, at_held] if held else None,
            columns_of=columns_of,
            states=ended.problem.cells.states,
        )

    @override
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        del found
        return (
            evidence_lack_of_fit(self.problem, self.start),
            evidence_lack_of_fit(self.problem, self.extended),
        )

    @override
    def next_poses(self, found: Verdict[ByRepeats], count: int, random_seed: int) -> Plan:
        pairs = unresolved_pairs(found.effects, found.not_testable)
        if pairs and self.problem.readings.measured.campaigns:
            return Plan((), (), "of a group it is not known which instrument would measure them")
        searched = self.judgement.ended.fit
        try:
            return separating_poses(self.problem, searched, pairs, count, random_seed)
        except DiscoveryError as error:  # the verdict stands without them
            return Plan((), (), f"{error.what}; {error.remedy}")

    @override
    def record_keys(self, found: Verdict[ByRepeats]) -> dict[str, Any]:
        ended = self.judgement.ended
        search = SearchByRepeats(
            candidates=found.candidates,
            error_rate=found.error_rate,
            needed_nats=needed_nats(found.candidates, found.error_rate),
            shared_error_mm=SharedError(
                before=shared_error_mm(self.problem, ended.nothing.variances.pose),
                after=shared_error_mm(self.problem, ended.score.variances.pose),
            ),
            readings_excluded=int(found.prepared.gross.sum()),
        )
        return {"search": search}


def _uncached(ended: EndOfSearch) -> EndOfSearch:
    """Return the end of a search with a model that keeps no derivatives of effects.

    Those of many forms, each used once, are not worth the memory.
    """
    model = replace(ended.fit.model, derivative_cache=None)
    return replace(ended, fit=replace(ended.fit, at=replace(ended.fit.at, model=model)))


def _without_shared_error_of_poses(ended: EndOfSearch) -> EndOfSearch:
    """Return the end of a search as if the cells of a pose shared no error of unknown cause.

    The search counts what it did not explain as such an error, that is as noise. With a variance of
    zero the noise of repeats alone is left to whiten rows: a form has to explain that error.
    """
    variances = SharedVariances(0.0, ended.score.variances.torque)
    return replace(ended, score=replace(ended.score, variances=variances))


def _columns_of_members(rows: WhitenedRows, numbers: Sequence[int]) -> Index:
    """Return the columns in `rows.own` of members of the search, by their numbers."""
    members = [rows.members[number] for number in numbers]
    columns = [column for member in members for column in range(member.start, member.stop)]
    return np.array(columns, dtype=np.intp)


def joint_steps_between_repeats(
    campaign: preparation.Prepared,
    again: Callable[[JointSteps], preparation.Prepared],
) -> JointSteps | None:
    """Return steps in the zeros of joints, which else count as the noise of repeats; None for none.

    They are judged about a model that was fitted to readings corrected by the likely steps.

    Args:
        again: prepares the campaign again with readings corrected by steps.
    """
    logged = campaign.torques == "logged"

    def completed(readings: Observations, at: FittedModel) -> Observations:
        in_order = readings.take(spread_over_time(readings, len(readings)))
        return preparation.complete(in_order, campaign.baseline, campaign.setup, at)

    readings = completed(campaign.readings, campaign.baseline)
    stated = whitener_of(readings.measured.stated_covariance)
    likely = likely_joint_steps(campaign.baseline, readings, stated)
    if likely is None:
        return None
    corrected = again(likely)
    at, context = _fitted(corrected)
    readings = completed(campaign.readings.take(~corrected.gross), at)
    noise = whitener_of(readings.measured.stated_covariance)
    effects = _sought_in(context, campaign.baseline)
    return joint_steps_of(at, readings, noise, noise, effects, logged=logged)


def _fitted(campaign: preparation.Prepared) -> tuple[FittedModel, CandidateContext]:
    """Return the model fitted to a campaign again, where repeats suffice, and what is possible."""
    baseline, setup, logged = campaign.baseline, campaign.setup, campaign.torques == "logged"
    try:
        problem = prepare(campaign.trusted, baseline, setup, torques_logged=logged)
        return fit(problem, (), (), NO_SHARED_ERROR).fitted(), problem.context
    except DiscoveryError:  # too few: the calibrated model
        readings = preparation.complete(campaign.trusted, baseline, setup)
        return baseline, preparation.context_of(readings, baseline, setup)


def discover_by_repeats(campaign: preparation.Prepared) -> Verdict[ByRepeats]:
    """Search a campaign for missing effects.

    Raises:
        DiscoveryError: when too little is repeated.
        CalibrationError: when a joint with a spring has no torque.
    """
    error_rate = campaign.setup.options.error_rate
    check_torques(campaign.baseline.model, campaign.readings)
    readings = campaign.trusted
    problem, start = _with_time(readings, campaign)
    family, refused = split_testable(problem, start, _sought(problem))

    def timed(lines: tuple[Effect, ...]) -> tuple[EvidenceProblem, EvidenceFit]:
        return _with_time(readings, campaign, lines)

    ended = search_with_errors_of_joints(problem, family, error_rate, start, timed)
    needed = needed_nats(preparation.effects_in(ended.family), error_rate)
    return _verdict(campaign, judge(ended, needed), start, refused)


def _verdict(
    campaign: preparation.Prepared,
    judgement: Judgement,
    start: EvidenceFit,
    refused: Sequence[Untestable],
) -> Verdict[ByRepeats]:
    """Return the verdict of a judgement, with the model of the named effects alone."""
    ended = judgement.ended
    problem, extended, family = ended.problem, ended.fit, ended.family
    named = tuple(finding.effect for finding in judgement.findings)
    if named != extended.effects:
        sizes = tuple(extended.size_of[effect] for effect in named)
        extended = fit(problem, named, sizes, ended.score.variances, extended)
    scorer = ByRepeats(
        extended=extended,
        covariance=covariance_of(problem, extended),
        problem=problem,
        start=start,
        judgement=judgement,
    )
    held_out, wander, floor = campaign.held_out, problem.in_time.wander, noise_floor_mm(problem)
    timed = extended.at, problem.readings, _whitener_in_time(problem)
    logged = problem.torques_logged
    if wander is None:
        causes = load_between_repeats(*timed, _sought(problem), logged=logged)
    else:
        causes = other_causes(wander, *timed, logged=logged)
    places = {(place.form, place.of) for place in judgement.unexplained}
    same = {tuple(np.flatnonzero(row).tolist()) for row in ended.same}
    groups = [group for group in sorted(same) if len(group) > 1]
    return Verdict(
        prepared=campaign,
        scorer=scorer,
        context=problem.context,
        candidates=preparation.effects_in(family),
        findings=judgement.findings,
        unexplained=(
            *judgement.unexplained,
            *motion_unexplained(problem.in_time, wander, floor),
        ),
        nameless=tuple(
            effect
            for effect in ended.fit.effects
            if effect.generic and (effect.id, effect.of) in places
        ),
        over_noise=any(place.form is None for place in judgement.unexplained),
        not_testable=tuple(each for each in refused if not is_fault(each.effect)),
        indistinguishable=tuple(tuple(family[k] for k in group) for group in groups),
        noise_floor_mm=floor,
        readings_wander=in_words(problem.in_time.of_targets),
        train=scorer.gap_on(average_repeats(campaign.trusted)),
        holdout=None if held_out is None else scorer.gap_on(held_out),
        faults_of_rows=causes.faults(wander, extended.at, problem.readings),
    )


def _sought(problem: EvidenceProblem) -> tuple[Effect, ...]:
    """Return the effects to be sought, without those that only replace others."""
    return _sought_in(problem.context, problem.baseline)


def _sought_in(context: CandidateContext, baseline: FittedModel) -> tuple[Effect, ...]:
    every = preparation.sought(context, baseline.model.terms)
    return tuple(
        effect for effect in every if effect.role_in_search != "substitute" or shows_torque(effect)
    )


def _with_time(
    readings: Observations, campaign: preparation.Prepared, lines: tuple[Effect, ...] = ()
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return the problem and the fit of its baseline, with motion in time if readings show it.

    The motion is estimated together with all effects that are sought, and lines of gears that were
    found. At first the noise is that of repeats less what running medians say that they moved by.
    Then, by what the motion is found to be:

    - a jump or a walk: the noise is that of repeats less this motion, which is estimated once more
      under that noise;
    - no such motion, but a drift, or running medians that differed: the noise is that of repeats as
      they are, since what they differ by is no motion of the whole;
    - neither: the noise stays as it is, in the second round less the motion of the first.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    baseline, setup, logged = campaign.baseline, campaign.setup, campaign.torques == "logged"
    poses = preparation.complete(readings, baseline, setup)
    residual, group = baseline.compared(poses).residual, same_circumstances(poses)
    moved = moved_between_repeats(poses, residual, group)
    problem = prepare(readings, baseline, setup, torques_logged=logged, moved_between_repeats=moved)
    start = fit(problem, (), (), NO_SHARED_ERROR)
    every = (*_sought(problem), *lines)
    for _ in range(EVIDENCE.rounds_of_time):
        in_time = _motion_in_time(problem, start, every)
        if in_time.wander is None and not in_time.has_drift and not moved.any():
            in_time = replace(problem.in_time, of_targets=in_time.of_targets)
            return replace(problem, in_time=in_time), start
        problem = prepare(readings, baseline, setup, torques_logged=logged, in_time=in_time)
        start = fit(problem, (), (), NO_SHARED_ERROR)
        if in_time.wander is None:
            break
    return problem, start


def _motion_in_time(
    problem: EvidenceProblem, start: EvidenceFit, effects: tuple[Effect, ...]
) -> TimeFindings:
    """Return how the base moves in time, about a fit of the baseline and beside effects."""
    return in_time_of(
        start.at,
        problem.readings,
        _whitener_in_time(problem),
        effects,
        logged=problem.torques_logged,
        weights=problem.torque is not None,
    )


def _whitener_in_time(problem: EvidenceProblem) -> Array:
    """Return the whitener (P, b, b) by which motion in time is sought."""
    # A jump within few repeats may leave directions without noise: a part of that stated is added.
    stated = problem.readings.measured.stated_covariance
    return whitener_of(problem.noise.cov + EVIDENCE.least_uncertainty_share**2 * stated)


def _exported(problem: EvidenceProblem, evidence_fit: EvidenceFit) -> FittedModel:
    """Return a fit as the model that is exported, without its covariance."""
    targets_m = targets_off_m(problem, evidence_fit)
    return replace(evidence_fit.fitted(), targets_off_m=targets_m)


# Lack of fit, tested against pure error.


def fit_given(
    problem: EvidenceProblem, effects: tuple[Effect, ...], most_steps: int
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Fit the baseline with effects that are given, whether or not the data support them.

    The sizes expected and the variances of shared errors are those of the greatest evidence. Noise
    and weights are computed about the fit, until these choices repeat.

    Args:
        most_steps: of each fit.

    Returns:
        The campaign prepared about the fit, and the fit.
    """
    current = fit(problem, (), (), NO_SHARED_ERROR)
    sizes = (EVIDENCE.usual_size,) * len(effects)  # indices in `EVIDENCE.sizes`
    last: tuple[object, ...] = ()
    for _ in range(EVIDENCE.rounds_of_sizes):
        evidence = evidence_about(problem, current, effects)
        every_effect = resized(evidence, tuple(enumerate(sizes)))
        score, sizes = evidence.score(every_effect), tuple(size for _, size in every_effect)
        choice = (sizes, score.grid_index)
        problem, current = refit(problem, effects, sizes, score.variances, current, most_steps)
        if choice == last:
            break
        last = choice
    return problem, current
