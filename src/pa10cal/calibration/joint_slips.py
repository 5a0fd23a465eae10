"""Slips in how joints were logged: signs, order, joints that move together, zeros.

A hypothesis is a change of the log; it is reported where it leaves a much smaller misfit. Where the
misfit of the nominal arm is larger than any departures of a real arm, the nominal arm decides, one
change after the other. Slips that departures partly take up are tried by quick calibrations.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from pa10cal.calibration.checked_campaign import CheckedCampaign
from pa10cal.calibration.log_changes import (
    CHECK_ALL,
    ChangedLog,
    CoupledAxes,
    LogChange,
    ReorderedColumns,
    ReversedSigns,
    set_offsets,
)
from pa10cal.calibration.rules import CHECKS
from pa10cal.campaign.conventions import STILL_WRONG
from pa10cal.numerics.least_squares import best_candidate
from pa10cal.results.calibration import InputFinding
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.joint import JointCoupling, moved_along


def _sign_and_order_changes(log: ChangedLog) -> Iterator[LogChange]:
    """Yield reversed signs, exchanged axes of one kind, and shifted columns."""
    slides = log.checked.arm.axes_slide
    axes = range(1, len(slides) + 1)
    yield from (ReversedSigns(some) for some in (tuple(axes), *((k,) for k in axes)))
    # Of equally good exchanges the first is taken, so neighbours come first.
    for one, other in sorted(itertools.combinations(axes, 2), key=lambda pair: pair[1] - pair[0]):
        if slides[one - 1] == slides[other - 1]:
            yield ReorderedColumns.exchanged(len(slides), one, other)
    if len(slides) > 2 and not log.changes:
        for by in axes[:-1]:
            columns = np.roll(np.arange(len(slides)), by)
            if np.array_equal(slides[columns], slides):
                yield ReorderedColumns(tuple((columns + 1).tolist()))


def _couplings(log: ChangedLog) -> Iterator[CoupledAxes]:
    """Yield axes that move as far as another of their kind, or against it, neighbours first."""
    slides = log.checked.arm.axes_slide
    pairs = itertools.permutations(range(1, len(slides) + 1), 2)
    for axis, by in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
        if slides[axis - 1] == slides[by - 1]:
            yield from (CoupledAxes(axis, by, factor) for factor in (1.0, -1.0))


def _screws(
    log: ChangedLog, error: Callable[[ChangedLog], float], step_mm: float
) -> Iterator[CoupledAxes]:
    """Yield axes that slide as a neighbour turns, each with the pitch of the least error."""
    slides = log.checked.arm.axes_slide
    for axis in np.flatnonzero(slides) + 1:
        for by in (axis - 1, axis + 1):
            if not 1 <= by <= len(slides) or slides[by - 1]:
                continue
            start = CoupledAxes(int(axis), int(by), 0.0)
            screw = _with_best_pitch(start, lambda each: error(log.with_change(each)), step_mm)
            if screw is not None:
                yield screw


def _with_best_pitch(
    screw: CoupledAxes, error: Callable[[CoupledAxes], float], step_mm: float
) -> CoupledAxes | None:
    """Return a screw with the pitch of the least error; None where the error has no minimum.

    The square of the error is nearly a parabola of the pitch: it is computed at the pitch of the
    screw, and a step [mm/turn] below and above it.
    """
    step = 1e-3 * step_mm / (2.0 * np.pi)  # in metres per radian, as the factor is
    below, here, above = (
        error(replace(screw, factor=screw.factor + steps * step)) ** 2 for steps in (-1.0, 0.0, 1.0)
    )
    if not np.isfinite([below, here, above]).all() or (below + above) / 2.0 <= here:
        return None
    factor = screw.factor + 0.5 * step * (below - above) / (below + above - 2.0 * here)
    # The pitch is rounded as the finding states it.
    pitch_mm = float(f"{1e3 * 2.0 * np.pi * factor:.4g}")
    return replace(screw, factor=1e-3 * pitch_mm / (2.0 * np.pi))


def _all_changes(log: ChangedLog) -> list[LogChange]:
    screws = _screws(log, lambda changed: changed.nominal_m, CHECKS.screw_steps_mm[0])
    return [*_sign_and_order_changes(log), *_couplings(log), *screws]


def signs_and_order(checked: CheckedCampaign) -> InputFinding | None:
    """Change signs and order of joints one after the other, as long as much less misfit is left.

    Where that does not put the log right, joints that move together are tried among the changes;
    then in place of the coupling that is stated, which may be of another pair of joints.
    """
    log = ChangedLog(checked)
    first_m = log.nominal_m
    if first_m < checked.not_departures_m:
        return None
    limit_m = min(
        CHECKS.nominal_left_share * first_m,
        max(checked.not_departures_m, CHECKS.misfit_left_share * first_m),
    )
    first_finding = None
    starts = [(log, lambda log: list(_sign_and_order_changes(log))), (log, _all_changes)]
    if checked.arm.coupled and len(checked.arm.coupling.own) == checked.arm.n:
        starts.append((ChangedLog(checked.without_coupling), _all_changes))
    for start, candidates in starts:
        changed, left_m = _changed_in_turn(start, candidates)
        # Where nothing at all fits, the misfit is infinite, and so is the limit.
        if not (np.isfinite(left_m) and left_m <= limit_m):
            continue
        if start is not log and not changed.coupled:
            continue  # that would be a change of the stated coupling, and was tried as one
        changed = _with_pitches_calibrated(changed)
        left_m = changed.nominal_m
        right = changed.checked.may_be_offered(changed.q, left_m)
        finding = changed.finding(
            "the nominal arm fits to", 1e3 * first_m, 1e3 * left_m, right=right
        )
        if right:
            return finding
        if first_finding is None:
            first_finding = finding
    return first_finding


def _with_pitches_calibrated(log: ChangedLog) -> ChangedLog:
    """Return the log with pitches found by calibrations.

    The pitch that suits the nominal arm best contains departures of the arm.
    """
    checked, changes = log.checked, list(log.changes)
    for k, change in enumerate(log.changes):
        screw = change.as_screw
        if screw is None:
            continue

        def error(screw: CoupledAxes, k: int = k) -> float:
            changed = replace(log, changes=(*changes[:k], screw, *changes[k + 1 :]))
            return checked.calibrated_mm(checked.payload, changed.q)[0]

        for step_mm in CHECKS.screw_steps_mm[1:]:
            screw = _with_best_pitch(screw, error, step_mm) or screw
        changes[k] = screw
    return replace(log, changes=tuple(changes))


def _changed_in_turn(
    log: ChangedLog, candidates: Callable[[ChangedLog], Sequence[LogChange]]
) -> tuple[ChangedLog, float]:
    """Return the log with the best changes made one after the other, and its nominal misfit [m]."""
    misfit_m = log.nominal_m
    for _ in range(CHECKS.most_changes):
        changed = map(log.with_change, candidates(log))
        stated = [each for each in changed if each.can_be_stated]
        best = _best_log(stated, CHECKS.change_left_share * misfit_m)
        if best is None:
            break
        misfit_m, log = best
    return log, misfit_m


def _best_log(logs: Sequence[ChangedLog], limit_m: float) -> tuple[float, ChangedLog] | None:
    """Return the smallest nominal misfit within a limit, and the first log that has it."""
    lower_bounds_m = [log.least_nominal_m for log in logs]
    best = best_candidate(lower_bounds_m, lambda k: logs[k].nominal_m, limit_m)
    return None if best is None else (best.misfit, logs[best.number])


def small_signs(checked: CheckedCampaign) -> InputFinding | None:
    """Find a sign, order or neighbours that move together by calibrating, one change at a time.

    Departures take up a part of the error of such a slip, as at the wrist, so that the nominal arm
    hardly shows it.
    """
    if not checked.above_noise:
        return None
    log = ChangedLog(checked)
    neighbours = (each for each in _couplings(log) if abs(each.axis - each.by) == 1)
    limit_m = CHECKS.worth_trying * log.nominal_m
    tried = []
    for change in (*_sign_and_order_changes(log), *neighbours):
        changed = log.with_change(change)
        if not (changed.can_be_stated and changed.may_be_below(limit_m)):
            continue
        nominal_m = changed.nominal_m
        if nominal_m < limit_m:
            tried.append((checked.calibrated_mm(None, changed.q)[0], nominal_m, changed))
    if not tried:
        return None
    now_mm, _ = checked.calibrated_mm(None)
    left_mm, nominal_m, best = min(tried, key=lambda each: each[0])
    if not left_mm < CHECKS.calibrated_left_share * now_mm < np.inf:
        return None
    right = checked.may_be_offered(best.q, nominal_m)
    return best.finding("the arm calibrates to", now_mm, left_mm, right=right)


def small_screws(checked: CheckedCampaign) -> InputFinding | None:
    """Find a quill that rises a little as it turns, by calibrating: the rest of a correction."""
    slides = checked.arm.axes_slide
    if slides.all() or not slides.any():
        return None
    now_mm, noise_mm = checked.calibrated_mm(checked.payload)
    if not CHECKS.screw_above_noise * noise_mm < now_mm < np.inf:
        return None

    # Of a pitch of zero, which every screw is tried with, and of the best one, more than once.
    known = {checked.grid.states.q_rad.tobytes(): now_mm}

    def error(changed: ChangedLog) -> float:
        q = changed.q
        if (key := q.tobytes()) not in known:
            known[key] = checked.calibrated_mm(checked.payload, q)[0]
        return known[key]

    log = ChangedLog(checked)
    tried = []
    for screw in _screws(log, error, CHECKS.screw_steps_mm[1]):
        changed = log.with_change(screw)
        tried.append((error(changed), screw, changed))
    if not tried:
        return None
    left_mm, screw, best = min(tried, key=lambda each: each[0])
    if not left_mm < CHECKS.calibrated_left_share * now_mm:
        return None
    best = _with_pitches_calibrated(best)
    right = checked.may_be_offered(best.q, best.nominal_m)
    finding = best.finding("the arm calibrates to", now_mm, error(best), right=right)
    joint, by = screw.joints(checked.arm)
    if moved_along(checked.arm).get(joint) != by:
        return finding
    effect = EffectName(id=JointCoupling.id, of=f"joint {joint}")
    return finding.model_copy(update={"effect": effect})


def joint_zeros(checked: CheckedCampaign) -> InputFinding | None:
    """Find a zero that is off by more than any mastering, by a calibration; None if none is."""
    arm, q = checked.arm, checked.grid.states.q_rad
    first_m = checked.nominal_misfit_m(q)
    if first_m < checked.not_departures_m:
        return None
    found = checked.calibration(checked.payload)
    if found is None:
        return None
    values = {p.name: x for p, x in zip(found.problem.parameters, found.fit.x, strict=True)}
    zeros_rad = np.array([values.get(f"delta_theta_{k}", 0.0) for k in range(1, arm.n + 1)])
    zeros_rad[arm.prismatic] = 0.0
    zeros_rad[~np.isin(np.arange(arm.n), arm.coupling.own)] = 0.0  # not logged: they follow others
    k = int(np.argmax(np.abs(zeros_rad)))
    if abs(zeros_rad[k]) < float(np.radians(CHECKS.no_mastering_deg)):
        return None
    moved = q.copy()
    moved[:, k] += zeros_rad[k]
    left_m = checked.nominal_misfit_m(moved)
    if left_m > CHECKS.nominal_left_share * first_m:
        return None
    right = checked.may_be_offered(moved, left_m)
    off_deg = float(np.degrees(zeros_rad[k]))
    axes_off = arm.coupling.to_axes(zeros_rad[k] * np.eye(arm.n)[k])
    axes_off = np.where(arm.axes_slide, 1e3 * axes_off, np.degrees(axes_off))
    stated = np.array(checked.offsets_deg)
    offsets = np.where(axes_off == 0.0, stated, np.round(stated + axes_off, 3))
    then = "" if right else f", {STILL_WRONG}"
    return InputFinding(
        kind="joint_zero",
        where=checked.words.joint(int(np.searchsorted(arm.coupling.own, k)) + 1),
        what=f"the zero of joint {k + 1} is {abs(off_deg):.3g} deg off: the nominal arm fits "
        f"to {1e3 * first_m:.3g} mm as logged, {1e3 * left_m:.3g} mm without that{then}",
        remedy=f"check the zero of this joint in the log, or {set_offsets(offsets)}"
        if right
        else CHECK_ALL,
        would_leave_mm=1e3 * left_m,
        joint=k + 1,
    )


def joints_without_motion(checked: CheckedCampaign) -> InputFinding | None:
    """Find joints with the same number in all poses, where the nominal arm does not fit at all."""
    axes = checked.axes
    still = np.flatnonzero(np.ptp(axes, axis=0) == 0.0)
    if not len(still) or len(still) == axes.shape[1]:
        return None
    left_m = checked.nominal_misfit_m(checked.grid.states.q_rad)
    spread_m = 1e-3 * checked.grid.measured.spread_mm
    if left_m < max(checked.not_departures_m, CHECKS.no_arm_share * spread_m):
        return None
    where = ", ".join(checked.words.joint(int(k) + 1) for k in still)
    # The file cannot tell a joint that is locked from one of which nothing was logged.
    it, this = ("it", "this joint") if len(still) == 1 else ("they", "these joints")
    lacks = f"if {it} moved, that was not logged"
    remedy = f"export what was logged of {this}, or check the description of the arm"
    # Zeros in the last columns may also fill up what columns shifted to the front left empty.
    if (still == np.arange(axes.shape[1])[-len(still) :]).all():
        lacks += "; or the columns hold the joints that come after theirs, the first ones lost"
        remedy += ", and check the order of all columns"
    return InputFinding(
        kind="joint_without_motion",
        where=where,
        what=f"the same number in all poses, and the nominal arm is {1e3 * left_m:.3g} mm off: "
        f"{lacks}",
        remedy=remedy,
    )
