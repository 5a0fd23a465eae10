"""Faults of a log that discovery finds: what is wrong, where, and what to do."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.fit.prediction import Suspicion
from pa10cal.results.fault_kind import FaultKind
from pa10cal.terms.faults.log_fault import LogFault

#: Kinds of what a calibration finds in its input that are faults of the log.
_OF_INPUT: dict[str, FaultKind] = {
    "joint_sign": "joint_sign",
    "joint_order": "joint_sign",
    "joint_zero": "joint_zero",
    "target_label": "label",
    "campaigns": "step_in_time",
}


@dataclass(frozen=True)
class Fault:
    """Something in the log that is wrong."""

    kind: FaultKind  # which fault
    where: str  # column, joint, load, pose, row or time
    what: str  # what is wrong and by how much, one clause
    remedy: str  # what to do about it
    # part of the weighted squared error that putting it right takes away; None where that was not
    # tried
    gain: float | None = None
    # whether the verdict is `check_the_log` whatever else was found; a reading with a gross error,
    # once excluded, leaves the effects found standing
    decides: bool = True
    # of a step that is told as a fact, its most likely time; readings before and after have bases
    # of their own
    at_s: float | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.remedy}"


def steps_told(faults: Sequence[Fault]) -> tuple[float, ...]:
    """Return the times of the steps that are told as facts [s], the most certain first."""
    return tuple(fault.at_s for fault in faults if fault.at_s is not None)


def fault_of(term: LogFault, x: Array, covariance: Array, gain: float | None) -> Fault:
    """Return a fault that the search found as a term.

    Args:
        term: which.
        x, covariance: its reported parameters, and their covariance.
        gain: part of the squared error that it explains.
    """
    told = term.told(x, np.sqrt(np.diag(covariance)))
    return Fault(term.kind, told.where, told.what, told.remedy, gain)


def faults_of_input(suspicions: Sequence[Suspicion]) -> tuple[Fault, ...]:
    """Return what the calibration found wrong in the input, as far as it is a fault of the log."""
    found = []
    for each in suspicions:
        kind = _OF_INPUT.get(each.kind)
        joint = re.fullmatch(r"(?:delta_theta_|q)(\d+)", each.where)
        if each.kind == "departure" and joint is not None:
            kind = "joint_zero"
        if kind is None:
            continue
        left = each.would_leave_mm
        then = "" if left is None else f" ({left:.3g} mm rms would remain if that is put right)"
        where = each.where if joint is None else f"joint {joint[1]}"
        found.append(Fault(kind, where, f"{each.what}{then}", each.remedy))
    return tuple(found)


def to_check(faults: Sequence[Fault], *, effects: bool) -> bool:
    """Return whether a verdict is `check_the_log`.

    Args:
        faults: those found.
        effects: whether effects stand.
    """
    return any(fault.decides or not effects for fault in faults)
