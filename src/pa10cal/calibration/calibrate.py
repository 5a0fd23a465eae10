"""The calibration of one load case, from measured poses to parameters with uncertainties."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.inner_poses import rows_of, spread_poses
from pa10cal.calibration.levels import TwoLevel
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.solve import Solution, random_starts, solve
from pa10cal.calibration.tolerance_terms import all_terms, null_space_terms, residual_weight
from pa10cal.calibration.uncertainty import Covariances, ErrorSources, propagate, with_own_scatter
from pa10cal.errors import CalibrationError
from pa10cal.fit.angles_seen import span_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import (
    Direction,
    Identifiability,
    identify,
    not_identifiable,
    unidentified_directions,
)
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model

#: Starts whose cost is within this part of the best have found the same minimum.
_SAME_COST = 1e-6
#: Relative changes at which linear springs are near enough, and the cubic share they start with.
_GOOD_ENOUGH = 1e-6
_LITTLE_SHARE = 0.01
#: The null space hardly moves with the parameters; it is found again at the solution this often.
_NULL_SPACE_PASSES = 3


@dataclass(frozen=True)
class Calibration:
    """A calibrated model."""

    level: TwoLevel  # the problem that was solved
    solution: Solution  # the best of all starts
    starts: tuple[Solution, ...]  # where every start ended, in order
    terms: Array  # (r, k) tolerance rows
    inner_poses: tuple[str, ...]  # labels of the poses of the inner level
    T_instr_base: Array  # (4, 4) base frame
    identifiability: Identifiability  # of all unknowns, base frame included
    # directions of all unknowns that the data do not identify
    unidentified_directions: tuple[Direction, ...]
    not_identifiable: frozenset[str]  # names of the parameters that take part in them
    covariances: Covariances  # of parameters and base frame

    @property
    def converged(self) -> bool:
        """Return whether the best start ended at a stationary point."""
        return self.solution.converged

    @property
    def starts_agreeing(self) -> int:
        """Return how many starts ended at the best cost."""
        best = self.solution.cost
        return sum(start.cost <= best * (1.0 + _SAME_COST) for start in self.starts)


def calibrate(
    model: Model,
    observations: Observations[Pose],
    options: CalibrationOptions,
    errors: ErrorSources,
    *,
    inner_poses: tuple[str, ...] | None = None,
) -> Calibration:
    """Calibrate a model on two levels, from several starts (paper, Section II.C).

    Args:
        model: chain and terms, the base frame not among them.
        observations: N measured poses.
        options: how to calibrate.
        errors: what is known of the errors of the measured poses.
        inner_poses: labels of the M poses; None chooses them spread out.

    Raises:
        CalibrationError: when there are fewer equations than unknowns.
    """
    _check_enough(model, observations)
    check_torques(model, observations)
    poses = inner_poses or spread_poses(observations, options.inner_poses)
    level = TwoLevel(model, observations, rows_of(observations, poses), options.r_max_m)
    starts = random_starts(model, options.starts, options.random_seed)
    starts[0] = _from_linear_springs(level, starts[0], options)
    terms = tolerance_rows(level, starts[0], options)
    solutions = [solve(level, start, terms, options.max_iterations) for start in starts]
    best = min(solutions, key=lambda solution: (not solution.converged, solution.cost))
    for _ in range(_NULL_SPACE_PASSES):
        refreshed = tolerance_rows(level, best.x, options)
        if _same_span(terms, refreshed):
            break
        terms = refreshed
        again = solve(level, best.x, terms, options.max_iterations)
        best = replace(again, iterations=best.iterations + again.iterations)
    return describe(level, best, tuple(solutions), terms, poses, errors)


def _from_linear_springs(level: TwoLevel, start: Array, options: CalibrationOptions) -> Array:
    """Return where linear springs lead, with a little of the cubic part.

    Straight from nominal geometry a stiff, nearly linear spring can end as an all but cubic one,
    a minimum too, but not the lowest.
    """
    springs = [term for term in level.model.terms if isinstance(term, JointSpring) and term.cubic]
    if not springs:
        return start
    terms = tuple(
        replace(term, cubic=False) if isinstance(term, JointSpring) else term
        for term in level.model.terms
    )
    shares = np.array(
        [parameter.name.startswith("cubic_share") for parameter in level.model.parameters]
    )
    linear = replace(level, model=Model(level.model.chain, terms))
    rows = tolerance_rows(linear, start[~shares], options)
    found = solve(linear, start[~shares], rows, options.max_iterations, _GOOD_ENOUGH)
    ahead = np.full(len(start), _LITTLE_SHARE)
    ahead[~shares] = found.x
    return ahead


def describe(
    level: TwoLevel,
    solution: Solution,
    starts: tuple[Solution, ...],
    terms: Array,
    inner_poses: tuple[str, ...],
    errors: ErrorSources,
) -> Calibration:
    """Compute base frame, rank and uncertainties of a solution."""
    model, observations = level.model, level.observations
    at_solution = level.rows(solution.x)
    whole = level.one_level(at_solution.T_instr_base)
    everything = whole.rows(np.concatenate([solution.x, np.zeros(6)]))
    jacobian = (level.weights[:, None] * everything.jacobian).reshape(-1, len(whole.scale))
    identifiability = identify(jacobian, whole.scale)
    return Calibration(
        level=level,
        solution=solution,
        starts=starts,
        terms=terms,
        inner_poses=inner_poses,
        T_instr_base=at_solution.T_instr_base,
        identifiability=identifiability,
        unidentified_directions=unidentified_directions(identifiability, whole.parameters),
        not_identifiable=not_identifiable(identifiability, whole.parameters)
        & {parameter.name for parameter in model.parameters},
        covariances=propagate(
            at_solution,
            observations
            if errors.readings is None
            else with_own_scatter(observations, errors.readings, model, solution.x),
            level.inner_rows,
            terms,
            level.r_max_m,
            errors.u_apparatus_m,
        ),
    )


def pull_beyond_bounds(calibration: Calibration) -> Array:
    """Return how far beyond its bound each held parameter would go, over its uncertainty, (k,).

    Zero for parameters that are not held. Noise alone makes this about 1 where the true value
    lies near the bound; a missing effect makes it large.
    """
    level, solution = calibration.level, calibration.solution
    at = level.rows(solution.x)
    scale = level.model.scale
    rows = np.concatenate([at.jacobian.reshape(-1, len(scale)), calibration.terms]) * scale
    target = np.concatenate([-at.residual.ravel(), -calibration.terms @ solution.x])
    step = np.linalg.lstsq(rows, target, rcond=None)[0] * scale
    std = np.sqrt(np.diag(calibration.covariances.parameters))
    pull = np.divide(np.abs(step), std, out=np.zeros_like(step), where=std > 0)
    return np.where(solution.at_bound, pull, 0.0)


def weak_directions(calibration: Calibration) -> tuple[tuple[float, Direction], ...]:
    """Return directions of the link parameters that tolerances determine better than the data.

    Returns:
        Standard uncertainty over the tolerance of each, above 1, and the direction.
    """
    parameters = calibration.level.model.parameters
    links = [
        k
        for k, parameter in enumerate(parameters)
        if parameter.tolerance is not None and parameter.name not in calibration.not_identifiable
    ]
    tolerance = np.array([parameters[k].tolerance for k in links], dtype=float)
    covariance = calibration.covariances.parameters[np.ix_(links, links)]
    sizes, vectors = np.linalg.eigh(covariance / np.outer(tolerance, tolerance))
    return tuple(
        (float(np.sqrt(size)), _direction(vector, [parameters[k].name for k in links]))
        for size, vector in zip(sizes[::-1], vectors.T[::-1], strict=True)
        if size > 1.0
    )


def _direction(vector: Array, names: list[str]) -> Direction:
    """Name the parameters that make up most of a direction, in tolerances, largest first."""
    order = np.argsort(-np.abs(vector))
    return Direction({names[k]: float(vector[k]) for k in order if abs(vector[k]) > 0.1})


def solve_one_level(
    level: TwoLevel, T_instr_base: Array, x_start: Array, terms: Array, max_iterations: int
) -> Solution:
    """Solve for all unknowns at once, the base frame's six small motions last."""
    padded = np.concatenate([terms, np.zeros((len(terms), 6))], axis=1)
    start = np.concatenate([x_start, np.zeros(6)])
    whole = level.one_level(T_instr_base)
    return solve(whole, start, padded, max_iterations, weights=level.weights)


def tolerance_rows(level: TwoLevel, x: Array, options: CalibrationOptions) -> Array:
    """Return the tolerance rows (r, k) of the options, at parameters x."""
    weight = residual_weight(options.epsilon, options.epsilon_acts_on)
    parameters = level.model.parameters
    if options.tolerance_terms == "all":
        return all_terms(parameters, weight)
    scale = level.model.scale
    jacobian = level.rows(x).jacobian.reshape(-1, len(x))
    return null_space_terms(identify(jacobian, scale), scale, weight)


def _same_span(first: Array, second: Array) -> bool:
    """Return whether two sets of rows weigh the same directions equally."""
    if first.shape != second.shape:
        return False
    difference = first.T @ first - second.T @ second
    return bool(
        np.abs(difference).max(initial=0.0) <= 1e-9 * np.abs(first.T @ first).max(initial=1.0)
    )


def _check_enough(model: Model, observations: Observations[Pose]) -> None:
    unknowns = len(model.parameters) + 6
    if 6 * len(observations) < unknowns:
        raise CalibrationError(
            "fewer equations than unknowns",
            where="grid poses",
            value=f"{len(observations)} poses, {unknowns} unknowns",
            allowed=f"at least {-(-unknowns // 6)} poses",
            remedy="measure more poses or omit parameters",
        )


def check_torques(model: Model, observations: Observations) -> None:
    """Refuse springs whose torques were not logged.

    Raises:
        CalibrationError: naming the joint.
    """
    for term in model.terms:
        if not isinstance(term, JointSpring):
            continue
        lacking = ~np.isfinite(observations.states.tau_Nm[:, term.joint - 1])
        if lacking.any():
            raise CalibrationError(
                f"joint {term.joint} has a spring, but no torque in {lacking.sum()} of "
                f"{len(lacking)} poses",
                where=f"tau{term.joint}_Nm",
                allowed="a torque in every pose",
                remedy="log the torques, or remove the joint from calibration.flexible_joints "
                "(an empty list calibrates a rigid arm)",
            )


def fitted_model(calibration: Calibration, payload: Payload | None) -> FittedModel:
    """Return the fitted model of a calibration on two levels.

    Args:
        calibration: where it ended.
        payload: what the arm carried; None where that is not known.
    """
    observations = calibration.level.observations
    return FittedModel(
        model=calibration.level.model,
        x=calibration.solution.x,
        T_instr_base=calibration.T_instr_base,
        covariance=calibration.covariances.together(calibration.T_instr_base),
        payload=payload,
        seen=span_seen(observations.states.q_rad),
    )
