"""Calibration with given effects: the fit and its grade.

The effects become part of the model. Weights of poses, noise and solver are those of the scorer
that would judge the campaign, without a search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.calibration import accuracy
from pa10cal.calibration.fit_summary import FitSummary
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.health import health
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.calibration.uncertainty import scatter_of_repeats
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.block_rows import weighted_rows
from pa10cal.discovery.blocked_cv.family import computable_shapes
from pa10cal.discovery.blocked_cv.other_baselines import with_tilts_shown
from pa10cal.discovery.blocked_cv.refit import refit
from pa10cal.discovery.blocked_cv.survey import Survey, judged_by_blocks
from pa10cal.discovery.credible_amounts import holds_zero
from pa10cal.discovery.evidence.by_repeats import fit_given
from pa10cal.discovery.evidence.fit import covariance_of, targets_off_m
from pa10cal.discovery.evidence.problem import prepare
from pa10cal.discovery.finding import effect_parameters, is_named, label_of
from pa10cal.discovery.gear_lines import gear_lines
from pa10cal.discovery.model_with_effects import ModelWithEffects, held_unknowns, with_targets_off
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, prepared
from pa10cal.discovery.rules import MAPS
from pa10cal.errors import CalibrationError, remedy_for
from pa10cal.fit.discrepancy import by_uncertain_joints_mm, discrepancy_of, lacking_mm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import of_one_target, position_noise_mm
from pa10cal.fit.problem import Solution, identify, not_identifiable
from pa10cal.fit.weighed_arm import weighed_model
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.quantities import Deviations
from pa10cal.results.calibration import (
    Health,
    InputFinding,
)
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.vocabulary import every_effect, everywhere_but
from pa10cal.terms.term import Role
from pa10cal.terms.wording import parameters_text


class Grading(NamedTuple):
    """What a grade rests on besides the fit, and how many steps the fit may take."""

    # poses, with their load [N], that the calibration without effects suspects; like readings with
    # a gross error they do not count in the remaining error
    suspected: frozenset[tuple[str, float]] = frozenset()
    findings: tuple[InputFinding, ...] = ()  # of the checks of the input
    # standard uncertainty that predicted positions are to have; None for any
    wanted_mm: float | None = None
    most_steps: int = CalibrationOptions().max_iterations


THE_FIT_ALONE = Grading()


@dataclass(frozen=True, eq=False)
class EffectCalibration:
    """A campaign calibrated with effects."""

    model: FittedModel
    poses: Observations  # averaged poses that were fitted, with what the model needs
    deviations: Deviations  # of the model there
    flagged: Mask  # (P,) poses with a gross error, or suspected
    fit: FitSummary  # how the fit ended
    health: Health  # its grade
    # warnings about effects that were given and are not in the model, each with the reason
    omitted: tuple[str, ...] = ()


def calibrate_with_effects(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    effects: Sequence[EffectOfPlace | Effect],
    grading: Grading = THE_FIT_ALONE,
) -> EffectCalibration:
    """Fit a calibrated model with effects, and all its parameters again.

    Effects whose amounts are not significantly different from zero are omitted: the data do not
    determine them. Readings with a gross error are excluded, as in a search.

    Args:
        every: single readings of a campaign, of all kinds.
        model: the calibrated model.
        setup: what is known of the campaign besides the poses.
        effects: what to add: effects of a model, or their names and places.
        grading: what the grade rests on besides the fit, and how many steps that may take.

    Raises:
        CalibrationError: when there is no such effect at that place of the arm, or an effect needs
            what is not known.
        DiscoveryError: when there are too few poses, or too little is repeated.
    """
    effects = tuple(dict.fromkeys(effects))  # an effect that is listed twice is there once
    campaign = prepared(every, model.with_bends(_bent_links(effects, model.arm)), setup)
    by_blocks = judged_by_blocks(campaign.trusted)
    fit_by = _fit_by_blocks if by_blocks else _fit_by_repeats
    fit = fit_by(campaign, effects, grading.most_steps)
    zero = dict(_may_be_zero(fit))
    if not zero:
        return _graded(campaign, fit, grading)
    names = {(effect.id, effect.of) for effect in zero}
    others = [each for each in effects if (each.id, each.of) not in names]
    found = calibrate_with_effects(every, model, setup, others, grading)
    return replace(found, omitted=(*zero.values(), *found.omitted))


def _bent_links(effects: Sequence[EffectOfPlace | Effect], arm: Arm) -> list[int]:
    """Return the rows, from 1, whose links bend by effects at the joints that follow them."""
    on_links = {kind.id for kind in every_effect() if kind.on_link_before}
    places = {each.of for each in effects if each.id in on_links}
    return [row for row in range(1, arm.n) if f"joint {row + 1}" in places]


# The fit, with the weights of poses, the noise and the solver of either scorer.


class _Fit(NamedTuple):
    """The calibrated model with effects, fitted as a scorer fits it."""

    extended: ModelWithEffects
    poses: Observations  # those fitted, P of them
    held: Mask  # (k,) unknowns that the fit holds, or that no reading shows
    covariance: Array  # (k, k) of all unknowns
    whitener: Array  # (P, b, b) of their components
    noise_cov: Array  # (P, b, b) of what the readings' noise does to them, and not the model
    noise_is_found: bool  # whether that is estimated from repeats, and not stated
    targets_off_m: Array  # (a,) deviations of stated coordinates of targets


def _fit_by_blocks(
    campaign: Prepared, wanted: Sequence[EffectOfPlace | Effect], most_steps: int
) -> _Fit:
    """Fit effects to a campaign whose poses are read once."""
    survey = Survey.of(campaign)
    rows = weighted_rows(survey, computable_shapes(survey)[0], MAPS.spacings[-1][0])
    effects = _effects(wanted, survey.context, campaign, survey.poses, rows.weights.whiteners())
    starts = tuple(effect.starts[0] for effect in effects)
    found = refit(survey, effects, starts, rows.weights, most_steps=most_steps)
    if tilted := with_tilts_shown(survey, found):
        survey = replace(survey, baseline=tilted)
        found = refit(survey, effects, starts, rows.weights, most_steps=most_steps)
    return _Fit(
        extended=found,
        poses=survey.poses,
        held=held_unknowns(survey.baseline, found.model, survey.poses.measured),
        covariance=found.covariance,
        whitener=found.weights.whiteners(),
        # The weights follow the residuals: they have what the model lacks, too.
        noise_cov=survey.poses.measured.stated_covariance,
        noise_is_found=False,
        targets_off_m=np.zeros(0),
    )


def _fit_by_repeats(
    campaign: Prepared, wanted: Sequence[EffectOfPlace | Effect], most_steps: int
) -> _Fit:
    """Fit effects to a campaign whose poses are repeated."""
    baseline, setup, logged = campaign.baseline, campaign.setup, campaign.torques == "logged"
    problem = prepare(campaign.trusted, baseline, setup, torques_logged=logged)
    whitener = whitener_of(problem.cell_cov)
    effects = _effects(wanted, problem.context, campaign, problem.cells, whitener)
    problem, fit = fit_given(problem, effects, most_steps)
    return _Fit(
        extended=fit,
        poses=problem.cells,
        held=held_unknowns(baseline, fit.model, problem.cells.measured),
        covariance=covariance_of(problem, fit),
        whitener=whitener_of(problem.cell_cov),
        noise_cov=problem.cell_cov,
        noise_is_found=True,
        targets_off_m=targets_off_m(problem, fit),
    )


def _effects(
    wanted: Sequence[EffectOfPlace | Effect],
    context: CandidateContext,
    campaign: Prepared,
    poses: Observations,
    whitener: Array,
) -> tuple[Effect, ...]:
    """Return the wanted effects in the form that suits the campaign.

    Lines of gears get their cycles a turn from the residual of the calibrated model, in poses (P,)
    that whiteners (P, b, b) make white.

    Raises:
        CalibrationError: where the arm has no such effect, or the residual no line of that joint.
    """
    # Scales of three axes may be asked for even if the instrument is not known to have them.
    context = replace(context, three_axes=None)
    possible = {(e.id, e.of): e for e in everywhere_but(every_effect(), context, ())}
    lines: dict[str, Effect] = {}
    if any(each.id == GearLine.id and isinstance(each, EffectOfPlace) for each in wanted):
        residual = campaign.baseline.compared(poses).residual
        rows = jacobians.WhitenedPoses(campaign.baseline, poses, residual, whitener)
        lines = {line.of: line for line in gear_lines(rows, campaign.setup.options.error_rate)}
    found = []
    for each in wanted:
        if not isinstance(each, EffectOfPlace):
            found.append(each)
        elif (each.id, each.of) not in possible:
            raise _no_such_place(each, [of for kind, of in possible if kind == each.id])
        elif each.id != GearLine.id:
            found.append(possible[each.id, each.of])
        elif each.of in lines:
            found.append(lines[each.of])
        else:
            raise CalibrationError(
                "no number of cycles a turn stands out in what the model leaves",
                where="calibration.effects",
                value={"id": each.id, "of": each.of},
                allowed=f"joints with a line: {', '.join(lines) or 'none'}",
                remedy="omit the effect, or measure poses at other angles of this joint",
            )
    return tuple(found)


def _no_such_place(wanted: EffectOfPlace, places: Sequence[str]) -> CalibrationError:
    """Return the refusal of an effect that the arm can have at some places only."""
    return CalibrationError(
        f"there is no {wanted.id} of {wanted.of}",
        where="calibration.effects",
        value={"id": wanted.id, "of": wanted.of},
        allowed=", ".join(places) or "an effect that this arm can have",
        remedy=remedy_for(wanted.of, places, "correct the place"),
    )


def _may_be_zero(fit: _Fit) -> Iterator[tuple[Effect, str]]:
    """Yield the effects whose amounts are not significant, each with a warning."""
    extended, covariance = fit.extended, fit.covariance
    for effect in filter(is_named, extended.effects):
        for why in holds_zero(effect, extended.fitted(covariance)):
            values = parameters_text(
                effect_parameters(effect, *extended.reported(effect, covariance))
            )
            yield effect, f"{label_of(effect, None)} is not in the model: {why} ({values})"


# The grade of the fit.


def _graded(campaign: Prepared, fit: _Fit, grading: Grading) -> EffectCalibration:
    """Return the calibration by a fit, with its grade."""
    fitted, apparatus_m = fit.extended.fitted(fit.covariance), campaign.setup.apparatus_m
    model = with_targets_off(fitted, fit.targets_off_m, apparatus_m, fit.poses)
    readings = campaign.readings
    # Predictions have the weights that the log shows about the postures of this very model.
    model = weighed_model(model, readings)
    poses = complete(average_repeats(readings), campaign.baseline, campaign.setup, model)
    labels = zip(poses.pose.tolist(), poses.states.load_N.tolist(), strict=True)
    flagged = np.array([label in grading.suspected for label in labels])
    flagged |= np.bincount(reading_groups(readings), campaign.gross) > 0.0
    single = complete(campaign.trusted, campaign.baseline, campaign.setup, model)
    discrepancy = discrepancy_of(model, poses.take(np.flatnonzero(~flagged)), readings=single)
    model = replace(model, discrepancy=discrepancy)
    deviations, summary, measured = model.deviations(poses), _summary(fit), fit.poses.measured
    evidence = GradeEvidence(
        ended=summary,
        train_rms_mm=accuracy.summarise(deviations, ~flagged).rms_mm,
        held_out=_held_out_errors(campaign, model, poses),
        suspected_outliers=int(flagged.sum()),
        noise_mm=position_noise_mm(measured, fit.noise_cov),
        noise_is_found=fit.noise_is_found,
        repeats=() if fit.noise_is_found else scatter_of_repeats(single, model),
        discrepancy_mm=lacking_mm(discrepancy, poses.states.q_rad),
        joints_mm=by_uncertain_joints_mm(model.model, model.x, poses),
        spread_mm=measured.spread_mm,
        findings=grading.findings,
        wanted_mm=grading.wanted_mm,
    )
    return EffectCalibration(model, poses, deviations, flagged, summary, health(evidence))


def _held_out_errors(
    campaign: Prepared, model: FittedModel, fitted: Observations
) -> accuracy.HeldOut | None:
    """Return the errors of held-out poses, without suspected ones unless all are; None for none."""
    if campaign.held_out is None:
        return None
    held_out = complete(campaign.held_out, campaign.baseline, campaign.setup, model)
    trusted = np.ones(len(held_out), dtype=bool)
    if campaign.suspected is not None and not campaign.suspected.all():
        trusted = ~campaign.suspected
    places = HeldOutPlaces.of(held_out, fitted)
    return accuracy.HeldOut.of(
        model.deviations(held_out), places, trusted, fitted.readings, held_out.readings
    )


def _summary(fit: _Fit) -> FitSummary:
    """Return how a fit ended, without what it holds and without uncertain weights of the arm.

    Those are known to their uncertainty: the poses need not determine them.
    """
    model, measured = fit.extended.model, fit.poses.measured
    every = (*model.parameters, *measured.target_parameters)
    of_target: Role = "target"
    roles = (*model.roles, *(of_target for _ in measured.target_parameters))
    kept = np.ones(len(every), dtype=bool)
    kept[: len(model.parameters)] = ~model.having("weight")
    kept &= ~fit.held[: len(kept)]
    parameters = tuple(each for each, stays in zip(every, kept, strict=True) if stays)
    jacobian = jacobians.residual_and_jacobian(fit.extended.at, fit.poses)[1][:, :, kept]
    white = fit.whitener @ jacobian
    scale = np.array([parameter.scale for parameter in parameters])
    rank = identify(white.reshape(-1, white.shape[2]), scale)
    converged, x = fit.extended.converged, fit.extended.x[: len(kept)][kept]
    count = fit.extended.iterations
    why = "the last step was small" if converged else f"{count} steps were not enough"
    at_bound = np.zeros(len(parameters), dtype=bool)
    return FitSummary(
        Solution(x, at_bound, 0.0, count, converged, why),
        pose=fit.poses.pose,
        parameters=parameters,
        roles=tuple(role for role, stays in zip(roles, kept, strict=True) if stays),
        departures=model.departures,
        covariance=fit.covariance[np.ix_(kept, kept)],
        identifiability=rank,
        white=white,
        position=of_one_target(measured, jacobian),
        not_identifiable=not_identifiable(rank, parameters),
    )
