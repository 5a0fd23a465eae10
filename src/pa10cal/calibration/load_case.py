"""Everything that is computed for one load case: both springs, both levels, what it rests on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import (
    Calibration,
    all_terms,
    calibrate,
    fitted_model,
    nominal_start,
    solve,
    solve_one_level,
    tolerance_rows,
)
from pa10cal.calibration.grade import Errors, FitSummary
from pa10cal.calibration.health import health, held_out_errors
from pa10cal.calibration.levels import TwoLevel, random_poses, rows_of
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import (
    ErrorSources,
    Suspects,
    align_nominal,
    deviations,
    gross_errors_of_repeats,
    scatter_of_repeats,
    summarise,
    summarise_by_load,
    with_own_scatter,
)
from pa10cal.errors import CalibrationError
from pa10cal.fit.identifiability import identify, not_identifiable
from pa10cal.fit.problem import Problem
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import Deviations
from pa10cal.results.calibration import LCurvePoint
from pa10cal.results.evaluation import Accuracy
from pa10cal.results.health import Health, InputFinding
from pa10cal.terms.joint_spring import baseline, nominal
from pa10cal.terms.model import Model

COMBINED = "combined"
#: Random postures at which it is found what no pose determines.
_POSTURES = 60
#: Weights of the L-curve: from no influence to next to no departures.
_L_CURVE_WEIGHTS = np.geomspace(1e-6, 3e-2, 14)


@dataclass(frozen=True)
class OneLevelCheck:
    """The one-level solution beside the two-level one."""

    # of any identifiable parameter from two levels with M = N, over the parameter's size (its
    # value, or its scale where that is larger)
    largest_difference: float
    mean_mm: float  # mean position error of the one-level solution over the poses fitted
    # (k,) one-level minus two-level solution with M poses, over its standard uncertainty
    shift: Array


@dataclass(frozen=True)
class LoadCase:
    """One load case of a campaign, computed."""

    load: str  # `combined`, or a load such as `44N`
    cubic: Calibration  # the paper's model
    linear: Calibration  # the same with K_cub = 0
    grid: Observations[Pose]  # averaged grid poses of every load
    # the poses fitted, with the covariance that their readings show about the model
    noise: Observations[Pose]
    residuals: Deviations  # predicted minus measured of the cubic model on `grid`
    # nominal rigid model, base frame aligned on unloaded positions, for every load
    before: dict[float, Accuracy]
    # nominal rigid model with the base frame of the straight-line moves
    before_seed_frame: dict[float, Accuracy]
    dependence: InnerDependence  # on the choice of inner poses
    one_level: OneLevelCheck  # the one-level solution beside it
    # what the weight of the tolerance terms would do, for the combined case
    l_curve: tuple[LCurvePoint, ...]
    health: Health  # whether the cubic model's calibration is good
    # seed_angle_deg and seed_distance_mm: how far the base frame ended from its seed
    seed_angle_deg: float
    seed_distance_mm: float


def work_out(
    arm: Arm,
    readings: Observations[Pose],
    held_out: Observations[Pose] | None,
    T_instr_base_seed: Array,
    load: str,
    options: CalibrationOptions,
    stated: Observations[Pose] | None = None,
    findings: tuple[InputFinding, ...] = (),
    suspects: Suspects | None = None,
) -> LoadCase:
    """Compute one load case.

    Args:
        arm: the nominal arm.
        readings: single readings of the grid poses, of every load.
        held_out: poses held out, only judged; None where there are none.
        T_instr_base_seed: (4, 4) base frame from the straight-line moves.
        load: `combined`, or a load such as `44N`.
        options: how to calibrate.
        stated: `readings` with the covariance that the instrument states; None where it is theirs.
        findings: what checks of the input found.
        suspects: says which of the held-out poses have a suspected reading; None for none.

    Raises:
        CalibrationError: when no grid pose has that load, or there are too few of them.
    """
    chosen = readings.take(rows_of_load(readings.states.load_N, load))
    grid, used = average_repeats(readings), average_repeats(chosen)
    errors = ErrorSources(chosen, 1e-3 * options.apparatus_uncertainty_mm)
    joints, tau_ref_Nm = options.flexible_joints, np.abs(used.states.tau_Nm).max(axis=0)

    def calibrated(*, cubic: bool) -> Calibration:
        model = baseline(arm, joints, options.tolerances, cubic=cubic, tau_ref_Nm=tau_ref_Nm)
        return calibrate(model, used, options, errors)

    cubic = calibrated(cubic=True)
    linear = calibrated(cubic=False) if joints else cubic
    rigid = nominal(arm)
    T_rigid = rigid.predict(grid.states, np.zeros(0))
    away = np.linalg.inv(T_instr_base_seed) @ cubic.T_instr_base
    noise = with_own_scatter(used, chosen, cubic.level.model, cubic.solution.x)
    return LoadCase(
        load=load,
        cubic=cubic,
        linear=linear,
        grid=grid,
        noise=noise,
        residuals=model_deviations(cubic, grid),
        before=summarise_by_load(
            deviations(T_rigid, align_nominal(rigid, grid), grid), grid.states.load_N
        ),
        before_seed_frame=summarise_by_load(
            deviations(T_rigid, T_instr_base_seed, grid), grid.states.load_N
        ),
        dependence=inner_dependence(cubic.level, cubic.solution.x, options, options.inner_subsets),
        one_level=_check_one_level(cubic, T_instr_base_seed, options),
        l_curve=(
            l_curve(cubic.level, cubic.solution.x, _L_CURVE_WEIGHTS, options.max_iterations)
            if load == COMBINED
            else ()
        ),
        health=_health(
            cubic,
            noise,
            held_out,
            (readings if stated is None else stated).take(
                rows_of_load(readings.states.load_N, load)
            ),
            1e-3 * options.apparatus_uncertainty_mm,
            findings,
            suspects,
        ),
        seed_angle_deg=float(
            np.degrees(np.arccos(np.clip((np.trace(away[:3, :3]) - 1) / 2, -1, 1)))
        ),
        seed_distance_mm=float(1e3 * np.linalg.norm(away[:3, 3])),
    )


def load_cases(load_N: Array) -> tuple[str, ...]:
    """Return the load cases of loads (P,) [N]: each of them by rising load, then all together."""
    return (*(f"{load:g}N" for load in np.unique(load_N)), COMBINED)


def rows_of_load(load_N: Array, load: str) -> NDArray[np.bool_]:
    """Return (P,) which poses are of a load case.

    Raises:
        CalibrationError: when none is.
    """
    labels = np.array([f"{value:g}N" for value in load_N])
    rows = np.ones(len(load_N), dtype=bool) if load == COMBINED else labels == load
    if not rows.any():
        raise CalibrationError(
            "no grid pose with this load",
            where="--load",
            value=load,
            allowed=", ".join([*dict.fromkeys(labels), COMBINED]),
            remedy="choose one of the measured loads",
        )
    return rows


def model_deviations(calibration: Calibration, poses: Observations[Pose]) -> Deviations:
    """Return predicted minus measured of a calibrated model."""
    T_base_ee = calibration.level.model.predict(poses.states, calibration.solution.x)
    return deviations(T_base_ee, calibration.T_instr_base, poses)


def _check_one_level(
    cubic: Calibration, T_instr_base_seed: Array, options: CalibrationOptions
) -> OneLevelCheck:
    """Solve on one level from the seed, and on two with all poses inside."""
    level, terms = cubic.level, cubic.terms
    start = nominal_start(level.model)
    one = solve_one_level(level, T_instr_base_seed, start, terms, options.max_iterations)
    x = one.x[:-6]
    all_inside = replace(level, inner_rows=np.arange(len(level.observations)))
    two = solve(all_inside, start, terms, options.max_iterations)
    known = np.array(
        [parameter.name not in cubic.not_identifiable for parameter in level.model.parameters]
    )
    size = np.maximum(np.abs(two.x), level.model.scale)
    T_base_ee = level.model.predict(level.observations.states, x)
    found = deviations(T_base_ee, all_inside.base(x).T_instr_base, level.observations)
    std = np.sqrt(np.diag(cubic.covariances.parameters))
    return OneLevelCheck(
        largest_difference=float((np.abs(x - two.x) / size)[known].max()),
        mean_mm=float(found.distance_mm.mean()),
        shift=np.where(known, (x - cubic.solution.x) / np.where(std > 0, std, 1.0), 0.0),
    )


def _health(
    cubic: Calibration,
    noise: Observations[Pose],
    held_out: Observations[Pose] | None,
    stated: Observations[Pose],
    u_apparatus_m: float,
    findings: tuple[InputFinding, ...],
    suspects: Suspects | None,
) -> Health:
    """Judge the calibration, base frame included."""
    level, solution = cubic.level, cubic.solution
    whole, x = level.one_level(cubic.T_instr_base), np.concatenate([solution.x, np.zeros(6)])
    jacobian = whole.rows(x).jacobian
    whitener = np.linalg.inv(np.linalg.cholesky(noise.measured.cov))
    held = [
        parameter.name
        for parameter, at_bound in zip(level.model.parameters, solution.at_bound, strict=True)
        if at_bound
    ]
    covariance = cubic.covariances.together(cubic.T_instr_base)
    hidden = _hidden(whole, x)
    ended = FitSummary(
        converged=solution.converged,
        reason=solution.reason,
        iterations=solution.iterations,
        at_bound=tuple(held),
        pose=level.observations.pose,
        parameters=whole.parameters,
        covariance=covariance,
        identifiability=cubic.identifiability,
        white=whitener @ jacobian,
        position=jacobian[:, :3],
        not_identifiable=cubic.not_identifiable,
        x=x,
        hidden=hidden,
        of_mounting=hidden | _of_last_row(level.model),
    )
    noise_mm = 1e3 * float(
        np.sqrt(np.trace(noise.measured.cov[:, :3, :3], axis1=1, axis2=2).mean())
    )
    p_instr_m = level.observations.measured.T_instr_target[:, :3, 3]
    off = None
    if held_out is not None:
        elsewhere = replace(whole, observations=held_out).rows(x).jacobian[:, :3]
        off = held_out_errors(
            model_deviations(cubic, held_out),
            level.observations,
            held_out,
            elsewhere,
            covariance,
            None if suspects is None else suspects(fitted_model(cubic, None)),
        )
    scatter = scatter_of_repeats(stated, fitted_model(cubic, None))
    if scatter:
        usual_mm = (
            1e3 * scatter[0].found * np.sqrt(3.0 * np.mean(1.0 / level.observations.readings))
        )
        findings = (*findings, *gross_errors_of_repeats(noise_mm, float(usual_mm)))
    return health(
        ended,
        Errors(
            train_rms_mm=summarise(model_deviations(cubic, level.observations)).rms_mm,
            held_out=off,
            noise_mm=noise_mm,
            spread_mm=1e3 * float(np.sqrt(np.sum(np.var(p_instr_m, axis=0)))),
            noise_is_found=bool(scatter),
            apparatus_mm=1e3 * _left_by_apparatus_m(level, jacobian, u_apparatus_m),
            repeats=scatter,
            from_touches=stated.measured.from_touches,
            findings=findings,
        ),
    )


def _left_by_apparatus_m(level: TwoLevel, jacobian: Array, u_m: float) -> float:
    """Return the position error that targets off their places leave after the fit [m]."""
    weights = level.weights[:, None]
    moved = u_m * weights * level.observations.measured.by_apparatus
    rows = (weights * jacobian).reshape(-1, jacobian.shape[2])
    columns = moved.reshape(len(rows), -1)
    taken = rows @ np.linalg.lstsq(rows, columns, rcond=None)[0]
    left = (columns - taken).reshape(moved.shape)[:, :3] * level.r_max_m
    return float(np.sqrt(np.sum(left**2) / len(left)))


def _hidden(problem: Problem, x: Array) -> frozenset[str]:
    """Return the parameters that no pose determines: they move what the base moves."""
    generator = np.random.default_rng(0)
    observations = problem.observations.take(
        generator.integers(len(problem.observations), size=_POSTURES)
    )
    states, arm = observations.states, problem.model.chain.arm
    low, high = arm.limits_rad.T
    drawn = replace(
        states,
        q_rad=generator.uniform(low, high, (_POSTURES, arm.n)),
        tau_Nm=generator.permuted(states.tau_Nm, axis=0),
    )
    rows = replace(problem, observations=observations.with_states(drawn)).rows(x).jacobian
    rank = identify(rows.reshape(-1, len(x)), problem.scale)
    names = {parameter.name for parameter in problem.parameters}
    return not_identifiable(rank, problem.parameters) & names


def _of_last_row(model: Model) -> frozenset[str]:
    """Return the departures of the last row, which hold how the apparatus is mounted as well."""
    return frozenset(
        parameter.name
        for parameter in model.parameters
        if parameter.name.startswith("delta_") and parameter.name.endswith(f"_{model.chain.arm.n}")
    )


# How far the answer depends on which M poses the inner level uses.


@dataclass(frozen=True)
class InnerDependence:
    """Spread of the answer over random choices of the inner poses."""

    choices: int  # how many were tried
    std: Array  # (k',) standard deviation of each reported parameter over the choices
    mean_mm: Array  # (choices,) mean position error of the poses fitted, for each choice


def inner_dependence(
    level: TwoLevel, x: Array, options: CalibrationOptions, draws: int
) -> InnerDependence:
    """Calibrate again with random inner poses, each time from the solution x."""
    reported, means = [], []
    for poses in random_poses(level.observations, options.inner_poses, draws, options.random_seed):
        other = replace(level, inner_rows=rows_of(level.observations, poses))
        terms = tolerance_rows(other, x, options)
        solution = solve(other, x, terms, options.max_iterations)
        T_base_ee = other.model.predict(other.observations.states, solution.x)
        base = other.base(solution.x).T_instr_base
        means.append(summarise(deviations(T_base_ee, base, other.observations)).mean_mm)
        reported.append(other.model.report(solution.x).values)
    count = len(reported)
    std = (
        np.std(reported, axis=0, ddof=1)
        if count > 1
        else np.zeros(len(level.model.report(x).values))
    )
    return InnerDependence(count, std, np.array(means))


# What the weight of the tolerance terms costs: misfit against departure from nominal.

#: Enough for a curve; heavy weights bend the valley so that the last digits would cost most.
_PRECISION = 1e-8


def l_curve(
    level: TwoLevel, x_start: Array, weights: Array, max_iterations: int
) -> tuple[LCurvePoint, ...]:
    """Solve once a weight, from small to large, each from the solution before.

    Args:
        level: the problem.
        x_start: (k,) start, best the solution without tolerance terms.
        weights: factors on the residuals.
        max_iterations: bound on the steps of one solve.
    """
    unit = all_terms(level.model.parameters, 1.0)
    points, x = [], x_start
    for weight in np.sort(weights):
        solution = solve(level, x, weight * unit, max_iterations, _PRECISION)
        x = solution.x
        T_base_ee = level.model.predict(level.observations.states, x)
        found = deviations(T_base_ee, level.base(x).T_instr_base, level.observations)
        points.append(
            LCurvePoint(
                weight=float(weight),
                misfit=float(np.linalg.norm(level.residual(x))),
                departure=float(np.linalg.norm(unit @ x)),
                mean_mm=summarise(found).mean_mm,
            )
        )
    return tuple(points)
