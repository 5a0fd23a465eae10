"""Levenberg-Marquardt on normal equations, inside the physical range of the parameters.

Every parameter has an expected size, so the normal equations are well conditioned, and a step costs
one product of the rows in place of their singular value decomposition, which takes most of the
time in scipy's trust-region solver.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

_PRECISION = 1e-8
_MOST_STEPS = 50
_FIRST_DAMPING = 1e-6
_LARGEST_DAMPING = 1e8


def minimise(
    rows: Callable[[Array], tuple[Array, Array]], x_start: Array, parameters: Sequence[Parameter]
) -> tuple[Array, float, bool]:
    """Minimise a sum of squares.

    Args:
        rows: gives residuals (R,) and their derivative (R, k) at x (k,).
        x_start: (k,) where to set out.
        parameters: scale and range of each.

    Returns:
        The parameters (k,), the sum of squares, and whether it came to rest.
    """
    scale = np.array([p.scale for p in parameters])
    lower = np.array([-np.inf if p.lower is None else p.lower for p in parameters])
    upper = np.array([np.inf if p.upper is None else p.upper for p in parameters])
    x = np.clip(x_start, lower, upper)
    damping = _FIRST_DAMPING
    residual, jacobian = rows(x)
    cost = float(residual @ residual)
    for _ in range(_MOST_STEPS):
        scaled = jacobian * scale
        gradient = scaled.T @ residual
        held = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        free = ~held
        normal = scaled[:, free].T @ scaled[:, free]
        size = np.diag(normal)
        while True:
            factor = cho_factor(normal + np.diag(damping * size))
            step = np.zeros(len(x))
            step[free] = -cho_solve(factor, gradient[free]) * scale[free]
            ahead = np.clip(x + step, lower, upper)
            new_residual, new_jacobian = rows(ahead)
            new_cost = float(new_residual @ new_residual)
            if new_cost <= cost * (1.0 + 1e-12):
                break
            damping = max(10.0 * damping, 1e-4)
            if damping > _LARGEST_DAMPING:
                return x, cost, True  # no direction leads down: rounding
        gained = cost - new_cost
        x, residual, jacobian, cost = ahead, new_residual, new_jacobian, new_cost
        damping *= 0.1
        if gained <= _PRECISION * (1.0 + cost):
            return x, cost, True
    return x, cost, False
