"""Levenberg-Marquardt on a calibration problem, from one start and from several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from pa10cal.calibration.levels import Level, Linearisation
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model

Array = NDArray[np.float64]

#: Relative changes at which a solve has arrived; near what double precision can show.
_ARRIVED = 1e-15
_POLISHING_STEPS = 8


@dataclass(frozen=True)
class Solution:
    """Where a solve ended.

    Attributes:
        x: (k,) parameters.
        at_bound: (k,) parameters held at the end of their physical range.
        cost: sum of squares of the data rows and of the tolerance terms.
        iterations: accepted and refused steps together.
        converged: whether it stopped by itself, at a stationary point.
        reason: the solver's own words.
    """

    x: Array
    at_bound: NDArray[np.bool_]
    cost: float
    iterations: int
    converged: bool
    reason: str


def solve(level: Level, x_start: Array, terms: Array, max_iterations: int) -> Solution:
    """Minimise the data rows plus the tolerance terms from one start.

    Steps are those of scipy's Levenberg-Marquardt in trust-region form. A parameter that leaves
    its physical range is put on the bound and the others are solved again.

    Args:
        level: the problem.
        x_start: (k,) start.
        terms: (r, k) tolerance rows; `terms @ x` are residuals.
        max_iterations: bound on the steps tried in one solve.
    """
    lower = np.array([-np.inf if p.lower is None else p.lower for p in level.model.parameters])
    free = np.ones(len(lower), dtype=bool)
    solution = _solve_free(level, x_start, terms, max_iterations, free)
    iterations = solution.iterations
    while (solution.x < lower).any():
        free &= solution.x >= lower
        start = np.where(free, solution.x, np.maximum(solution.x, lower))
        solution = _solve_free(level, start, terms, max_iterations, free)
        iterations += solution.iterations
    return replace(solution, iterations=iterations)


def _solve_free(
    level: Level, x_start: Array, terms: Array, max_iterations: int, free: NDArray[np.bool_]
) -> Solution:
    """Solve for the free parameters; the others stay at their start."""
    scale = level.model.scale[free]
    last: dict[bytes, Linearisation] = {}

    def point(z: Array) -> Array:
        x = x_start.copy()
        x[free] = z * scale
        return x

    def linearise(z: Array) -> Linearisation:
        # One linearisation, hence one inner solve, serves residuals and derivative of a step.
        key = z.tobytes()
        if key not in last:
            last.clear()
            last[key] = level.linearise(point(z))
        return last[key]

    def residuals(z: Array) -> Array:
        return np.concatenate([linearise(z).residuals.ravel(), terms @ point(z)])

    def jacobian(z: Array) -> Array:
        rows = linearise(z).jacobian
        return np.concatenate([rows.reshape(-1, rows.shape[2]), terms])[:, free] * scale

    result = least_squares(
        residuals,
        x_start[free] / scale,
        jacobian,
        method="trf",
        x_scale="jac",
        ftol=_ARRIVED,
        xtol=_ARRIVED,
        gtol=_ARRIVED,
        max_nfev=max_iterations,
    )
    z = _polish(result.x, residuals, jacobian)
    return Solution(
        x=point(z),
        at_bound=~free,
        cost=float(np.sum(residuals(z) ** 2)),
        iterations=int(result.nfev),
        converged=bool(result.status > 0),
        reason=str(result.message),
    )


def _polish(
    z: Array, residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array]
) -> Array:
    """Take Gauss-Newton steps while they shrink: the last digits that a cost cannot show."""
    last = np.inf
    for _ in range(_POLISHING_STEPS):
        matrix = jacobian(z)
        size = np.linalg.norm(matrix, axis=0)
        step = lstsq(matrix / size, -residuals(z), lapack_driver="gelsy")[0] / size
        length = float(np.linalg.norm(step))
        if not length < 0.5 * last:
            break
        z, last = z + step, length
    return z


def random_starts(model: Model, count: int, random_seed: int) -> list[Array]:
    """Draw starts: nominal geometry with usual springs first, then scattered ones.

    Departures are scattered with five tolerances, stiffness over a decade.
    """
    generator = np.random.default_rng(random_seed)
    starts = []
    for number in range(count):
        spread = 0.0 if number == 0 else 1.0
        parts = []
        for term in model.terms:
            if isinstance(term, JointSpring):
                k_lin = 1e4 * 10.0 ** (spread * generator.uniform(-0.5, 0.5))
                k_cub = 1e7 * 10.0 ** (spread * generator.uniform(-1.0, 0.5))
                parts.append(term.solved(k_lin, k_cub))
            else:
                sizes = np.array([parameter.scale for parameter in term.parameters])
                parts.append(5.0 * spread * sizes * generator.standard_normal(len(sizes)))
        starts.append(np.concatenate(parts))
    return starts
