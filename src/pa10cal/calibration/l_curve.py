"""What the weight of the tolerance terms costs: misfit against departure from nominal."""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.accuracy import deviations, summarise
from pa10cal.calibration.levels import TwoLevel
from pa10cal.calibration.solve import solve
from pa10cal.calibration.tolerance_terms import all_terms
from pa10cal.results.calibration import LCurvePoint

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
