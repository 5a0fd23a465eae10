"""Levenberg-Marquardt on a calibration problem, from one start and from several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from pa10cal.arrays import Array
from pa10cal.fit.least_squares import Bounds
from pa10cal.fit.problem import Rows
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Parameter

#: Relative changes at which the Gauss-Newton steps that follow converge to the last digit.
FULL_PRECISION = 1e-13
_POLISHING_STEPS = 8
#: Rounding of a cost near its minimum, relative.
_NO_WORSE = 1e-9
#: Distances from a bound, in scales: where a start is moved to, and what counts as being on it.
_INSIDE = 1e-3
_NEAR_BOUND = 1e-2
#: Why the solver stopped, by its status; `p` is the precision asked for.
_REASONS = {
    0: "the largest number of steps was reached (calibration.max_iterations)",
    1: "the gradient of the cost is zero within {p:g}",
    2: "the cost fell by less than {p:g} of itself",
    3: "the steps became smaller than {p:g} of the parameters",
    4: "cost and steps changed by less than {p:g} of themselves",
}


class LeastSquares(Protocol):
    """What the solver needs: the paper's two levels, or a `fit.Problem` on one."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the k unknowns."""

    def rows(self, x: Array) -> Rows:
        """Return residuals and exact derivatives."""


@dataclass(frozen=True)
class Solution:
    """Where a solve ended."""

    x: Array  # (k,) parameters
    at_bound: NDArray[np.bool_]  # (k,) parameters held at the end of their physical range
    cost: float  # sum of squares of the data rows and of the tolerance terms
    iterations: int  # accepted and refused steps together
    converged: bool  # whether it stopped by itself, at a stationary point
    reason: str  # why the solver stopped, in words


def solve(
    problem: LeastSquares,
    x_start: Array,
    terms: Array,
    max_iterations: int,
    precision: float = FULL_PRECISION,
    weights: Array | None = None,
) -> Solution:
    """Minimise the data rows plus the tolerance terms from one start.

    Steps are those of scipy's Levenberg-Marquardt in trust-region form, kept inside the physical
    range of the parameters; what ends at a bound is put on it, and the rest takes its last digits
    from Gauss-Newton steps.

    Args:
        problem: the problem.
        x_start: (k,) start, inside the physical range.
        terms: (r, k) tolerance rows; `terms @ x` are residuals.
        max_iterations: bound on the steps tried.
        precision: relative changes at which it has arrived.
        weights: (6,) by which the components of its rows are multiplied; None for one.
    """
    scale = np.array([parameter.scale for parameter in problem.parameters])
    bounds = Bounds.of(problem.parameters)
    lower, upper = bounds.lower / scale, bounds.upper / scale
    last: dict[bytes, Rows] = {}

    def linearise(z: Array) -> Rows:
        # One linearisation, hence one inner solve, serves residuals and derivative of a step.
        key = z.tobytes()
        if key not in last:
            last.clear()
            rows = problem.rows(z * scale)
            if weights is not None:
                rows = Rows(weights * rows.residual, weights[:, None] * rows.jacobian)
            last[key] = rows
        return last[key]

    def residuals(z: Array) -> Array:
        return np.concatenate([linearise(z).residual.ravel(), terms @ (z * scale)])

    def jacobian(z: Array) -> Array:
        rows = linearise(z).jacobian
        found: Array = np.concatenate([rows.reshape(-1, len(z)), terms]) * scale
        return found

    result = least_squares(
        residuals,
        np.clip(x_start / scale, lower + _INSIDE, upper - _INSIDE),
        jacobian,
        bounds=(lower, upper),
        method="trf",
        x_scale="jac",
        ftol=precision,
        xtol=precision,
        gtol=precision,
        max_nfev=max_iterations,
    )
    at_lower = (result.x - lower < _NEAR_BOUND) & (result.grad > 0)
    at_upper = (upper - result.x < _NEAR_BOUND) & (result.grad < 0)
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
    free: NDArray[np.bool_],
    ends: tuple[Array, Array],
) -> Array:
    """Take Gauss-Newton steps while they shrink: the last digits that a cost cannot show.

    Where the valley is too long for them, the point that the solver gave stays.
    """
    last, cost = np.inf, float(np.sum(residuals(z) ** 2))
    for _ in range(_POLISHING_STEPS):
        matrix = jacobian(z)[:, free]
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0.0] = 1.0  # the cubic share of a rigid joint moves nothing
        step = np.zeros(len(z))
        step[free] = lstsq(matrix / size, -residuals(z), lapack_driver="gelsy")[0] / size
        length = float(np.linalg.norm(step))
        ahead = np.clip(z + step, *ends)
        if not length < 0.5 * last or np.sum(residuals(ahead) ** 2) > cost * (1.0 + _NO_WORSE):
            break
        z, last = ahead, length
    return z


def nominal_start(model: Model) -> Array:
    """Return nominal geometry with usual springs."""
    return random_starts(model, 1, 0)[0]


def random_starts(model: Model, count: int, random_seed: int) -> list[Array]:
    """Draw starts: nominal geometry with usual springs first, then scattered ones.

    Departures are scattered with five tolerances, stiffness over a decade. Springs start soft in
    their cubic part: from a hard one the solver can run into a purely cubic spring, which is a
    minimum too, but not the lowest.
    """
    generator = np.random.default_rng(random_seed)
    starts = []
    for number in range(count):
        spread = 0.0 if number == 0 else 1.0
        parts = []
        for term in model.terms:
            if isinstance(term, JointSpring):
                k_lin = 1e4 * 10.0 ** (spread * generator.uniform(-0.5, 0.5))
                k_cub = 1e6 * 10.0 ** (spread * generator.uniform(-1.0, 1.0))
                parts.append(term.solved(k_lin, k_cub))
            else:
                sizes = np.array([parameter.scale for parameter in term.parameters])
                parts.append(5.0 * spread * sizes * generator.standard_normal(len(sizes)))
        starts.append(np.concatenate(parts))
    return starts
