"""How much the repeats of one configuration scatter: the paper's repeatability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.figures.poses import Poses
from pa10cal.figures.records import Calibration

#: A mean error up to so many times the scatter of averaged repeats may be scatter alone.
_COMPLETE_WITHIN = 3.0


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of the measured position within one grid configuration, at one load.

    That of the distance: the root of the variances along three axes together.

    Attributes:
        largest_mm: over the configurations.
        mean_mm: over the configurations.
        mean_of_average_mm: that of the average of a configuration's repeats, over the
            configurations.
    """

    largest_mm: float
    mean_mm: float
    mean_of_average_mm: float

    @property
    def largest_per_axis_mm(self) -> float:
        """Return the largest along one axis, nearest to the paper's scatter of a scalar error."""
        return float(self.largest_mm / np.sqrt(3.0))


def scatter_by_load(poses: Poses) -> dict[str, Scatter]:
    """Return the scatter at each load with repeats, by load as `0`, `22`, …."""
    grid = poses.kind == "grid"
    load_N, p_mm = poses.load_N[grid], poses.p_instr_mm[grid]
    _, pose = np.unique(poses.pose[grid], return_inverse=True)
    loads, load = np.unique(load_N, return_inverse=True)
    _, first, group = np.unique(
        load * (pose.max(initial=0) + 1) + pose, return_index=True, return_inverse=True
    )
    count = np.bincount(group)
    mean = np.zeros((len(count), 3))
    np.add.at(mean, group, p_mm)
    mean /= count[:, None]
    square = np.bincount(group, ((p_mm - mean[group]) ** 2).sum(axis=1))
    repeated = count > 1
    std = np.sqrt(square[repeated] / (count[repeated] - 1))
    of_average = std / np.sqrt(count[repeated])
    at = load[first][repeated]
    return {
        f"{loads[k]:g}": Scatter(
            largest_mm=float(std[at == k].max()),
            mean_mm=float(std[at == k].mean()),
            mean_of_average_mm=float(of_average[at == k].mean()),
        )
        for k in np.unique(at)
    }


def incompleteness(case: Calibration, scatter: dict[str, Scatter]) -> str | None:
    """Say that a calibrated model is incomplete, None where repeats do not show that it is.

    What a general model leaves is the scatter of averaged repeats, on which it was calibrated.

    Args:
        case: the calibration.
        scatter: of repeats, by load.
    """
    loads = [load for load in case.errors if load in scatter]
    if not loads:
        return None
    left_mm = np.mean([case.errors[load].after.mean_mm for load in loads])
    repeats_mm = np.mean([scatter[load].mean_of_average_mm for load in loads])
    if left_mm <= _COMPLETE_WITHIN * repeats_mm:
        return None
    times = f"{left_mm / repeats_mm:.0f}" if repeats_mm > 0.0 else "infinitely many"
    return (
        f"The error left after calibration is {times} times the scatter of averaged repeats: the "
        "model is incomplete, and ± does not cover what it lacks."
    )
