"""The record of a calibration with given effects: that without them, its last fit replaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.calibration import accuracy
from pa10cal.calibration.fit_summary import FitSummary, names_of
from pa10cal.calibration.load_case import LoadCase, base_parameters
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.calibration.uncertainty import calibrated_parameters
from pa10cal.discovery.given import EffectCalibration, Grading, calibrate_with_effects
from pa10cal.discovery.preparation import setup_of
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.model_reading import models_of
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.observe.instrument import target_coordinates
from pa10cal.options import DiscoveryOptions
from pa10cal.results.calibration import (
    CalibratedParameter,
    CalibrationRecord,
    Covariance,
    GeneralCalibrationRecord,
    LoadErrors,
)
from pa10cal.results.evaluation import BeforeAfter, ResidualRows
from pa10cal.results.record import CampaignIdentity
from pa10cal.terms.effects.effect import Effect, is_effect
from pa10cal.terms.term import Report

R = TypeVar("R", bound=CalibrationRecord)

#: Names of the six parameters of the base frame.
_BASE = ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")


def effects_listed(options: CalibrationOptions) -> tuple[EffectOfPlace, ...]:
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
            remedy="list the effects; the command calibrate reads them from "
            "discovery/extended.json, given with --named",
        )
    return options.effects


def record_with_effects(
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
    of_case = case.rows(every.states) | (every.kind != "grid")
    *_, model = models_of(record, f"calibration of {case.load}").values()
    setup = setup_of(case.campaign, case.arm, options, discovery)
    outliers = record.suspected_outliers if isinstance(record, GeneralCalibrationRecord) else ()
    grading = Grading(
        suspected=frozenset((each.pose, each.load_N) for each in outliers),
        findings=case.findings,
        wanted_mm=options.wanted_uncertainty_mm,
        most_steps=options.max_iterations,
    )
    used = every.take(np.flatnonzero(of_case))
    found = calibrate_with_effects(used, model, setup, effects, grading)
    if not found.model.model.terms_of("effect"):
        return record.model_copy(update={"warnings": (*record.warnings, *found.omitted)})
    return _with_last_fit(record, found, case.campaign)


def _with_last_fit(record: R, found: EffectCalibration, campaign: CampaignIdentity) -> R:
    """Return the record of a calibration, with its last fit replaced by that with effects."""
    before = found.model.fitted_to
    open_targets = () if before is None else before.open_targets
    about = FittedTo.of(found.poses, record.load, found.health, campaign, open_targets=open_targets)
    model, fit, poses = replace(found.model, fitted_to=about), found.fit, found.poses
    of_first_fit = (record.health.line, f"not converged: {record.reason}")
    kept = (warning for warning in record.warnings if warning not in of_first_fit)
    names = (
        *(parameter.name for parameter in model.model.parameters),
        *_BASE,
        *target_coordinates(model.target_names),
    )
    return record.model_copy(
        update={
            "status": "converged" if fit.solution.converged else "not converged",
            "reason": fit.solution.reason,
            "iterations": fit.solution.iterations,
            "parameters": _parameters(found),
            "covariance": Covariance(names=names, matrix=model.covariance),
            "T_instr_base": model.T_instr_base,
            "fitted_model": model_to_plain(model),
            "rank": fit.identifiability.rank,
            "unknowns": len(fit.parameters),
            "condition": fit.identifiability.condition,
            "singular_values": fit.identifiability.singular_values,
            "errors": _errors_by_load(record, found),
            "residuals": ResidualRows(
                pose=poses.pose,
                load_N=poses.states.load_N,
                place_mm=1e3 * model.model.predict(poses.states, model.x)[:, :3, 3],
                position_mm=found.deviations.position_mm,
                rotation_deg=found.deviations.rotation_deg,
            ),
            "health": found.health,
            "warnings": (
                *(() if found.health.grade == "good" else (found.health.line,)),
                *kept,
                *found.omitted,
            ),
        }
    )


def _errors_by_load(record: CalibrationRecord, found: EffectCalibration) -> dict[str, LoadErrors]:
    """Return the errors of a record by load, those after its last fit replaced."""
    deviations, load_N, errors = found.deviations, found.poses.states.load_N, dict(record.errors)
    of_trusted = accuracy.summarise_trusted(deviations, deviations, load_N, found.flagged)
    for load, after in accuracy.summarise_by_load(deviations, load_N).items():
        if load not in errors:
            continue
        trusted = of_trusted.get(load)
        if trusted is not None:
            before = (errors[load].trusted or errors[load]).before
            trusted = BeforeAfter(before=before, after=trusted.after)
        errors[load] = errors[load].model_copy(update={"after": after, "trusted": trusted})
    return errors


def _parameters(found: EffectCalibration) -> dict[str, CalibratedParameter]:
    """Return every parameter with value, standard uncertainty and unit, effects by their place."""
    model, not_identifiable = found.model, found.fit.not_identifiable
    assert model.covariance is not None
    parameters: dict[str, CalibratedParameter] = {}
    for term in model.model.terms:
        columns = model.model.columns_of(term)
        report = term.report(model.x[columns])
        is_open = np.array([each.name in not_identifiable for each in term.parameters], dtype=bool)
        held = names_of(report.parameters, (report.jacobian[:, is_open] != 0.0).any(axis=1))
        of_term = calibrated_parameters(
            report, model.covariance[columns, columns], held, u_scale=model.model.u_scale
        )
        place = f"{term.id}_{term.of.removeprefix('joint ')}_" if is_effect(term) else ""
        parameters |= {f"{place}{name}": each for name, each in of_term.items()}
    R = model.T_instr_base[:3, :3]
    of_base = slice(len(model.x), len(model.x) + len(_BASE))
    base = base_parameters(model.T_instr_base, model.covariance[of_base, of_base], R)
    return parameters | base | _places(found.fit)


def _places(fit: FitSummary) -> dict[str, CalibratedParameter]:
    """Return the coordinates of targets that were fitted."""
    at = np.flatnonzero([role == "target" for role in fit.roles])
    report = Report(tuple(fit.parameters[k] for k in at), fit.solution.x[at], np.eye(len(at)))
    return calibrated_parameters(report, fit.covariance[np.ix_(at, at)], fit.not_identifiable)
