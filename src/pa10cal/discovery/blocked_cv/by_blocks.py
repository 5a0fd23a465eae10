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
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv import judge
from pa10cal.discovery.blocked_cv.bands import InBands
from pa10cal.discovery.blocked_cv.by_campaign import by_campaign
from pa10cal.discovery.blocked_cv.outcome import SearchWithMotion, search_with_motion
from pa10cal.discovery.blocked_cv.refit import (
    PartialFits,
    Refit,
    refit,
    seen_by_maps,
    with_tilts_shown,
)
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.gap import PairedErrors, errors_of, gap
from pa10cal.discovery.joint_series import agreement, joint_series
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit
from pa10cal.discovery.motor_ripple import witnesses
from pa10cal.discovery.next_poses import poses_at_unseen_angles, separating_poses, unresolved
from pa10cal.discovery.noise import AS_FOUND, Noise
from pa10cal.discovery.nuisances import motion_unexplained, steps_in_time
from pa10cal.discovery.other_numbers import NEXT_POSES
from pa10cal.discovery.pose_scatter import PoseDeviations, scatter_of, share_inside
from pa10cal.discovery.predicted_rows import without_repeats
from pa10cal.discovery.preparation import Prepared, complete
from pa10cal.discovery.rules import BLOCKS, MAPS, NAMES, PROBABILITIES
from pa10cal.discovery.short_forms import FormComparison
from pa10cal.discovery.together import Scored, Together
from pa10cal.discovery.verdict import Plan, Scorer, Verdict, with_findings
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.observations import Observations
from pa10cal.results.analysis import LackOfFit
from pa10cal.results.calibration import EffectByCampaign
from pa10cal.results.discovery import Needed, Remaining, SearchByBlocks
from pa10cal.results.maps import JointWitness, PoseScatter
from pa10cal.terms.effects.effect import Effect, driven_joints
from pa10cal.terms.effects.joint_error_map import (
    GearError,
    JointErrorMap,
    SensorError,
    is_error_map,
)
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import motion_of_base
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights


@dataclass(frozen=True, eq=False, kw_only=True)
class ByBlocks(Scorer):
    """Judges effects by how well held-out blocks of poses are predicted."""

    survey: Survey  # the campaign as it was judged
    remaining: Remaining  # position error of the held-out blocks, and what else was tried on it
    least_gain: float  # sum of squares by which an effect must help at least
    extended: Refit  # the model with the effects found
    noise: Noise  # of single readings
    causes: Mapping[int, JointWitness] = field(default_factory=dict)  # of each map, by joint
    bands: InBands | None = None  # of the maps; None where none has a band

    method: ClassVar[str] = "cross-validation over blocks"
    of_sets: ClassVar[bool] = True

    @property
    @override
    def searched_from(self) -> FittedModel:
        return self.survey.baseline

    @property
    @override
    def beside(self) -> Array:
        survey, at = self.survey, self.extended.at
        columns = [each.columns(survey.baseline, survey.poses) for each in survey.nuisances]
        shift = survey.net_residual(at) - linear.residual(at, survey.poses)
        return np.concatenate([*columns, shift[:, :, None]], axis=2)

    @cached_property
    @override
    def seen(self) -> AngleCoverage | None:
        return seen_by_maps(self.survey, self.extended.effects)

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
            before.of(effect) if effect in before.effects else effect.starts[0]
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
        extended, survey = self.extended, self.survey
        at, rows = extended.at, np.arange(len(survey.poses))
        if most_poses is not None and len(rows) > most_poses:  # some of every block, in any order
            rows = drawn(len(rows), most_poses)
        whiten = extended.weights.whiteners(rows)
        poses: Observations = survey.poses.take(rows)
        components = whiten.shape[1]
        seen: slice | Index = slice(None)
        if poses.measured.campaigns:  # each pose has the components of its own campaign alone
            seen = np.flatnonzero(poses.measured.components_seen)

        def flat(columns: Sequence[Array]) -> list[Array]:
            return [each.reshape(len(rows) * components, -1)[seen] for each in columns]

        def columns_of(effects: Sequence[Effect]) -> list[Array]:
            in_model = {term: at.values_of(term) for term in at.model.terms}
            points = [in_model.get(effect, effect.starts[0]) for effect in effects]
            return flat(linear.by_effects(at, poses, effects, points, whiten))

        fitted = [term for term in at.model.terms if not is_error_map(term) and term not in held]
        own = flat(linear.by_own_terms(at, poses, fitted, whiten))
        sizes = possible_sizes(at.model, poses.measured)
        targets = whiten @ linear.by_targets(at, poses) * sizes[len(at.x) :]
        (white,) = flat([whiten @ survey.net_residual(at)[rows][:, :, None]])
        data = -white[:, 0]
        noise_share = min(1.0, (self.remaining.floor_mm / self.remaining.mean_mm) ** 2)
        noise = float(data @ data) * noise_share
        # Data are measured less predicted by a model without what is held. The prior of the arm's
        # weights is about those described, not about the fit.
        for term, columns in zip(fitted, own, strict=True):
            if holds_weights(term):
                data = data + columns @ (at.values_of(term) / sizes[at.model.columns_of(term)])
        of_held = columns_of(held)
        for effect, columns in zip(held, of_held, strict=True):
            if effect in at.model.terms:
                amounts = at.values_of(effect)[: effect.linear]
                data = data + columns @ np.linalg.solve(effect.prior_factor, amounts)
        return FormComparison(
            data=data,
            own=np.concatenate([*own, *flat([targets])], axis=1),
            block=np.repeat(survey.block[rows], components)[seen],
            held=np.concatenate(of_held, axis=1) if of_held else None,
            columns_of=columns_of,
            states=poses.states,
            noise=noise,
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
        at, whiteners = extended.at, extended.weights.whiteners()
        sets = Together.of(at, survey.poses, whiteners, found.context, survey.setup, self.beside)
        present = sets.holding(extended.model.terms)
        likeliest = sets.likeliest(present)
        if sets.giving_way(likeliest.at) == sets.giving_way(present):
            return None
        ahead = _searched(found.prepared, _survey_about(found, sets, likeliest))
        moved = ahead.scorer.survey.wander or ahead.scorer.survey.change
        return ahead if _better(ahead, found) and not moved else None

    @override
    def next_poses(self, found: Verdict[ByBlocks], count: int, random_seed: int) -> Plan:
        # Poses that separate ambiguous effects come first, then joint angles not visited.
        rivals, separations = unresolved(found.effects), None
        few = len(self.extended.at.x) <= NEXT_POSES.most_parameters
        if rivals and few and not self.survey.poses.measured.campaigns:
            # Rivals such as tilting axes may need bends that the model does not have.
            others = [other for _, other in rivals if other is not None]
            survey = replace(self.survey, baseline=self.survey.baseline.bending_as(others))
            extended = replace(self.extended, at=self.extended.at.bending_as(others))
            problem, fit = without_repeats(survey, extended, self.noise)
            try:
                plan = separating_poses(
                    problem, fit, rivals, count, random_seed, PROBABILITIES.blocks
                )
            except DiscoveryError:  # the verdict stands without it
                plan = Plan(())
            if plan.poses:
                return plan
            separations = plan.separations
        unseen = poses_at_unseen_angles(
            self.survey, self.seen or self.survey.angles_seen, count, random_seed
        )
        return Plan(unseen, separations)

    @override
    def keys(self, found: Verdict[ByBlocks]) -> dict[str, Any]:
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
    tilted = (
        with_tilts_shown(found.scorer.survey, found.scorer.extended) if found.findings else None
    )
    if tilted is None:
        return found
    ahead = _searched(campaign, _survey_from(found, tilted))
    return ahead if _better(ahead, found) else found


def _better(ahead: Verdict[ByBlocks], found: Verdict[ByBlocks]) -> bool:
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


def _verdict(campaign: Prepared, searched: SearchWithMotion) -> Verdict[ByBlocks]:
    """Return the verdict of a search, maps without their causes."""
    found = searched.outcome
    survey, extended, poses = found.survey, found.extended, found.survey.poses
    noise = survey.noise_about(extended.fitted())
    floor_mm = linear.mean_error_of_noise_mm(poses.measured, noise.cov)
    remaining = judge.remaining_error(
        survey.block,
        found.errors_mm,
        floor_mm,
        found.expected_over_noise * floor_mm,
        found.tried,
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
            *judge.unexplained(
                remaining, found.nameless, {effect.of for effect in extended.effects}
            ),
            *motion_unexplained(searched.in_time, survey.wander, floor_mm),
            *of_lag,
        ),
        not_testable=found.hidden,
        below_detection_limit=found.below_detection_limit,
        noise_floor_mm=floor_mm,
        noise_floor_from=noise.origin,
        train=scorer.gap_on(poses),
        holdout=None if campaign.held_out is None else scorer.gap_on(campaign.held_out),
        faults_of_rows=(
            *steps_in_time(survey.wander, extended.at, poses, searched.rivals_of_jumps),
            *of_change,
        ),
        nameless=found.nameless if remaining.over_floor else (),
        over_noise=remaining.over_floor,
    )


# Surveys about another model: with springs of a likelier set, or with tilts of parallel axes.


def _survey_about(found: Verdict[ByBlocks], sets: Together, likeliest: Scored) -> Survey:
    """Return a survey about the calibrated model with the springs of a set, fitted again.

    The set is one of what gives way under weights that nobody stated.
    """
    calibrated = found.scorer.searched_from
    springs = sets.springs(likeliest)
    effects = sets.effects(likeliest)
    terms = [term for term in calibrated.model.terms if not is_spring(term)]
    # springs stand after the links, else first
    first = 1 + next((k for k, term in enumerate(terms) if term.of == "links"), -1)
    terms[first:first] = springs
    bent = calibrated.bending_as(effects)
    model = Model(bent.model.chain, tuple(terms))
    weights = sets.weights_of(likeliest)

    def start(term: Term) -> Array:
        if term in springs:
            return springs[term]
        if holds_weights(term):  # the set was found about weights of its own
            return weights[list(term.columns)]
        return calibrated.values_of(term)

    about = replace(bent, model=model, x=np.concatenate([*map(start, terms)]), covariance=None)
    return replace(_survey_from(found, about), begins_with=effects)


def _survey_from(found: Verdict[ByBlocks], about: FittedModel) -> Survey:
    """Return a survey whose search sets out from another model, fitted to its poses."""
    campaign = found.prepared
    fitted = refit(Survey.of(campaign, about), (), (), found.scorer.extended.weights).fitted()
    return replace(Survey.of(campaign, fitted), calibrated_before=campaign.baseline)


def _with_rivals(found: Verdict[ByBlocks], nameless: tuple[Effect, ...]) -> Verdict[ByBlocks]:
    """Return the verdict with the errors of a model that has generic effects, too."""
    if not nameless:
        return found
    extended, survey = found.scorer.extended, found.scorer.survey
    effects = (*extended.effects, *nameless)
    starts = (*map(extended.of, extended.effects), *(each.starts[0] for each in nameless))
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
    names, alternatives = names_by_cause(scorer.extended.effects, causes)
    found = replace(found, scorer=replace(scorer, causes=causes))
    return _renamed(found, names, alternatives)


def _renamed(
    found: Verdict[ByBlocks],
    names: Mapping[Effect, Effect],
    alternatives: Mapping[Effect, tuple[Effect, ...]],
) -> Verdict[ByBlocks]:
    """Return a verdict with effects under other names of the same form."""
    if not names:
        return found
    extended = found.scorer.extended
    effects = tuple(names.get(effect, effect) for effect in extended.effects)
    terms = tuple(names.get(term, term) for term in extended.model.terms)  # type: ignore[call-overload]
    at = replace(extended.at, model=Model(extended.model.chain, terms))
    findings = tuple(
        replace(
            finding,
            effect=names.get(finding.effect, finding.effect),
            alternatives=(*finding.alternatives, *alternatives.get(finding.effect, ())),
        )
        for finding in found.findings
    )
    scorer = found.scorer.with_model(replace(extended, effects=effects, at=at))
    return replace(found, findings=findings, scorer=scorer)


# Names of maps by their cause, sensor or gear, as far as the motor's ripple shows it.

#: The effect by which a map is named, for each cause.
_NAMES: Mapping[str, type[JointErrorMap]] = {"sensor": SensorError, "gear": GearError}


def causes_of(survey: Survey, found: Refit) -> dict[int, JointWitness]:
    """Return the ripple and the agreement that show the cause of every map, by joint.

    A joint that only follows others has neither sensor nor gear.
    """
    driven = driven_joints(survey.context)
    maps = filter(is_error_map, found.effects)
    joints = [each.joint for each in maps if each.joint in driven]
    if not joints:
        return {}
    residual, whiteners = survey.net_residual(found.at), found.weights.whiteners()
    rows = linear.WhitenedPoses(found.at, survey.poses, residual, whiteners)
    series = joint_series(rows, joints)
    ripples = witnesses(series, found.at.arm.gear_ratio)
    return {
        joint: JointWitness(ripple=ripples[joint - 1], agreement=agreement(series[joint - 1]))
        for joint in sorted(joints)
    }


def names_by_cause(
    effects: Sequence[Effect], causes: Mapping[int, JointWitness]
) -> tuple[dict[Effect, Effect], dict[Effect, tuple[Effect, ...]]]:
    """Return the named effect, and its alternatives, for each map whose cause is known.

    Sensor and gear are alternatives of each other if the ripple does not decide between them.
    Without a ripple they are the causes of a map with fine waves on which campaigns or turns agree,
    since nothing else turns a joint to and fro ten times a turn, or of one that was named already.
    Any other map without a ripple stays a map.
    """
    names: dict[Effect, Effect] = {}
    alternatives: dict[Effect, tuple[Effect, ...]] = {}
    for effect in effects:
        if not is_error_map(effect) or effect.joint not in causes:
            continue
        witness = causes[effect.joint]
        by_ripple = None if witness.ripple is None else witness.ripple.likely
        agreed = witness.agreement is not None and witness.agreement.holds
        of_joint = by_ripple or (agreed and effect.knots >= MAPS.fine_knots)
        if witness.cause is None and not of_joint and effect.id == JointErrorMap.id:
            continue
        likely = witness.cause or by_ripple or "sensor"
        form = (effect.of, effect.knots, effect.spectrum)
        names[effect] = _NAMES[likely](*form)
        others = [kind(*form) for name, kind in _NAMES.items() if name != likely]
        alternatives[effect] = () if witness.cause else tuple(others)
    return names, alternatives
