"""Faults of the log as a verdict reports them, and the findings that become such faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal.results.calibration import InputFinding
from pa10cal.results.discovery import Fault, FaultKind
from pa10cal.results.record import EffectName
from pa10cal.terms.weights import LogFault


class DiagnosedFault(Fault):
    """A fault of the log, with its consequences for the verdict, which are not written."""

    gain: float | None = None
    # whether the verdict is `check_the_log` even where effects were found; not for a reading with a
    # gross error, which is excluded
    decides: bool = Field(default=True, exclude=True)
    # time of a certain step of the base [s]; readings before and after it have different bases
    at_s: float | None = Field(default=None, exclude=True)
    # effect with the same consequences: where it was found, there is no fault
    effect: EffectName | None = Field(default=None, exclude=True)
    # whether it is a large departure of the arm: where held-out poses confirm it, there is no fault
    is_departure: bool = Field(default=False, exclude=True)


def steps_told(faults: Sequence[DiagnosedFault]) -> tuple[float, ...]:
    """Return the times of certain steps [s], the most certain first."""
    return tuple(fault.at_s for fault in faults if fault.at_s is not None)


def fault_of(term: LogFault, x: Array, covariance: Array, gain: float | None) -> DiagnosedFault:
    """Return a fault from its term, with the part of the squared error that it explains."""
    text = term.fault_text(x, np.sqrt(np.diag(covariance)))
    return DiagnosedFault(
        kind=term.kind, where=text.where, what=text.what, remedy=text.remedy, gain=gain
    )


#: Fault of the log that each kind of finding about the input is: the nearest one where no fault has
#: its name. None for what is no fault of the log, with the reason.
_OF_INPUT: dict[str, FaultKind | None] = {
    "joint_sign": "joint_sign",
    "joint_order": "joint_sign",  # nearest: joints are not counted as described, either
    "joint_coupling": "joint_sign",  # nearest, likewise
    "joint_zero": "joint_zero",
    "target_label": "label",
    # Campaigns of a group that contradict each other: nearest is a step between them.
    "campaigns": "step_in_time",
    "instrument_scale": "step_in_time",
    "instrument_range": "step_in_time",
    "payload": "payload",
    # A departure of the arm, unless it is the zero of a joint: see `faults_of_input`.
    "departure": None,
    # Descriptions of the arm, the tool, the mounting or the instrument are wrong, not the rows; the
    # grade of the calibration reports them.
    "other_arm": None,
    "masses": None,
    "gravity": None,
    "temperature": None,
    "target_places": None,
    "scale": None,
    "stated_uncertainty": None,
    # The nominal arm does not fit at all then; the grade of the calibration reports it.
    "joint_without_motion": None,
    # Where it is so, effects are not sought, and the verdict says that.
    "attitude_convention": None,
    # The readings themselves are found by `row_faults`.
    "outlier": None,
}


def faults_of_input(suspicions: Sequence[InputFinding]) -> tuple[DiagnosedFault, ...]:
    """Return those findings of the calibration about its input that are faults of the log."""
    faults = []
    for finding in suspicions:
        joint, kind = finding.joint, _OF_INPUT.get(finding.kind)
        if finding.kind == "departure" and joint is not None:
            kind = "joint_zero"
        if kind is None:
            continue
        where, what = finding.where if joint is None else f"joint {joint}", finding.what
        if finding.would_leave_mm is not None:
            what += f" ({finding.would_leave_mm:.3g} mm rms would remain if that is put right)"
        faults.append(
            DiagnosedFault(
                kind=kind,
                where=where,
                what=what,
                remedy=finding.remedy,
                effect=finding.effect,
                is_departure=finding.is_departure,
            )
        )
    return tuple(faults)


def to_check(faults: Sequence[DiagnosedFault], *, effects: bool) -> bool:
    """Return whether a verdict is `check_the_log`, by its faults and whether it has effects."""
    return any(fault.decides or not effects for fault in faults)


def fault_of_quarantined(finding: InputFinding) -> DiagnosedFault:
    """Return the fault of a configuration that was quarantined when the files were read."""
    kind: FaultKind = "label" if finding.kind == "target_label" else "outlier"
    return DiagnosedFault(
        kind=kind,
        where=finding.where,
        what=finding.what,
        remedy=finding.remedy,
        decides=kind == "label",
    )


def fault_of_pose(pose: str, what: str, gain: float | None, *, decides: bool) -> DiagnosedFault:
    """Return the fault of all readings of a pose."""
    return DiagnosedFault(
        kind="outlier",
        where=f"pose {pose}",
        what=what,
        remedy="check the readings of this pose: joints, load, labels",
        gain=gain,
        decides=decides,
    )


def influential_pose(pose: str, name: str, gain: float | None) -> DiagnosedFault:
    """Return the fault of the one pose on which the evidence of an effect rests."""
    what = (
        f"without this pose there is no evidence of {name}: one pose cannot show an effect of all"
    )
    return fault_of_pose(pose, what, gain, decides=True)
