"""`calibration/<load>.json` of the paper's model, and what it shares with the general one's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import (
    Calibration,
    fitted_model,
    pull_beyond_bounds,
    weak_directions,
)
from pa10cal.calibration.levels import report_base
from pa10cal.calibration.load_case import LoadCase, model_deviations
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import summarise_by_load
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import observability
from pa10cal.fit.model_file import model_from_plain, model_to_plain
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.results.calibration import (
    CalibratedParameter,
    CalibrationRecord,
    Covariance,
    Fit,
    InnerDependence,
    LinearFit,
    OneLevel,
    PaperCalibrationRecord,
    PaperErrors,
    SeedDifference,
    WeakDirection,
)
from pa10cal.results.evaluation import Accuracy, ResidualRows
from pa10cal.results.health import Health
from pa10cal.results.record import Campaign
from pa10cal.terms.term import Report

#: The straight lines give the base frame to about the nominal model's own error, near 1 deg.
_FAR_FROM_SEED_DEG = 3.0
#: Standard uncertainties beyond a bound that noise reaches in one case of twenty.
_PULL_OF_NOISE = 2.0
#: Root mean square error over that of the noise above which the model lacks something.
_INCOMPLETE = 3.0


def paper_record(
    case: LoadCase, campaign: Campaign, payload: Payload | None, settings: CalibrationOptions
) -> PaperCalibrationRecord:
    """Return the record of a load case computed with the paper's model.

    Args:
        case: the load case.
        campaign: whose it is.
        payload: what the arm carried; None where that is not known.
        settings: what it was computed with.
    """
    cubic, model = case.cubic, case.cubic.level.model
    solved = [parameter.name for parameter in model.parameters]
    reported = [parameter.name for parameter in model.report(cubic.solution.x).parameters]
    after = _after(cubic, case.grid)
    about = fitted_to(cubic.level.observations, case.load, case.health, campaign)
    before, from_seed = by_load(case.before), by_load(case.before_seed_frame)
    return PaperCalibrationRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        robot=campaign.robot,
        load=case.load,
        loads_fitted=_loads(cubic.level.observations),
        **_fit_keys(cubic, payload, about),
        rank=cubic.identifiability.rank,
        unknowns=len(cubic.identifiability.singular_values),
        condition=cubic.identifiability.condition,
        singular_values=cubic.identifiability.singular_values,
        null_directions=tuple(each.weights for each in cubic.unidentified_directions),
        weak_directions=tuple(
            WeakDirection(std_over_tolerance=size, weights=direction.weights)
            for size, direction in weak_directions(cubic)
        ),
        observability=observability(cubic.identifiability, len(cubic.level.observations)),
        errors={
            load: PaperErrors(
                before=before[load], before_seed_frame=from_seed[load], after=after[load]
            )
            for load in after
        },
        inner_poses=tuple(cubic.inner_poses),
        inner_dependence=InnerDependence(
            choices=case.dependence.choices,
            std=dict(zip(reported, case.dependence.std.tolist(), strict=True)),
            mean_mm=case.dependence.mean_mm,
        ),
        one_level=OneLevel(
            largest_difference=case.one_level.largest_difference,
            mean_mm=case.one_level.mean_mm,
            shift_over_std=dict(zip(solved, case.one_level.shift.tolist(), strict=True)),
        ),
        seed_difference=SeedDifference(
            angle_deg=case.seed_angle_deg, distance_mm=case.seed_distance_mm
        ),
        linear=LinearFit(
            **_fit_keys(case.linear, payload, about), after=_after(case.linear, case.grid)
        ),
        l_curve=case.l_curve,
        residuals=_residuals(case),
        health=case.health,
        warnings=_warnings(case),
        seconds=None,
        settings=settings.model_dump(mode="json"),
    )


def parameter_records(calibration: Calibration) -> dict[str, CalibratedParameter]:
    """Return every parameter with value, standard uncertainty, unit and tolerance.

    A parameter of a direction that is not identifiable is held by its tolerance term alone, so
    its tolerance is given as its uncertainty.
    """
    outer = calibration.level.model.report(calibration.solution.x)
    base = report_base(calibration.T_instr_base)
    covariances = calibration.covariances
    at_bound = _at_bound(calibration, outer)
    return {
        name: CalibratedParameter(
            **(keys if name not in calibration.not_identifiable else _held(keys)),
            identifiable=name not in calibration.not_identifiable,
            at_bound=name in at_bound,
        )
        for report, covariance in ((outer, covariances.parameters), (base, covariances.base))
        for name, keys in reported_keys(report, covariance).items()
    }


def reported_keys(report: Report, covariance: Array) -> dict[str, dict[str, Any]]:
    """Return value, standard uncertainty, unit and tolerance of reported parameters, by name.

    Args:
        report: k parameters, and their derivative by the m solved ones.
        covariance: (m, m) of those solved.
    """
    std = np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T))
    return {
        parameter.name: {
            "value": float(value),
            "std": float(sigma),
            "unit": parameter.unit,
            "tolerance": parameter.tolerance,
        }
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def models_of(record: CalibrationRecord, where: str) -> dict[str, FittedModel]:
    """Return the fitted models of a calibration by the names under which they are evaluated.

    Args:
        record: what `calibration/<load>.json` holds; the last model is the calibration itself.
        where: file that it was read from, for messages.

    Raises:
        ModelError: when a model cannot be made of what is written.
        TermError: when it has a term that is not known.
    """
    return {
        name: _model_of(fit, f"{where}: fitted_model of {name}")
        for name, fit in record.fits_by_model.items()
    }


def calibration_options(record: CalibrationRecord, where: str) -> CalibrationOptions:
    """Return the options that a calibration was computed with.

    Raises:
        SettingsError: when they are none.
    """
    from pa10cal.settings_reading import parse_section

    return parse_section(CalibrationOptions, record.settings, where=where)


def _model_of(fit: Fit, where: str) -> FittedModel:
    """Return the model of a fit, with the covariance of the parameters it is solved in."""
    model = model_from_plain(fit.fitted_model, FittedModel, where=where)
    names, matrix = fit.covariance.names, fit.covariance.matrix
    solved = tuple(parameter.name for parameter in model.model.parameters)
    report = model.model.report(model.x)
    k = len(solved)
    covariance = np.zeros((k + 6, k + 6))
    if names[:k] == solved:
        base = [name.replace(".", "_") for name in BASE]
        known = [names.index(name) for name in (*solved, *base) if name in names]
        at = [*range(k), *(k + base.index(name) for name in names if name in base)]
        covariance[np.ix_(at, at)] = matrix[np.ix_(known, known)]
    elif names == tuple(parameter.name for parameter in report.parameters):
        back = np.linalg.pinv(report.jacobian)
        covariance[:k, :k] = back @ matrix @ back.T
    else:
        return model
    return replace(model, covariance=covariance)


def fitted_to(
    observations: Observations, load: str, health: Health, campaign: Campaign
) -> FittedTo:
    """Return what a model was fitted to.

    Args:
        observations: the poses fitted.
        load: load case.
        health: of the calibration.
        campaign: whose poses they are.
    """
    states = observations.states
    return FittedTo(
        campaign=campaign.name,
        provenance=campaign.provenance,
        calibration=load,
        instrument=" and ".join(observations.measured.kinds),
        poses=len(observations),
        temperature_C=float(states.temperature_C.mean()),
        time_s=(float(states.time_s.min()), float(states.time_s.max())),
        grade=health.grade,
        health=health.line,
        suspicions=health.findings,
        loads_N=tuple(map(float, np.unique(states.load_N))),
    )


def by_load(accuracies: dict[float, Accuracy]) -> dict[str, Accuracy]:
    """Return accuracies keyed by load as `0N`, `22N`, …, as the files are named."""
    return {f"{load:g}N": accuracy for load, accuracy in accuracies.items()}


def _fit_keys(calibration: Calibration, payload: Payload | None, about: FittedTo) -> dict[str, Any]:
    """Return how a fit ended, its parameters and its base frame."""
    fitted = replace(fitted_model(calibration, payload), fitted_to=about)
    solution = calibration.solution
    report = calibration.level.model.report(solution.x)
    return {
        "status": "converged" if calibration.converged else "not converged",
        "reason": solution.reason,
        "cost": solution.cost,
        "iterations": solution.iterations,
        "starts": len(calibration.starts),
        "starts_agreeing": calibration.starts_agreeing,
        "parameters": parameter_records(calibration),
        "covariance": Covariance(
            names=tuple(parameter.name for parameter in report.parameters),
            matrix=report.jacobian @ calibration.covariances.parameters @ report.jacobian.T,
        ),
        "T_instr_base": calibration.T_instr_base,
        "fitted_model": model_to_plain(fitted),
    }


def _after(calibration: Calibration, grid: Observations[Pose]) -> dict[str, Accuracy]:
    """Return the errors on the grid poses of every load, whether the fit used them or not."""
    return by_load(summarise_by_load(model_deviations(calibration, grid), grid.states.load_N))


def _loads(poses: Observations[Pose]) -> tuple[float, ...]:
    return tuple(np.unique(poses.states.load_N).tolist())


def _held(keys: dict[str, Any]) -> dict[str, Any]:
    return {**keys, "std": keys["tolerance"]}


def _residuals(case: LoadCase) -> ResidualRows:
    """Return place, position and rotation residual of every grid pose, along base axes."""
    T_base_ee = case.cubic.level.model.predict(case.grid.states, case.cubic.solution.x)
    return ResidualRows(
        pose=case.grid.pose,
        load_N=case.grid.states.load_N,
        place_mm=1e3 * T_base_ee[:, :3, 3],
        position_mm=case.residuals.position_mm,
        rotation_deg=case.residuals.rotation_deg,
    )


def _warnings(case: LoadCase) -> tuple[str, ...]:
    """Return what a reader should know before trusting the fit."""
    cubic, found = case.cubic, []
    if not cubic.converged:
        found.append(f"not converged: {cubic.solution.reason}")
    bound = sorted(_at_bound(cubic, cubic.level.model.report(cubic.solution.x)))
    if bound:
        pull = float(pull_beyond_bounds(cubic).max())
        meaning = (
            "the data fit best with a stiffness that is not positive, as happens when an effect is "
            "missing from the model"
            if pull > _PULL_OF_NOISE
            else "indistinguishable from the bound with these data"
        )
        found.append(
            f"{', '.join(bound)} at the end of the physical range, {pull:.1f} standard "
            f"uncertainties beyond it: {meaning}"
        )
    over = _over_repeats(case)
    if over > _INCOMPLETE:
        found.append(
            f"the remaining error is {over:.0f} times the noise of the readings: the model is "
            "incomplete, and the uncertainties do not cover the missing effect"
        )
    if cubic.starts_agreeing < 2 <= len(cubic.starts):
        found.append(f"only one of {len(cubic.starts)} starts found this minimum")
    if case.seed_angle_deg > _FAR_FROM_SEED_DEG:
        found.append(f"the base frame is {case.seed_angle_deg:.2f} deg from its seed")
    return tuple(found)


def _over_repeats(case: LoadCase) -> float:
    """Return the position error of the poses fitted over the part that their noise explains."""
    level = case.cubic.level
    noise_m2 = np.trace(case.noise.measured.cov[:, :3, :3], axis1=1, axis2=2).mean()
    if not noise_m2 > 0:
        return 0.0
    residuals = level.residual(case.cubic.solution.x)[:, :3] * level.r_max_m
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)) / noise_m2))


def _at_bound(calibration: Calibration, report: Report) -> frozenset[str]:
    """Return the reported parameters that depend on a parameter at its bound.

    A linear spring's K_cub is at its end, zero, while its K_lin is an ordinary number.
    """
    held = np.flatnonzero(calibration.solution.at_bound)
    touched = np.abs(report.jacobian[:, held]).sum(axis=1) > 0
    at_zero = touched & (report.values == 0.0)
    names = (parameter.name for parameter in report.parameters)
    flagged = at_zero if at_zero.any() else touched
    return frozenset(name for name, is_held in zip(names, flagged, strict=True) if is_held)
