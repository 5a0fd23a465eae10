"""Poses that a fit doubts, each with why; they stay in it, with less weight."""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.general.fit import Fit
from pa10cal.fit.problem import Problem
from pa10cal.fit.robust_weights import suspect_beyond
from pa10cal.results.calibration import SuspectedOutlier

#: A pose with less weight than this is listed in any case.
_LITTLE_WEIGHT = 0.5


def suspected_outliers(problem: Problem, fit: Fit) -> tuple[SuspectedOutlier, ...]:
    """List the poses a fit doubts, the worst first."""
    limit = suspect_beyond(problem.components_seen)
    rows = np.flatnonzero((fit.distance > limit) | (fit.weights < _LITTLE_WEIGHT))
    rows = rows[np.argsort(-fit.distance[rows])]
    sizes = {
        kind: np.sqrt(
            fit.scatter[kind] ** 2
            + np.diagonal(problem.stated_covariance, axis1=1, axis2=2)[:, columns].mean(axis=1)
        )
        for kind, columns in problem.measured.component_kinds
    }
    return tuple(
        SuspectedOutlier(
            row=int(row),
            pose=str(problem.observations.pose[row]),
            load_N=float(problem.observations.states.load_N[row]),
            distance=float(fit.distance[row]),
            weight=float(fit.weights[row]),
            why=_why(problem, fit, sizes, int(row)),
        )
        for row in rows
    )


def _why(problem: Problem, fit: Fit, sizes: dict[str, Array], row: int) -> str:
    """Describe the kind of component that deviates most."""
    found = []
    for kind, columns in problem.measured.component_kinds:
        off = float(np.linalg.norm(fit.residual[row, columns]))
        text = (
            f"{np.degrees(off):.3f} deg" if kind.startswith("attitude") else f"{1e3 * off:.3f} mm"
        )
        times = off / float(sizes[kind][row])
        found.append((times, f"{kind} off by {text}, {times:.0f} times the scatter of one axis"))
    return max(found)[1]
