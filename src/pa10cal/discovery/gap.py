"""How much nearer the extended model comes to the measurement: paired, pose by pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from pa10cal.calibration.accuracy import Accuracy, summarise
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.terms.effects.effect import Effect

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
class Parts:
    """The gap inside the joint positions that the fit has seen, and beyond them.

    Attributes:
        inside: (P,) configurations that keep to the positions seen; the others are extrapolated.
        before_inside, after_inside: accuracies over these; None where there is none.
        before_beyond, after_beyond: over the others.
    """

    inside: NDArray[np.bool_]
    before_inside: Accuracy | None
    after_inside: Accuracy | None
    before_beyond: Accuracy | None
    after_beyond: Accuracy | None


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
        noise_floor_mm: mean error that their noise alone would leave.
        parts: inside and beyond what the fit has seen; None where it is not needed.
    """

    before: Accuracy
    after: Accuracy
    by_load: dict[float, tuple[Accuracy, Accuracy]]
    reduction: Paired
    reduction_by_load: dict[float, Paired]
    found_before: Deviations
    found_after: Deviations
    poses: Observations
    noise_floor_mm: float
    parts: Parts | None = None


@dataclass(frozen=True)
class Named:
    """The model with the first few of the effects.

    Attributes:
        effects: those that are in it, in the order found.
        train, holdout: its errors; None without held-out poses.
    """

    effects: tuple[Effect, ...]
    train: Accuracy
    holdout: Accuracy | None


def gap(
    poses: Observations,
    before: FittedModel,
    after: Deviations,
    noise_floor_mm: float,
    seen: AnglesSeen | None = None,
    T_moved: Array | None = None,
) -> Gap:
    """Compare two models on averaged poses.

    Args:
        poses: P measured configurations, complete.
        before: the calibrated model.
        after: what the extended model leaves of them.
        noise_floor_mm: mean error that the noise of these configurations would leave.
        seen: joint positions that the fit of the extended model has seen; None where it has seen
            all that it may predict.
        T_moved: (P, 4, 4) how the base had moved at each; None where it had not.
    """
    inside = None if seen is None else seen.inside(poses.states.q_rad)
    return gap_of(poses, [left_by(before, poses, T_moved), after], noise_floor_mm, inside)


def fallen_back(found: Gap, outside: NDArray[np.bool_]) -> Gap:
    """Return the gap where some configurations (P,) are left to the calibrated model."""
    after = found.found_after.with_others(outside, found.found_before)
    inside = None if found.parts is None else found.parts.inside
    return gap_of(found.poses, [found.found_before, after], found.noise_floor_mm, inside)


def trusted(found: Gap | None, suspected: NDArray[np.bool_] | None) -> Gap | None:
    """Return the gap without configurations that are suspected; None where nothing is left."""
    if found is None or suspected is None or not suspected.any():
        return found
    if suspected.all():
        return None
    inside = None if found.parts is None else found.parts.inside[~suspected]
    deviations = [found.found_before.take(~suspected), found.found_after.take(~suspected)]
    return gap_of(found.poses.take(~suspected), deviations, found.noise_floor_mm, inside)


def reduction(found: Gap, rows: NDArray[np.bool_]) -> Paired:
    """Return the mean reduction over some configurations (P,), paired over their poses."""
    saved_mm = found.found_before.distance_mm - found.found_after.distance_mm
    return _paired(saved_mm[rows], found.poses.pose[rows])


def gap_of(
    poses: Observations,
    found: list[Deviations],
    noise_floor_mm: float,
    inside: NDArray[np.bool_] | None,
) -> Gap:
    """Return the gap of deviations before and after."""
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
        parts=None if inside is None else _parts(inside, found),
    )


def left_by(model: FittedModel, poses: Observations, T_moved: Array | None = None) -> Deviations:
    """Return what a model leaves of complete poses, at which the base had moved (P, 4, 4)."""
    T_base_ee = model.as_read(poses) if T_moved is None else T_moved @ model.as_read(poses)
    return poses.measured.deviations(T_base_ee, model.T_instr_base, model.targets_m)


def _parts(inside: NDArray[np.bool_], found: list[Deviations]) -> Parts:
    accuracies = [
        summarise(deviations, rows) if rows.any() else None
        for rows in (inside, ~inside)
        for deviations in found
    ]
    return Parts(inside, *accuracies)


def _paired(saved_mm: Array, pose: NDArray[np.str_]) -> Paired:
    _, group = np.unique(pose, return_inverse=True)
    by_pose = np.bincount(group, saved_mm) / np.bincount(group)
    count, mean = len(by_pose), float(by_pose.mean())
    half = 0.0
    if count > 1:
        spread = float(by_pose.std(ddof=1)) / np.sqrt(count)
        half = float(stdtrit(count - 1, 0.5 + _LEVEL / 2.0)) * spread
    return Paired(mean, mean - half, mean + half, count)
