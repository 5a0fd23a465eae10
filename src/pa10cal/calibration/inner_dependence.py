"""How far the answer depends on which M poses the inner level uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.accuracy import deviations, summarise
from pa10cal.calibration.calibrate import tolerance_rows
from pa10cal.calibration.inner_poses import random_poses, rows_of
from pa10cal.calibration.levels import TwoLevel
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.solve import solve


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
