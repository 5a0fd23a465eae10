"""Levenberg-Marquardt on the paper's two-level problem, from one start, within bounds."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.levels import TwoLevel
from pa10cal.calibration.rules import FIT
from pa10cal.fit.problem import Rows, Solution
from pa10cal.numerics.least_squares import Bounds

#: Why scipy's solver stopped, by its status; `p` is the precision requested (format).
_REASONS = {
    0: "the largest number of steps was reached (calibration.max_iterations)",
    1: "the gradient of the cost is zero within {p:g}",
    2: "the cost fell by less than {p:g} of itself",
    3: "the steps became smaller than {p:g} of the parameters",
    4: "cost and steps changed by less than {p:g} of themselves",
}


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
