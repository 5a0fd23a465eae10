"""Everything that is computed with the general model for one load case."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arm.weights import weights_known
from pa10cal.arrays import Array
from pa10cal.calibration.accuracy import summarise, summarise_by_load
from pa10cal.calibration.general.apart import Apart, apart
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general
from pa10cal.calibration.general.from_prior import calibrate_from
from pa10cal.calibration.general.prior import prior_of
from pa10cal.calibration.general.suspected_outliers import suspected_outliers
from pa10cal.calibration.health import Errors, FitSummary, Health, health, held_out_errors
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.repeats import scatter_of_repeats
from pa10cal.calibration.suspected_held_out import Suspects
from pa10cal.campaign.findings import InputFinding
from pa10cal.errors import CalibrationError
from pa10cal.fit.angles_seen import span_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import Direction, not_identifiable, unidentified_directions
from pa10cal.fit.loads import with_torques
from pa10cal.fit.problem import Problem
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations, Start
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import SuspectedOutlier
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import about_moved_base, motion_of_base
from pa10cal.terms.weights import Weights

#: Standard uncertainty of a windup, in its size, below which poses show it.
_SHOWN = 0.5
#: Part of the spread of the places seen that no calibrated arm is off by.
_NO_FIT = 0.05


@dataclass(frozen=True)
class GeneralCase:
    """One load case, computed with the general model."""

    load: str  # `combined`, `general`, or a load such as `44N`
    full: GeneralCalibration  # links, springs, frames
    # the same without springs; `full` itself where it has none, and `nominal` where it started
    # from a prior
    geometry: GeneralCalibration
    nominal: GeneralCalibration  # frames and targets alone
    grid: Observations  # poses of every load, with torques
    residuals: Deviations  # of the full model on `grid`
    # before and after: nominal and full model on `grid`, for every load
    before: dict[float, Accuracy]
    after: dict[float, Accuracy]
    geometry_after: dict[float, Accuracy]  # geometry alone on `grid`, for every load
    # unidentified_directions and not_identifiable: what the poses do not identify
    unidentified_directions: tuple[Direction, ...]
    not_identifiable: frozenset[str]
    suspected_outliers: tuple[SuspectedOutlier, ...]  # poses far outside the scatter of the others
    health: Health  # whether it is good
    apart: Apart | None  # of a group, what each campaign says alone; None of a single campaign


def work_out_general(
    arm: Arm,
    grid: Observations,
    held_out: Observations | None,
    rows: NDArray[np.bool_],
    start: Start,
    load: str,
    payload: Payload | None,
    options: CalibrationOptions,
    *,
    readings: Observations | None = None,
    findings: tuple[InputFinding, ...] = (),
    suspects: Suspects | None = None,
    prior: FittedModel | None = None,
) -> GeneralCase:
    """Compute one load case.

    Args:
        arm: the nominal arm.
        grid: grid poses of every load.
        held_out: poses held out, only judged; None where there are none.
        rows: (P,) those of the grid poses to fit.
        start: about where frames and targets are.
        load: name of the load case.
        payload: what the arm carries, None where it is not known.
        options: how to calibrate.
        readings: single readings behind the poses to fit, whose repeats show the noise; None for
            none.
        findings: what checks of the input found.
        suspects: says which of the held-out poses have a suspected reading; None for none.
        prior: fitted model of the arm to start from; None for none.

    Raises:
        CalibrationError: when there are too few poses, a spring lacks torques, the arm as described
            does not fit the readings at all, or the prior is of another arm.
    """
    used, rigid = grid.take(rows), options.with_springs(())
    nominal = calibrate_general(arm, used, start, payload, rigid, links=False).without_rows()
    if prior is None:
        full = calibrate_general(arm, used, start, payload, options)
    else:
        expected = prior_of(prior, arm, payload)
        full = calibrate_from(expected, arm, used, start, payload, options)
    geometry = full if prior is None else nominal
    if full.springs and prior is None:
        geometry = calibrate_general(arm, used, start, payload, rigid).without_rows()
    calibrated, load_N = fitted(full), grid.states.load_N

    def weighed(poses: Observations) -> Observations:
        states, _ = with_torques(calibrated.model, calibrated.x, poses.states, payload)
        return poses.with_states(states)

    grid = weighed(grid)
    found = calibrated.deviations(grid)
    _refuse_another_arm(full, summarise(found.take(rows)).rms_mm, used.measured.spread_mm)
    off = None
    if held_out is not None and len(held_out):
        held_out = weighed(held_out)
        elsewhere = replace(full.problem, observations=held_out.turned(start.R_ee_target))
        position = _position(elsewhere, elsewhere.rows(full.fit.x).jacobian)
        off = held_out_errors(
            calibrated.deviations(held_out),
            used,
            held_out,
            position,
            full.fit.covariance,
            None if suspects is None else suspects(calibrated),
        )
    parameters = full.problem.parameters
    names = {parameter.name for parameter in parameters}
    openly = not_identifiable(full.fit.identifiability, parameters) & names - _sags(full)
    doubts, known = suspected_outliers(full.problem, full.fit), weights_known(arm)
    trusted = np.setdiff1d(np.flatnonzero(rows), np.flatnonzero(rows)[[d.row for d in doubts]])
    alone = apart(full.problem, full.fit)
    if alone is not None:
        findings = (*findings, *alone.contradictions)
    errors = Errors(
        train_rms_mm=summarise(found.take(trusted)).rms_mm,
        held_out=off,
        noise_mm=_noise_mm(full),
        spread_mm=used.measured.spread_mm,
        suspected_outliers=len(doubts),
        repeats=() if readings is None else scatter_of_repeats(readings, calibrated),
        findings=findings,
        without_springs_mm=summarise(fitted(geometry).deviations(grid).take(trusted)).rms_mm
        if geometry is not full
        else None,
        weights=known.origin if known.assumed and full.springs else "",
    )
    return GeneralCase(
        load=load,
        full=full,
        geometry=geometry,
        nominal=nominal,
        grid=grid,
        residuals=found,
        before=summarise_by_load(fitted(nominal).deviations(grid), load_N),
        after=summarise_by_load(found, load_N),
        geometry_after=summarise_by_load(fitted(geometry).deviations(grid), load_N),
        unidentified_directions=unidentified_directions(full.fit.identifiability, parameters),
        not_identifiable=openly,
        suspected_outliers=doubts,
        health=health(_fit_summary(full, openly), errors),
        apart=alone,
    )


def _refuse_another_arm(general: GeneralCalibration, left_mm: float, spread_mm: float) -> None:
    """Refuse readings that are not of the arm described."""
    rank = general.fit.identifiability.rank
    if rank and left_mm < _NO_FIT * spread_mm:
        return
    raise CalibrationError(
        "the arm as described does not fit the readings",
        where=general.arm.name,
        value=f"{left_mm:.1f} mm rms remain; the measured positions spread by {spread_mm:.0f} mm",
        allowed=f"errors below {100 * _NO_FIT:.0f} % of that spread",
        remedy="check robot, order, signs and zeros of the joints, and units",
    )


def fitted(general: GeneralCalibration) -> FittedModel:
    """Return a calibrated model with its base motions taken into the base frame."""
    problem, x = general.problem, general.fit.x
    model = Model(problem.model.chain, problem.model.terms[:-1])
    of_model = problem.of_model(x)
    count = len(model.parameters)
    small = base_motion(problem.model, of_model[count:])
    return FittedModel(
        model=model,
        x=about_moved_base(model.terms, of_model[:count], small),
        T_instr_base=problem.T_instr_base @ motion_of_base(small),
        R_ee_target=general.start.R_ee_target,
        targets_m=problem.places_at(x),
        target_names=problem.measured.target_names,
        covariance=_covariance(general, count),
        payload=general.payload,
        seen=span_seen(problem.observations.states.q_rad),
    )


def _covariance(general: GeneralCalibration, count: int) -> Array:
    """Return the covariance (k + 6, k + 6) of a model's k parameters and the base's motions."""
    base = general.unknowns.base.coordinates
    of_base = count + np.array([BASE.index(name) for name in base], dtype=np.intp)
    rows = np.concatenate([np.arange(count), of_base])
    covariance = np.zeros((count + 6, count + 6))
    used = len(rows)
    covariance[np.ix_(rows, rows)] = general.fit.covariance[:used, :used]
    return covariance


def base_motion(model: Model, x_base: Array) -> Array:
    """Return the six small motions (6,) of the base, zero for those that are no unknowns."""
    values = dict(zip(model.terms[-1].coordinates, x_base, strict=True))
    return np.array([values.get(name, 0.0) for name in BASE])


def _fit_summary(general: GeneralCalibration, openly: frozenset[str]) -> FitSummary:
    fit, parameters = general.fit, general.problem.parameters
    root = np.sqrt(fit.weights)[:, None, None]
    return FitSummary(
        converged=fit.converged,
        reason=fit.reason,
        iterations=fit.iterations,
        at_bound=tuple(
            parameter.name for parameter, held in zip(parameters, fit.at_bound, strict=True) if held
        ),
        parameters=parameters,
        covariance=fit.covariance,
        identifiability=fit.identifiability,
        white=(root * fit.whitener) @ fit.jacobian,
        position=_position(general.problem, fit.jacobian),
        not_identifiable=openly,
        x=fit.x,
        hidden=_assumed_weights(general),
    )


def _sags(general: GeneralCalibration) -> frozenset[str]:
    """Return the springs under weights that nobody stated whose sag poses show all the same.

    What poses leave open of those weights goes with the springs by a little, and these with them.
    """
    if not weights_known(general.arm).assumed:
        return frozenset()
    std = np.sqrt(np.maximum(np.diag(general.fit.covariance), 0.0))
    return frozenset(
        parameter.name
        for parameter, value, sigma in zip(
            general.problem.parameters, general.fit.x, std, strict=True
        )
        if parameter.name.startswith("windup") and sigma < _SHOWN * value
    )


def _assumed_weights(general: GeneralCalibration) -> frozenset[str]:
    """Return the weights that nobody stated: what poses leave open of them is no lack of poses."""
    if not weights_known(general.arm).assumed:
        return frozenset()
    weights = (term for term in general.problem.model.terms if isinstance(term, Weights))
    return frozenset(parameter.name for term in weights for parameter in term.parameters)


def _position(problem: Problem, jacobian: Array) -> Array:
    """Return the derivative of the predicted position, of one target where there are several."""
    columns = problem.measured.position_columns
    share: Array = jacobian[:, columns] / np.sqrt(_targets_seen(problem))[:, None, None]
    return share


def _noise_mm(general: GeneralCalibration) -> float:
    """Return what the stated noise explains of the root mean square error."""
    problem = general.problem
    columns = problem.measured.position_columns
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)[:, columns]
    seen = problem.components_seen[:, columns]
    per_pose = np.where(seen, variances, 0.0).sum(axis=1) / _targets_seen(problem)
    return float(1e3 * np.sqrt(per_pose.mean()))


def _targets_seen(problem: Problem) -> Array:
    """Return how many targets were seen in each pose, (P,)."""
    columns = problem.measured.position_columns
    targets: Array = np.maximum(1.0, problem.components_seen[:, columns].sum(axis=1) // 3)
    return targets
