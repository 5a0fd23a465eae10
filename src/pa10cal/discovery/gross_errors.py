"""Single readings that a gross error moved: their repeats do not confirm them.

What a model lacks moves all readings of a pose alike, while a gross error moves one. So a reading
is judged by the other readings of its pose, load and direction of arrival; where there is none, by
the calibrated model, and only beyond what heavy tails of its errors make. Touched balls are judged
as all else is: each touch was within its ball, and the ball may have been another place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.in_time.running import moved_between_repeats
from pa10cal.discovery.linear import by_every_joint, residual
from pa10cal.discovery.noise import compared, noise_of_repeats
from pa10cal.discovery.weights import pose_weights
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.off_prediction import (
    LEAST_STATED,
    by_stated,
    components_seen,
    confirmed,
    far_from_prediction,
)
from pa10cal.fit.tails import ACCUSED_RATE, Tails
from pa10cal.observe.averages import average_groups
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations

#: Probability that any reading is excluded where none is wrong and errors are normal.
EXCLUDED_RATE = 0.1
#: Readings before and after one that are looked at: where most of them are off as well, something
#: happened in time, and the reading is no single one.
_NEIGHBOURS = 5
#: Relative error of a scatter that is found from one deviate, by its median, twice.
_OF_SCALE = 2.3
#: Means of poses have lighter tails than readings: as `tails.ACCUSED_RATE`, and standard errors by
#: which their tails may be heavier than found.
_OF_POSES_RATE = 1e-3
_OF_POSES_SURELY = 1.6
#: More readings than this are no gross errors.
_MOST_BEYOND = 0.1
#: Scatter is no less than this part of the noise found: rounding is none.
_LEAST_NOISE = 0.1


@dataclass(frozen=True)
class GrossErrors:
    """Which of P single readings have a gross error."""

    excluded: Mask  # (P,) readings that are not to be averaged
    accused: Mask  # (P,) those of them that no tail of right data makes
    times: Array  # (P,) how many times as far off as is usual
    off_mm: Array  # (P,) how far off, of the position or distance


def gross_errors(readings: Observations, model: FittedModel) -> GrossErrors:
    """Return which single readings have a gross error.

    Args:
        readings: P single readings, with what the model needs.
        model: the calibrated model.
    """
    left = residual(model, readings)
    by_repeats = _off_repeats(readings, model, left)
    return _off_model(readings, model, left, by_repeats)


def off_prediction(poses: Observations, model: FittedModel, fitted: Observations) -> GrossErrors:
    """Return which readings held out of a fit are far from where it predicts them.

    Args:
        poses: P single readings held out, with what the model needs.
        model: the calibrated model.
        fitted: single readings that it was fitted to, likewise: they show what is usual.
    """
    far, white = far_from_prediction(poses, model, fitted)
    components = np.sqrt(np.maximum(poses.measured.components_seen.sum(axis=1), 1))
    times = np.linalg.norm(white, axis=1) / components
    return GrossErrors(far, far, times, _position_mm(poses, residual(model, poses)))


def _off_repeats(readings: Observations, model: FittedModel, left: Array) -> GrossErrors:
    """Judge readings by the others of their circumstances."""
    count = len(readings)
    group, seen = compared(readings), readings.measured.components_seen
    nobody = np.zeros(count, dtype=bool)
    alone = np.bincount(group)[group] < 2
    nothing = np.zeros(count)
    if alone.all():
        return GrossErrors(nobody, nobody, nothing, nothing)
    left = left - moved_between_repeats(readings, left, group)
    further = np.linalg.norm(by_stated(readings, left), axis=1)

    def judged(whitener: Array, without: Mask, least: float) -> GrossErrors:
        """Exclude the reading furthest from the others of its group, group by group, anew.

        What is usual is found without some readings, and is at least this part of what was thought.
        """
        out, scale = nobody.copy(), np.ones(left.shape[1])

        def from_others(without: Mask) -> Array:
            apart = _from_others(left, group, seen, without)
            return np.asarray((whitener @ apart[:, :, None])[:, :, 0] / scale)

        first, own = from_others(without), scale.copy()
        for _, at in readings.measured.component_kinds:
            here = (first[:, at] != 0.0) & ~(alone | without)[:, None]
            own[at] = max(Tails.of(first[:, at][here]).scale, least)
        scale *= own
        components = np.maximum(seen.sum(axis=1), 1)
        limit = np.sqrt(chdtri(components, EXCLUDED_RATE / count))
        limit *= 1.0 + _OF_SCALE / np.sqrt(float(seen[~(alone | without)].sum()))
        while True:
            distance = np.linalg.norm(from_others(out), axis=1)
            far = np.flatnonzero(~out & (distance > limit))
            if not len(far):
                break
            # Of two readings the one further from the model; of more, the one off the others.
            left_in = np.bincount(group[~out], minlength=group.max() + 1)[group]
            order = np.lexsort((further[far], np.where(left_in[far] > 2, distance[far], 0.0)))
            worst = np.unique(group[far[order[::-1]]], return_index=True)[1]
            out[far[order[::-1]][worst]] = True
        apart = from_others(out)
        times = np.linalg.norm(apart, axis=1) / np.sqrt(components)
        out &= ~_in_time(out, readings.states.time_s)
        beyond = _beyond_tails(apart, readings, ~(alone | out), ~alone)
        return GrossErrors(out, out & beyond, times, nothing)

    stated = readings.measured.stated_covariance
    found = judged(np.linalg.inv(np.linalg.cholesky(stated)), nobody, LEAST_STATED)
    try:
        plain = _with_means_of_others(left, group, seen, found.excluded)
        noise = noise_of_repeats(readings, -plain, by_every_joint(model, readings))
        cov = noise.cov + LEAST_STATED**2 * stated
        whitener = np.linalg.inv(np.linalg.cholesky(cov))
    except (DiscoveryError, np.linalg.LinAlgError):
        pass
    else:
        found = judged(whitener, found.excluded, _LEAST_NOISE)
    apart, _ = _less_others(left, group, seen, found.excluded)
    return GrossErrors(found.excluded, found.accused, found.times, _position_mm(readings, apart))


def _off_model(
    readings: Observations, model: FittedModel, left: Array, found: GrossErrors
) -> GrossErrors:
    """Judge readings without a repeat of the same circumstances by the model."""
    group, seen = compared(readings), readings.measured.components_seen
    alone = np.bincount(group)[group] < 2
    if not alone.any():
        return found
    white = _by_scatter(readings, model, left)
    far = alone & _beyond_tails(white, readings, np.ones(len(readings), dtype=bool))
    far &= ~confirmed(readings, left, np.flatnonzero(far))
    far &= ~_in_time(far, readings.states.time_s)
    components = np.sqrt(np.maximum(seen.sum(axis=1), 1))
    return GrossErrors(
        found.excluded | far,
        found.accused | far,
        np.where(far, np.linalg.norm(white, axis=1) / components, found.times),
        np.where(far, _position_mm(readings, left), found.off_mm),
    )


def poses_off(readings: Observations, model: FittedModel) -> dict[str, tuple[float, float]]:
    """Return poses of which all readings are far from the model, and no other pose is like them.

    Args:
        readings: P single readings without gross errors, with what the model needs.
        model: the calibrated model.

    Returns:
        How far off each is [mm], and how many times as far as is usual.
    """
    labels, pose = np.unique(readings.pose, return_inverse=True)
    if len(labels) == len(readings):
        return {}  # each was judged as a reading
    averages = average_groups(readings, pose)
    left = group_means(residual(model, readings), pose)
    white = _by_scatter(averages, model, left)
    far = np.zeros(len(labels), dtype=bool)
    for _, at in averages.measured.component_kinds:
        tails = Tails.of(white[:, at][components_seen(averages, at)], _OF_POSES_SURELY)
        far |= np.any(np.abs(white[:, at]) > tails.largest(_OF_POSES_RATE), axis=1)
    far &= ~_in_time(far, averages.states.time_s)
    components = np.sqrt(np.maximum(averages.measured.components_seen.sum(axis=1), 1))
    times = np.linalg.norm(white, axis=1) / components
    off_mm = _position_mm(averages, left)
    return {str(labels[k]): (float(off_mm[k]), float(times[k])) for k in np.flatnonzero(far)}


def _by_scatter(readings: Observations, model: FittedModel, left: Array) -> Array:
    """Return what a model leaves (P, b) in the scatter of it."""
    dof = len(model.model.parameters) + len(model.targets_m) + 6
    whitener = pose_weights(left, dof, readings.measured).whitener
    return np.asarray((whitener @ left[:, :, None])[:, :, 0])


def _beyond_tails(
    white: Array, readings: Observations, usual: Mask, judged: Mask | None = None
) -> Mask:
    """Return (P,) which readings are further off than any tail of right data makes.

    Args:
        white: (P, b) of about unit size.
        readings: P single readings.
        usual: (P,) those that show what tails there are.
        judged: (P,) those that may be beyond them; None for the same.
    """
    judged = usual if judged is None else judged
    beyond = np.zeros(len(readings), dtype=bool)
    # Those found count no more, so that they do not hide each other.
    while True:
        found = beyond.copy()
        for _, at in readings.measured.component_kinds:
            # Zero is what nothing else was seen of.
            seen = components_seen(readings, at) & (white[:, at] != 0.0)
            bulk = white[:, at][seen & (usual & ~beyond)[:, None]]
            limit = Tails.of(bulk).largest(ACCUSED_RATE)
            found |= judged & np.any(seen & (np.abs(white[:, at]) > limit), axis=1)
        if not (found & ~beyond).any() or found.mean() > _MOST_BEYOND:
            break
        beyond = found
    return beyond


def _from_others(values: Array, group: Index, seen: Mask, out: Mask) -> Array:
    """Return values (P, b) less the mean of the others of their group, in their own scatter.

    Zero where nothing else was seen. What is out counts in no mean.
    """
    apart, others = _less_others(values, group, seen, out)
    return np.asarray(apart / np.sqrt(1.0 + 1.0 / np.maximum(others, 1.0)))


def _less_others(values: Array, group: Index, seen: Mask, out: Mask) -> tuple[Array, Array]:
    counts = seen & ~out[:, None]
    shape = (int(group.max()) + 1, values.shape[1])
    total, times = np.zeros(shape), np.zeros(shape)
    np.add.at(total, group, np.where(counts, values, 0.0))
    np.add.at(times, group, counts)
    others = times[group] - counts
    mean = (total[group] - np.where(counts, values, 0.0)) / np.maximum(others, 1.0)
    return np.where(seen & (others > 0), values - mean, 0.0), others


def _with_means_of_others(values: Array, group: Index, seen: Mask, out: Mask) -> Array:
    apart, _ = _less_others(values, group, seen, out)
    return np.where(out[:, None], values - apart, values)


def _in_time(off: Mask, time_s: Array) -> Mask:
    """Return (P,) readings that are off in a stretch of time in which most readings are."""
    order = np.argsort(time_s, kind="stable")
    window = np.ones(2 * _NEIGHBOURS + 1)
    if len(off) < len(window):
        return np.zeros(len(off), dtype=bool)
    most = np.convolve(off[order], window, mode="same") - off[order] > _NEIGHBOURS
    together = np.zeros(len(off), dtype=bool)
    together[order] = np.convolve(most & off[order], window, mode="same") > 0.5
    return together & off


def _position_mm(readings: Observations, apart: Array) -> Array:
    """Return the length (P,) [mm] of what differs in positions or distances."""
    at = readings.measured.position_columns
    return np.asarray(1e3 * np.linalg.norm(apart[:, at], axis=1))
