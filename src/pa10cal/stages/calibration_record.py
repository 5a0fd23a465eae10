"""Calibrations as JSON: what `calibration/<load>.json` holds, written and read back."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.calibration.accuracy import Accuracy, summarise_by_load
from pa10cal.calibration.base_parameters import report_base
from pa10cal.calibration.calibrate import (
    Calibration,
    Options,
    pull_beyond_bounds,
    weak_directions,
)
from pa10cal.calibration.identifiability import observability
from pa10cal.calibration.load_case import LoadCase, Study, model_deviations
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.observations import PoseObservations
from pa10cal.errors import RecordError
from pa10cal.settings_reading import parse_section
from pa10cal.stages.general_record import read_general
from pa10cal.stages.health_record import health_record
from pa10cal.stages.records import read_pose_matrix
from pa10cal.terms.baseline import baseline, solved_parameters
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Tolerances
from pa10cal.terms.term import Parameter, Report

Array = NDArray[np.float64]

#: The straight lines give the base frame to about the nominal model's own error, near 1 deg.
_FAR_FROM_SEED_DEG = 3.0
#: Standard uncertainties beyond a bound that noise reaches in one case of twenty.
_PULL_OF_NOISE = 2.0
#: Root mean square error over that of the noise above which the model lacks something.
_INCOMPLETE = 3.0


def study_of(settings: CalibrationOptions) -> Study:
    """Return models and solver options of the settings."""
    return Study(
        flexible_joints=settings.flexible_joints,
        tolerances=_tolerances(settings),
        options=Options(
            epsilon=settings.epsilon,
            epsilon_acts_on=settings.epsilon_acts_on,
            tolerance_terms=settings.tolerance_terms,
            inner_poses=None if settings.inner_poses == "all" else settings.inner_poses,
            r_max_m=settings.r_max_m,
            starts=settings.starts,
            random_seed=settings.random_seed,
            max_iterations=settings.max_iterations,
        ),
        inner_subsets=settings.inner_subsets,
    )


def load_case_record(case: LoadCase) -> dict[str, Any]:
    """Return the numbers of `calibration/<load>.json`."""
    cubic = case.cubic
    fit = fit_record(cubic, case.grid)
    after, before = fit.pop("after"), accuracy_records(case.before)
    from_seed = accuracy_records(case.before_seed_frame)
    return {
        "load": case.load,
        "model": "paper",
        "loads_fitted": sorted({float(load) for load in cubic.level.observations.states.load_N}),
        **fit,
        "rank": cubic.identifiability.rank,
        "unknowns": len(cubic.identifiability.singular_values),
        "condition": cubic.identifiability.condition,
        "singular_values": cubic.identifiability.singular_values.tolist(),
        "null_directions": [direction.weights for direction in cubic.unidentified_directions],
        "weak_directions": [
            {"std_over_tolerance": size, "weights": direction.weights}
            for size, direction in weak_directions(cubic)
        ],
        "observability": asdict(
            observability(cubic.identifiability, len(cubic.level.observations))
        ),
        "errors": {
            load: {
                "before": before[load],
                "before_seed_frame": from_seed[load],
                "after": after[load],
            }
            for load in after
        },
        "inner_poses": list(cubic.inner_poses),
        "inner_dependence": _dependence_record(case),
        "one_level": {
            "largest_difference": case.one_level.largest_difference,
            "mean_mm": case.one_level.mean_mm,
            "shift_over_std": dict(
                zip(
                    (parameter.name for parameter in cubic.level.model.parameters),
                    case.one_level.shift.tolist(),
                    strict=True,
                )
            ),
        },
        "seed_difference": {
            "angle_deg": case.seed_angle_deg,
            "distance_mm": case.seed_distance_mm,
        },
        "linear": fit_record(case.linear, case.grid),
        "l_curve": [asdict(point) for point in case.l_curve],
        "residuals": _residual_records(case),
        "health": health_record(case.health, cubic.level.observations.pose),
        "warnings": _warnings(case),
        "seconds": case.seconds,
    }


def parameter_records(calibration: Calibration) -> dict[str, dict[str, Any]]:
    """Return every parameter with value, standard uncertainty, unit and tolerance.

    A parameter of a direction that the data leave open is settled by its tolerance term alone, so
    its tolerance stands for its uncertainty.
    """
    model = calibration.level.model
    outer = model.report(calibration.solution.x)
    base = report_base(calibration.T_instr_base)
    records = _records(outer, calibration.covariances.parameters)
    records |= _records(base, calibration.covariances.base)
    at_bound = _at_bound(calibration, outer)
    for name, record in records.items():
        record["identifiable"] = name not in calibration.not_identifiable
        record["at_bound"] = name in at_bound
        if not record["identifiable"]:
            record["std"] = record["tolerance"]
    return records


def covariance_record(calibration: Calibration) -> dict[str, Any]:
    """Return the covariance of the reported outer parameters, in products of their units."""
    report = calibration.level.model.report(calibration.solution.x)
    matrix = report.jacobian @ calibration.covariances.parameters @ report.jacobian.T
    return {
        "names": [parameter.name for parameter in report.parameters],
        "matrix": matrix.tolist(),
    }


def accuracy_records(accuracies: dict[float, Accuracy]) -> dict[str, dict[str, Any]]:
    """Return accuracies keyed by load as `0N`, `22N`, …, as the files are named."""
    return {f"{load:g}N": asdict(accuracy) for load, accuracy in accuracies.items()}


def fit_record(calibration: Calibration, grid: PoseObservations) -> dict[str, Any]:
    """Return how a fit ended, its parameters and its errors on all grid poses.

    Args:
        calibration: the fit.
        grid: averaged grid poses of every load, whether the fit used them or not.
    """
    solution = calibration.solution
    found = model_deviations(calibration, grid)
    return {
        "status": "converged" if calibration.converged else "not converged",
        "reason": solution.reason,
        "cost": solution.cost,
        "iterations": solution.iterations,
        "starts": len(calibration.starts),
        "starts_agreeing": calibration.starts_agreeing,
        "parameters": parameter_records(calibration),
        "covariance": covariance_record(calibration),
        "T_instr_base": calibration.T_instr_base.tolist(),
        "after": accuracy_records(summarise_by_load(found, grid.states.load_N)),
    }


def read_fit(
    record: dict[str, Any], arm: Arm, path: Path, *, cubic: bool
) -> tuple[Model, Array, Array]:
    """Return model, parameters (k,) and T_instr_base (4, 4) of a calibration record.

    Args:
        record: content of `calibration/<load>.json`.
        arm: the nominal arm.
        path: where it was read from, for the message.
        cubic: the fit with cubic springs, else the linear one; the general model has one.

    Raises:
        RecordError: when it lacks a parameter or was written with other settings.
    """
    if record.get("model") == "general":
        found = read_general(record, arm, path)
        return found.model, found.x, found.T_instr_base
    settings = parse_section(CalibrationOptions, record.get("settings"), where=str(path))
    fit = record if cubic else record["linear"]
    model = baseline(arm, settings.flexible_joints, _tolerances(settings), cubic=cubic)
    try:
        reported = {name: float(entry["value"]) for name, entry in fit["parameters"].items()}
        x = solved_parameters(model, reported)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise RecordError(
            "the record lacks a parameter of its model",
            where=str(path),
            value=str(error),
            allowed="every parameter with a value",
            remedy="run the calibrate stage again",
        ) from None
    return model, x, read_pose_matrix(fit, "T_instr_base", path)


def _tolerances(settings: CalibrationOptions) -> Tolerances:
    """Return the tolerances of the settings."""
    return Tolerances(**settings.tolerances.model_dump())


def _dependence_record(case: LoadCase) -> dict[str, Any]:
    """Return the spread over random inner poses, beside the standard uncertainty's names."""
    names = (p.name for p in case.cubic.level.model.report(case.cubic.solution.x).parameters)
    means = case.dependence.mean_mm
    return {
        "choices": case.dependence.choices,
        "std": dict(zip(names, case.dependence.std.tolist(), strict=True)),
        "mean_mm": means.tolist(),
    }


def _residual_records(case: LoadCase) -> list[dict[str, Any]]:
    """Return place, position and rotation residual of every grid pose, along base axes."""
    T_base_ee = case.cubic.level.model.predict(case.grid.states, case.cubic.solution.x)
    return [
        {
            "pose": str(pose),
            "load_N": float(load),
            "place_mm": (1e3 * T[:3, 3]).tolist(),
            "position_mm": position.tolist(),
            "rotation_deg": rotation.tolist(),
        }
        for pose, load, T, position, rotation in zip(
            case.grid.pose,
            case.grid.states.load_N,
            T_base_ee,
            case.residuals.position_mm,
            case.residuals.rotation_deg,
            strict=True,
        )
    ]


def _warnings(case: LoadCase) -> list[str]:
    """Return what a reader should know before trusting the fit."""
    cubic, found = case.cubic, []
    if not cubic.converged:
        found.append(f"not converged: {cubic.solution.reason}")
    bound = sorted(_at_bound(cubic, cubic.level.model.report(cubic.solution.x)))
    if bound:
        pull = float(pull_beyond_bounds(cubic).max())
        meaning = (
            "the data ask for a stiffness that is not positive, as they do when an effect is "
            "missing from the model"
            if pull > _PULL_OF_NOISE
            else "not to be told from the bound with these data"
        )
        found.append(
            f"{', '.join(bound)} at the end of the physical range, {pull:.1f} standard "
            f"uncertainties beyond it: {meaning}"
        )
    over = _over_repeats(case)
    if over > _INCOMPLETE:
        found.append(
            f"the error left is {over:.0f} times what the noise of the readings explains: the "
            "model is incomplete, and the uncertainties do not cover what it lacks"
        )
    if cubic.starts_agreeing < 2 <= len(cubic.starts):
        found.append(f"only one of {len(cubic.starts)} starts found this minimum")
    if case.seed_angle_deg > _FAR_FROM_SEED_DEG:
        found.append(f"base frame ended {case.seed_angle_deg:.2f} deg away from its seed")
    return found


def _records(report: Report, covariance: Array) -> dict[str, dict[str, Any]]:
    std = np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T))
    return {
        parameter.name: _record(parameter, value, sigma)
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def _record(parameter: Parameter, value: float, std: float) -> dict[str, Any]:
    return {
        "value": float(value),
        "std": float(std),
        "unit": parameter.unit,
        "tolerance": parameter.tolerance,
    }


def _over_repeats(case: LoadCase) -> float:
    """Return the position error left on the poses fitted over what their noise explains."""
    level = case.cubic.level
    noise_m2 = np.trace(case.noise.cov_ee[:, :3, :3], axis1=1, axis2=2).mean()
    if not noise_m2 > 0:
        return 0.0
    residuals = level.residuals(case.cubic.solution.x)[:, :3] * level.r_max_m
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)) / noise_m2))


def _at_bound(calibration: Calibration, report: Report) -> frozenset[str]:
    """Return the reported parameters that stand or fall with a parameter at its bound.

    A linear spring's K_cub is at its end, zero, while its K_lin is an ordinary number.
    """
    held = np.flatnonzero(calibration.solution.at_bound)
    touched = np.abs(report.jacobian[:, held]).sum(axis=1) > 0
    at_zero = touched & (report.values == 0.0)
    names = (parameter.name for parameter in report.parameters)
    flagged = at_zero if at_zero.any() else touched
    return frozenset(name for name, is_held in zip(names, flagged, strict=True) if is_held)
