"""Faults of single readings or poses, found before anything is sought.

They would be explained by effects, or would hide them: exchanged labels of targets, exchanged
loads, gross errors. What has one is excluded from noise, floor, search and refit, and told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.findings import InputFinding
from pa10cal.discovery.faults import Fault
from pa10cal.discovery.gross_errors import GrossErrors, gross_errors, off_prediction, poses_off
from pa10cal.discovery.linear import residual
from pa10cal.discovery.loads_exchanged import loads_exchanged
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource
from pa10cal.observe.observations import Observations
from pa10cal.results.fault_kind import FaultKind

#: Labels are exchanged where another order leaves so little of what is left.
_EXCHANGED_LEFT = 0.25
#: Targets whose orders are all tried.
_MOST_TARGETS = 5
_LOOK_AT_POSE = "look at the readings of this pose: joints, load, labels"
_LOOK = "look at the raw reading, and measure it again or leave it out"


@dataclass(frozen=True)
class RowFaults:
    """Faults of single readings."""

    # (P,) readings not to be used; more than the faults name, as some are merely far
    excluded: Mask
    faults: tuple[Fault, ...]  # what is certain


def row_faults(
    readings: Observations, model: FittedModel, payload: Payload | None, torques: TorqueSource
) -> RowFaults:
    """Find faults of single readings of the poses fitted.

    Args:
        readings: P single readings, with what the model needs.
        model: the calibrated model.
        payload: what the arm carries; None where it is not known.
        torques: where the torques of the readings come from.
    """
    exchanged = loads_exchanged(readings, model, payload, torques)
    other = exchanged.load_N != readings.states.load_N
    faults = [*_of_loads(readings, exchanged.load_N, exchanged.gain)]
    rest = np.flatnonzero(~other)
    gross = gross_errors(readings.take(rest), model)
    excluded = other.copy()
    excluded[rest] |= gross.excluded
    faults += _of_readings(readings.take(rest), model, gross, "")
    for pose, (off_mm, times) in poses_off(readings.take(~excluded), model).items():
        excluded |= readings.pose == pose
        what = f"all its readings are {off_mm:.3g} mm off, {times:.3g} times as far as is usual"
        faults.append(Fault("outlier", f"pose {pose}", what, _LOOK_AT_POSE, decides=False))
    return RowFaults(excluded, tuple(faults))


def held_out_faults(held_out: Observations, model: FittedModel, fitted: Observations) -> RowFaults:
    """Find readings held out that are far from their prediction; none is left out for that.

    Args:
        held_out: P single readings held out, with what the model needs.
        model: the calibrated model.
        fitted: single readings that it was fitted to, likewise.
    """
    found = off_prediction(held_out, model, fitted)
    faults = _of_readings(held_out, model, found, "held out, ")
    return RowFaults(found.excluded, tuple(faults))


def of_wrong_row(finding: InputFinding) -> Fault:
    """Return the fault of a configuration that was quarantined because it is wrong."""
    kind: FaultKind = "label" if finding.kind == "target_label" else "outlier"
    return Fault(kind, finding.where, finding.what, finding.remedy, decides=kind == "label")


def carries(pose: str, name: str, gain: float | None) -> Fault:
    """Return the fault of a pose that carried a name alone."""
    return Fault(
        "outlier",
        f"pose {pose}",
        f"without this pose nothing speaks for {name}: one pose is no evidence of what acts in all",
        _LOOK_AT_POSE,
        gain,
    )


def place_of(readings: Observations, row: int) -> str:
    """Return which reading a row is, in words."""
    load_N, repeat = readings.states.load_N[row], readings.repeat[row]
    return f"pose {readings.pose[row]}, {load_N:g} N, repeat {repeat}"


def _of_loads(readings: Observations, told_N: Array, gain: Array) -> Iterator[Fault]:
    """Tell the readings of each pose whose load is another's."""
    stated_N = readings.states.load_N
    wrong = told_N != stated_N
    for pose in np.unique(readings.pose[wrong]):
        here = wrong & (readings.pose == pose)
        pairs = sorted(set(zip(stated_N[here].tolist(), told_N[here].tolist(), strict=True)))
        whole = all(here[(readings.pose == pose) & (stated_N == one)].all() for one, _ in pairs)
        repeats = sorted(set(readings.repeat[here].tolist()))
        among = "" if whole else f", repeat {', '.join(map(str, repeats))}"
        each = "; ".join(f"{one:g} N stated, {other:g} N told" for one, other in pairs)
        swapped = len(pairs) > 1 and {one for one, _ in pairs} == {other for _, other in pairs}
        yield Fault(
            "load",
            f"pose {pose}, {', '.join(f'{one:g} N' for one, _ in pairs)}{among}",
            f"{'the loads seem exchanged' if swapped else 'the load seems another'}: {each}",
            "check which load hung on the arm, and correct load_N there",
            float(gain[here].sum()),
        )


def _of_readings(
    readings: Observations, model: FittedModel, gross: GrossErrors, which: str
) -> Iterator[Fault]:
    """Tell the readings that are surely wrong: by their labels, or for a reason not known."""
    rows = np.flatnonzero(gross.accused)
    if not len(rows):
        return
    orders = _orders(readings.take(rows), model)
    whole = float(np.sum(gross.times**2)) + len(readings)
    for row, order in zip(rows.tolist(), orders, strict=True):
        gain = float(gross.times[row] ** 2 / whole)
        if order is not None:
            names = readings.measured.target_names
            moved = " and ".join(names[b] for b, other in enumerate(order) if other != b)
            yield Fault(
                "label",
                f"{which}{place_of(readings, row)}",
                f"the labels of targets {moved} seem exchanged",
                "correct the labels of this configuration",
                gain,
            )
        else:
            yield Fault(
                "outlier",
                f"{which}{place_of(readings, row)}",
                f"{gross.off_mm[row]:.3g} mm off, {gross.times[row]:.3g} times the usual scatter",
                _LOOK,
                gain,
                decides=False,
            )


def _orders(readings: Observations, model: FittedModel) -> list[tuple[int, ...] | None]:
    """Return the order of the targets that explains each reading; None where none does."""
    names = readings.measured.target_names
    found: list[tuple[int, ...] | None] = [None] * len(readings)
    if not 2 <= len(names) <= _MOST_TARGETS:
        return found
    least = _EXCHANGED_LEFT * np.linalg.norm(residual(model, readings), axis=1)
    for order in permutations(range(len(names))):
        other = replace(readings, measured=readings.measured.in_order(order))
        left = np.linalg.norm(residual(model, other), axis=1)
        for row in np.flatnonzero(left < least).tolist():
            found[row], least[row] = order, left[row]
    return found
