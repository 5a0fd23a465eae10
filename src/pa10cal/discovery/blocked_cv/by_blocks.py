"""The verdict by blocked cross-validation, on a campaign of many different poses.

The scorer `ByBlocks`; then `discover_by_blocks`, which runs the search, repeats it about a better
model if it finds one, and names the causes of maps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array, Index, drawn
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv import judge
from pa10cal.discovery.blocked_cv.as_repeated import as_repeated
from pa10cal.discovery.blocked_cv.bands import InBands
from pa10cal.discovery.blocked_cv.by_campaign import by_campaign, contradictions_left
from pa10cal.discovery.blocked_cv.map_causes import NamedMap, causes_of, named_by_cause
from pa10cal.discovery.blocked_cv.other_baselines import (
    survey_about,
    with_compliances_of,
    with_tilts_shown,
    without_spring,
)
from pa10cal.discovery.blocked_cv.outcome import (
    SearchOutcome,
    SearchWithMotion,
    search_with_motion,
)
from pa10cal.discovery.blocked_cv.refit import PartialFits, Refit, refit, squares_left
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.gap import PairedErrors, errors_of, gap
from pa10cal.discovery.gear_lines import stroke_waves
from pa10cal.discovery.joint_steps import JointSteps
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit
from pa10cal.discovery.next_poses import poses_at_unseen_angles, separating_poses, unresolved_pairs
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.nuisances import MovedZeros, motion_unexplained
from pa10cal.discovery.pose_scatter import AS_FOUND, PoseDeviations, scatter_of, share_inside
from pa10cal.discovery.preparation import Prepared, complete
from pa10cal.discovery.refitted_verdict import with_findings
from pa10cal.discovery.rules import BLOCKS, NAMES, PROBABILITIES
from pa10cal.discovery.short_forms import FormComparison
from pa10cal.discovery.target_wander import in_words
from pa10cal.discovery.together import Together
from pa10cal.discovery.tuning import NEXT_POSES
from pa10cal.discovery.verdict import NOTHING_PLANNED, Plan, Scorer, Verdict
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import mean_noise_error_mm
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.validity import AngleCoverage, angles_seen
from pa10cal.observe.observations import Observations
from pa10cal.results.analysis import LackOfFit
from pa10cal.results.calibration import EffectByCampaign, InputFinding
from pa10cal.results.discovery import Needed, Remaining, SearchByBlocks, Unexplained
from pa10cal.results.maps import JointWitness, PoseScatter
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import motion_of_base
from pa10cal.terms.statement_faults import fault_candidates, is_fault
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights


@dataclass(frozen=True, eq=False, kw_only=True)
class ByBlocks(Scorer):
    """Judges effects by how well held-out blocks of poses are predicted."""

    survey: Survey  # the campaign as it was judged
    # position error of held-out blocks by a model with the effects found, and what else was tried
    remaining: Remaining
    least_gain: float  # sum of squares by which an effect must help at least
    extended: Refit  # the model with the effects found
    noise: Noise  # of single readings
    causes: Mapping[int, JointWitness] = field(default_factory=dict)  # of each map, by joint
    bands: InBands | None = None  # of the maps; None where none has a band

    method: ClassVar[str] = "cross-validation over blocks"
    adds_rivals_of_sets: ClassVar[bool] = True

    @property
    @override
    def searched_from(self) -> FittedModel:
        return self.survey.baseline

    @property
    @override
    def nuisances(self) -> Array:
        survey, at = self.survey, self.extended.at
        columns = [each.columns(survey.baseline, survey.poses) for each in survey.nuisances]
        shift = survey.net_residual(at) - at.compared(survey.poses).residual
        return np.concatenate([*columns, shift[:, :, None]], axis=2)

    @property
    @override
    def moved(self) -> MovedZeros | None:
        change = self.survey.change
        return change.moved if isinstance(change, JointSteps) else None

    @cached_property
    @override
    def seen(self) -> AngleCoverage | None:
        order = np.zeros(self.survey.context.arm.n)  # the finest wave of the maps of each joint
        for each in filter(is_error_map, self.extended.effects):
            order[each.joint - 1] = max(order[each.joint - 1], each.finest_order)
        return angles_seen(self.survey.poses.states.q_rad, order) if order.any() else None

    @property
    @override
    def unstated_forces(self) -> bool:
        return self.noise.torque_share < 1.0

    @cached_property
    @override
    def scatter(self) -> PoseDeviations | None:
        if not any(is_error_map(effect) for effect in self.extended.effects):
            return None
        at, poses = self.extended.at, self.survey.poses
        return scatter_of(at, poses, self.survey.net_residual(at))

    @override
    def refitted(self, effects: tuple[Effect, ...], known: Sequence[Finding]) -> ByBlocks:
        before = self.extended
        starts = tuple(
            before.at.values_of(effect) if effect in before.effects else effect.starts[0]
            for effect in effects
        )
        widening = AS_FOUND if self.bands is None else self.bands.widening
        return self.with_model(refit(self.survey, effects, starts, before.weights, widening))

    def with_model(self, extended: Refit) -> ByBlocks:
        """Return the scorer with another extended model."""
        return replace(self, extended=extended, covariance=extended.covariance)

    @override
    def fitted_poses(self, campaign: Prepared) -> Observations:
        return self.survey.poses

    @override
    def gap_on(self, poses: Observations, before: PairedErrors | None = None) -> PairedErrors:
        survey, after, wander = self.survey, self.extended.fitted(), self.survey.wander
        poses = complete(poses, survey.baseline, survey.setup, after)
        T_moved = None if wander is None else motion_of_base(wander.motions(poses.states.time_s))
        found = gap(poses, survey.calibrated, after, self.remaining.floor_mm, self.seen, T_moved)
        return found if before is None else found.with_nuisances_of(before)

    @override
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        return self._partial.model_with(effects)

    @cached_property
    def _partial(self) -> PartialFits:
        return PartialFits(self.survey, self.extended)

    @override
    def comparison(self, held: Sequence[Effect], most_poses: int | None = None) -> FormComparison:
        # Maps that are not held stay as they were fitted; all else is fitted with the forms.
        at, count = self.extended.at, len(self.survey.poses)
        poses = np.arange(count)
        if most_poses is not None and count > most_poses:  # some of every block, in any order
            poses = drawn(count, most_poses)
        rows = _FitRows(self.survey, self.extended, poses)
        fitted = [term for term in at.model.terms if not is_error_map(term) and term not in held]
        by_fitted, by_held = rows.by_own_terms(fitted), rows.by_effects(held)
        residual = rows.measured_less_predicted()
        noise_share = min(1.0, (self.remaining.floor_mm / self.remaining.mean_mm) ** 2)
        # Data are the residual and what fitted weights and held effects predict now: the rows are
        # of a model without what is held, and with the weights as described, about which the prior
        # of the arm's weights is.
        data = residual
        sizes = possible_sizes(at.model)
        for term, columns in zip(fitted, by_fitted, strict=True):
            if holds_weights(term):
                data = data + columns @ (at.values_of(term) / sizes[at.model.columns_of(term)])
        for effect, columns in zip(held, by_held, strict=True):
            if effect in at.model.terms:
                amounts = at.values_of(effect)[: effect.linear]
                data = data + columns @ np.linalg.solve(effect.prior_factor, amounts)
        return FormComparison(
            data=data,
            own=np.concatenate([*by_fitted, rows.by_targets()], axis=1),
            block=rows.block,
            held=np.concatenate(by_held, axis=1) if by_held else None,
            columns_of=rows.by_effects,
            states=rows.poses.states,
            noise=float(residual @ residual) * noise_share,
        )

    @override
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        poses, cov = self.survey.poses, self.noise.cov
        before, after = (
            lack_of_fit(CellResiduals.about(at, poses, cov))
            for at in (found.baseline, self.extended.fitted())
        )
        return before, after

    @override
    def likelier(self, found: Verdict[ByBlocks]) -> Verdict[ByBlocks] | None:
        # The calibrated model has springs only, and they take up deflections of links, bearings and
        # base in a search that adds one effect at a time. So the search is repeated from the
        # likeliest set and its weights, and accepted if it predicts held-out blocks better.
        survey, extended = self.survey, self.extended
        if survey.wander or survey.change:
            return None
        at, weights = extended.at, extended.weights
        sets = Together.of(
            at, survey.poses, weights.whiteners(), found.context, survey.setup, self.nuisances
        )
        present = sets.holding(extended.model.terms)
        likeliest = sets.likeliest(present)
        if sets.giving_way(likeliest.at) == sets.giving_way(present):
            return None
        model = with_compliances_of(self.searched_from, sets, likeliest)
        about = survey_about(found.prepared, model, weights)
        ahead = _searched(found.prepared, replace(about, begins_with=sets.effects(likeliest)))
        moved = ahead.scorer.survey.wander or ahead.scorer.survey.change
        return ahead if _is_better(ahead, found) and not moved else None

    @override
    def next_poses(self, found: Verdict[ByBlocks], count: int, random_seed: int) -> Plan:
        # Poses that separate ambiguous effects come first, then joint angles not visited.
        rivals, plan = unresolved_pairs(found.effects), NOTHING_PLANNED
        few = len(self.extended.at.x) <= NEXT_POSES.most_parameters
        if rivals and few and not self.survey.poses.measured.campaigns:
            # Rivals such as tilting axes may need bends that the model does not have.
            others = [other for _, other in rivals if other is not None]
            survey = replace(self.survey, baseline=self.survey.baseline.bending_as(others))
            extended = replace(self.extended, at=self.extended.at.bending_as(others))
            problem, fit = as_repeated(survey, extended, self.noise)
            try:
                plan = separating_poses(
                    problem, fit, rivals, count, random_seed, PROBABILITIES.blocks
                )
            except DiscoveryError as error:  # the verdict stands without it
                plan = Plan((), why_none=f"{error.what}; {error.remedy}")
            if plan.poses:
                return plan
        unseen = poses_at_unseen_angles(
            self.survey, self.seen or self.survey.angles_seen, count, random_seed
        )
        return Plan(unseen, plan.separations, plan.why_none)

    @override
    def record_keys(self, found: Verdict[ByBlocks]) -> dict[str, Any]:
        search = SearchByBlocks(
            candidates=found.candidates,
            error_rate=found.error_rate,
            blocks=BLOCKS.blocks,
            needed=Needed(
                standard_errors=BLOCKS.standard_errors,
                sum_of_squares=self.least_gain,
                part_of_remaining_error_over_noise=BLOCKS.least_share,
            ),
            poses_down_weighted=int(np.sum(self.extended.weights.weight < 1.0)),
            refit_converged=bool(self.extended.converged),
        )
        return {
            "search": search,
            "remaining": self.remaining,
            "bands": None if self.bands is None else self.bands.record,
            "scatter": pose_scatter(found),
        }

    @override
    def witness(self, effect: Effect) -> JointWitness | None:
        cause = self.causes.get(effect.joint) if is_error_map(effect) else None
        return cause if cause is not None and (cause.ripple or cause.agreement) else None

    @override
    def by_campaign(self) -> tuple[EffectByCampaign, ...] | None:
        return by_campaign(self.survey, self.extended) or None

    @override
    def contradictions(self) -> tuple[InputFinding, ...] | None:
        return contradictions_left(self.survey, self.extended)


class _FitRows:
    """Whitened rows of some poses about a fit: each component of each pose is one of R rows.

    In a group each pose has rows of the components that its own campaign measures alone.
    """

    def __init__(self, survey: Survey, fit: Refit, poses: Index) -> None:
        self._survey, self._at, self._chosen = survey, fit.at, poses
        self.poses: Observations = survey.poses.take(poses)
        self._whiteners = fit.weights.whiteners(poses)
        seen = self.poses.measured.components_seen
        grouped = bool(self.poses.measured.campaigns)
        self._rows: Index | slice = np.flatnonzero(seen) if grouped else slice(None)
        self.block = np.repeat(survey.block[poses], seen.shape[1])[self._rows]  # (R,)

    def measured_less_predicted(self) -> Array:
        """Return the whitened residual, nuisances subtracted, (R,)."""
        residual = self._survey.net_residual(self._at)[self._chosen]
        return -self._of(self._whiteners @ residual[:, :, None])[:, 0]

    def by_own_terms(self, terms: Sequence[Term]) -> list[Array]:
        """Return the columns (R, k) of terms of the fit, in their possible sizes."""
        columns = jacobians.by_scaled_terms(self._at, self.poses, terms, self._whiteners)
        return list(map(self._of, columns))

    def by_effects(self, effects: Sequence[Effect]) -> list[Array]:
        """Return the columns (R, k) of effects in plausible sizes, as fitted or at their start."""
        at = self._at
        values = {term: at.values_of(term) for term in at.model.terms}
        points = [values.get(effect, effect.starts[0]) for effect in effects]
        columns = jacobians.by_scaled_effects(at, self.poses, effects, points, self._whiteners)
        return list(map(self._of, columns))

    def by_targets(self) -> Array:
        """Return the columns (R, t) of the coordinates of targets, in their possible sizes."""
        sizes = possible_sizes(self._at.model, self.poses.measured)[len(self._at.x) :]
        return self._of(self._whiteners @ self._at.compared(self.poses).by_targets * sizes)

    def _of(self, columns: Array) -> Array:
        """Return columns (P, b, k) as rows (R, k)."""
        count, b, k = columns.shape
        return columns.reshape(count * b, k)[self._rows]


def pose_scatter(found: Verdict[ByBlocks]) -> PoseScatter | None:
    """Return the scatter of single poses about the model; None where no map has a band."""
    scorer, model = found.scorer, found.model
    scatter = scorer.scatter
    if scorer.bands is None or scatter is None:
        return None

    def inside95(gap: PairedErrors) -> float:
        residual = scorer.survey.net_residual(model, gap.poses)
        return share_inside(model, scatter, gap.poses, residual)

    return PoseScatter(
        joints=tuple(scatter.joints.tolist()),
        kinds=dict(scatter.kinds),
        inside95_train=inside95(found.train),
        inside95_holdout=None if found.holdout is None else inside95(found.holdout),
    )


def discover_by_blocks(campaign: Prepared) -> Verdict[ByBlocks]:
    """Search a campaign of many different poses for missing effects.

    Raises:
        DiscoveryError: when there are too few poses.
    """
    found = _searched(campaign, Survey.of(campaign))
    if not found.effects and _weights_explain(found):
        about = _about_statement(campaign, found)
        ahead = found if about is None else _searched(campaign, about)
        told = any(is_fault(each.effect) for each in ahead.findings)
        if told and (not found.findings or _is_better(ahead, found)):
            return ahead
    if not found.weights_assumed:
        found = _without_spring_for_another(found)
    if not found.findings:
        return found
    extended = found.scorer.extended
    tilted = with_tilts_shown(found.scorer.survey, extended)
    if tilted is None:
        return found
    ahead = _searched(campaign, survey_about(campaign, tilted, extended.weights))
    return ahead if _is_better(ahead, found) else found


def _without_spring_for_another(first: Verdict[ByBlocks]) -> Verdict[ByBlocks]:
    """Return the verdict of a search about rigid joints, where springs stand for other effects.

    A calibration has springs alone for what turns a joint, and one that took up a part of another
    effect leaves too little of it to be found beside it. Tried are springs of joints at which an
    effect nearly helps; the joint's compliance is among the candidates again. Where maps were
    found, as only many poses show them, a spring hides nothing.
    """
    campaign, extended, best = first.prepared, first.scorer.extended, first
    if any(is_error_map(effect) for effect in extended.effects):
        return first
    held, tried = {finding.of for finding in first.findings}, first.scorer.remaining.tried
    nearly = {each.of for each in tried if each.gain > HALF_WIDTH_95 * each.gain_std}
    for spring in filter(is_spring, first.baseline.model.terms):
        if spring.of not in nearly - held:
            continue
        rigid = without_spring(first.baseline, spring)
        ahead = _searched(campaign, survey_about(campaign, rigid, extended.weights))
        names = {(each.id, each.of) for each in ahead.findings if not each.effect.yields}
        if any(of == spring.of for _, of in names) and _is_better(ahead, best):
            best = ahead
    return best


def _weights_explain(found: Verdict[ByBlocks]) -> bool:
    """Return whether weights unlike those described explain most of the error."""
    train = found.train
    weighs = any(map(holds_weights, found.scorer.extended.model.terms))
    return weighs and train.after.mean_mm < NAMES.most_left_share * train.before.mean_mm


def _about_statement(campaign: Prepared, found: Verdict[ByBlocks]) -> Survey | None:
    """Return a survey about springs as they are where one statement about weights is wrong.

    Rows are linear about springs that were fitted to the weights as stated: half of a moment looks
    like half of a stiffness, and the error that is left hides the statement.
    """
    survey, extended = found.scorer.survey, found.scorer.extended
    faults = fault_candidates(survey.context, survey.baseline.model.terms)
    fits = [refit(survey, (each,), (each.starts[0],), extended.weights) for each in faults]
    if not fits:
        return None
    best = min(fits, key=lambda each: squares_left(survey, each, extended.weights))
    baseline, x = survey.baseline, best.x[: len(survey.baseline.x)].copy()
    x[baseline.model.having("weight")] = 0.0
    about = Survey.of(campaign, replace(baseline, x=x, targets_m=best.at.targets_m))
    return replace(about, calibrated_before=campaign.baseline)


def _is_better(ahead: Verdict[ByBlocks], found: Verdict[ByBlocks]) -> bool:
    """Return whether a verdict predicts held-out blocks better than another.

    With more names it has to be better by more than another fit of the same model could be.
    """
    more_names = len(ahead.effects) > len(found.effects)
    least_ratio = NAMES.worse_ratio if more_names else 1.0
    return least_ratio * ahead.scorer.remaining.rms_mm < found.scorer.remaining.rms_mm


def _searched(campaign: Prepared, survey: Survey) -> Verdict[ByBlocks]:
    """Return the verdict of the search of a survey, with the causes of maps."""
    searched = search_with_motion(survey)
    verdict = _verdict(campaign, searched)
    nameless = searched.outcome.nameless
    return with_causes(_without_motion_for_arm(_with_rivals(verdict, nameless)))


def _with_stroke_waves(
    unexplained: Sequence[Unexplained], found: SearchOutcome
) -> Sequence[Unexplained]:
    """Return what is unexplained, at slides along which it shows in waves if no place is known."""
    if [each.of for each in unexplained] != [None]:
        return unexplained
    survey, fitted = found.survey, found.extended
    rows = survey.whitened(fitted.at, fitted.weights.whiteners())
    waves = stroke_waves(rows, survey.context, survey.setup.options.error_rate)
    (left,) = unexplained
    return [
        left.model_copy(
            update={
                "of": wave.of,
                "why": f"{left.why}; along {wave.of} waves of {1e3 * wave.length_m:.3g} mm stand "
                "out, as of supports of a rail, teeth of a rack or turns of a screw, and no effect "
                "that is sought has that form",
            }
        )
        for wave in waves
    ] or unexplained


def _verdict(campaign: Prepared, searched: SearchWithMotion) -> Verdict[ByBlocks]:
    """Return the verdict of a search, maps without their causes."""
    found = searched.outcome
    survey, extended, poses = found.survey, found.extended, found.survey.poses
    noise = survey.noise_about(extended.fitted())
    floor_mm = mean_noise_error_mm(poses.measured, noise.cov)
    block, errors_mm, over_noise = found.held_out
    remaining = judge.remaining_error(
        block, errors_mm, floor_mm, over_noise * floor_mm, found.tried
    )
    findings = tuple(
        Finding(
            effect,
            *extended.reported(effect, extended.covariance),
            judged.alternatives,
            judged.proof,
            judged.rivals,
        )
        for effect, judged in zip(extended.effects, found.judged, strict=True)
    )
    scorer = ByBlocks(
        extended=extended,
        covariance=extended.covariance,
        survey=survey,
        remaining=remaining,
        least_gain=found.least_gain,
        noise=noise,
        bands=found.bands,
    )
    of_lag = () if survey.lag is None else (survey.lag.unexplained(remaining.mean_mm),)
    of_change = () if survey.change is None else survey.change.faults(survey.baseline, poses)
    return Verdict(
        prepared=campaign,
        scorer=scorer,
        context=survey.context,
        candidates=found.candidates,
        findings=findings,
        unexplained=(
            *_with_stroke_waves(
                judge.unexplained(
                    remaining, found.nameless, {effect.of for effect in extended.effects}
                ),
                found,
            ),
            *motion_unexplained(searched.in_time, survey.wander, floor_mm),
            *of_lag,
        ),
        not_testable=found.hidden,
        below_detection_limit=found.below_detection_limit,
        noise_floor_mm=floor_mm,
        noise_floor_from=noise.origin,
        readings_wander=in_words(searched.in_time.of_targets),
        train=scorer.gap_on(poses),
        holdout=None if campaign.held_out is None else scorer.gap_on(campaign.held_out),
        faults_of_rows=(
            *searched.causes.faults(survey.wander, extended.at, poses),
            *of_change,
        ),
        nameless=found.nameless,
        over_noise=remaining.over_floor,
    )


def _with_rivals(found: Verdict[ByBlocks], nameless: tuple[Effect, ...]) -> Verdict[ByBlocks]:
    """Return the verdict with the errors of a model that has generic effects, too."""
    if not nameless:
        return found
    extended, survey = found.scorer.extended, found.scorer.survey
    effects = (*extended.effects, *nameless)
    starts = (*map(extended.at.values_of, extended.effects), *(each.starts[0] for each in nameless))
    model = refit(survey, effects, starts, extended.weights, start_from=extended.at).fitted()

    def with_remaining(gap: PairedErrors) -> PairedErrors:
        poses = complete(gap.poses, found.baseline, survey.setup, model)
        return replace(gap, with_rivals=errors_of(model, poses))

    return found.with_gaps(with_remaining)


def _without_motion_for_arm(found: Verdict[ByBlocks]) -> Verdict[ByBlocks]:
    """Return the verdict, fitted again without motion of the base if that imitated the arm.

    If the order of poses is unrelated to joint positions, the arm fitted together with the motion
    is nearer to the truth. If rows are sorted by a joint, motion takes up errors of the arm. Then a
    model without it explains more of the readings than its parameters could by chance.
    """
    scorer, survey = found.scorer, found.scorer.survey
    if survey.wander is None:
        return found
    without = replace(scorer, survey=replace(survey, wander=None))
    still = with_findings(replace(found, scorer=without), found.findings)
    components = max(int(survey.poses.measured.components_seen.sum()), 1)
    by_chance = BLOCKS.chance_shares * len(found.extended.x) / components
    by_chance = min(by_chance, BLOCKS.most_by_chance)
    least_mm = np.sqrt(1.0 - by_chance) / NAMES.worse_ratio * found.train.after.rms_mm
    return found if still.train.after.rms_mm > least_mm else still


def with_causes(found: Verdict[ByBlocks]) -> Verdict[ByBlocks]:
    """Return a verdict in which maps whose cause is known are sensor or gear errors."""
    scorer = found.scorer
    causes = causes_of(scorer.survey, scorer.extended)
    named = named_by_cause(scorer.extended.effects, causes)
    return _with_maps_named(replace(found, scorer=replace(scorer, causes=causes)), named)


def _with_maps_named(found: Verdict[ByBlocks], named: Mapping[Term, NamedMap]) -> Verdict[ByBlocks]:
    """Return a verdict with maps under the names of their causes: the fit stays as it is."""
    if not named:
        return found
    extended = found.scorer.extended
    effects = tuple(named[e].effect if e in named else e for e in extended.effects)
    terms = tuple(named[t].effect if t in named else t for t in extended.model.terms)
    at = replace(extended.at, model=Model(extended.model.chain, terms))
    findings = tuple(
        replace(
            each,
            effect=named[each.effect].effect,
            alternatives=(*each.alternatives, *named[each.effect].alternatives),
        )
        if each.effect in named
        else each
        for each in found.findings
    )
    scorer = found.scorer.with_model(replace(extended, effects=effects, at=at))
    return replace(found, findings=findings, scorer=scorer)
