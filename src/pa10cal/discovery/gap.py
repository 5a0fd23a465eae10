"""How much nearer the extended model comes to the measurement: paired, pose by pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from pa10cal.calibration.accuracy import Accuracy, deviations, summarise
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import Deviations

Array = NDArray[np.float64]

_LEVEL = 0.95


@dataclass(frozen=True)
class Paired:
    """Mean reduction of the position error, poses being the unit.

    Attributes:
        mean_mm: mean over poses.
        low_mm, high_mm: its 95 % interval; equal to the mean where there is one pose.
        poses: how many.
    """

    mean_mm: float
    low_mm: float
    high_mm: float
    poses: int


@dataclass(frozen=True)
class Gap:
    """The gap between model and measurement on some configurations.

    Attributes:
        before, after: errors of the calibrated baseline and of the extended model.
        by_load: the same for every load.
        reduction: paired over poses.
        reduction_by_load: the same for every load.
        found_before, found_after: deviations, configuration by configuration.
        poses: the configurations.
        noise_floor_mm: mean error that their repeatability alone would leave.
    """

    before: Accuracy
    after: Accuracy
    by_load: dict[float, tuple[Accuracy, Accuracy]]
    reduction: Paired
    reduction_by_load: dict[float, Paired]
    found_before: Deviations
    found_after: Deviations
    poses: Observations[Pose]
    noise_floor_mm: float


def gap(
    poses: Observations[Pose],
    before: tuple[Array, Array],
    after: tuple[Array, Array],
    noise_floor_mm: float,
) -> Gap:
    """Compare two models on averaged poses.

    Args:
        poses: P measured configurations.
        before, after: predicted T_base_ee (P, 4, 4) and T_instr_base (4, 4) of each model.
        noise_floor_mm: mean error that the repeatability of these configurations would leave.
    """
    found = [deviations(*model, poses) for model in (before, after)]
    saved = found[0].distance_mm - found[1].distance_mm
    load_N = poses.states.load_N
    loads = [float(load) for load in np.unique(load_N)]
    return Gap(
        before=summarise(found[0]),
        after=summarise(found[1]),
        by_load={
            load: (summarise(found[0], load_N == load), summarise(found[1], load_N == load))
            for load in loads
        },
        reduction=_paired(saved, poses.pose),
        reduction_by_load={
            load: _paired(saved[load_N == load], poses.pose[load_N == load]) for load in loads
        },
        found_before=found[0],
        found_after=found[1],
        poses=poses,
        noise_floor_mm=noise_floor_mm,
    )


def _paired(saved_mm: Array, pose: NDArray[np.str_]) -> Paired:
    _, group = np.unique(pose, return_inverse=True)
    by_pose = np.bincount(group, saved_mm) / np.bincount(group)
    count, mean = len(by_pose), float(by_pose.mean())
    half = 0.0
    if count > 1:
        spread = float(by_pose.std(ddof=1)) / np.sqrt(count)
        half = float(stdtrit(count - 1, 0.5 + _LEVEL / 2.0)) * spread
    return Paired(mean, mean - half, mean + half, count)
