"""What a verdict consists of: effects found, what has no name, what the data cannot show."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pa10cal.arrays import Array
from pa10cal.results.health import InputFinding
from pa10cal.results.record import FaultKind
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.log_faults import LogFault

P_co = TypeVar("P_co", covariant=True)


@dataclass(frozen=True)
class ReportedValue:
    """A reported parameter: value and standard uncertainty."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class GivesWay:
    """The statistics that decided about the spring of a joint."""

    nats: float  # log evidence lost without it, its weights and all else fitted anew
    needed_nats: float  # log evidence needed
    sag_rad: float  # largest deflection over the poses fitted
    sag_std_rad: float  # its standard uncertainty
    # without_mm and with_mm: root mean square position error of the poses fitted, with the joint
    # rigid and as it is
    without_mm: float
    with_mm: float
    # held_out_without_mm and held_out_with_mm: of those held out; None without any
    held_out_without_mm: float | None
    held_out_with_mm: float | None
    all_rigid_mm: float  # of those held out, or else fitted, with all joints rigid that give way
    # without_each_mm and all_rigid_each_mm: (P,) the errors of these poses, one by one
    without_each_mm: Array
    all_rigid_each_mm: Array
    weights: str  # where the weights come from: `assumed`, `total` or `logged`

    #: Not carried by a single pose: it acts in all of them.
    carrier: None = None


@dataclass(frozen=True, eq=False)
class Finding(Generic[P_co]):
    """One effect that was found."""

    effect: Effect  # which, and where
    # x and covariance: its reported parameters, and their covariance
    x: Array
    covariance: Array
    alternatives: tuple[Effect, ...]  # effects that explain the data as well in its place
    proof: P_co  # the statistics that decided

    @property
    def id(self) -> str:
        """Return the id of the effect."""
        return self.effect.id

    @property
    def of(self) -> str:
        """Return where it sits."""
        return self.effect.of

    @property
    def gain(self) -> float | None:
        """Return the part of the squared error of poses left out that it explains, if known."""
        gain = getattr(self.proof, "gain", None)
        return None if gain is None else float(gain)

    @property
    def carrier(self) -> str | None:
        """Return the one pose that carries it, without which nothing speaks for it; else None."""
        carrier = getattr(self.proof, "carrier", None)
        return None if carrier is None else str(carrier)

    @property
    def parameters(self) -> Mapping[str, ReportedValue]:
        """Return its reported parameters by name."""
        known = self.effect.report(np.zeros(len(self.effect.parameters))).parameters
        std = np.sqrt(np.diag(self.covariance))
        return {
            parameter.name: ReportedValue(float(value), float(sigma), parameter.unit)
            for parameter, value, sigma in zip(known, self.x, std, strict=True)
        }


@dataclass(frozen=True)
class Unexplained:
    """Something that is missing from the model and has no name."""

    of: str | None  # where it sits, as a place of the vocabulary; None where the data do not say
    # id of the smooth unknown function that predicts it best; None where none does
    form: str | None
    error_mm: float | None  # its position error; None where a map has taken it up
    why: str  # why it has no name, one clause


@dataclass(frozen=True)
class NotTestable:
    """An effect that these data cannot show."""

    effect: Effect  # which, and where
    why: str  # the reason
    # whether other poses might show it; not where what it needs was not logged
    by_these_poses: bool = True


# Faults of a log that discovery finds: what is wrong, where, and what to do.

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


def faults_of_input(suspicions: Sequence[InputFinding]) -> tuple[Fault, ...]:
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
