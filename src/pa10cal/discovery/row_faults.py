"""Faults of single readings or poses: exchanged labels of targets, exchanged loads, gross errors.

Effects would explain them, or they would hide effects. They are found before effects are sought;
readings with a fault are excluded from noise, noise floor, search and refit, and reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.discovery.exchanged_loads import loads_exchanged
from pa10cal.discovery.finding import DiagnosedFault
from pa10cal.discovery.gross_errors import (
    GrossErrors,
    above_noise,
    gross_errors,
    poses_off,
    position_mm,
    times_usual,
)
from pa10cal.discovery.linear import residual
from pa10cal.discovery.rules import ROWS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource
from pa10cal.fit.tails import far_from_prediction
from pa10cal.observe.observations import Observations
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import FaultKind


@dataclass(frozen=True)
class RowFaults:
    """Faults of single readings."""

    # (P,) readings not to be used; more than the faults name, as some are merely far
    excluded: Mask
    faults: tuple[DiagnosedFault, ...]  # those that are certain


def row_faults(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> RowFaults:
    """Find the faults of complete single readings of the poses fitted.

    A payload of None is one that is not known.
    """
    shown_N, gain = loads_exchanged(readings, model, payload, torques)
    exchanged = shown_N != readings.states.load_N
    faults = [*_load_faults(readings, shown_N, gain)]
    others, excluded = readings.take(~exchanged), exchanged.copy()
    gross = gross_errors(others, model)
    excluded[~exchanged] = gross.excluded
    faults += _reading_faults(others, model, gross, "")
    for pose, (off_mm, times) in poses_off(readings.take(~excluded), model).items():
        excluded |= readings.pose == pose
        what = f"all its readings are {off_mm:.3g} mm off, {times:.3g} times as far as is usual"
        faults.append(_outlier(pose, what, None, decides=False))
    return RowFaults(excluded, tuple(faults))


def held_out_faults(held_out: Observations, model: FittedModel, fitted: Observations) -> RowFaults:
    """Find held-out readings that are far from their prediction; they stay in the gap.

    Held-out and fitted readings are complete single readings.
    """
    far, white = far_from_prediction(held_out, model, fitted)
    of_model = residual(model, held_out)
    far &= above_noise(held_out, of_model, white)
    off_mm = position_mm(held_out, of_model)
    gross = GrossErrors(far, far, times_usual(white, held_out), off_mm)
    return RowFaults(far, tuple(_reading_faults(held_out, model, gross, "held out, ")))


def of_wrong_row(finding: InputFinding) -> DiagnosedFault:
    """Return the fault of a configuration that was quarantined because it is wrong."""
    kind: FaultKind = "label" if finding.kind == "target_label" else "outlier"
    return DiagnosedFault(
        kind=kind,
        where=finding.where,
        what=finding.what,
        remedy=finding.remedy,
        decides=kind == "label",
    )


def influential_pose(pose: str, name: str, gain: float | None) -> DiagnosedFault:
    """Return the fault of a pose that is the only evidence of a name."""
    what = (
        f"without this pose there is no evidence of {name}: one pose cannot show an effect of all"
    )
    return _outlier(pose, what, gain, decides=True)


def _outlier(pose: str, what: str, gain: float | None, *, decides: bool) -> DiagnosedFault:
    remedy = "check the readings of this pose: joints, load, labels"
    where = f"pose {pose}"
    return DiagnosedFault(
        kind="outlier", where=where, what=what, remedy=remedy, gain=gain, decides=decides
    )


def _load_faults(readings: Observations, shown_N: Array, gain: Array) -> Iterator[DiagnosedFault]:
    """Yield one fault for each pose with readings (P,) that show another load than stated."""
    stated_N = readings.states.load_N
    wrong = shown_N != stated_N
    for pose in np.unique(readings.pose[wrong]):
        of_pose = readings.pose == pose
        here = wrong & of_pose
        pairs = sorted(set(zip(stated_N[here].tolist(), shown_N[here].tolist(), strict=True)))
        where = f"pose {pose}, {', '.join(f'{stated:g} N' for stated, _ in pairs)}"
        if not all(here[of_pose & (stated_N == stated)].all() for stated, _ in pairs):
            where += f", repeat {', '.join(map(str, np.unique(readings.repeat[here])))}"
        swapped = {stated for stated, _ in pairs} == {shown for _, shown in pairs}
        exchanged = len(pairs) > 1 and swapped
        what = "the loads seem exchanged: " if exchanged else "the load seems another: "
        what += "; ".join(f"{stated:g} N stated, {shown:g} N told" for stated, shown in pairs)
        remedy = "check which load hung on the arm, and correct load_N there"
        gained = float(gain[here].sum())
        yield DiagnosedFault(kind="load", where=where, what=what, remedy=remedy, gain=gained)


def _reading_faults(
    readings: Observations, model: FittedModel, gross: GrossErrors, prefix: str
) -> Iterator[DiagnosedFault]:
    """Yield a fault for each accused reading: exchanged labels of targets, or an outlier.

    The prefix stands before the pose in its place.
    """
    rows = np.flatnonzero(gross.accused)
    if not len(rows):
        return
    names = readings.measured.target_names
    order_of = _orders_of_targets(readings.take(rows), model)
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


def _orders_of_targets(readings: Observations, model: FittedModel) -> dict[int, tuple[int, ...]]:
    """Return, by row, the order of the targets that explains a reading far better than its own."""
    count = len(readings.measured.target_names)
    orders: dict[int, tuple[int, ...]] = {}
    if not 2 <= count <= ROWS.most_targets:
        return orders
    least = ROWS.exchanged_left_share * np.linalg.norm(residual(model, readings), axis=1)
    for order in permutations(range(count)):
        reordered = replace(readings, measured=readings.measured.in_order(order))
        misfit = np.linalg.norm(residual(model, reordered), axis=1)
        for k in np.flatnonzero(misfit < least).tolist():
            orders[k], least[k] = order, misfit[k]
    return orders
