"""The verdict by the evidence of repeats: from single readings to an extended model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from typing_extensions import override

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.two_level_fit import check_torques
from pa10cal.discovery import preparation
from pa10cal.discovery.evidence.candidates import split_testable
from pa10cal.discovery.evidence.confirmation import whitened_rows
from pa10cal.discovery.evidence.fit import (
    EvidenceFit,
    covariance_of,
    fit,
    pose_rows,
    targets_off_m,
    torque_rows,
)
from pa10cal.discovery.evidence.judge import Judgement, floor_mm, judge, shared_error_mm
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR, NoiseModel, SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem, prepare
from pa10cal.discovery.evidence.search import EndOfSearch, evidence_about, refit, resized, search
from pa10cal.discovery.finding import Finding, Untestable
from pa10cal.discovery.gap import PairedErrors, errors_of, gap
from pa10cal.discovery.gross_errors import moved_between_repeats
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.jacobians import WhitenedPoses, ideal_by_joints
from pa10cal.discovery.joint_steps import JointSteps, joint_steps_of, likely_joint_steps
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit, pure_error_test
from pa10cal.discovery.next_poses import separating_poses, unresolved_pairs
from pa10cal.discovery.noise import same_circumstances, whitener_of
from pa10cal.discovery.nuisances import NO_MOTION, motion_unexplained, steps_in_time
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.residual_candidates import gear_lines
from pa10cal.discovery.rules import EVIDENCE, LINES
from pa10cal.discovery.short_forms import FormComparison
from pa10cal.discovery.target_wander import in_words
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.discovery.verdict import Plan, Scorer, Verdict
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.time_order import spread_over_time
from pa10cal.results.analysis import LackOfFit, PureErrorTest
from pa10cal.results.discovery import SearchByRepeats, SharedError
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import GearLine
from pa10cal.terms.forms.form import Form
from pa10cal.terms.offsets import motion_of_base
from pa10cal.terms.weights import is_fault


@dataclass(frozen=True, eq=False, kw_only=True)
class ByRepeats(Scorer):
    """Judges effects by the evidence that the scatter of repeated poses allows."""

    problem: EvidenceProblem  # the campaign, with noise and weights about the extended model
    start: EvidenceFit  # the baseline, fitted under the same noise models
    judgement: Judgement  # of the effects that the search found
    extended: EvidenceFit  # the model with the effects found

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
        return self.judgement.found.fit.effects

    @override
    def targets_off_m(self, stated: int) -> Array:
        return targets_off_m(self.problem, self.extended)

    @override
    def judged_states(self, fitted: Observations) -> PoseStates:
        return self.judgement.found.problem.cells.states

    @override
    def refitted(self, effects: tuple[Effect, ...], known: Sequence[Finding]) -> ByRepeats:
        size, found = self.extended.size_of, self.judgement.found
        for finding in known:
            for other in finding.alternatives:
                size.setdefault(other, size[finding.effect])
        sizes = tuple(size[effect] for effect in effects)
        extended = fit(self.problem, effects, sizes, found.score.variances, found.fit)
        return replace(self, extended=extended, covariance=covariance_of(self.problem, extended))

    @override
    def fitted_poses(self, campaign: preparation.Prepared) -> Observations:
        return average_repeats(campaign.trusted)

    @override
    def gap_on(self, poses: Observations, before: PairedErrors | None = None) -> PairedErrors:
        problem, searched = self.problem, self.judgement.found.fit
        poses = preparation.complete(poses, problem.baseline, problem.setup, self.extended.at)
        floor, after = floor_mm(problem, poses.readings), _exported(problem, self.extended)
        T_moved = self._base_motion(poses.states.time_s)
        found = gap(poses, problem.baseline, after, floor, T_moved=T_moved)
        if not any(effect.generic for effect in searched.effects):
            return found
        # The model at the end of the search has generic effects, too.
        poses = preparation.complete(poses, problem.baseline, problem.setup, searched.at)
        return replace(found, with_rivals=errors_of(_exported(problem, searched), poses))

    def _base_motion(self, times_s: Array) -> Array | None:
        """Return the motion of the base at averaged poses (P, 4, 4), by their times; None at rest.

        Poses of the fit are averages: their motion is the mean of those of the readings.
        """
        single, wander = self.problem.readings.states.time_s, self.problem.in_time.wander
        if wander is None:
            return None
        group = reading_groups(self.problem.readings)
        of_groups_s = group_means(single, group)
        if len(of_groups_s) == len(times_s) and np.allclose(of_groups_s, times_s):
            return motion_of_base(group_means(wander.motions(single), group))
        return motion_of_base(wander.motions(times_s))

    @override
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        problem, extended = self.problem, self.extended
        sizes = tuple(extended.size_of[effect] for effect in effects)
        return _exported(problem, fit(problem, effects, sizes, extended.variances, extended))

    @override
    def comparison(self, held: Sequence[Effect], most_poses: int | None = None) -> FormComparison:
        found = self.judgement.found
        # The derivatives of many forms are not worth caching.
        model = replace(found.fit.model, derivative_cache=None)
        found = replace(found, fit=replace(found.fit, at=replace(found.fit.at, model=model)))
        if not held:  # formulas then have to reach the noise of repeats
            variances = SharedVariances(0.0, found.score.variances.torque)
            found = replace(found, score=replace(found.score, variances=variances))
        problem = found.problem
        rows = whitened_rows(problem, found, ())
        columns = np.arange(rows.own.shape[1])
        members = [rows.members[found.fit.effects.index(effect)] for effect in held]
        of_held = np.concatenate([columns[:0], *(columns[member] for member in members)])
        _, pose = np.unique(problem.cells.pose, return_inverse=True)

        def columns_of(forms: Sequence[Form]) -> list[Array]:
            return list(whitened_rows(problem, found, tuple(forms)).family)

        return FormComparison(
            data=rows.data,
            own=np.delete(rows.own, of_held, axis=1),
            block=(pose % EVIDENCE.form_folds)[rows.cell],
            held=rows.own[:, of_held] if held else None,
            columns_of=columns_of,
            states=problem.cells.states,
        )

    @override
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        return (
            evidence_lack_of_fit(self.problem, self.start),
            evidence_lack_of_fit(self.problem, self.extended),
        )

    @override
    def next_poses(self, found: Verdict[ByRepeats], count: int, random_seed: int) -> Plan:
        # None for a group, as it is not known which of its instruments would measure.
        if self.problem.readings.measured.campaigns:
            return Plan((), ())
        pairs = unresolved_pairs(found.effects, found.not_testable)
        fitted = self.judgement.found.fit
        try:
            return separating_poses(self.problem, fitted, pairs, count, random_seed)
        except DiscoveryError:  # torques cannot be predicted, for lack of masses
            return Plan((), ())

    @override
    def record_keys(self, found: Verdict[ByRepeats]) -> dict[str, Any]:
        ended = self.judgement.found
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
    problem = prepare(corrected.trusted, campaign.baseline, campaign.setup, torques_logged=logged)
    at = fit(problem, (), (), NO_SHARED_ERROR).fitted()
    readings = completed(campaign.readings.take(~corrected.gross), at)
    noise = whitener_of(readings.measured.stated_covariance)
    return joint_steps_of(at, readings, noise, noise, _sought(problem), logged=logged)


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
    lines: tuple[Effect, ...] = ()
    found = search(problem, family, error_rate, start)
    for _ in range(LINES.most_rounds):
        added = _lines(found, error_rate)
        if not added:
            break
        family, lines = (*family, *added), (*lines, *added)
        if problem.in_time.wander is not None:  # lines may have been taken for motion in time
            problem, start = _with_time(readings, campaign, lines)
        found = search(problem, family, error_rate, start)
    needed = needed_nats(preparation.effects_in(family), error_rate)
    return _verdict(campaign, judge(found, needed), start, refused)


def _verdict(
    campaign: preparation.Prepared,
    judgement: Judgement,
    start: EvidenceFit,
    refused: Sequence[Untestable],
) -> Verdict[ByRepeats]:
    """Return the verdict of a judgement, with the model of the named effects alone."""
    found = judgement.found
    problem, extended, family = found.problem, found.fit, found.family
    named = tuple(finding.effect for finding in judgement.findings)
    if named != extended.effects:
        sizes = tuple(extended.size_of[effect] for effect in named)
        extended = fit(problem, named, sizes, found.score.variances, extended)
    scorer = ByRepeats(
        extended=extended,
        covariance=covariance_of(problem, extended),
        problem=problem,
        start=start,
        judgement=judgement,
    )
    held_out, wander, floor = campaign.held_out, problem.in_time.wander, floor_mm(problem)
    places = {(place.form, place.of) for place in judgement.unexplained}
    same = {tuple(np.flatnonzero(row).tolist()) for row in found.same}
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
            for effect in found.fit.effects
            if effect.generic and (effect.id, effect.of) in places
        ),
        over_noise=any(place.form is None for place in judgement.unexplained),
        not_testable=tuple(each for each in refused if not is_fault(each.effect)),
        indistinguishable=tuple(tuple(family[k] for k in group) for group in groups),
        noise_floor_mm=floor,
        readings_wander=in_words(problem.in_time.of_targets),
        train=scorer.gap_on(average_repeats(campaign.trusted)),
        holdout=None if held_out is None else scorer.gap_on(held_out),
        faults_of_rows=steps_in_time(wander, extended.at, problem.readings),
    )


def _lines(found: EndOfSearch, error_rate: float) -> tuple[Effect, ...]:
    """Return the lines of gears in the residuals of a search, at joints where none was tried."""
    at, cells = found.fit.at, found.problem.cells
    tried = [each.of for each in found.family if each.id == GearLine.id]
    whiteners = whitener_of(found.problem.cell_cov)
    rows = WhitenedPoses(at, cells, at.compared(cells).residual, whiteners)
    return gear_lines(rows, error_rate, tried)


def _sought(problem: EvidenceProblem) -> tuple[Effect, ...]:
    """Return the effects to be sought, without those that only replace others."""
    every = preparation.sought(problem.context, problem.baseline.model.terms)
    return tuple(effect for effect in every if effect.role_in_search != "substitute")


def _with_time(
    readings: Observations, campaign: preparation.Prepared, lines: tuple[Effect, ...] = ()
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return the problem and the fit of its baseline, with motion in time if readings show it.

    The motion is estimated together with all effects that are sought, and lines of gears that were
    found. The noise is that of repeats without the motion between them: by running medians at
    first, by the motion found in the second round.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    baseline, setup, logged = campaign.baseline, campaign.setup, campaign.torques == "logged"
    poses = preparation.complete(readings, baseline, setup)
    residual, group = baseline.compared(poses).residual, same_circumstances(poses)
    moved = moved_between_repeats(poses, residual, group)
    problem = prepare(readings, baseline, setup, torques_logged=logged, moved_between_repeats=moved)
    start = fit(problem, (), (), NO_SHARED_ERROR)
    every, found = (*_sought(problem), *lines), NO_MOTION
    for _ in range(EVIDENCE.rounds_of_time):
        # A jump within few repeats may leave directions without noise: a part of that stated is
        # added.
        stated = problem.readings.measured.stated_covariance
        found = in_time_of(
            start.at,
            problem.readings,
            whitener_of(problem.noise.cov + EVIDENCE.least_uncertainty_share**2 * stated),
            every,
            logged=problem.torques_logged,
            weights=problem.torque is not None,
        )
        if found.wander is None and not (found.has_drift or moved.any()):
            in_time = replace(problem.in_time, of_targets=found.of_targets)
            problem = replace(problem, in_time=in_time)
            break
        problem = prepare(readings, baseline, setup, torques_logged=logged, in_time=found)
        start = fit(problem, (), (), NO_SHARED_ERROR)
        if found.wander is None:
            break
    return problem, start


def _exported(problem: EvidenceProblem, found: EvidenceFit) -> FittedModel:
    """Return a fit as the model that is exported, without its covariance."""
    return replace(found.fitted(), targets_off_m=targets_off_m(problem, found))


# Lack of fit, tested against pure error.


class ChannelTest(NamedTuple):
    """Test of the errors that readings of a pose share, in poses or in torques."""

    pure_error: PureErrorTest | None  # None without repeats
    shared_variance: float  # of these errors, in units of the variance of a reading


def evidence_lack_of_fit(problem: EvidenceProblem, found: EvidenceFit) -> LackOfFit:
    """Compute where a fit and the data disagree, in poses and in torques.

    Residuals are those beyond the most likely errors common to all poses: of places of targets on
    the apparatus, masses, loads and zeros.
    """
    cells, at = problem.cells, found.at
    of_poses, of_torques = channel_tests(problem, found)
    components = _net_residual(problem.pose, pose_rows(problem, at), of_poses.shared_variance)
    residuals = CellResiduals(at, cells, components, problem.cell_cov, ideal_by_joints(at, cells))
    if problem.torque is not None and of_torques is not None:
        rows, variance = torque_rows(problem, at), of_torques.shared_variance
        torque_Nm = _net_residual(problem.torque, rows, variance)
        residuals = replace(residuals, torque_Nm=torque_Nm, torque_noise_Nm=problem.noise.torque_Nm)
    return lack_of_fit(residuals, of_poses.pure_error)


def channel_tests(
    problem: EvidenceProblem, found: EvidenceFit
) -> tuple[ChannelTest, ChannelTest | None]:
    """Test the errors that readings of a pose share, in poses and, where logged, in torques.

    The degrees of freedom of a row are one less its leverage, by the parameters of the fit.
    """
    noise = problem.noise
    channels = [(problem.pose, pose_rows(problem, found.at), noise.components_compared)]
    if problem.torque is not None:
        torques = torque_rows(problem, found.at)
        channels.append((problem.torque, torques, noise.differences * torques.shape[1]))
    whitened = [channel.whitened(values, 0.0) for channel, values, _ in channels]
    # Columns in units of the possible size of each parameter, so that those that the rows do not
    # determine take no degree of freedom.
    sizes = possible_sizes(found.model, problem.cells.measured)
    columns = [rows[:, 1:] * sizes for rows in whitened]
    nothing = Gaussian.none(len(found.x))
    both = sum((Gaussian.of(by_x, np.zeros(len(by_x))) for by_x in columns), nothing)
    tests = []
    for (channel, _, pure_dof), rows, by_x in zip(channels, whitened, columns, strict=True):
        dof = 1.0 - both.variances(by_x)
        shares = channel.shared.variance > COMPUTING.no_part
        shared_dof = float(dof[shares].sum())
        if shared_dof <= COMPUTING.no_part:
            tests.append(ChannelTest(None, 0.0))
            continue
        test = pure_error_test(float((rows[shares, 0] ** 2).sum()), shared_dof, pure_dof)
        beyond = max(test.chi_square - test.dof, 0.0)
        variance = beyond / float(dof @ channel.shared.variance) if beyond else 0.0
        tests.append(ChannelTest(test, variance))
    of_torques = None if problem.torque is None else tests[1]
    return tests[0], of_torques


def _net_residual(model: NoiseModel, rows: Array, shared_variance: float) -> Array:
    """Return measured less predicted (C, b) without the errors common to all poses.

    From rows (C, b, 1 + k) of predicted minus measured and its derivative.
    """
    residual_rows = -model.noise_whitened(rows[:, :, :1])
    amounts = model.common_amounts(residual_rows, shared_variance)
    net = residual_rows - model.common @ amounts
    white = (model.shared.rotation.T @ net).reshape(*model.whitener.shape[:2], 1)
    return np.asarray(np.linalg.solve(model.whitener, white)[:, :, 0])


def fit_given(
    problem: EvidenceProblem, effects: tuple[Effect, ...], most_steps: int
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Fit the baseline with effects that are given, whether or not the data support them.

    The sizes expected and the variances of shared errors are those of the greatest evidence. Noise
    and weights are computed about the fit, until nothing changes. Each fit has so many steps at
    most.

    Returns:
        The campaign prepared about the fit, and the fit.
    """
    current = fit(problem, (), (), NO_SHARED_ERROR)
    sizes = (EVIDENCE.usual_size,) * len(effects)
    last: tuple[object, ...] = ()
    for _ in range(EVIDENCE.rounds_of_sizes):
        evidence = evidence_about(problem, current, effects)
        chosen = resized(evidence, tuple(enumerate(sizes)))
        score, sizes = evidence.score(chosen), tuple(size for _, size in chosen)
        choice = (sizes, score.grid_index)
        problem, current = refit(problem, effects, sizes, score.variances, current, most_steps)
        if choice == last:
            break
        last = choice
    return problem, current
