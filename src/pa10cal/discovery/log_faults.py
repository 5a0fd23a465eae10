"""Faults of the log as a verdict reports them, and the findings that become such faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal.results.calibration import SEVERAL_CAUSES, InputFinding
from pa10cal.results.discovery import Fault, FaultKind
from pa10cal.results.record import EffectName
from pa10cal.terms.statement_faults import LogFault


class DiagnosedFault(Fault):
    """A fault of the log, with its consequences for the verdict, which are not written."""

    gain: float | None = None  # as of `Fault`; by default it was not tried
    # whether the verdict is `check_the_log` even where effects were found; not for a reading with a
    # gross error, which is excluded
    decides: bool = Field(default=True, exclude=True)
    # time of a certain step of the base [s]; readings before and after it have different bases
    at_s: float | None = Field(default=None, exclude=True)
    # effect with the same consequences: where it was found, `Verdict.faults` omits the fault
    effect: EffectName | None = Field(default=None, exclude=True)
    # whether it is a large departure of the arm: where held-out poses confirm it, `Verdict.faults`
    # omits the fault
    is_departure: bool = Field(default=False, exclude=True)
    # what to do instead where the model written is of readings corrected by it; None where it is
    # never
    remedy_if_corrected: str | None = Field(default=None, exclude=True)
    # whether campaigns of a group contradict each other: judged again about the extended model
    between_campaigns: bool = Field(default=False, exclude=True)


def steps_told(faults: Sequence[DiagnosedFault]) -> tuple[float, ...]:
    """Return the times of certain steps [s], the most certain first."""
    return tuple(fault.at_s for fault in faults if fault.at_s is not None)


def as_corrected(fault: DiagnosedFault) -> DiagnosedFault:
    """Return a fault as it is told where the model written is of readings corrected by it."""
    remedy = fault.remedy_if_corrected
    return fault if remedy is None else fault.model_copy(update={"remedy": remedy})


def fault_of(term: LogFault, x: Array, covariance: Array, gain: float | None) -> DiagnosedFault:
    """Return a fault from its term, with the part of the squared error that it explains."""
    text = term.fault_text(x, np.sqrt(np.diag(covariance)))
    return DiagnosedFault(
        kind=term.kind, where=text.where, what=text.what, remedy=text.remedy, gain=gain
    )


# What the other kinds of findings report is no fault of the log:
#   departure          of the arm, but for zeros of joints: see `faults_of_input`
#   other_arm, masses, gravity, temperature, target_places, scale, stated_uncertainty
#                      what is described, or how the instrument reads, is wrong in all rows alike;
#                      the grade of the calibration reports it
#   joint_without_motion
#                      the nominal arm does not fit at all then, as the same grade reports
#   attitude_convention
#                      effects are not sought then, and the verdict says why
#   outlier            `row_faults` finds the readings themselves
#: Fault of the log that each kind of finding about the input is, by name or the nearest one.
_OF_INPUT: dict[str, FaultKind] = {
    "joint_sign": "joint_sign",
    "joint_order": "joint_sign",  # nearest: neither are joints counted as described
    "joint_coupling": "joint_sign",  # nearest, for the same reason
    "joint_zero": "joint_zero",
    "target_label": "label",
    # Campaigns of a group that contradict each other: nearest is a step between them.
    "campaigns": "step_in_time",
    SEVERAL_CAUSES: "step_in_time",
    "instrument_scale": "step_in_time",
    "instrument_range": "step_in_time",
    "payload": "payload",
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
        what = finding.what
        if finding.would_leave_mm is not None:
            what += f" ({finding.would_leave_mm:.3g} mm rms would remain if that is put right)"
        faults.append(
            DiagnosedFault(
                kind=kind,
                where=finding.place,
                what=what,
                remedy=finding.remedy,
                effect=finding.effect,
                is_departure=finding.is_departure,
                between_campaigns=bool(finding.between_campaigns),
                decides=finding.kind != SEVERAL_CAUSES,
            )
        )
    return tuple(faults)


def log_is_to_be_checked(
    faults: Sequence[DiagnosedFault], *, has_effects: bool, is_unexplained: bool
) -> bool:
    """Return whether a verdict is `check_the_log`, by its faults and what it has besides.

    Campaigns that no single cause sets apart may as well differ by what is unexplained.
    """
    return any(
        fault.decides or not (has_effects or (fault.between_campaigns and is_unexplained))
        for fault in faults
    )


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


def fault_of_influential_pose(pose: str, name: str, gain: float | None) -> DiagnosedFault:
    """Return the fault of the one pose on which the evidence of an effect rests."""
    what = (
        f"without this pose there is no evidence of {name}: one pose cannot show an effect of all"
    )
    fault = fault_of_pose(pose, what, gain, decides=True)
    remedy = f"{fault.remedy}; if they are right, measure more poses like it"
    return fault.model_copy(update={"remedy": remedy})
