"""The paper's calibration of poses: parameters of the arm with uncertainties, on two levels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.general.problem import check_enough
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import FIT
from pa10cal.calibration.two_level_problem import TwoLevel, TwoLevelRows, rows_of, spread_poses
from pa10cal.calibration.uncertainty import propagate, with_own_scatter
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import (
    Identifiability,
    Problem,
    Rows,
    Solution,
    identify_beyond,
    not_identifiable,
    possible_sizes,
)
from pa10cal.fit.validity import angles_seen
from pa10cal.numerics.least_squares import Bounds
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.model import Model
from pa10cal.terms.term import yields

#: Why scipy's solver stopped, by its status; `p` is the precision requested (format).
_REASONS = {
    0: "the largest number of steps was reached (calibration.max_iterations)",
    1: "the gradient of the cost is zero within {p:g}",
    2: "the cost fell by less than {p:g} of itself",
    3: "the steps became smaller than {p:g} of the parameters",
    4: "cost and steps changed by less than {p:g} of themselves",
}


@dataclass(frozen=True)
class Calibration:
    """A solved two-level problem of k parameters and N poses."""

    level: TwoLevel  # the problem
    solution: Solution  # the best of all starts
    starts: tuple[Solution, ...]  # solutions from all starts, in order
    terms: Array  # (r, k) tolerance rows
    inner_poses: tuple[str, ...]  # labels of the poses of the inner level
    problem: Problem  # the same on one level, about the base frame found
    jacobian: Array  # (N, 6, k + 6) of its rows by all unknowns, six motions of the base the last
    identifiability: Identifiability  # of all these unknowns
    # standard deviation of a row, by which some directions are hardly shown; 0 where none is
    row_noise: float
    # names of the parameters that take part in directions that the data do not identify
    not_identifiable: frozenset[str]
    # (k + 6, k + 6) of the parameters and of six small motions of the base along its own axes
    covariance: Array

    @property
    def T_instr_base(self) -> Array:
        """Return the base frame, (4, 4)."""
        return self.problem.T_instr_base

    @property
    def converged(self) -> bool:
        """Return whether the best start ended at a stationary point."""
        return self.solution.converged

    @property
    def starts_agreeing(self) -> int:
        """Return the number of starts that ended at the best cost."""
        best = self.solution.cost
        return sum(start.cost <= best * (1.0 + FIT.same_cost) for start in self.starts)

    def model(self, payload: Payload | None) -> FittedModel:
        """Return the fitted model.

        Args:
            payload: what the arm carries; None where it is not known.
        """
        return FittedModel(
            model=self.level.model,
            x=self.solution.x,
            T_instr_base=self.T_instr_base,
            covariance=self.covariance,
            payload=payload,
            seen=angles_seen(self.level.observations.states.q_rad),
        )


def calibrate(
    model: Model,
    observations: Observations[Pose],
    options: CalibrationOptions,
    readings: Observations[Pose] | None = None,
    u_apparatus_m: float = 0.0,
) -> Calibration:
    """Calibrate a model on two levels, from several starts (paper, Section II.C).

    Args:
        model: chain and terms, the base frame not among them.
        readings: single readings that were averaged to the poses; their scatter about the model is
            the noise. None: the covariances of the poses are.
        u_apparatus_m: standard uncertainty of a target's place on the apparatus, per axis.

    Raises:
        TooFewPosesError: when there are fewer equations than unknowns, or poses than inner poses.
    """
    level = TwoLevel(model, observations, np.arange(len(observations)), options.r_max_m)
    check_enough(level.one_level(np.eye(4)))
    check_torques(model, observations)
    poses = spread_poses(observations, options.inner_poses)
    level = replace(level, inner_rows=rows_of(observations, poses))
    starts = random_starts(model, options.starts, options.random_seed)
    starts[0] = _from_linear_springs(level, starts[0], options)
    terms = tolerance_rows(level, starts[0], options)
    solutions = [solve(level, start, terms, options.max_iterations) for start in starts]
    best = min(solutions, key=lambda solution: (not solution.converged, solution.cost))
    best, terms = _with_null_space_at_solution(level, best, terms, options)
    held, of_held = _with_null_space_at_solution(level, best, terms, options, level.noise)
    more, row_noise = len(of_held) - len(terms), 0.0
    if more > 0 and held.cost < best.cost + FIT.hardly_squares * more * level.noise**2:
        best, terms, row_noise = held, of_held, level.noise
    at_solution = level.rows(best.x)
    one_level = level.one_level(at_solution.T_instr_base)
    jacobian = one_level.rows(np.concatenate([best.x, np.zeros(6)])).jacobian
    weighted = (level.weights[:, None] * jacobian).reshape(-1, len(one_level.scale))
    identifiability = identify_beyond(
        weighted, one_level.scale, possible_sizes(one_level.model), row_noise
    )
    noise = observations
    if readings is not None:
        noise = with_own_scatter(observations, readings, model, best.x)
    return Calibration(
        level=level,
        solution=best,
        starts=tuple(solutions),
        terms=terms,
        inner_poses=poses,
        problem=one_level,
        jacobian=jacobian,
        identifiability=identifiability,
        row_noise=row_noise,
        not_identifiable=not_identifiable(identifiability, one_level.parameters)
        & {parameter.name for parameter in model.parameters},
        covariance=propagate(
            at_solution, noise, level.inner_rows, terms, level.r_max_m, u_apparatus_m
        )
        + _of_hardly_shown(level, at_solution, row_noise),
    )


def _with_null_space_at_solution(
    level: TwoLevel,
    best: Solution,
    terms: Array,
    options: CalibrationOptions,
    row_noise: float = 0.0,
) -> tuple[Solution, Array]:
    """Return a solution by the tolerance rows at itself, and these rows (r, k).

    The null space depends on the parameters: its rows are computed anew until they stay. With the
    noise of a row it has directions that are hardly shown, too.
    """
    for _ in range(FIT.null_space_passes):
        new_terms = tolerance_rows(level, best.x, options, row_noise)
        if _weigh_alike(terms, new_terms):
            break
        terms = new_terms
        again = solve(level, best.x, terms, options.max_iterations)
        best = replace(again, iterations=best.iterations + again.iterations)
    return best, terms


def _weigh_alike(rows: Array, others: Array) -> bool:
    """Return whether tolerance rows (r, k) have the same normal matrix as others."""
    if rows.shape != others.shape:
        return False
    squares = rows.T @ rows
    difference = np.abs(squares - others.T @ others).max(initial=0.0)
    return bool(difference <= FIT.same_span * np.abs(squares).max(initial=1.0))


def _from_linear_springs(level: TwoLevel, start: Array, options: CalibrationOptions) -> Array:
    """Return the solution with linear springs, with a small cubic share, as a start.

    From nominal geometry a stiff, nearly linear spring can end at a local minimum in which it is
    almost purely cubic.
    """
    model = level.model
    cubic = model.having("cubic")
    if not cubic.any():
        return start
    linear = replace(level, model=model.without("cubic"))
    rows = tolerance_rows(linear, start[~cubic], options)
    solution = solve(linear, start[~cubic], rows, options.max_iterations, FIT.good_enough)
    new_start = np.full(len(start), FIT.cubic_share)
    new_start[~cubic] = solution.x
    return new_start


def pull_beyond_bounds(calibration: Calibration) -> Array:
    """Return the step beyond its bound of each held parameter, over its uncertainty, (k,).

    Zero for parameters that are not held. Noise alone makes this about 1 where the true value
    lies near the bound; a missing effect makes it large.
    """
    level, solution = calibration.level, calibration.solution
    at_solution = level.rows(solution.x)
    scale = level.model.scale
    jacobian = at_solution.jacobian.reshape(-1, len(scale))
    rows = np.concatenate([jacobian, calibration.terms]) * scale
    target = np.concatenate([-at_solution.residual.ravel(), -calibration.terms @ solution.x])
    step = np.linalg.lstsq(rows, target, rcond=None)[0] * scale
    std = np.sqrt(np.diag(calibration.covariance)[: len(step)])
    pull = np.divide(np.abs(step), std, out=np.zeros_like(step), where=std > 0)
    return np.where(solution.at_bound, pull, 0.0)


def tolerance_rows(
    level: TwoLevel, x: Array, options: CalibrationOptions, row_noise: float = 0.0
) -> Array:
    """Return the tolerance rows W (r, k) of paper equation (2), at parameters x; W x are residuals.

    As printed in the paper they act on every departure, and so pull identified parameters towards
    nominal. On the null space they only fix the directions that the data do not identify.

    Args:
        row_noise: standard deviation of a row; above zero, directions that the data tell no better
            than is thought possible are fixed, too.
    """
    on_residual = options.epsilon_acts_on == "residual"
    weight = options.epsilon if on_residual else float(np.sqrt(options.epsilon))
    scale = level.model.scale
    if options.tolerance_terms == "all":
        tolerances = [parameter.tolerance for parameter in level.model.parameters]
        rows = np.array([0.0 if size is None else weight / size for size in tolerances])
        return np.diag(rows)[rows > 0]
    null: Array = weight * _identified(level, level.rows(x), row_noise).null_space.T / scale
    return null


def _of_hardly_shown(level: TwoLevel, at_solution: TwoLevelRows, row_noise: float) -> Array:
    """Return the covariance (k + 6, k + 6) by directions that the poses tell less than is possible.

    The fit holds them, so the noise says nothing of them: they may be as large as is thought
    possible. Directions without any effect on poses are left out, whatever their size.
    """
    scale, possible = level.model.scale, possible_sizes(level.model)
    hardly = _identified(level, at_solution, row_noise).null_space
    none = _identified(level, at_solution, 0.0).null_space
    basis, sizes, _ = np.linalg.svd(hardly - none @ (none.T @ hardly), full_matrices=False)
    basis = basis[:, sizes > FIT.hardly_share]
    of_basis = np.linalg.inv(basis.T @ (basis * (scale / possible)[:, None] ** 2))
    moved = basis * scale[:, None]
    base = at_solution.base_jacobian @ moved
    base[:3] = at_solution.T_instr_base[:3, :3].T @ base[:3]
    both = np.concatenate([moved, base])
    return np.asarray(both @ of_basis @ both.T)


def _identified(level: TwoLevel, rows: TwoLevelRows, row_noise: float) -> Identifiability:
    """Return what the poses tell of the outer parameters, better than is thought possible."""
    model = level.model
    jacobian = rows.jacobian.reshape(-1, len(model.scale))
    return identify_beyond(jacobian, model.scale, possible_sizes(model), row_noise)


def check_torques(model: Model, observations: Observations) -> None:
    """Refuse springs whose torques were not logged.

    Raises:
        CalibrationError: naming the joint.
    """
    for term in filter(yields, model.terms):
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


def random_starts(model: Model, count: int, random_seed: int) -> list[Array]:
    """Draw starts: nominal geometry with usual springs first, then scattered ones.

    Departures are scattered with five tolerances, stiffness over a decade, see `Term.scattered`.
    """
    generator = np.random.default_rng(random_seed)
    starts = []
    for number in range(count):
        spread = 0.0 if number == 0 else 1.0
        starts.append(np.concatenate([term.scattered(generator, spread) for term in model.terms]))
    return starts


# One start: Levenberg-Marquardt within bounds.


def solve(
    level: TwoLevel,
    x_start: Array,
    terms: Array,
    max_iterations: int,
    precision: float = FIT.full_precision,
) -> Solution:
    """Minimise the data rows plus the tolerance terms from one start.

    Scipy's trust-region solver keeps the parameters inside their physical range. Then parameters
    that ended near a bound are put on it, and Gauss-Newton steps give the others their last digits.

    Args:
        x_start: (k,) start, inside the physical range.
        terms: (r, k) tolerance rows; `terms @ x` are residuals.
        precision: relative changes at which the solver has converged.
    """
    scale, bounds = level.model.scale, Bounds.of(level.parameters)
    lower, upper = bounds.lower / scale, bounds.upper / scale

    @lru_cache(maxsize=1)  # one inner solve serves residuals and derivative of a step
    def linearise(z: bytes) -> Rows:
        return level.rows(np.frombuffer(z) * scale)

    def residuals(z: Array) -> Array:
        rows = linearise(z.tobytes()).residual.ravel()
        return np.concatenate([rows, terms @ (z * scale)])

    def jacobian(z: Array) -> Array:
        rows = linearise(z.tobytes()).jacobian.reshape(-1, len(z))
        return np.concatenate([rows, terms]) * scale

    result = least_squares(
        residuals,
        np.clip(x_start / scale, lower + FIT.inside_scales, upper - FIT.inside_scales),
        jacobian,
        bounds=(lower, upper),
        method="trf",
        x_scale="jac",
        ftol=precision,
        xtol=precision,
        gtol=precision,
        max_nfev=max_iterations,
    )
    at_lower = (result.x - lower < FIT.near_bound_scales) & (result.grad > 0)
    at_upper = (upper - result.x < FIT.near_bound_scales) & (result.grad < 0)
    at_bound = at_lower | at_upper
    z = np.where(at_lower, lower, np.where(at_upper, upper, result.x))
    z = _polish(z, residuals, jacobian, ~at_bound, (lower, upper))
    return Solution(
        x=z * scale,
        at_bound=at_bound,
        cost=float(np.sum(residuals(z) ** 2)),
        iterations=int(result.nfev),
        converged=bool(result.status > 0),
        reason=_REASONS[result.status].format(p=precision),
    )


def _polish(
    z: Array,
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    free: Mask,
    ends: tuple[Array, Array],
) -> Array:
    """Take Gauss-Newton steps while they shrink, for the last digits that the cost does not show.

    Args:
        z: (k,) solution in scales, which stays where steps do not shrink.
        free: (k,) parameters that are not at a bound.
        ends: (k,) lower and upper bounds.
    """
    last_length, cost = np.inf, float(np.sum(residuals(z) ** 2))
    for _ in range(FIT.polishing_steps):
        matrix = jacobian(z)[:, free]
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0.0] = 1.0  # the cubic share of a rigid joint moves nothing
        step = np.zeros(len(z))
        step[free] = lstsq(matrix / size, -residuals(z), lapack_driver="gelsy")[0] / size
        length = float(np.linalg.norm(step))
        candidate = np.clip(z + step, *ends)
        worse = np.sum(residuals(candidate) ** 2) > cost * (1.0 + FIT.no_worse)
        if not length < FIT.shrinks_share * last_length or worse:
            break
        z, last_length = candidate, length
    return z
