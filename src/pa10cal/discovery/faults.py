"""Faults of a log that discovery finds: what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.terms.faults.log_fault import FaultKind, LogFault

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fault:
    """Something in the log that is wrong.

    Attributes:
        kind: which fault.
        where: column, joint, load, pose, row or time.
        what: what is wrong and by how much, one clause.
        remedy: what to do about it.
        gain: part of the weighted squared error that putting it right takes away; None where that
            was not tried.
        decides: whether the verdict is `check_the_log` whatever else was found; a reading with a
            gross error, once excluded, leaves the effects found standing.
    """

    kind: FaultKind
    where: str
    what: str
    remedy: str
    gain: float | None = None
    decides: bool = True

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.remedy}"


def fault_of(term: LogFault, x: Array, covariance: Array, gain: float | None) -> Fault:
    """Return a fault that the search found as a term.

    Args:
        term: which.
        x, covariance: its reported parameters, and their covariance.
        gain: part of the squared error that it explains.
    """
    told = term.told(x, np.sqrt(np.diag(covariance)))
    return Fault(term.kind, told.where, told.what, told.remedy, gain)


def to_check(faults: Sequence[Fault], *, effects: bool) -> bool:
    """Return whether a verdict is `check_the_log`.

    Args:
        faults: those found.
        effects: whether effects stand.
    """
    return any(fault.decides or not effects for fault in faults)
