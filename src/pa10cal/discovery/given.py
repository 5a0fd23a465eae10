"""The calibrated model with effects that are given, fitted to a campaign as a search would fit it.

What was named becomes part of the model: the weights, the noise and the solver are those of the
scorer that would judge the campaign, and nothing is searched.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.calibration import uncertainty
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.health import GradeEvidence, health
from pa10cal.calibration.load_case import LoadCase, base_parameters
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.discovery.blocked_cv.family import computable_shapes
from pa10cal.discovery.blocked_cv.refit import refit, weighted_rows, with_tilts_shown
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.discover import judged_by_blocks
from pa10cal.discovery.evidence.by_repeats import fit_given
from pa10cal.discovery.evidence.problem import covariance_of, prepare, targets_off_m
from pa10cal.discovery.finding import effect_parameters
from pa10cal.discovery.gates import holds_zero
from pa10cal.discovery.gear_lines import gear_lines
from pa10cal.discovery.linear import ModelWithEffects, residual, residual_and_jacobian
from pa10cal.discovery.noise import whitener_of
from pa10cal.discovery.preparation import MeasurementSetup, complete_about, prepared, setup_of
from pa10cal.discovery.rules import MAPS
from pa10cal.discovery.verdict import is_named, label_of
from pa10cal.errors import CalibrationError, remedy_for
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel, model_to_plain, models_of
from pa10cal.fit.identifiability import identify, not_identifiable
from pa10cal.fit.problem import Solution
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.order import HeldOutPlaces
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
from pa10cal.terms.wording import sized


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
    """Fit a calibrated model with effects, all parameters anew.

    Effects that may as well be zero are not in it: it would follow amounts that nothing determines.
    Readings with a gross error are out of the fit, as they are out of a search.

    Args:
        every: single readings of a campaign, of all kinds.
        model: the calibrated model.
        setup: what is known of the campaign besides the poses.
        effects: what to add: effects of a model, or their names and places.
        suspected: poses, with their load [N], that the calibration without effects suspects; like
            readings with a gross error they have no part in the remaining error.
        wanted_mm: standard uncertainty that predicted positions are to have; None for any.

    Raises:
        CalibrationError: when there is no such effect at that place of the arm, or an effect needs
            what is not known.
        DiscoveryError: when there are too few poses, or too little is repeated.
    """
    campaign = prepared(every, model.with_bends(_bent(effects, model.arm)), setup)
    fitted: ModelWithEffects
    readings = campaign.trusted
    if judged_by_blocks(readings):
        judged = Survey.of(campaign)
        chosen = _effects(effects, judged.context)
        rows = weighted_rows(judged, computable_shapes(judged)[0], MAPS.spacings[-1][0])
        rate, whiten = setup.options.error_rate, rows.weights.whiteners()
        chosen = _with_cycles(chosen, effects, campaign.baseline, judged.poses, whiten, rate)
        starts = tuple(effect.starts[0] for effect in chosen)
        found = refit(judged, chosen, starts, rows.weights)
        if tilted := with_tilts_shown(judged, found):
            found = refit(replace(judged, baseline=tilted), chosen, starts, rows.weights)
        fitted = found
        used, covariance = judged.poses, found.covariance
        whitener, off_m = found.weights.whiteners(), np.zeros(0)
    else:
        logged = campaign.torques == "logged"
        problem = prepare(readings, campaign.baseline, setup, torques_logged=logged)
        chosen, whiten = _effects(effects, problem.context), whitener_of(problem.cell_cov)
        at, rate = campaign.baseline, setup.options.error_rate
        chosen = _with_cycles(chosen, effects, at, problem.cells, whiten, rate)
        problem, fit = fit_given(problem, chosen)
        fitted, used = fit, problem.cells
        covariance, off_m = covariance_of(problem, fit), targets_off_m(problem, fit)
        whitener = whitener_of(problem.cell_cov)
    calibrated = replace(fitted.fitted(covariance), targets_off_m=off_m)
    if zero := tuple(_may_be_zero(fitted, covariance)):
        gone = {(effect.id, effect.of) for effect, _ in zero}
        rest = [each for each in effects if (each.id, each.of) not in gone]
        others = calibrate_with(every, model, setup, rest, suspected, wanted_mm)
        return replace(others, without=(*(why for _, why in zero), *others.without))

    def ready(poses: Observations) -> Observations:
        return complete_about(poses, campaign.baseline, calibrated, setup)

    poses = ready(average_repeats(campaign.readings))
    deviations = calibrated.deviations(poses)
    labels = zip(poses.pose.tolist(), poses.states.load_N.tolist(), strict=True)
    flagged = np.array([label in suspected for label in labels])
    flagged |= np.bincount(reading_groups(campaign.readings), campaign.gross) > 0.0
    calibrated = replace(
        calibrated, discrepancy=discrepancy_of(calibrated, poses.take(np.flatnonzero(~flagged)))
    )
    held_out = None
    if campaign.held_out is not None:
        away, wrong = ready(campaign.held_out), campaign.suspected
        trusted = np.ones(len(away), dtype=bool)
        if wrong is not None and not wrong.all():
            trusted = ~wrong
        held_out = uncertainty.HeldOut.of(
            calibrated.deviations(away),
            HeldOutPlaces.of(away, poses),
            trusted,
            poses.readings,
            away.readings,
        )
    noise = np.asarray(np.linalg.inv(np.swapaxes(whitener, 1, 2) @ whitener), dtype=np.float64)
    jacobian = residual_and_jacobian(fitted.at, used)[1]
    every_parameter = (*fitted.model.parameters, *used.measured.target_parameters)
    # Weights that nobody stated exactly are known to their uncertainty: poses need not show them.
    kept = np.ones(len(every_parameter), dtype=bool)
    kept[: len(fitted.model.parameters)] = ~fitted.model.having("weight")
    parameters = tuple(each for each, stays in zip(every_parameter, kept, strict=True) if stays)
    of_target: Role = "target"
    roles = (*fitted.model.roles, *(of_target for _ in used.measured.target_parameters))
    jacobian, x = jacobian[:, :, kept], fitted.x[: len(kept)][kept]
    white = whitener @ jacobian
    scale = np.array([parameter.scale for parameter in parameters])
    rank = identify(white.reshape(-1, white.shape[2]), scale)
    why = "the last step was small" if fitted.converged else "steps were not enough"
    free = np.zeros(len(parameters), dtype=bool)
    ended = FitSummary(
        Solution(x, free, 0.0, 0, fitted.converged, why),
        pose=used.pose,
        parameters=parameters,
        roles=tuple(role for role, stays in zip(roles, kept, strict=True) if stays),
        departures=fitted.model.departures,
        covariance=covariance[np.ix_(kept, kept)],
        identifiability=rank,
        white=white,
        position_gram=uncertainty.gram(uncertainty.of_one_target(used.measured, jacobian)),
        not_identifiable=not_identifiable(rank, parameters),
    )
    evidence = GradeEvidence(
        ended=ended,
        train_rms_mm=uncertainty.summarise(deviations, ~flagged).rms_mm,
        held_out=held_out,
        suspected_outliers=int(flagged.sum()),
        noise_mm=uncertainty.position_noise_mm(used.measured, noise),
        noise_is_found=True,
        spread_mm=used.measured.spread_mm,
        wanted_mm=wanted_mm,
    )
    return CalibratedWith(calibrated, poses, deviations, flagged, ended, health(evidence))


def _may_be_zero(found: ModelWithEffects, covariance: Array) -> Iterator[tuple[Effect, str]]:
    """Yield the names whose amounts may as well be zero, and how it is said."""
    for effect in filter(is_named, found.effects):
        for why in holds_zero(effect, found.fitted(covariance)):
            values = sized(effect_parameters(effect, *found.reported(effect, covariance)))
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
    fitted = case.rows(every.states.load_N) | (every.kind != "grid")
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
    """Return the effects that are wanted, in the form that the campaign gives them."""
    # Whoever names scales of three axes may know that a machine with three axes measured.
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


def _with_cycles(
    chosen: tuple[Effect, ...],
    asked: Sequence[EffectOfPlace | Effect],
    at: FittedModel,
    poses: Observations,
    whiten: Array,
    error_rate: float,
) -> tuple[Effect, ...]:
    """Return effects with the cycles of lines of gears that were asked for by their place alone.

    Raises:
        CalibrationError: where what the model leaves has no line at that joint.
    """
    places = {each.of for each in chosen if each.id == GearLine.id and each not in asked}
    if not places:
        return chosen
    lines = gear_lines(at, poses, residual(at, poses), whiten, error_rate)
    found = {line.of: line for line in lines}
    for place in sorted(places - set(found)):
        raise CalibrationError(
            "no number of cycles a turn stands out in what the model leaves",
            where="calibration.effects",
            value={"id": GearLine.id, "of": place},
            allowed=f"joints with a line: {', '.join(found) or 'none'}",
            remedy="omit the effect, or measure poses at other angles of this joint",
        )
    return tuple(
        found[each.of] if each.id == GearLine.id and each.of in places else each for each in chosen
    )


# The record of a calibration with effects: that without them, its fit replaced.

R = TypeVar("R", bound=CalibrationRecord)


def with_effects(record: R, found: CalibratedWith, campaign: CampaignIdentity) -> R:
    """Return the record of a calibration whose last fit is that with effects."""
    about = FittedTo.of(found.poses, record.load, found.health, campaign)
    model = replace(found.model, fitted_to=about)
    load_N = found.poses.states.load_N
    ended, errors = found.ended, dict(record.errors)
    less = uncertainty.summarise_trusted(found.found, found.found, load_N, found.flagged)
    for load, after in uncertainty.summarise_by_load(found.found, load_N).items():
        if load in errors:
            before = errors[load].trusted or errors[load]
            trusted = less.get(load)
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
    model, openly = found.model, found.ended.not_identifiable
    assert model.covariance is not None
    parameters: dict[str, CalibratedParameter] = {}
    for term in model.model.terms:
        columns = model.model.columns_of(term)
        report = term.report(model.x[columns])
        is_open = np.array([parameter.name in openly for parameter in term.parameters], dtype=bool)
        held = names_of(report.parameters, (report.jacobian[:, is_open] != 0.0).any(axis=1))
        covariance = model.covariance[columns, columns]
        of_term = uncertainty.calibrated_parameters(
            report, covariance, held, u_scale=model.model.u_scale
        )
        place = f"{term.id}_{term.of.removeprefix('joint ')}_" if is_effect(term) else ""
        parameters |= {f"{place}{name}": each for name, each in of_term.items()}
    R = model.T_instr_base[:3, :3]
    return parameters | base_parameters(model.T_instr_base, model.covariance[-6:, -6:], R)


# The calibrated model with the effects that were found missing.


@dataclass(frozen=True, eq=False)
class Extended:
    """The model with the effects that were missing."""

    model: FittedModel
    # joint angles that its maps have learnt from; None where it has learnt nothing that stops
    # there
    seen: AngleCoverage | None = None
    # times at which the verdict has it that instrument or base moved suddenly [s], the most certain
    # first
    steps_s: tuple[float, ...] = ()
