"""The short forms that are tried at a place: what a physicist would write down first, by order.

An error that goes with the angle of a joint that turns comes back every turn, so no powers of the
angle are among them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import ClassVar

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, joint_of, static_loads_in, turning_joints
from pa10cal.terms.effects.readings import FalseReading
from pa10cal.terms.forms.form import (
    Along,
    AngleForm,
    Form,
    FormShape,
    PullForm,
    beyond,
    settled_since,
    sines,
    sized,
)
from pa10cal.terms.term import Report, TermParameter

#: Cycles a turn that are tried: as many as there are positions, within these.
_FEWEST_CYCLES, _MOST_CYCLES = 12, 360
#: Orders of a joint that suggest teeth and second orders, and places within a tooth that are tried.
_SUGGESTING, _STARTS = 10, 12
#: Widest stretch of a turn without a pose over which orders are still told apart [rad].
WIDEST_GAP_RAD = np.pi / 4.0
#: Cycles a turn of what goes with something else as well.
_FEW_CYCLES = (1, 2, 3, 4)
_THRESHOLDS, _BOTH_SIDES = 10, (0.17, 0.83)
#: Time constants and periods, of the length of the campaign.
_TIMES = (0.03, 0.1, 0.2, 0.4, 0.8)
_PERIODS = (0.5, 0.7, 1.0, 1.5, 2.0)
#: Periods of what goes with place, of the span measured.
_WAVES = (0.25, 0.35, 0.5, 0.7, 1.0)


def forms_at(place: str, context: CandidateContext, states: PoseStates) -> tuple[Form, ...]:
    """Return the forms tried at a place: `joint 2`, `base`, `instrument`; elsewhere none."""
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
    """Return the forms that the best single orders of each joint suggest.

    Teeth as many as the cycles of an order that helps, which is most of their error; and two
    orders, the best with each of the next, of a joint that was seen all around: over part of a
    turn two orders follow any smooth error. Of the forms tried the best one comes first.
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
    """Return whether angles (P,) of a joint are nearly everywhere in its turn."""
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
            for share in _WAVES:
                numbers = (axis, along, share * spans_m[along])
                yield ReadingForm("instrument", "wave", numbers, (x, y, z))
        for first, second in combinations_with_replacement(range(3), 2):
            if first != second:
                yield ReadingForm("instrument", "product", (axis, first, second), (x, y, z))


def _levels(values: Array) -> list[float]:
    """Return thresholds that values are on either side of, a sixth of them at least."""
    found: list[float] = np.unique(
        np.quantile(values, np.linspace(*_BOTH_SIDES, _THRESHOLDS))
    ).tolist()
    return found


def _times(context: CandidateContext) -> list[tuple[float, float]]:
    """Return time constants to try, each with the time of the first reading [s]."""
    first, last = context.time_span_s
    return [(share * (last - first), first) for share in _TIMES] if last > first else []


# Short forms of the base, and of what the instrument reads.

#: Tilt of a base to be expected [rad] at the moment at which it is [N m]; shift in time [m].
_TILT_RAD, _MOMENT_NM = 2e-4, 300.0
_SHIFT_M = 1e-4
#: Error of a reading to be expected [m], so far from the middle of what was measured [m].
_READING_M, _FROM_MIDDLE_M = 3e-5, 0.3


_M = ", M the overturning moment"
_C1, _C2, _C3 = (
    sized("cx cy", unit, _TILT_RAD / _MOMENT_NM**k)
    for k, unit in ((1, "rad/(N m)"), (2, "rad/(N m)²"), (3, "rad/(N m)³"))
)


@dataclass(frozen=True)
class TiltForm(Form):
    """The base tilts about x and y by a short form of its overturning moment M."""

    coordinates = ("base.rx", "base.ry")
    adds_to = "base.rx += "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "moment_abs_moment": FormShape(
            f"cx M_x |M_x|, base.ry += cy M_y |M_y|{_M}",
            lambda at: tuple(M * np.abs(M) for M in at.moments),
            _C2,
        ),
        "moment_cubed": FormShape(
            f"cx M_x^3, base.ry += cy M_y^3{_M}", lambda at: tuple(M**3 for M in at.moments), _C3
        ),
        "moment_beyond": FormShape(
            "cx sgn(M_x) max(|M_x| - {0:.4g}, 0), base.ry likewise with cy and M_y" + _M,
            lambda at, threshold: tuple(beyond(M, threshold) for M in at.moments),
            _C1,
            ("threshold",),
        ),
        "sign_of_moment": FormShape(
            f"cx sgn(M_x), base.ry += cy sgn(M_y){_M}",
            lambda at: tuple(np.sign(M) for M in at.moments),
            sized("cx cy", "rad", _TILT_RAD),
        ),
    }

    def per_unit(self, states: PoseStates) -> Array:
        """Return each column along its own tilt, (P, 2, 2)."""
        static_loads_in(states, self)
        return self.values(states)[:, :, None] * np.eye(2)


@dataclass(frozen=True)
class ShiftForm(Form):
    """The base shifts by a short form of time."""

    coordinates = BASE[:3]
    adds_to = "base.x, y, z += "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "settling": FormShape(
            "(dx, dy, dz) exp(-(t - {1:.6g}) / {0:.4g}), t in s",
            lambda at, *time_s: (settled_since(at, *time_s),) * 3,
            sized("dx dy dz", "m", _SHIFT_M),
            ("time",),
        ),
        "wave_in_time": FormShape(
            "(dx, dy, dz) sin(2 pi t / {0:.4g}) + (ex, ey, ez) cos(2 pi t / {0:.4g}), t in s",
            lambda at, period_s: tuple(
                np.repeat(sines(2.0 * np.pi * at.states.time_s / period_s), 3, axis=0)
            ),
            sized("dx dy dz ex ey ez", "m", _SHIFT_M),
            ("period",),
        ),
    }

    def per_unit(self, states: PoseStates) -> Array:
        axes = np.tile(np.eye(3), len(self.shape.solved) // 3)
        return np.asarray(self.values(states)[:, None, :] * axes)


_CUBED = sized("c3", "1/m²", _READING_M / _FROM_MIDDLE_M**3)
_SQUARED = ("1/m", _READING_M / _FROM_MIDDLE_M**2)


@dataclass(frozen=True)
class ReadingForm(Form, FalseReading):
    """One axis of the instrument reads too much by a short form of place.

    Its first number is the axis that reads so, the next are those along which it does, 0 to 2 for x
    to z. Coordinates are counted from a middle, in the instrument's frame.
    """

    # where the coordinates are counted from
    middle_instr_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    adds_to = "reading of {a} += "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "quadratic": FormShape(
            "c ({b} - {b}0)^2",
            lambda at, *_: (at.u**2, at.u),
            (*sized("c", *_SQUARED), *sized("d", "1", 1e-4)),
            ("axis", "along"),
        ),
        "cubic": FormShape(
            "c3 u^3 + c2 u^2 + c1 u, u = {b} {b0} m",
            lambda at, *_: (at.u**3, at.u**2, at.u),
            (*_CUBED, *sized("c2", *_SQUARED), *sized("c1", "1", 1e-4)),
            ("axis", "along"),
        ),
        "product": FormShape(
            "c ({b} {b0} m) ({c} {c0} m)",
            lambda at, *_: at.u * at.v,
            sized("c", *_SQUARED),
            ("axis", "along", "along"),
        ),
        "wave": FormShape(
            "A sin(2 pi ({b} {b0} m) / ({2:.4g} m) + phi)",
            lambda at, _axis, _along, period_m: sines(2.0 * np.pi * at.u / period_m),
            sized("s c", "m", _READING_M),
            ("axis", "along", "period"),
        ),
    }

    @property
    def formula(self) -> str:
        axes = [int(number) for number in self.numbers[1:3]]
        middle = [self.middle_instr_m[k % 3] for k in axes]
        names = {key: "xyz"[k % 3] for key, k in zip("bc", axes, strict=False)}
        at = {
            f"{key}0": f"{'-' if value >= 0.0 else '+'} {abs(value):.4g}"
            for key, value in zip("bc", middle, strict=False)
        }
        a = "xyz"[int(self.numbers[0])]
        words = f"{self.adds_to}{self.shape.words}"
        return words.format(*self.numbers, a=a, **names, **at)

    def field(self, p_instr_m: Array) -> Array:
        from_middle_m = p_instr_m - np.array(self.middle_instr_m)
        names = zip(self.shape.numbers, self.numbers, strict=True)
        axes = [int(number) for name, number in names if name == "along"]
        at = Along(from_middle_m[..., axes[0]], from_middle_m[..., axes[-1]])
        columns = self.shape.at(at, self.numbers)
        field = np.zeros((*p_instr_m.shape, columns.shape[-1]))
        field[:, :, int(self.numbers[0])] = columns
        return field

    def report(self, x: Array) -> Report:
        if self.form != "quadratic":
            return super().report(x)
        c = x[0] if x[0] != 0.0 else np.finfo(float).tiny
        along = int(self.numbers[1])
        vertex = self.middle_instr_m[along] - 0.5 * x[1] / c
        jacobian = np.array([[1.0, 0.0], [0.5 * x[1] / c**2, -0.5 / c]])
        names = (self.shape.solved[0], TermParameter(f"{'xyz'[along]}0", "m", 1.0))
        return Report(names, np.array([x[0], vertex]), jacobian)
