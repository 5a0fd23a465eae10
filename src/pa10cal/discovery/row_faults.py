"""Faults of single readings or poses: exchanged labels of targets, exchanged loads, gross errors.

Effects could explain them, or be hidden by them. So they are found before effects are sought, and
readings with a fault are reported and excluded from noise, noise floor, search and refit.

First come exchanged loads: two readings of a pose each show the load that is stated of the other,
by their torques or their joints that give way, while nearly all other readings show their own. Then
come gross errors of the readings that remain, exchanged labels among them, and at last poses that
are off in all their readings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.discovery.gross_errors import (
    GrossErrors,
    above_noise,
    gross_errors,
    off_in_words,
    poses_off,
    times_usual,
)
from pa10cal.discovery.log_faults import DiagnosedFault, fault_of_pose
from pa10cal.discovery.rules import NOISE, ROWS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.fit.tails import far_from_prediction
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import FaultKind, SuspectedReading


@dataclass(frozen=True)
class RowFaults:
    """Faults of P single readings."""

    # (P,) readings that are not used: those of the faults, and some that are only suspected
    excluded: Mask
    faults: tuple[DiagnosedFault, ...]
    suspected: tuple[SuspectedReading, ...] = ()


def row_faults(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> RowFaults:
    """Find the faults of single readings of the poses fitted; the readings are complete."""
    true_N, gain = true_loads(readings, model, payload, torques)
    faults = [*_load_faults(readings, true_N, gain)]
    excluded = true_N != readings.states.load_N  # (P,)
    rest = ~excluded  # (P,) readings whose loads are not exchanged
    of_rest = readings.take(rest)
    gross = gross_errors(of_rest, model)
    excluded[rest] = gross.excluded
    faults += _reading_faults(of_rest, model, gross, "")
    for pose, (off, times) in poses_off(readings.take(~excluded), model).items():
        excluded |= readings.pose == pose
        what = f"the mean of its readings is {off}, {times:.3g} times as far as is usual"
        faults.append(fault_of_pose(pose, what, None, decides=False))
    return RowFaults(excluded, tuple(faults), tuple(_suspected(of_rest, gross)))


def held_out_faults(held_out: Observations, model: FittedModel, fitted: Observations) -> RowFaults:
    """Find held-out readings that are far from their prediction, by complete single readings.

    They still count in the gap.
    """
    far, white = far_from_prediction(held_out, model, fitted)
    of_model = model.compared(held_out).residual
    far &= above_noise(held_out, of_model, white)
    gross = GrossErrors(far, far, of_model, white)
    return RowFaults(far, tuple(_reading_faults(held_out, model, gross, "held out, ")))


def _load_faults(readings: Observations, true_N: Array, gain: Array) -> Iterator[DiagnosedFault]:
    """Yield one fault for each pose with readings (P,) whose load is not the one stated."""
    stated_N = readings.states.load_N
    wrong = true_N != stated_N
    for pose in np.unique(readings.pose[wrong]):
        of_pose = readings.pose == pose
        here = wrong & of_pose
        pairs = sorted(set(zip(stated_N[here].tolist(), true_N[here].tolist(), strict=True)))
        loads = []
        for load_N in np.unique(stated_N[here]):
            of_load = of_pose & (stated_N == load_N)
            repeats = ", ".join(map(str, np.unique(readings.repeat[here & of_load])))
            loads.append(f"{load_N:g} N" + ("" if here[of_load].all() else f", repeat {repeats}"))
        loads_shown = "; ".join(f"{stated:g} N stated, {true:g} N shown" for stated, true in pairs)
        yield DiagnosedFault(
            kind="load",
            where=f"pose {pose}, {' and '.join(loads)}",
            what=f"the loads seem exchanged: {loads_shown}",
            remedy="check which load hung on the arm, and correct load_N there",
            gain=float(gain[here].sum()),
        )


def _suspected(readings: Observations, gross: GrossErrors) -> Iterator[SuspectedReading]:
    """Yield the readings that are excluded and not certainly wrong."""
    for row in np.flatnonzero(gross.excluded & ~gross.accused).tolist():
        yield SuspectedReading(where=_where(readings, row), what=_off(readings, gross, row))


def _where(readings: Observations, row: int) -> str:
    load_N, repeat = readings.states.load_N[row], readings.repeat[row]
    return f"pose {readings.pose[row]}, {load_N:g} N, repeat {repeat}"


def _off(readings: Observations, gross: GrossErrors, row: int) -> str:
    times = times_usual(gross.white, readings)[row]
    off = off_in_words(readings.measured, gross.apart[row], gross.white[row])
    return f"{off}, {times:.3g} times the usual scatter"


def _reading_faults(
    readings: Observations, model: FittedModel, gross: GrossErrors, prefix: str
) -> Iterator[DiagnosedFault]:
    """Yield a fault for each reading with a certain gross error: exchanged labels, or an outlier.

    The prefix comes before the name of the pose.
    """
    rows = np.flatnonzero(gross.accused)
    if not len(rows):
        return
    names, times = readings.measured.target_names, times_usual(gross.white, readings)
    order_of = _exchanged_labels(readings.take(rows), model)
    total = float(np.sum(times**2))
    for k, row in enumerate(rows.tolist()):
        kind: FaultKind = "outlier"
        what = _off(readings, gross, row)
        remedy = "check the raw reading; measure it again or exclude it"
        if k in order_of:
            moved = " and ".join(names[b] for b, other in enumerate(order_of[k]) if other != b)
            kind, what = "label", f"the labels of targets {moved} seem exchanged"
            remedy = "correct the labels of this configuration"
        yield DiagnosedFault(
            kind=kind,
            where=f"{prefix}{_where(readings, row)}",
            what=what,
            remedy=remedy,
            gain=float(times[row] ** 2 / total),
            decides=kind == "label",
        )


def _exchanged_labels(readings: Observations, model: FittedModel) -> dict[int, tuple[int, ...]]:
    """Return, by index of the reading, an order of the targets with which it fits far better."""
    order_of: dict[int, tuple[int, ...]] = {}
    misfit = np.linalg.norm(model.compared(readings).residual, axis=1)
    to_beat = ROWS.exchanged_left_share * misfit
    for order in _orders(readings.measured):
        reordered = replace(readings, measured=readings.measured.in_order(order))
        misfit = np.linalg.norm(model.compared(reordered).residual, axis=1)
        for k in np.flatnonzero(misfit < to_beat).tolist():
            order_of[k], to_beat[k] = order, misfit[k]
    return order_of


def _orders(measured: Instrument) -> Iterator[tuple[int, ...]]:
    """Yield the orders of all targets that exchange the labels of one campaign.

    None of a campaign with so many targets that there are too many orders to try.
    """
    every = tuple(range(len(measured.target_names)))
    first = 0
    for _, part in measured.campaigns or (("", measured),):
        count = len(part.target_names) if part.target_parameters else 0
        if 2 <= count <= ROWS.most_targets:
            for own in permutations(every[first : first + count]):
                yield (*every[:first], *own, *every[first + count :])
        first += count


# Loads that were exchanged between readings of one pose.


class LoadsShown(NamedTuple):
    """The loads that P readings show."""

    true_N: Array  # (P,) not the stated one where it was exchanged
    gain: Array  # (P,) share of the squared error of all readings that the exchange removes


def true_loads(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> LoadsShown:
    """Return the loads that readings show.

    All loads are as stated where the readings cannot show them (the payload is not known, there is
    one load, or there are no torques), and where so many seem exchanged that a load or torque is
    wrong instead.
    """
    stated_N = readings.states.load_N
    as_stated = LoadsShown(stated_N, np.zeros(len(readings)))
    if payload is None or len(np.unique(stated_N)) < 2 or torques == "none":
        return as_stated
    deviation, by_load = _load_rows(readings, model, payload, torques)
    shown = _exchanged_loads(_less_error_of_pose(deviation, readings), by_load, readings)
    by_loads = _less_error_of_pose(deviation, readings, loads_alike=True)
    others = _exchanged_loads(by_loads, by_load, readings)
    found = np.isin(readings.pose, readings.pose[shown.true_N != stated_N])
    shown = LoadsShown(
        np.where(found, shown.true_N, others.true_N), np.where(found, shown.gain, others.gain)
    )
    wrong = shown.true_N != stated_N
    return as_stated if not wrong.any() or _are_no_slips(wrong, readings) else shown


def _exchanged_loads(centred: Array, by_load: Array, readings: Observations) -> LoadsShown:
    """Return the loads shown by deviations (P, r) less those of their poses.

    Args:
        by_load: (P, r) derivative of the deviations by the load.
    """
    stated_N = readings.states.load_N
    scale = NOISE.median_to_sigma * np.median(np.abs(centred), axis=0)
    known = scale > 0.0
    white, columns = centred[:, known] / scale[known], by_load[:, known] / scale[known]
    shown_N = _shown_loads(white, columns, stated_N)
    true_N = np.where(_are_exchanged(shown_N, stated_N, readings.pose), shown_N, stated_N)
    corrected = white - columns * (true_N - stated_N)[:, None]
    removed = np.sum(white**2 - corrected**2, axis=1)
    gain = removed / max(float(np.sum(white**2)), np.finfo(float).tiny)
    return LoadsShown(true_N, np.where(true_N != stated_N, gain, 0.0))


def _are_no_slips(wrong: Mask, readings: Observations) -> bool:
    """Return whether loads (P,) are wrong in too many readings and poses for slips of a hand."""
    slipped = [  # of the poses that were measured under several loads
        wrong[rows].any()
        for rows in (readings.pose == pose for pose in np.unique(readings.pose))
        if len(np.unique(readings.states.load_N[rows])) > 1
    ]
    in_many_readings = wrong.mean() > ROWS.most_slips_share
    return bool(in_many_readings and np.mean(slipped) > ROWS.most_slipped_poses)


def _load_rows(
    readings: Observations, model: FittedModel, payload: Payload, torques: TorqueSource
) -> tuple[Array, Array]:
    """Return deviations (P, r), measured less modelled, and their derivative by the load.

    Of the torques where these were logged, else of the components of the readings.
    """
    states = readings.states
    if torques == "logged":
        loads = statics_of(model.model, model.x, states, payload)
        return states.tau_Nm - loads.joint_Nm, loads.by_load
    unknown = replace(states, tau_Nm=np.full_like(states.tau_Nm, np.nan))

    def deviation(more_N: float) -> Array:
        loaded = replace(unknown, load_N=states.load_N + more_N)
        carried, _ = with_torques(model.model, model.x, loaded, payload)
        other_load = readings.with_states(replace(carried, load_N=states.load_N))
        return -model.compared(other_load).residual

    step_N = float(np.ptp(states.load_N))
    now = deviation(0.0)
    return now, (now - deviation(step_N)) / step_N


def _less_error_of_pose(
    deviation: Array, readings: Observations, *, loads_alike: bool = False
) -> Array:
    """Return deviations (P, r) less their median over the readings of a pose.

    An error of the pose moves the readings of all its loads; an exchange of two loads moves them by
    opposite amounts. It leaves the median where it is if it is of as many readings of both. If all
    readings of loads with unequal numbers of repeats are exchanged, it leaves the median of the
    medians of the loads (`loads_alike`). Of three loads in cyclic order it leaves neither, so these
    are not found. The readings of a pose that was measured under one load stay as they are: no load
    in it can have been exchanged.
    """
    centred, stated_N = deviation.copy(), readings.states.load_N
    for pose in np.unique(readings.pose):
        rows = np.flatnonzero(readings.pose == pose)
        loads_N = np.unique(stated_N[rows])
        if len(loads_N) < 2:
            continue
        middle = deviation[rows]
        if loads_alike:
            of_load = [rows[stated_N[rows] == load_N] for load_N in loads_N]
            middle = np.stack([np.median(deviation[at], axis=0) for at in of_load])
        centred[rows] -= np.median(middle, axis=0)
    return centred


def _shown_loads(white: Array, columns: Array, stated_N: Array) -> Array:
    """Return the load of the campaign that each reading clearly shows, else the stated one, (P,).

    Of several that it may show it is the one that leaves the least error.

    Args:
        white: (P, r) whitened deviations under the stated loads.
        columns: (P, r) their derivative by the load.
        stated_N: (P,) the stated loads.
    """
    information = np.sum(columns**2, axis=1)
    # By least squares the load shown is the stated one and so much more.
    more_N = np.sum(columns * white, axis=1) / np.maximum(information, np.finfo(float).tiny)
    # In some postures the load has hardly any effect, so each load shown has its own uncertainty.
    # Deviations hold more than noise: their scatter is that of the loads shown, in these units.
    scatter = NOISE.median_to_sigma * float(np.median(np.abs(more_N) * np.sqrt(information)))
    u_N = scatter / np.sqrt(np.maximum(information, np.finfo(float).tiny))
    shown_N, least = stated_N.copy(), ROWS.load_left_share * np.sum(white**2, axis=1)
    for load_N in np.unique(stated_N):
        difference_N = load_N - stated_N
        allowed_N = ROWS.near_load_share * np.abs(difference_N)
        left = np.sum((white - columns * difference_N[:, None]) ** 2, axis=1)
        clear = np.abs(more_N - difference_N) < allowed_N  # never of the stated load itself
        clear &= ROWS.load_known_times * u_N < allowed_N
        clear &= np.abs(more_N) > ROWS.load_errors * u_N
        clear &= left < least
        shown_N[clear], least[clear] = load_N, left[clear]
    return shown_N


def _are_exchanged(shown_N: Array, stated_N: Array, pose: NDArray[np.str_]) -> Mask:
    """Return which readings (P,) show the load of another reading of their pose, and it theirs.

    A reading that alone shows another load has a large error.
    """
    exchanged = np.zeros(len(pose), dtype=bool)
    for row in np.flatnonzero(shown_N != stated_N):
        others = (pose == pose[row]) & (stated_N == shown_N[row])
        exchanged[row] = np.any(shown_N[others] == stated_N[row])
    return exchanged
