"""Faults of single readings or poses: exchanged labels of targets, exchanged loads, gross errors.

Effects could explain them, or be hidden by them. So they are found before effects are sought, and
readings with a fault are reported and excluded from noise, noise floor, search and refit.

A load was written down at the wrong reading if that reading shows the load of another configuration
of its pose, by its torques or its joints that give way, while nearly all others show their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.discovery.gross_errors import (
    GrossErrors,
    above_noise,
    gross_errors,
    poses_off,
    position_mm,
    times_usual,
)
from pa10cal.discovery.log_faults import DiagnosedFault, fault_of_pose
from pa10cal.discovery.rules import NOISE, ROWS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.fit.tails import far_from_prediction
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import FaultKind


@dataclass(frozen=True)
class RowFaults:
    """Faults of P single readings."""

    # (P,) readings that are not used: those of the faults, and some that are only suspected
    excluded: Mask
    faults: tuple[DiagnosedFault, ...]


def row_faults(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> RowFaults:
    """Find the faults of single readings of the poses fitted; the readings are complete."""
    true_N, gain = true_loads(readings, model, payload, torques)
    exchanged = true_N != readings.states.load_N
    faults = [*_load_faults(readings, true_N, gain)]
    others, excluded = readings.take(~exchanged), exchanged.copy()
    gross = gross_errors(others, model)
    excluded[~exchanged] = gross.excluded
    faults += _reading_faults(others, model, gross, "")
    for pose, (off_mm, times) in poses_off(readings.take(~excluded), model).items():
        excluded |= readings.pose == pose
        what = f"all its readings are {off_mm:.3g} mm off, {times:.3g} times as far as is usual"
        faults.append(fault_of_pose(pose, what, None, decides=False))
    return RowFaults(excluded, tuple(faults))


def held_out_faults(held_out: Observations, model: FittedModel, fitted: Observations) -> RowFaults:
    """Find held-out readings that are far from their prediction, by complete single readings.

    They still count in the gap.
    """
    far, white = far_from_prediction(held_out, model, fitted)
    of_model = model.compared(held_out).residual
    far &= above_noise(held_out, of_model, white)
    off_mm = position_mm(held_out, of_model)
    gross = GrossErrors(far, far, times_usual(white, held_out), off_mm)
    return RowFaults(far, tuple(_reading_faults(held_out, model, gross, "held out, ")))


def _load_faults(readings: Observations, true_N: Array, gain: Array) -> Iterator[DiagnosedFault]:
    """Yield one fault for each pose with readings (P,) whose load is not the one stated."""
    stated_N = readings.states.load_N
    wrong = true_N != stated_N
    for pose in np.unique(readings.pose[wrong]):
        of_pose = readings.pose == pose
        here = wrong & of_pose
        pairs = sorted(set(zip(stated_N[here].tolist(), true_N[here].tolist(), strict=True)))
        where = f"pose {pose}, {', '.join(f'{stated:g} N' for stated, _ in pairs)}"
        if not all(here[of_pose & (stated_N == stated)].all() for stated, _ in pairs):
            where += f", repeat {', '.join(map(str, np.unique(readings.repeat[here])))}"
        swapped = {stated for stated, _ in pairs} == {true for _, true in pairs}
        exchanged = len(pairs) > 1 and swapped
        what = "the loads seem exchanged: " if exchanged else "the load seems another: "
        what += "; ".join(f"{stated:g} N stated, {true:g} N told" for stated, true in pairs)
        remedy = "check which load hung on the arm, and correct load_N there"
        gained = float(gain[here].sum())
        yield DiagnosedFault(kind="load", where=where, what=what, remedy=remedy, gain=gained)


def _reading_faults(
    readings: Observations, model: FittedModel, gross: GrossErrors, prefix: str
) -> Iterator[DiagnosedFault]:
    """Yield a fault for each reading with a certain gross error: exchanged labels, or an outlier.

    The prefix comes before the name of the pose.
    """
    rows = np.flatnonzero(gross.accused)
    if not len(rows):
        return
    names = readings.measured.target_names
    order_of = _exchanged_labels(readings.take(rows), model)
    total = float(np.sum(gross.times**2)) + len(readings)
    for k, row in enumerate(rows.tolist()):
        kind: FaultKind = "outlier"
        what = f"{gross.off_mm[row]:.3g} mm off, {gross.times[row]:.3g} times the usual scatter"
        remedy = "check the raw reading; measure it again or exclude it"
        if k in order_of:
            moved = " and ".join(names[b] for b, other in enumerate(order_of[k]) if other != b)
            kind, what = "label", f"the labels of targets {moved} seem exchanged"
            remedy = "correct the labels of this configuration"
        load_N, repeat = readings.states.load_N[row], readings.repeat[row]
        yield DiagnosedFault(
            kind=kind,
            where=f"{prefix}pose {readings.pose[row]}, {load_N:g} N, repeat {repeat}",
            what=what,
            remedy=remedy,
            gain=float(gross.times[row] ** 2 / total),
            decides=kind == "label",
        )


def _exchanged_labels(readings: Observations, model: FittedModel) -> dict[int, tuple[int, ...]]:
    """Return, by row, another order of the targets with which the reading fits far better."""
    count = len(readings.measured.target_names)
    orders: dict[int, tuple[int, ...]] = {}
    if not 2 <= count <= ROWS.most_targets:
        return orders
    least = ROWS.exchanged_left_share * np.linalg.norm(model.compared(readings).residual, axis=1)
    for order in permutations(range(count)):
        reordered = replace(readings, measured=readings.measured.in_order(order))
        misfit = np.linalg.norm(model.compared(reordered).residual, axis=1)
        for k in np.flatnonzero(misfit < least).tolist():
            orders[k], least[k] = order, misfit[k]
    return orders


# Loads that were exchanged between readings of one pose.


def true_loads(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> tuple[Array, Array]:
    """Return the load of each reading, (P,), which is not the stated one where it was exchanged.

    And the share (P,) of the squared error of all readings that the exchange removes.
    """
    stated_N = readings.states.load_N
    nothing = stated_N, np.zeros(len(readings))
    loads_N = np.unique(stated_N)
    if payload is None or len(loads_N) < 2 or torques == "none":
        return nothing
    deviation, by_load = _load_rows(readings, model, payload, torques)
    if not np.any(by_load):
        return nothing
    # An error of the pose moves the readings of all its loads.
    centred = deviation.copy()
    for pose in np.unique(readings.pose):
        rows = np.flatnonzero(readings.pose == pose)
        if len(np.unique(stated_N[rows])) > 1:
            centred[rows] -= np.median(deviation[rows], axis=0)
    scale = NOISE.median_to_sigma * np.median(np.abs(centred), axis=0)
    known = scale > 0.0
    if not known.any():
        return nothing
    white, columns = centred[:, known] / scale[known], by_load[:, known] / scale[known]
    shown_N = _shown_loads(white, columns, stated_N)
    # Loads are exchanged between two readings: one that alone shows another load has a large error.
    true_N = stated_N.copy()
    for row in np.flatnonzero(shown_N != stated_N):
        there = (readings.pose == readings.pose[row]) & (stated_N == shown_N[row])
        if np.any(shown_N[there] == stated_N[row]):
            true_N[row] = shown_N[row]
    wrong = true_N != stated_N
    if not wrong.any() or wrong.mean() > ROWS.most_slips_share:
        return nothing
    corrected = white - columns * (true_N - stated_N)[:, None]
    gain = np.sum(white**2 - corrected**2, axis=1) / np.sum(white**2)
    return true_N, np.where(wrong, gain, 0.0)


def _shown_loads(white: Array, columns: Array, stated_N: Array) -> Array:
    """Return the load of the campaign that each reading clearly shows, else the stated one, (P,).

    By whitened deviations (P, r) under the stated loads (P,), and their derivative by the load.
    """
    information = np.sum(columns**2, axis=1)
    more_N = np.sum(columns * white, axis=1) / np.maximum(information, np.finfo(float).tiny)
    # In some postures the load has hardly any effect.
    scatter = NOISE.median_to_sigma * float(np.median(np.abs(more_N) * np.sqrt(information)))
    u_N = scatter / np.sqrt(np.maximum(information, np.finfo(float).tiny))
    before = np.sum(white**2, axis=1)
    shown_N = stated_N.copy()
    for load_N in np.unique(stated_N):
        difference_N = load_N - stated_N
        allowed_N = ROWS.near_load_share * np.abs(difference_N)
        after = np.sum((white - columns * difference_N[:, None]) ** 2, axis=1)
        clear = np.abs(more_N - difference_N) < allowed_N
        clear &= ROWS.load_known_times * u_N < allowed_N
        clear &= np.abs(more_N) > ROWS.load_errors * u_N
        clear &= after < ROWS.load_left_share * before
        shown_N[clear & (difference_N != 0.0)] = load_N
    return shown_N


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
