"""The short forms that are tried at a place, simple formulas first.

Errors that follow the angle of a joint are periodic in it, so powers of the angle are not tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext, joint_of, turning_joints
from pa10cal.terms.forms.form import AngleForm, Form, PullForm, ReadingForm, ShiftForm, TiltForm

#: Bounds of the highest order tried, which is the number of different joint positions
#: [cycles a turn].
_FEWEST_CYCLES, _MOST_CYCLES = 12, 360
#: Best orders of a joint that suggest further forms, and phases within a tooth that are tried.
_SUGGESTING, _STARTS = 10, 12
#: Widest range of angles without a pose in which orders can still be distinguished [rad].
WIDEST_GAP_RAD = np.pi / 4.0
#: Orders tried of what depends on something besides the angle [cycles a turn].
_FEW_CYCLES = (1, 2, 3, 4)
#: Number of thresholds tried, and the lowest and highest quantile of the values among them.
_THRESHOLDS, _BOTH_SIDES = 10, (0.17, 0.83)
#: Time constants and periods tried, as parts of the length of the campaign.
_TIMES = (0.03, 0.1, 0.2, 0.4, 0.8)
_PERIODS = (0.5, 0.7, 1.0, 1.5, 2.0)
#: Wavelengths tried of errors that follow the place, as parts of the range measured.
_WAVES = (0.25, 0.35, 0.5, 0.7, 1.0)


def forms_at(place: str, context: CandidateContext, states: PoseStates) -> tuple[Form, ...]:
    """Return the forms tried at a place: a joint that turns, `base` or `instrument`; else none.

    Forms of time are not among them where the order of poses gives no time.
    """
    times_s = context.time_span_s if states.tells_time else (0.0, 0.0)
    context = replace(context, time_span_s=times_s)
    if place.startswith("joint "):
        joint = joint_of(place)
        if joint in turning_joints(context):
            return tuple(_of_joint(place, context, states))
    if place == "base":
        return tuple(_of_base(context, states))
    if place == "instrument" and states.seen is not None:
        return tuple(_of_readings(context, states))
    return ()


def _of_joint(place: str, context: CandidateContext, states: PoseStates) -> Iterator[Form]:
    joint = joint_of(place)
    q_rad, tau_Nm = states.q_rad[:, joint - 1], np.abs(states.tau_Nm[:, joint - 1])
    poses = len(np.unique(np.round(q_rad, 4)))
    orders = range(1, int(np.clip(poses, _FEWEST_CYCLES, _MOST_CYCLES)) + 1)
    few = [(float(order),) for order in _FEW_CYCLES]
    thresholds = _levels(q_rad)
    loaded = context.carried_at(joint) > 0.0
    yield from (AngleForm(place, "harmonic", (float(order),)) for order in orders)
    yield from (AngleForm(place, "step", (at,)) for at in thresholds)
    if loaded:
        for form in ("torque_squared", "torque_abs_torque", "torque_cubed", "sign_of_torque"):
            yield AngleForm(place, form)
        yield from (AngleForm(place, "torque_beyond", (at,)) for at in _levels(tau_Nm))
        yield from (AngleForm(place, "torque_by_angle", order) for order in few)
    if np.any(states.arrival[:, joint - 1]):
        if loaded:
            yield AngleForm(place, "arrival_by_torque")
            yield AngleForm(place, "arrival_by_torque_squared")
        yield from (AngleForm(place, "arrival_by_angle", order) for order in few)
    for other in turning_joints(context):
        if other == joint:
            continue
        yield from (AngleForm(place, "other_angle", (float(other), *order)) for order in few)
        yield AngleForm(place, "product_of_angles", (float(other),))
        yield AngleForm(place, "product_of_sines", (float(other),))
        if context.carried_at(other):
            yield AngleForm(place, "other_torque", (float(other),))
    yield from (AngleForm(place, "settling", each) for each in _times(context))
    yield PullForm(place, "pull")
    yield from (PullForm(place, "pull_harmonic", order) for order in few)
    for at in thresholds:
        yield PullForm(place, "pull_beyond", (at,))
        yield PullForm(place, "pull_below", (at,))


def further(forms: Sequence[Form], states: PoseStates) -> list[Form]:
    """Return the forms suggested by the best harmonics of each joint.

    They are a sawtooth and a square wave, whose errors are mostly of their first harmonic, and the
    best harmonic together with each of the next ones if the joint went all around: over a part of a
    turn two harmonics follow any smooth error.

    Args:
        forms: forms that were tried, the best first.
    """
    found: list[Form] = []
    single = [form for form in forms if form.form == "harmonic"]
    for place in dict.fromkeys(form.of for form in single):
        first, *others = [form.numbers for form in single if form.of == place][:_SUGGESTING]
        for (order,), start in product((first, *others), np.arange(_STARTS + 1) / _STARTS):
            found.append(AngleForm(place, "sawtooth", (order, float(start))))
            if start <= 0.5:
                found.append(AngleForm(place, "square", (order, float(start))))
        if all_around(states.q_rad[:, joint_of(place) - 1]):
            found += [AngleForm(place, "two_harmonics", (*first, *other)) for other in others]
    return found


def all_around(q_rad: Array) -> bool:
    """Return whether angles (P,) of a joint leave no wide gap in its turn."""
    angles = np.sort(np.mod(q_rad, 2.0 * np.pi))
    gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    return bool(gaps.max() <= WIDEST_GAP_RAD)


def _of_base(context: CandidateContext, states: PoseStates) -> Iterator[Form]:
    if states.static_loads is not None:
        for form in ("moment_abs_moment", "moment_cubed", "sign_of_moment"):
            yield TiltForm("base", form)
        moment_Nm = np.abs(states.static_loads.base_Nm[:, :2]).max(axis=1)
        yield from (TiltForm("base", "moment_beyond", (at,)) for at in _levels(moment_Nm))
    yield from (ShiftForm("base", "settling", each) for each in _times(context))
    first, last = context.time_span_s
    if last > first:
        for share in _PERIODS:
            yield ShiftForm("base", "wave_in_time", (share * (last - first),))


def _of_readings(context: CandidateContext, states: PoseStates) -> Iterator[Form]:
    assert states.seen is not None
    x, y, z = (float(value) for value in context.p_instr_middle_m)
    p_m = states.seen.p_instr_targets_m.reshape(-1, 3)
    spans_m = np.ptp(p_m[np.isfinite(p_m).all(axis=1)], axis=0).tolist()
    for axis in range(3):
        for along in range(3):
            for form in ("quadratic", "cubic"):
                yield ReadingForm("instrument", form, (axis, along), (x, y, z))
            for share in _WAVES if spans_m[along] > 0.0 else ():
                numbers = (axis, along, share * spans_m[along])
                yield ReadingForm("instrument", "wave", numbers, (x, y, z))
        for first, second in combinations(range(3), 2):
            yield ReadingForm("instrument", "product", (axis, first, second), (x, y, z))


def _levels(values: Array) -> list[float]:
    """Return thresholds with at least a sixth of the values on either side."""
    quantiles = np.quantile(values, np.linspace(*_BOTH_SIDES, _THRESHOLDS))
    found: list[float] = np.unique(quantiles).tolist()
    return found


def _times(context: CandidateContext) -> list[tuple[float, float]]:
    """Return time constants to try, each with the time of the first reading [s]."""
    first, last = context.time_span_s
    return [(share * (last - first), first) for share in _TIMES] if last > first else []
