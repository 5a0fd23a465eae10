"""Faults of single readings or poses, found before anything is sought.

They would be explained by effects, or would hide them: exchanged labels of targets, exchanged
loads, gross errors. What has one is excluded from noise, floor, search and refit, and told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.finding import DiagnosedFault
from pa10cal.discovery.linear import by_every_joint, residual
from pa10cal.discovery.noise import (
    noise_of_repeats,
    pose_weights,
    repeat_groups,
    whitener_of,
)
from pa10cal.discovery.rules import NOISE, ROWS
from pa10cal.errors import DiscoveryError
from pa10cal.fit import robust_weights
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import FaultKind
from pa10cal.rules import SCATTER


@dataclass(frozen=True)
class RowFaults:
    """Faults of single readings."""

    # (P,) readings not to be used; more than the faults name, as some are merely far
    excluded: Mask
    faults: tuple[DiagnosedFault, ...]  # what is certain


def row_faults(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> RowFaults:
    """Find faults of single readings of the poses fitted, with what the model needs.

    A payload of None is one that is not known.
    """
    told_N, gain = loads_exchanged(readings, model, payload, torques)
    other = told_N != readings.states.load_N
    faults = [*_of_loads(readings, told_N, gain)]
    rest, excluded = readings.take(~other), other.copy()
    gross = gross_errors(rest, model)
    excluded[~other] = gross.excluded
    faults += _of_readings(rest, model, gross, "")
    for pose, (off_mm, times) in poses_off(readings.take(~excluded), model).items():
        excluded |= readings.pose == pose
        what = f"all its readings are {off_mm:.3g} mm off, {times:.3g} times as far as is usual"
        faults.append(_outlier(pose, what, None, decides=False))
    return RowFaults(excluded, tuple(faults))


def held_out_faults(held_out: Observations, model: FittedModel, fitted: Observations) -> RowFaults:
    """Find readings held out that are far from their prediction; none is left out for that.

    Both they and those fitted are single readings with what the model needs.
    """
    far, white = robust_weights.far_from_prediction(held_out, model, fitted)
    far &= _above_noise(held_out, residual(model, held_out), white)
    off_mm = _position_mm(held_out, residual(model, held_out))
    gross = GrossErrors(far, far, _times_usual(white, held_out), off_mm)
    return RowFaults(far, tuple(_of_readings(held_out, model, gross, "held out, ")))


def of_wrong_row(finding: InputFinding) -> DiagnosedFault:
    """Return the fault of a configuration that was quarantined because it is wrong."""
    kind: FaultKind = "label" if finding.kind == "target_label" else "outlier"
    told = {"where": finding.where, "what": finding.what, "remedy": finding.remedy}
    return DiagnosedFault(kind=kind, **told, decides=kind == "label")


def influential_pose(pose: str, name: str, gain: float | None) -> DiagnosedFault:
    """Return the fault of a pose that carried a name alone."""
    what = (
        f"without this pose there is no evidence of {name}: one pose cannot show an effect of all"
    )
    return _outlier(pose, what, gain, decides=True)


def _outlier(pose: str, what: str, gain: float | None, *, decides: bool) -> DiagnosedFault:
    remedy = "check the readings of this pose: joints, load, labels"
    told = {"where": f"pose {pose}", "what": what, "remedy": remedy}
    return DiagnosedFault(kind="outlier", **told, gain=gain, decides=decides)


def _of_loads(readings: Observations, told_N: Array, gain: Array) -> Iterator[DiagnosedFault]:
    """Tell the readings of each pose whose load is another's."""
    stated_N = readings.states.load_N
    wrong = told_N != stated_N
    for pose in np.unique(readings.pose[wrong]):
        of_pose = readings.pose == pose
        here = wrong & of_pose
        pairs = sorted(set(zip(stated_N[here].tolist(), told_N[here].tolist(), strict=True)))
        where = f"pose {pose}, {', '.join(f'{stated:g} N' for stated, _ in pairs)}"
        if not all(here[of_pose & (stated_N == stated)].all() for stated, _ in pairs):
            where += f", repeat {', '.join(map(str, np.unique(readings.repeat[here])))}"
        swapped = len(pairs) > 1 and {one for one, _ in pairs} == {other for _, other in pairs}
        what = "the loads seem exchanged: " if swapped else "the load seems another: "
        what += "; ".join(f"{stated:g} N stated, {told:g} N told" for stated, told in pairs)
        remedy = "check which load hung on the arm, and correct load_N there"
        gained = float(gain[here].sum())
        yield DiagnosedFault(kind="load", where=where, what=what, remedy=remedy, gain=gained)


def _of_readings(
    readings: Observations, model: FittedModel, gross: GrossErrors, which: str
) -> Iterator[DiagnosedFault]:
    """Tell the readings that are surely wrong: by their labels, or for a reason not known."""
    rows = np.flatnonzero(gross.accused)
    if not len(rows):
        return
    some, names = readings.take(rows), readings.measured.target_names
    # The order of the targets that explains each reading, where another does than theirs.
    order_of: dict[int, tuple[int, ...]] = {}
    if 2 <= len(names) <= ROWS.most_targets:
        least = ROWS.exchanged_left_share * np.linalg.norm(residual(model, some), axis=1)
        for order in permutations(range(len(names))):
            other = replace(some, measured=some.measured.in_order(order))
            left = np.linalg.norm(residual(model, other), axis=1)
            for k in np.flatnonzero(left < least).tolist():
                order_of[k], least[k] = order, left[k]
    whole = float(np.sum(gross.times**2)) + len(readings)
    for k, row in enumerate(rows.tolist()):
        kind: FaultKind = "outlier"
        what = f"{gross.off_mm[row]:.3g} mm off, {gross.times[row]:.3g} times the usual scatter"
        remedy = "check the raw reading; measure it again or exclude it"
        if k in order_of:
            moved = " and ".join(names[b] for b, other in enumerate(order_of[k]) if other != b)
            kind, what = "label", f"the labels of targets {moved} seem exchanged"
            remedy = "correct the labels of this configuration"
        load_N, repeat = readings.states.load_N[row], readings.repeat[row]
        where = f"{which}pose {readings.pose[row]}, {load_N:g} N, repeat {repeat}"
        told = {"where": where, "what": what, "remedy": remedy}
        gain = float(gross.times[row] ** 2 / whole)
        yield DiagnosedFault(kind=kind, **told, gain=gain, decides=kind == "label")


# Single readings that a gross error moved: their repeats do not confirm them.
#
# What a model lacks moves all readings of a pose alike, while a gross error moves one. So a
# reading is judged by the other readings of its pose, load and direction of arrival; where there
# is none, by the calibrated model, and only beyond what heavy tails of its errors make. Touched
# balls are judged as all else is: each touch was within its ball, and the ball may have been
# another place.


@dataclass(frozen=True)
class GrossErrors:
    """Which of P single readings have a gross error."""

    excluded: Mask  # (P,) readings that are not to be averaged
    accused: Mask  # (P,) those of them that no tail of right data makes
    times: Array  # (P,) how many times as far off as is usual
    off_mm: Array  # (P,) how far off, of the position or distance


def gross_errors(readings: Observations, model: FittedModel) -> GrossErrors:
    """Return which of P single readings, with what the model needs, have a gross error.

    Each is judged by the others of its circumstances, or else by the model.
    """
    left, group = residual(model, readings), repeat_groups(readings)
    alone = np.bincount(group)[group] < 2
    found = _off_repeats(readings, model, left, group)
    if not alone.any():
        return found
    white = _by_scatter(readings, model, left)
    far = alone & _beyond_tails(white, readings, np.ones_like(alone))
    far &= _above_noise(readings, left, white)
    far &= ~robust_weights.confirmed(readings, left, np.flatnonzero(far))
    far &= ~_in_time(far, readings.states.time_s)
    return GrossErrors(
        found.excluded | far,
        found.accused | far,
        np.where(far, _times_usual(white, readings), found.times),
        np.where(far, _position_mm(readings, left), found.off_mm),
    )


def _off_repeats(
    readings: Observations, model: FittedModel, left: Array, group: Index
) -> GrossErrors:
    """Judge readings by the others of their circumstances, where some have any."""
    count, seen = len(readings), readings.measured.components_seen
    nobody, nothing = np.zeros(count, dtype=bool), np.zeros(count)
    alone = np.bincount(group)[group] < 2
    if alone.all():
        return GrossErrors(nobody, nobody, nothing, nothing)
    left = left - moved_between_repeats(readings, left, group)
    further = np.linalg.norm(robust_weights.by_stated(readings, left), axis=1)

    def exclude_gross_errors(whitener: Array, without: Mask, least: float) -> GrossErrors:
        """Exclude the reading furthest from the others of its group, group by group, anew.

        What is usual is found without some readings, and is at least this part of what was thought.
        """
        out, scale = nobody.copy(), np.ones(left.shape[1])

        def from_others(without: Mask) -> Array:
            apart, others = _less_others(left, group, seen, without)
            apart /= np.sqrt(1.0 + 1.0 / np.maximum(others, 1.0))  # in their own scatter
            return np.asarray((whitener @ apart[:, :, None])[:, :, 0] / scale)

        first, own = from_others(without), scale.copy()
        for _, at in readings.measured.component_kinds:
            here = (first[:, at] != 0.0) & ~(alone | without)[:, None]
            own[at] = max(robust_weights.Tails.of(first[:, at][here]).scale, least)
        scale *= own
        components = np.maximum(seen.sum(axis=1), 1)
        limit = np.sqrt(chdtri(components, ROWS.excluded_rate / count))
        limit *= 1.0 + ROWS.scale_error / np.sqrt(float(seen[~(alone | without)].sum()))
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
        times = _times_usual(apart, readings)
        out &= ~_in_time(out, readings.states.time_s)
        beyond = _beyond_tails(apart, readings, ~(alone | out), ~alone)
        return GrossErrors(out, out & beyond, times, nothing)

    stated = readings.measured.stated_covariance
    found = exclude_gross_errors(whitener_of(stated), nobody, SCATTER.least_stated)
    try:
        apart, _ = _less_others(left, group, seen, found.excluded)
        plain = np.where(found.excluded[:, None], left - apart, left)
        noise = noise_of_repeats(readings, -plain, by_every_joint(model, readings))
        whitener = whitener_of(noise.cov + SCATTER.least_stated**2 * stated)
    except (DiscoveryError, np.linalg.LinAlgError):
        pass
    else:
        found = exclude_gross_errors(whitener, found.excluded, ROWS.least_noise_share)
    apart, _ = _less_others(left, group, seen, found.excluded)
    if _of_one_joint(readings, model, apart, found.excluded):
        return GrossErrors(nobody, nobody, nothing, nothing)
    return replace(found, off_mm=_position_mm(readings, apart))


def _of_one_joint(readings: Observations, model: FittedModel, apart: Array, out: Mask) -> bool:
    """Return whether readings (P,) are off their repeats by what one joint moved, alike in size.

    So is one that rests in its lost motion, or in a hysteresis, now at one side and now at the
    other: its readings are right. By what readings (P, b) are off the others of their group.
    """
    rows = np.flatnonzero(out & np.any(apart != 0.0, axis=1))
    off = readings.take(rows)
    if len(rows) < ROWS.least_of_a_joint or off.measured.components_seen.sum(axis=1).min() < 3:
        return False
    whitener = whitener_of(off.measured.stated_covariance)
    white = (whitener @ apart[rows, :, None])[:, :, 0]
    by_joint = whitener @ by_every_joint(model, off)
    turned = np.einsum("pbj,pb->pj", by_joint, white)
    turned /= np.maximum(np.sum(by_joint**2, axis=1), np.finfo(float).tiny)
    left = np.sum((white[:, :, None] - by_joint * turned[:, None, :]) ** 2, axis=(0, 1))
    joint = int(np.argmin(left))
    size = np.abs(turned[:, joint])
    alike = size.max() <= ROWS.of_a_joint_times * np.median(size)
    return bool(alike and left[joint] <= (1.0 - ROWS.of_a_joint_share) * np.sum(white**2))


def poses_off(readings: Observations, model: FittedModel) -> dict[str, tuple[float, float]]:
    """Return poses of which all readings are far from the model, and no other pose is like them.

    Single readings are without gross errors.

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
        tails = robust_weights.Tails.of(
            white[:, at][robust_weights.components_seen(averages, at)], ROWS.of_poses_errors
        )
        far |= np.any(np.abs(white[:, at]) > tails.largest(ROWS.of_poses_rate), axis=1)
    far &= ~_in_time(far, averages.states.time_s)
    far &= _above_noise(averages, left, white)
    times = _times_usual(white, averages)
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
    """Return which single readings (P,) are further off than any tail of right data makes.

    Rows (P, b) are of about unit size. Usual ones show what tails there are, judged ones may be
    beyond them; None for the same.
    """
    judged = usual if judged is None else judged
    beyond = np.zeros(len(readings), dtype=bool)
    # Those found count no more, so that they do not hide each other.
    while True:
        found = beyond.copy()
        for _, at in readings.measured.component_kinds:
            # Zero is what nothing else was seen of.
            seen = robust_weights.components_seen(readings, at) & (white[:, at] != 0.0)
            bulk = white[:, at][seen & (usual & ~beyond)[:, None]]
            limit = robust_weights.Tails.of(bulk).largest(SCATTER.accused_rate)
            found |= judged & np.any(seen & (np.abs(white[:, at]) > limit), axis=1)
        if not (found & ~beyond).any() or found.mean() > ROWS.most_beyond_share:
            break
        beyond = found
    return beyond


def _less_others(values: Array, group: Index, seen: Mask, out: Mask) -> tuple[Array, Array]:
    """Return values (P, b) less the mean of the others of their group, and how many these are.

    Zero where nothing else was seen. What is out counts in no mean.
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
    """Return (P,) readings that are off in a stretch of time in which most readings are."""
    order = np.argsort(time_s, kind="stable")
    window = np.ones(2 * ROWS.neighbours + 1)
    if len(off) < len(window):
        return np.zeros(len(off), dtype=bool)
    most = np.convolve(off[order], window, mode="same") - off[order] > ROWS.neighbours
    together = np.zeros(len(off), dtype=bool)
    together[order] = np.convolve(most & off[order], window, mode="same") >= 1.0
    return together & off


def _above_noise(readings: Observations, left: Array, white: Array) -> Mask:
    """Return which readings (P,) are further off than is usual, and than their stated noise.

    Nothing below both can be seen in a single reading, however alike the others are.
    """
    stated = _times_usual(robust_weights.by_stated(readings, left), readings)
    return np.asarray((stated > 1.0) & (_times_usual(white, readings) > 1.0))


def _times_usual(white: Array, readings: Observations) -> Array:
    """Return how many times as far off as is usual readings are, (P,), by (P, b) of unit size."""
    components = np.maximum(readings.measured.components_seen.sum(axis=1), 1)
    return np.asarray(np.linalg.norm(white, axis=1) / np.sqrt(components))


def _position_mm(readings: Observations, apart: Array) -> Array:
    """Return the length (P,) [mm] of what differs in positions or distances."""
    at = readings.measured.position_columns
    return np.asarray(1e3 * np.linalg.norm(apart[:, at], axis=1))


# What moved between repeats, by running medians: gross errors do not sway it.


def moved_between_repeats(readings: Observations, left: Array, group: Index) -> Array:
    """Return by how much the components of readings moved with time, (P, b).

    By what a model leaves of them (P, b), and the number of the pose, load and direction of arrival
    of each (P,), from 0. Zero where the motion is smaller than the scatter about it.
    """
    found = np.zeros_like(left)
    several = np.bincount(group)[group] > 1
    if np.count_nonzero(several) <= ROWS.median_readings:
        return found
    apart = np.empty_like(left)  # less the median of the group
    for own in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
        apart[own] = left[own] - np.median(left[own], axis=0)
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


# Loads written down at the wrong readings: what each reading says of its load.
#
# Torques, and joints that give way, tell the load of a reading apart from what is stated. Where a
# few readings tell the load of another configuration while all others tell their own, the loads
# were exchanged.


def loads_exchanged(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> tuple[Array, Array]:
    """Find single readings whose load is that of another configuration.

    Returns:
        The load that each reading tells (P,), one of the campaign's, as stated but for those
        exchanged; and the part (P,) of the squared error of all readings that it takes away.
    """
    stated_N = readings.states.load_N
    nothing = stated_N, np.zeros(len(readings))
    loads_N = np.unique(stated_N)
    if payload is None or len(loads_N) < 2 or torques == "none":
        return nothing
    left, by_load = _load_rows(readings, model, payload, torques)
    if not np.any(by_load):
        return nothing
    alone = left.copy()  # less the median over the loads of each pose, where it has several
    for pose in np.unique(readings.pose):
        rows = np.flatnonzero(readings.pose == pose)
        if len(np.unique(stated_N[rows])) > 1:
            alone[rows] -= np.median(left[rows], axis=0)
    scale = NOISE.median_to_sigma * np.median(np.abs(alone), axis=0)
    known = scale > 0.0
    if not known.any():
        return nothing
    white, columns = alone[:, known] / scale[known], by_load[:, known] / scale[known]
    information = np.sum(columns**2, axis=1)
    told_N = np.sum(columns * white, axis=1) / np.maximum(information, np.finfo(float).tiny)
    # A posture that hardly feels the load says little of it.
    usual = NOISE.median_to_sigma * float(np.median(np.abs(told_N) * np.sqrt(information)))
    u_N = usual / np.sqrt(np.maximum(information, np.finfo(float).tiny))
    before = np.sum(white**2, axis=1)
    found = stated_N.copy()
    for load_N in loads_N:
        apart = load_N - stated_N
        allowed_N = ROWS.near_load_share * np.abs(apart)
        after = np.sum((white - columns * apart[:, None]) ** 2, axis=1)
        nearer = (np.abs(told_N - apart) < allowed_N) & (ROWS.load_known_times * u_N < allowed_N)
        nearer &= (np.abs(told_N) > ROWS.load_errors * u_N) & (
            after < ROWS.load_left_share * before
        )
        found[nearer & (apart != 0.0)] = load_N
    # Loads are exchanged between two readings. One that tells another load alone is merely off.
    told = found.copy()
    for row in np.flatnonzero(told != stated_N):
        there = (readings.pose == readings.pose[row]) & (stated_N == told[row])
        if not np.any(told[there] == stated_N[row]):
            found[row] = stated_N[row]
    wrong = found != stated_N
    if not wrong.any() or wrong.mean() > ROWS.most_slips_share:
        return nothing
    instead = white - columns * (found - stated_N)[:, None]
    gain = np.sum(white**2 - instead**2, axis=1) / np.sum(white**2)
    return found, np.where(wrong, gain, 0.0)


def _load_rows(
    readings: Observations, model: FittedModel, payload: Payload, torques: TorqueSource
) -> tuple[Array, Array]:
    """Return rows (P, r) measured less modelled that follow the load, and their derivative."""
    states = readings.states
    if torques == "logged":
        loads = statics_of(model.model, model.x, states, payload)
        return states.tau_Nm - loads.torque_Nm, loads.torque_by_load
    unknown = replace(states, tau_Nm=np.full_like(states.tau_Nm, np.nan))

    def left(more_N: float) -> Array:
        loaded = replace(unknown, load_N=states.load_N + more_N)
        carried, _ = with_torques(model.model, model.x, loaded, payload)
        return -residual(model, readings.with_states(replace(carried, load_N=states.load_N)))

    step_N = float(np.ptp(states.load_N))
    now = left(0.0)
    return now, (now - left(step_N)) / step_N
