"""Calibration with given effects: the fit, its grade, and the record of the calibration.

The effects become part of the model. Weights of poses, noise and solver are those of the scorer
that would judge the campaign, without a search.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.calibration import accuracy, uncertainty
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.health import health
from pa10cal.calibration.load_case import LoadCase, base_parameters
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.block_rows import weighted_rows
from pa10cal.discovery.blocked_cv.family import computable_shapes
from pa10cal.discovery.blocked_cv.other_baselines import with_tilts_shown
from pa10cal.discovery.blocked_cv.refit import refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.discover import judged_by_blocks
from pa10cal.discovery.evidence.by_repeats import fit_given
from pa10cal.discovery.evidence.fit import covariance_of, targets_off_m
from pa10cal.discovery.evidence.problem import prepare
from pa10cal.discovery.finding import effect_parameters
from pa10cal.discovery.gates import holds_zero
from pa10cal.discovery.gear_lines import gear_lines
from pa10cal.discovery.noise import whitener_of
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, prepared, setup_of
from pa10cal.discovery.rules import MAPS
from pa10cal.discovery.verdict import is_named, label_of
from pa10cal.errors import CalibrationError, remedy_for
from pa10cal.fit.discrepancy import by_uncertain_joints_mm, discrepancy_of, lacking_mm
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel, model_to_plain, models_of
from pa10cal.fit.problem import Solution, identify, not_identifiable
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.quantities import Deviations
from pa10cal.options import DiscoveryOptions
from pa10cal.results.calibration import (
    CalibratedParameter,
    CalibrationRecord,
    Covariance,
    GeneralCalibrationRecord,
    Health,
)
from pa10cal.results.evaluation import BeforeAfter, ResidualRows
from pa10cal.results.record import CampaignIdentity
from pa10cal.terms.effects.effect import (
    CandidateContext,
    Effect,
    every_effect,
    everywhere_but,
    is_effect,
)
from pa10cal.terms.effects.joint import GearLine
from pa10cal.terms.term import Role
from pa10cal.terms.wording import parameters_text

R = TypeVar("R", bound=CalibrationRecord)


@dataclass(frozen=True, eq=False)
class CalibratedWith:
    """A campaign calibrated with effects."""

    model: FittedModel
    poses: Observations  # averaged poses that were fitted, with what the model needs
    found: Deviations  # its deviations there
    flagged: Mask  # (P,) poses with a gross error, or suspected
    ended: FitSummary  # how the fit ended
    health: Health  # whether it is good
    # effects that were given and are not in the model, each with the reason
    without: tuple[str, ...] = ()


def calibrate_with(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    effects: Sequence[EffectOfPlace | Effect],
    suspected: Collection[tuple[str, float]] = (),
    wanted_mm: float | None = None,
) -> CalibratedWith:
    """Fit a calibrated model with effects, and all its parameters again.

    Effects whose amounts are not significantly different from zero are omitted: the data do not
    determine them. Readings with a gross error are excluded, as in a search.

    Args:
        every: single readings of a campaign, of all kinds.
        model: the calibrated model.
        setup: what is known of the campaign besides the poses.
        effects: what to add: effects of a model, or their names and places.
        suspected: poses, with their load [N], that the calibration without effects suspects; like
            readings with a gross error they do not count in the remaining error.
        wanted_mm: standard uncertainty that predicted positions are to have; None for any.

    Raises:
        CalibrationError: when there is no such effect at that place of the arm, or an effect needs
            what is not known.
        DiscoveryError: when there are too few poses, or too little is repeated.
    """
    campaign = prepared(every, model.with_bends(_bent(effects, model.arm)), setup)
    if judged_by_blocks(campaign.trusted):
        fit = _fit_by_blocks(campaign, effects)
    else:
        fit = _fit_by_repeats(campaign, effects)
    if zero := tuple(_may_be_zero(fit.fitted, fit.covariance)):
        names = {(effect.id, effect.of) for effect, _ in zero}
        others = [each for each in effects if (each.id, each.of) not in names]
        found = calibrate_with(every, model, setup, others, suspected, wanted_mm)
        return replace(found, without=(*(why for _, why in zero), *found.without))
    calibrated = replace(fit.fitted.fitted(fit.covariance), targets_off_m=fit.targets_off_m)

    def ready(poses: Observations) -> Observations:
        return complete(poses, campaign.baseline, setup, calibrated)

    poses = ready(average_repeats(campaign.readings))
    deviations = calibrated.deviations(poses)
    labels = zip(poses.pose.tolist(), poses.states.load_N.tolist(), strict=True)
    flagged = np.array([label in suspected for label in labels])
    flagged |= np.bincount(reading_groups(campaign.readings), campaign.gross) > 0.0
    discrepancy = discrepancy_of(calibrated, poses.take(np.flatnonzero(~flagged)))
    calibrated = replace(calibrated, discrepancy=discrepancy)
    held_out = None
    if campaign.held_out is not None:
        held_out_poses, wrong = ready(campaign.held_out), campaign.suspected
        trusted = np.ones(len(held_out_poses), dtype=bool)
        if wrong is not None and not wrong.all():
            trusted = ~wrong
        held_out = accuracy.HeldOut.of(
            calibrated.deviations(held_out_poses),
            HeldOutPlaces.of(held_out_poses, poses),
            trusted,
            poses.readings,
            held_out_poses.readings,
        )
    measured = fit.poses.measured
    noise = np.asarray(np.linalg.inv(np.swapaxes(fit.whitener, 1, 2) @ fit.whitener), np.float64)
    summary = _summary(fit)
    evidence = GradeEvidence(
        ended=summary,
        train_rms_mm=accuracy.summarise(deviations, ~flagged).rms_mm,
        held_out=held_out,
        suspected_outliers=int(flagged.sum()),
        noise_mm=accuracy.position_noise_mm(measured, noise),
        noise_is_found=True,
        discrepancy_mm=lacking_mm(discrepancy, poses.states.q_rad),
        joints_mm=by_uncertain_joints_mm(calibrated.model, calibrated.x, poses),
        spread_mm=measured.spread_mm,
        wanted_mm=wanted_mm,
    )
    return CalibratedWith(calibrated, poses, deviations, flagged, summary, health(evidence))


class _Fit(NamedTuple):
    """The calibrated model with effects, fitted as a scorer fits it."""

    fitted: linear.ModelWithEffects
    poses: Observations  # those fitted, P of them
    covariance: Array  # (k, k) of all unknowns
    whitener: Array  # (P, b, b) of their components
    targets_off_m: Array  # (a,) deviations of stated coordinates of targets


def _fit_by_blocks(campaign: Prepared, wanted: Sequence[EffectOfPlace | Effect]) -> _Fit:
    """Fit effects to a campaign whose poses are read once."""
    survey = Survey.of(campaign)
    rows = weighted_rows(survey, computable_shapes(survey)[0], MAPS.spacings[-1][0])
    whitener, rate = rows.weights.whiteners(), campaign.setup.options.error_rate
    effects = _effects(wanted, survey.context)
    effects = _with_orders(effects, wanted, campaign.baseline, survey.poses, whitener, rate)
    starts = tuple(effect.starts[0] for effect in effects)
    found = refit(survey, effects, starts, rows.weights)
    if tilted := with_tilts_shown(survey, found):
        found = refit(replace(survey, baseline=tilted), effects, starts, rows.weights)
    return _Fit(found, survey.poses, found.covariance, found.weights.whiteners(), np.zeros(0))


def _fit_by_repeats(campaign: Prepared, wanted: Sequence[EffectOfPlace | Effect]) -> _Fit:
    """Fit effects to a campaign whose poses are repeated."""
    baseline, setup, logged = campaign.baseline, campaign.setup, campaign.torques == "logged"
    problem = prepare(campaign.trusted, baseline, setup, torques_logged=logged)
    whitener, rate = whitener_of(problem.cell_cov), setup.options.error_rate
    effects = _effects(wanted, problem.context)
    effects = _with_orders(effects, wanted, baseline, problem.cells, whitener, rate)
    problem, fit = fit_given(problem, effects)
    return _Fit(
        fitted=fit,
        poses=problem.cells,
        covariance=covariance_of(problem, fit),
        whitener=whitener_of(problem.cell_cov),
        targets_off_m=targets_off_m(problem, fit),
    )


def _summary(fit: _Fit) -> FitSummary:
    """Return how a fit ended, without uncertain weights of the arm.

    Those are known to their uncertainty: the poses need not determine them.
    """
    model, measured = fit.fitted.model, fit.poses.measured
    every = (*model.parameters, *measured.target_parameters)
    of_target: Role = "target"
    roles = (*model.roles, *(of_target for _ in measured.target_parameters))
    kept = np.ones(len(every), dtype=bool)
    kept[: len(model.parameters)] = ~model.having("weight")
    parameters = tuple(each for each, stays in zip(every, kept, strict=True) if stays)
    jacobian = linear.residual_and_jacobian(fit.fitted.at, fit.poses)[1][:, :, kept]
    white = fit.whitener @ jacobian
    scale = np.array([parameter.scale for parameter in parameters])
    rank = identify(white.reshape(-1, white.shape[2]), scale)
    converged, x = fit.fitted.converged, fit.fitted.x[: len(kept)][kept]
    why = "the last step was small" if converged else "steps were not enough"
    at_bound = np.zeros(len(parameters), dtype=bool)
    return FitSummary(
        Solution(x, at_bound, 0.0, 0, converged, why),
        pose=fit.poses.pose,
        parameters=parameters,
        roles=tuple(role for role, stays in zip(roles, kept, strict=True) if stays),
        departures=model.departures,
        covariance=fit.covariance[np.ix_(kept, kept)],
        identifiability=rank,
        white=white,
        position_gram=accuracy.gram(accuracy.of_one_target(measured, jacobian)),
        not_identifiable=not_identifiable(rank, parameters),
    )


def _may_be_zero(found: linear.ModelWithEffects, covariance: Array) -> Iterator[tuple[Effect, str]]:
    """Yield the effects whose amounts are not significant, each with a warning."""
    for effect in filter(is_named, found.effects):
        for why in holds_zero(effect, found.fitted(covariance)):
            values = parameters_text(effect_parameters(effect, *found.reported(effect, covariance)))
            yield effect, f"{label_of(effect, None)} is not in the model: {why} ({values})"


def listed(options: CalibrationOptions) -> tuple[EffectOfPlace, ...]:
    """Return the effects that the options list.

    Raises:
        CalibrationError: where they are to be those of a verdict, which is not known here.
    """
    if options.effects == "named":
        raise CalibrationError(
            "the effects that were named are not known",
            where="calibration.effects",
            value="named",
            allowed="the extended model of a search, with --named",
            remedy="give discovery/extended.json with --named, or list the effects",
        )
    return options.effects


def calibrated_with(
    effects: Sequence[EffectOfPlace | Effect],
    record: R,
    case: LoadCase,
    discovery: DiscoveryOptions,
) -> R:
    """Calibrate a load case once more with effects; with none its record is returned as it is.

    Args:
        record: of the load case without effects.

    Raises:
        CalibrationError: where an effect has no such place, or the poses do not determine it.
    """
    if not effects:
        return record
    every, options = case.every, case.options
    fitted = case.rows(every.states) | (every.kind != "grid")
    *_, model = models_of(record, f"calibration of {case.load}").values()
    setup = setup_of(case.campaign, case.arm, options, discovery)
    outliers = record.suspected_outliers if isinstance(record, GeneralCalibrationRecord) else ()
    suspected = {(each.pose, each.load_N) for each in outliers}
    used = every.take(np.flatnonzero(fitted))
    found = calibrate_with(used, model, setup, effects, suspected, options.wanted_uncertainty_mm)
    if not found.model.model.terms_of("effect"):
        return record.model_copy(update={"warnings": (*record.warnings, *found.without)})
    return with_effects(record, found, case.campaign)


def _bent(effects: Sequence[EffectOfPlace | Effect], arm: Arm) -> list[int]:
    """Return the rows, from 1, whose links bend by effects at the joints that follow them."""
    on_links = {kind.id for kind in every_effect() if kind.on_link}
    places = {each.of for each in effects if each.id in on_links}
    return [row for row in range(1, arm.n) if f"joint {row + 1}" in places]


def _effects(
    wanted: Sequence[EffectOfPlace | Effect], context: CandidateContext
) -> tuple[Effect, ...]:
    """Return the wanted effects in the form that suits the campaign."""
    # Scales of three axes may be asked for even if the instrument is not known to have them.
    context = replace(context, three_axes=None)
    known = {
        (effect.id, effect.of): effect for effect in everywhere_but(every_effect(), context, ())
    }
    found = []
    for each in wanted:
        if isinstance(each, Effect):
            found.append(each)
            continue
        if (each.id, each.of) not in known:
            places = [of for kind, of in known if kind == each.id]
            raise CalibrationError(
                f"there is no {each.id} of {each.of}",
                where="calibration.effects",
                value={"id": each.id, "of": each.of},
                allowed=", ".join(places) or "an effect that this arm can have",
                remedy=remedy_for(each.of, places, "correct the place"),
            )
        found.append(known[each.id, each.of])
    return tuple(found)


def _with_orders(
    effects: tuple[Effect, ...],
    wanted: Sequence[EffectOfPlace | Effect],
    at: FittedModel,
    poses: Observations,
    whiten: Array,
    error_rate: float,
) -> tuple[Effect, ...]:
    """Return the effects, where gear lines that are wanted by their place have an order.

    Raises:
        CalibrationError: where the residual of the model has no line at that joint.
    """
    places = {effect.of for effect in effects if effect.id == GearLine.id and effect not in wanted}
    if not places:
        return effects
    rows = linear.WhitenedPoses(at, poses, linear.residual(at, poses), whiten)
    found = {line.of: line for line in gear_lines(rows, error_rate)}
    for place in sorted(places - set(found)):
        raise CalibrationError(
            "no number of cycles a turn stands out in what the model leaves",
            where="calibration.effects",
            value={"id": GearLine.id, "of": place},
            allowed=f"joints with a line: {', '.join(found) or 'none'}",
            remedy="omit the effect, or measure poses at other angles of this joint",
        )
    return tuple(
        found[effect.of] if effect.id == GearLine.id and effect.of in places else effect
        for effect in effects
    )


def with_effects(record: R, found: CalibratedWith, campaign: CampaignIdentity) -> R:
    """Return the record of a calibration, with its last fit replaced by that with effects."""
    about = FittedTo.of(found.poses, record.load, found.health, campaign)
    model = replace(found.model, fitted_to=about)
    load_N = found.poses.states.load_N
    ended, errors = found.ended, dict(record.errors)
    of_trusted = accuracy.summarise_trusted(found.found, found.found, load_N, found.flagged)
    for load, after in accuracy.summarise_by_load(found.found, load_N).items():
        if load in errors:
            before = errors[load].trusted or errors[load]
            trusted = of_trusted.get(load)
            if trusted is not None:
                trusted = BeforeAfter(before=before.before, after=trusted.after)
            update = {"after": after, "trusted": trusted}
            errors[load] = errors[load].model_copy(update=update)
    return record.model_copy(
        update={
            "status": "converged" if ended.solution.converged else "not converged",
            "reason": ended.solution.reason,
            "parameters": _parameters(found),
            "covariance": Covariance(
                names=(*(p.name for p in model.model.parameters), *_BASE), matrix=model.covariance
            ),
            "T_instr_base": model.T_instr_base,
            "fitted_model": model_to_plain(model),
            "rank": ended.identifiability.rank,
            "unknowns": len(ended.parameters),
            "condition": ended.identifiability.condition,
            "singular_values": ended.identifiability.singular_values,
            "errors": errors,
            "residuals": ResidualRows(
                pose=found.poses.pose,
                load_N=load_N,
                place_mm=1e3 * model.model.predict(found.poses.states, model.x)[:, :3, 3],
                position_mm=found.found.position_mm,
                rotation_deg=found.found.rotation_deg,
            ),
            "health": found.health,
            "warnings": (
                *(() if found.health.grade == "good" else (found.health.line,)),
                *found.without,
            ),
        }
    )


_BASE = ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")


def _parameters(found: CalibratedWith) -> dict[str, CalibratedParameter]:
    """Return every parameter with value, standard uncertainty and unit, effects by their place."""
    model, not_found = found.model, found.ended.not_identifiable
    assert model.covariance is not None
    parameters: dict[str, CalibratedParameter] = {}
    for term in model.model.terms:
        columns = model.model.columns_of(term)
        report = term.report(model.x[columns])
        is_open = np.array([each.name in not_found for each in term.parameters], dtype=bool)
        held = names_of(report.parameters, (report.jacobian[:, is_open] != 0.0).any(axis=1))
        covariance = model.covariance[columns, columns]
        of_term = uncertainty.calibrated_parameters(
            report, covariance, held, u_scale=model.model.u_scale
        )
        place = f"{term.id}_{term.of.removeprefix('joint ')}_" if is_effect(term) else ""
        parameters |= {f"{place}{name}": each for name, each in of_term.items()}
    R = model.T_instr_base[:3, :3]
    return parameters | base_parameters(model.T_instr_base, model.covariance[-6:, -6:], R)


@dataclass(frozen=True, eq=False)
class Extended:
    """The calibrated model with the effects that a verdict found missing."""

    model: FittedModel
    seen: AngleCoverage | None = None  # joint angles that its maps were fitted to; None without any
    # times of sudden motions of instrument or base by the verdict [s], the most certain first
    steps_s: tuple[float, ...] = ()
