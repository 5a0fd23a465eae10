"""Single readings, and poses, with gross errors: those that no other reading confirms.

An effect that a model lacks moves all readings of a pose alike; a gross error moves one. So a
reading is compared with the others of its group, those of its pose, load and direction of arrival.
A reading without others is compared with the calibrated model, with a limit by the heavy tails of
its errors. Touched balls are no exception: though its touches agree, a ball may have been
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from pa10cal.arrays import Array, Index, Mask, rms
from pa10cal.discovery.pose_scatter import pose_weights
from pa10cal.discovery.repeats import noise_of_repeats, repeat_groups
from pa10cal.discovery.rules import NOISE, ROWS
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.fit.tails import Tails, by_stated, components_seen, confirmed
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.instrument import Instrument, group_means
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.rules import SCATTER


@dataclass(frozen=True)
class GrossErrors:
    """Which of P single readings have a gross error."""

    excluded: Mask  # (P,) readings that are not to be averaged
    accused: Mask  # (P,) those of them that no heavy tail of correct data explains
    apart: Array  # (P, b) deviations from the other readings of the group, or from the model
    white: Array  # (P, b) the same over the usual ones


def gross_errors(readings: Observations, model: FittedModel) -> GrossErrors:
    """Return which of P complete single readings have a gross error.

    Each is judged by the others of its group, or by the model where there are none.
    """
    of_model, group = model.compared(readings).residual, repeat_groups(readings)
    alone = np.bincount(group)[group] < 2
    found = _off_repeats(readings, model, of_model, group)
    if not alone.any():
        return found
    white = _whitened(readings, model, of_model)
    far = alone & _beyond_tails(white, readings, np.ones_like(alone))
    far &= above_noise(readings, of_model, white)
    far &= ~confirmed(readings, of_model, np.flatnonzero(far))
    far &= ~_in_time(far, readings.states.time_s)
    return GrossErrors(
        excluded=found.excluded | far,
        accused=found.accused | far,
        apart=np.where(alone[:, None], of_model, found.apart),
        white=np.where(alone[:, None], white, found.white),
    )


def _off_repeats(
    readings: Observations, model: FittedModel, of_model: Array, group: Index
) -> GrossErrors:
    """Return the gross errors of readings that have others in their group.

    The scatter is first that of the stated covariance, then that found from the readings that
    remain, where these are enough. None is within the stated uncertainty of its repeats.
    """
    nobody = np.zeros(len(readings), dtype=bool)
    if (np.bincount(group)[group] < 2).all():
        return GrossErrors(nobody, nobody, np.zeros_like(of_model), np.zeros_like(of_model))
    stated = readings.measured.stated_covariance
    moved = moved_between_repeats(readings, of_model, group)
    still = of_model - _likelier_motion(readings, model, of_model, group, moved)
    repeats = _Repeats(readings, still, group)
    found = repeats.gross_errors(whitener_of(stated), nobody, SCATTER.least_stated)
    try:
        plain = np.where(found.excluded[:, None], still - found.apart, still)
        noise = noise_of_repeats(readings, -plain, ideal_by_joints(model, readings))
        whitener = whitener_of(noise.cov + SCATTER.least_stated**2 * stated)
    except (DiscoveryError, np.linalg.LinAlgError):
        pass
    else:
        found = repeats.gross_errors(whitener, found.excluded, ROWS.least_noise_share)
    if _of_one_joint(readings, model, found.apart, found.excluded):
        return replace(found, excluded=nobody, accused=nobody)
    # What is within the stated uncertainty is no gross error, however well the others agree.
    beyond = times_usual(by_stated(readings, found.apart), readings) > 1.0
    return replace(found, excluded=found.excluded & beyond, accused=found.accused & beyond)


@dataclass(frozen=True, eq=False)
class _Repeats:
    """Single readings that are compared with the others of their group."""

    readings: Observations
    residual: Array  # (P, b) without motion between repeats
    group: Index  # (P,) number of each reading's group

    def whitened(self, whitener: Array, out: Mask) -> Array:
        """Return whitened deviations (P, b) from the mean of the others, without those `out`."""
        seen = self.readings.measured.components_seen
        apart, others = _less_others(self.residual, self.group, seen, out)
        apart /= np.sqrt(1.0 + 1.0 / np.maximum(others, 1.0))  # the mean scatters as well
        return np.asarray((whitener @ apart[:, :, None])[:, :, 0])

    def gross_errors(self, whitener: Array, without: Mask, least: float) -> GrossErrors:
        """Return the gross errors by a whitener (P, b, b) of readings.

        The usual scatter of each kind of component is found from readings but those `without`, and
        is at least the factor `least` of what the whitener has.
        """
        readings = self.readings
        seen = readings.measured.components_seen
        alone = np.bincount(self.group)[self.group] < 2
        first, scale = self.whitened(whitener, without), np.ones(seen.shape[1])
        for _, at in readings.measured.component_kinds:
            here = (first[:, at] != 0.0) & ~(alone | without)[:, None]
            scale[at] = max(Tails.of(first[:, at][here]).scale, least)
        components = np.maximum(seen.sum(axis=1), 1)
        limit = np.sqrt(chdtri(components, ROWS.excluded_rate / len(readings)))
        limit *= 1.0 + ROWS.scale_error / np.sqrt(float(seen[~(alone | without)].sum()))
        out = self._beyond(limit, whitener / scale[:, None])
        white = self.whitened(whitener, out) / scale
        out &= ~_in_time(out, readings.states.time_s)
        beyond = _beyond_tails(white, readings, ~(alone | out), ~alone)
        apart, _ = _less_others(self.residual, self.group, seen, out)
        return GrossErrors(out, out & beyond, apart, white)

    def _beyond(self, limit: Array, whitener: Array) -> Mask:
        """Return the readings (P,) whose whitened deviation is longer than their limit (P,).

        In each group the reading furthest from the others is excluded, as long as there is one.
        """
        group, out = self.group, np.zeros(len(self.readings), dtype=bool)
        of_model = np.linalg.norm(by_stated(self.readings, self.residual), axis=1)
        while True:
            distance = np.linalg.norm(self.whitened(whitener, out), axis=1)
            far = np.flatnonzero(~out & (distance > limit))
            if not len(far):
                return out
            # Of two readings the one further from the model; of more, the one off the others.
            remaining = np.bincount(group[~out], minlength=group.max() + 1)[group]
            several = np.where(remaining[far] > 2, distance[far], 0.0)
            furthest = far[np.lexsort((of_model[far], several))[::-1]]
            worst = np.unique(group[furthest], return_index=True)[1]
            out[furthest[worst]] = True


def _likelier_motion(
    readings: Observations, model: FittedModel, of_model: Array, group: Index, moved: Array
) -> Array:
    """Return the motion in the course of time (P, b) that leaves repeats least scatter.

    That of the whole, or that of the zeros of joints which moved one after the other, as of a joint
    that warms up or was mastered anew: right readings before and after differ by it.

    Args:
        moved: (P, b) motion of the whole, by running medians.
    """
    rows = np.flatnonzero(np.bincount(group)[group] > 1)
    if len(rows) <= ROWS.median_readings:
        return moved
    rows = rows[np.argsort(readings.states.time_s[rows], kind="stable")]
    off, own = readings.take(rows), np.unique(group[rows], return_inverse=True)[1].ravel()
    seen, whitener = off.measured.components_seen, whitener_of(off.measured.stated_covariance)
    by_joint = whitener @ ideal_by_joints(model, off)
    information = np.maximum(np.sum(by_joint**2, axis=1), np.finfo(float).tiny)

    def white(values: Array) -> Array:
        return np.asarray((whitener @ values[rows, :, None])[:, :, 0])

    def scatter(rest: Array) -> float:
        return NOISE.median_to_sigma * float(np.median(np.abs(_apart(rest, own)[seen])))

    rest, of_joints = white(of_model), np.zeros((len(rows), by_joint.shape[2]))
    for _ in range(of_joints.shape[1]):
        turned = _apart(np.einsum("pbj,pb->pj", by_joint, rest) / information, own)
        turned = median_filter(turned, size=(ROWS.median_readings, 1), mode="nearest")
        without = [rest - by_joint[:, :, j] * turned[:, j, None] for j in range(turned.shape[1])]
        scatters = [scatter(each) for each in without]
        joint = int(np.argmin(scatters))
        if rms(rest - without[joint]) <= scatters[joint] or scatters[joint] >= scatter(rest):
            break
        rest = without[joint]
        of_joints[:, joint] += turned[:, joint]
    if scatter(rest) >= scatter(white(of_model - moved)):
        return moved
    found = np.zeros_like(of_model)
    motion = np.einsum("pbj,pj->pb", ideal_by_joints(model, off), of_joints)
    found[rows] = np.where(seen, motion, 0.0)
    return found


def _apart(of_model: Array, group: Index) -> Array:
    """Return residuals (P, b) less the median of each group."""
    apart = np.empty_like(of_model)
    for own in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
        apart[own] = of_model[own] - np.median(of_model[own], axis=0)
    return apart


def _of_one_joint(readings: Observations, model: FittedModel, apart: Array, out: Mask) -> bool:
    """Return whether excluded readings are off their repeats by similar motions of one joint.

    So are the readings of a joint that rests now at one side of its lost motion or hysteresis, now
    at the other: they are correct.

    Args:
        apart: (P, b) deviations from the others of the group.
        out: (P,) excluded readings.
    """
    rows = np.flatnonzero(out & np.any(apart != 0.0, axis=1))
    off = readings.take(rows)
    seen_count = off.measured.components_seen.sum(axis=1)
    if len(rows) < ROWS.least_of_a_joint or seen_count.min() < ROWS.least_components:
        return False
    whitener = whitener_of(off.measured.stated_covariance)
    white = (whitener @ apart[rows, :, None])[:, :, 0]
    by_joint = whitener @ ideal_by_joints(model, off)
    turned = np.einsum("pbj,pb->pj", by_joint, white)
    turned /= np.maximum(np.sum(by_joint**2, axis=1), np.finfo(float).tiny)
    remaining = np.sum((white[:, :, None] - by_joint * turned[:, None, :]) ** 2, axis=(0, 1))
    joint = int(np.argmin(remaining))
    size = np.abs(turned[:, joint])
    alike = size.max() <= ROWS.of_a_joint_times * np.median(size)
    return bool(alike and remaining[joint] <= (1.0 - ROWS.of_a_joint_share) * np.sum(white**2))


def poses_off(readings: Observations, model: FittedModel) -> dict[str, tuple[str, float]]:
    """Return the poses whose averages have a gross error: how far they are off, and over the usual.

    The single readings are without gross errors of their own.
    """
    labels, pose = np.unique(readings.pose, return_inverse=True)
    if len(labels) == len(readings):
        return {}  # each was judged as a reading
    averages = average_groups(readings, pose)
    of_model = group_means(model.compared(readings).residual, pose)
    white = _whitened(averages, model, of_model)
    far = np.zeros(len(labels), dtype=bool)
    for _, at in averages.measured.component_kinds:
        tails = Tails.of(white[:, at][components_seen(averages, at)], ROWS.of_poses_errors)
        far |= np.any(np.abs(white[:, at]) > tails.largest(ROWS.of_poses_rate), axis=1)
    far &= ~_in_time(far, averages.states.time_s)
    far &= above_noise(averages, of_model, white)
    times = times_usual(white, averages)
    return {
        str(labels[k]): (off_in_words(averages.measured, of_model[k], white[k]), float(times[k]))
        for k in np.flatnonzero(far)
    }


def _whitened(readings: Observations, model: FittedModel, of_model: Array) -> Array:
    """Return the residual (P, b) of a model, whitened by its own scatter."""
    dof = len(model.model.parameters) + len(model.targets_m) + 6
    whitener = pose_weights(of_model, dof, readings.measured).whitener
    return np.asarray((whitener @ of_model[:, :, None])[:, :, 0])


def _beyond_tails(
    white: Array, readings: Observations, usual: Mask, judged: Mask | None = None
) -> Mask:
    """Return which readings (P,) are further off than the tails of correct readings explain.

    Args:
        white: (P, b) whitened deviations; zero where there is nothing to compare with.
        usual: (P,) readings whose deviations show the tails.
        judged: (P,) readings that may be beyond them; None for the same.
    """
    judged = usual if judged is None else judged
    beyond = np.zeros(len(readings), dtype=bool)
    # Tails are estimated again without the readings beyond them, which could hide each other.
    while True:
        found = beyond.copy()
        for _, at in readings.measured.component_kinds:
            seen = components_seen(readings, at) & (white[:, at] != 0.0)
            bulk = white[:, at][seen & (usual & ~beyond)[:, None]]
            limit = Tails.of(bulk).largest(SCATTER.accused_rate)
            found |= judged & np.any(seen & (np.abs(white[:, at]) > limit), axis=1)
        if not (found & ~beyond).any() or found.mean() > ROWS.most_beyond_share:
            break
        beyond = found
    return beyond


def _less_others(values: Array, group: Index, seen: Mask, out: Mask) -> tuple[Array, Array]:
    """Return values (P, b) less the mean of the others in their group, and the number of these.

    Zero where no other was seen. Readings that are `out` (P,) do not count in means.
    """
    counts = seen & ~out[:, None]
    shape = (int(group.max()) + 1, values.shape[1])
    total, times = np.zeros(shape), np.zeros(shape)
    np.add.at(total, group, np.where(counts, values, 0.0))
    np.add.at(times, group, counts)
    others = times[group] - counts
    mean = (total[group] - np.where(counts, values, 0.0)) / np.maximum(others, 1.0)
    return np.where(seen & (others > 0), values - mean, 0.0), others


def _in_time(off: Mask, time_s: Array) -> Mask:
    """Return which readings (P,) are off together with most readings near them in time."""
    order = np.argsort(time_s, kind="stable")
    window = np.ones(2 * ROWS.neighbours + 1)
    if len(off) < len(window):
        return np.zeros(len(off), dtype=bool)
    most_are_off = np.convolve(off[order], window, mode="same") - off[order] > ROWS.neighbours
    together = np.zeros(len(off), dtype=bool)
    together[order] = np.convolve(most_are_off & off[order], window, mode="same") >= 1.0
    return together & off


def above_noise(readings: Observations, of_model: Array, white: Array) -> Mask:
    """Return which readings (P,) are off by more than the usual and the stated scatter.

    Args:
        of_model: (P, b) residual.
        white: (P, b) the same, whitened by its scatter.
    """
    stated = times_usual(by_stated(readings, of_model), readings)
    return np.asarray((stated > 1.0) & (times_usual(white, readings) > 1.0))


def times_usual(white: Array, readings: Observations) -> Array:
    """Return the root mean square (P,) over the components seen of whitened deviations (P, b)."""
    components = np.maximum(readings.measured.components_seen.sum(axis=1), 1)
    return np.asarray(np.linalg.norm(white, axis=1) / np.sqrt(components))


def off_in_words(measured: Instrument, apart: Array, white: Array) -> str:
    """Return how far a reading is off: `0.24 mm off` of position or distance, or `5 deg off`.

    Of position and orientation it is that which is further off, as usual deviations go.

    Args:
        measured: by the instrument that has its components.
        apart: (b,) its deviations; of an orientation twice the sine of half the angle.
        white: (b,) the same over the usual ones.
    """
    position = measured.position_columns
    turned = np.setdiff1d(np.arange(len(apart)), position)
    if np.linalg.norm(white[turned]) <= np.linalg.norm(white[position]):
        return f"{1e3 * np.linalg.norm(apart[position]):.3g} mm off"
    sine_of_half = min(float(np.linalg.norm(apart[turned])) / 2.0, 1.0)
    return f"{np.degrees(2.0 * np.arcsin(sine_of_half)):.3g} deg off"


def moved_between_repeats(readings: Observations, of_model: Array, group: Index) -> Array:
    """Return the motion of readings in the course of time, (P, b), by running medians.

    Medians are robust against gross errors. Zero where the motion is within the scatter about it.

    Args:
        of_model: (P, b) residual of a model.
        group: (P,) number, from 0, of each reading's pose, load and direction of arrival.
    """
    found = np.zeros_like(of_model)
    several = np.bincount(group)[group] > 1
    if np.count_nonzero(several) <= ROWS.median_readings:
        return found
    apart = _apart(of_model, group)
    rows = np.flatnonzero(several)
    rows = rows[np.argsort(readings.states.time_s[rows], kind="stable")]
    running_median = median_filter(apart[rows], size=(ROWS.median_readings, 1), mode="nearest")
    for _, at in readings.measured.component_kinds:
        seen = readings.measured.components_seen[rows, at]
        moved, rest = running_median[:, at], apart[rows, at] - running_median[:, at]
        if not seen.any():
            continue
        scatter = NOISE.median_to_sigma * float(np.median(np.abs(rest[seen])))
        if float(np.sqrt(np.mean(moved[seen] ** 2))) > scatter:
            found[rows, at] = np.where(seen, moved, 0.0)
    return found
