"""Short forms: formulas with a few parameters, and a shape that is fixed by a few numbers.

Forms of a joint, of its angle or its torque; of the base, by its overturning moment or in time; and
of the readings of the instrument, by the place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext, joint_of
from pa10cal.terms.effects.effect import Effect, static_loads_in
from pa10cal.terms.effects.joint import amplitude_and_phase
from pa10cal.terms.effects.readings import FalseReading
from pa10cal.terms.term import JointTorqueOnly, Report, TermParameter, report_as_solved

Numbers = tuple[float, ...]

#: Prior standard deviation of the parameters, in plausible sizes: hardly a constraint.
_ANY_SIZE = 10.0
#: Names of numbers that may have any value; orders, teeth, joints and axes are whole.
_ANY_VALUE = ("threshold", "start", "time", "period")


class AtPoses(NamedTuple):
    """Poses and a joint at which the columns of a form are computed."""

    states: PoseStates
    q: Array  # (P,) angle of the joint [rad]
    tau: Array  # (P,) its torque [N m]
    arrival: Array  # (P,) direction in which it arrived

    @property
    def moments(self) -> tuple[Array, Array]:
        """Return the overturning moments of the base about x and y, (P,) each [N m]."""
        assert self.states.static_loads is not None
        M_x, M_y, _ = self.states.static_loads.base_Nm.T
        return M_x, M_y

    def q_of(self, joint: float) -> Array:
        """Return the angle of a joint, from 1, (P,) [rad]."""
        return self.states.q_rad[:, int(joint) - 1]

    def tau_of(self, joint: float) -> Array:
        """Return the torque of a joint, from 1, (P,) [N m]."""
        return self.states.tau_Nm[:, int(joint) - 1]


class Along(NamedTuple):
    """Measured places, from their middle on, at which the columns of a form are computed [m]."""

    u: Array  # coordinates along the first axis
    v: Array  # along the second axis; the first again where there is only one


@dataclass(frozen=True)
class FormShape:
    """A kind of form."""

    # the formula after `Form.adds_to`, with `{j}` for the joint and `{0}`, `{1}`, … for the numbers
    words: str
    # derivative by each parameter, (P,) or a tuple of these, by an `AtPoses` (of readings an
    # `Along`) and the numbers
    columns: Callable[..., Array | tuple[Array, ...]]
    solved: tuple[TermParameter, ...]  # the parameters that are solved for
    numbers: tuple[str, ...] = ()  # names of the numbers that a reader needs besides

    def columns_at(self, place: AtPoses | Along, numbers: Numbers) -> Array:
        """Return the derivative by the parameters, (P, k); (..., k) at places."""
        columns = self.columns(place, *numbers)
        return np.stack(columns if isinstance(columns, tuple) else (columns,), axis=-1)

    @property
    def real_index(self) -> int | None:
        """Return the index of the number that may have any value; None where all are whole."""
        return next((k for k, name in enumerate(self.numbers) if name in _ANY_VALUE), None)


@dataclass(frozen=True)
class Form(Effect):
    """A short form at a place, proportional to its parameters."""

    form: str  # name of its kind in `shapes`
    numbers: Numbers = ()  # numbers that fix its shape: orders, thresholds, other joints
    id = "short_form"
    shapes: ClassVar[Mapping[str, FormShape]]
    adds_to: ClassVar[str] = ""  # beginning of its formulas

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return none: forms are tried only where an effect without a name was found."""
        return ()

    @property
    def shape(self) -> FormShape:
        """Return its kind."""
        return self.shapes[self.form]

    @property
    def length(self) -> int:
        """Return the number of parameters, orders and thresholds that a reader needs."""
        return len(self.shape.solved) + len(self.shape.numbers)

    @property
    def order(self) -> int | None:
        """Return its cycles a turn; None where it is not periodic in the angle."""
        for name, number in zip(self.shape.numbers, self.numbers, strict=False):
            if name in ("order", "teeth"):
                return int(number)
        return None

    @property
    def real_number(self) -> float:
        """Return the number that may have any value."""
        assert self.shape.real_index is not None
        return self.numbers[self.shape.real_index]

    def with_real_number(self, value: float) -> Self:
        """Return the form with another such number."""
        k = self.shape.real_index
        assert k is not None
        return replace(self, numbers=(*self.numbers[:k], value, *self.numbers[k + 1 :]))

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return self.shape.solved

    @property
    def joint(self) -> int:
        """Return its joint, from 1; 0 for a form of base or instrument."""
        return joint_of(self.of) if self.of.startswith("joint ") else 0

    @property
    def formula(self) -> str:
        words = f"{self.adds_to}{self.shape.words}".format(*self.numbers, j=self.joint)
        return words.replace("(1 q_", "(q_")

    @property
    def prior_factor(self) -> Array:
        return np.asarray(_ANY_SIZE * super().prior_factor)

    def values(self, states: PoseStates) -> Array:
        """Return the derivative of what it adds by each parameter, (P, k)."""
        own = (of[:, self.joint - 1] for of in (states.q_rad, states.tau_Nm, states.arrival))
        return self.shape.columns_at(AtPoses(states, *own), self.numbers)

    def report(self, x: Array) -> Report:
        solved = self.shape.solved
        names = [parameter.name for parameter in solved]
        if names == ["s", "c"]:  # a sine and a cosine part
            return amplitude_and_phase(x, solved[0].unit)
        if names == ["k", "q0"]:  # a slope and a constant, reported as a slope and its zero
            slope = x[0] if x[0] != 0.0 else np.finfo(float).tiny
            zero = -x[1] / slope
            jacobian = np.array([[1.0, 0.0], [-zero / slope, -1.0 / slope]])
            return Report(solved, np.array([x[0], zero]), jacobian)
        return report_as_solved(solved, x)


def sines(angle: Array, times: Array | float = 1.0) -> tuple[Array, Array]:
    """Return sine and cosine of angles, times a factor."""
    return times * np.sin(angle), times * np.cos(angle)


def beyond(value: Array, threshold: float) -> Array:
    """Return by how much values exceed a threshold in size, with their sign; else 0."""
    return np.asarray(np.sign(value) * np.maximum(np.abs(value) - threshold, 0.0))


def sized(names: str, unit: str, plausible: float) -> tuple[TermParameter, ...]:
    """Return parameters of one plausible size, by their names with blanks between them."""
    scale = 0.03 * plausible
    return tuple(TermParameter(name, unit, scale, plausible=plausible) for name in names.split())


# Short forms of a joint.

#: Plausible error of an angle [rad], and torque that follows an angle [N m].
_ANGLE_RAD = 3e-4
_TORQUE_NM = 10.0
#: Torque at which an error that follows it is plausibly `_ANGLE_RAD` [N m].
_LOAD_NM = 30.0


def _saw(q: Array, teeth: float, start: float) -> Array:
    turns = teeth * q / (2.0 * np.pi) - start
    return np.asarray(2.0 * (turns - np.floor(turns)) - 1.0)


def _product_of_sines(at: AtPoses, joint: float) -> tuple[Array, ...]:
    of_own, of_other = sines(at.q), sines(at.q_of(joint))
    return tuple(own * other for own in of_own for other in of_other)


def settled_since(at: AtPoses, time_s: float, first_s: float) -> Array:
    """Return an exponential decay (P,) with a time constant, which is 1 at the first time."""
    return np.exp(-(at.states.time_s - first_s) / time_s)


_A = sized("A", "rad", _ANGLE_RAD)
_SINES = sized("s c", "rad", _ANGLE_RAD)
_FOUR = sized("a b c d", "rad", _ANGLE_RAD)
_TWO_SINES = sized("s1 c1 s2 c2", "rad", _ANGLE_RAD)
_C_ANGLE = sized("c", "1/rad", _ANGLE_RAD)
#: Units of angles over powers of a torque.
_UNITS_NM = {1: "rad/(N m)", 2: "rad/(N m)²", 3: "rad/(N m)³"}
_C1, _C2, _C3 = (sized("c", unit, _ANGLE_RAD / _LOAD_NM**k) for k, unit in _UNITS_NM.items())
_H1, _H2 = (sized("h", _UNITS_NM[k], _ANGLE_RAD / _LOAD_NM**k) for k in (1, 2))
_SINES_NM = sized("s c", _UNITS_NM[1], _ANGLE_RAD / _LOAD_NM)
_PULL = sized("k", "N m/rad", _TORQUE_NM)
_PULL_FROM = (*_PULL, *sized("q0", "rad", _TORQUE_NM))
_PULL_SINES = sized("s c", "N m", _TORQUE_NM)


@dataclass(frozen=True)
class AngleForm(Form):
    """An error of the joint's angle."""

    adds_to = "theta_{j} "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "harmonic": FormShape(
            "+= A sin({0:g} q_{j} + phi)", lambda at, k: sines(k * at.q), _SINES, ("order",)
        ),
        "two_harmonics": FormShape(
            "+= s1 sin({0:g} q_{j}) + c1 cos({0:g} q_{j}) + s2 sin({1:g} q_{j}) "
            "+ c2 cos({1:g} q_{j})",
            lambda at, one, other: (*sines(one * at.q), *sines(other * at.q)),
            _TWO_SINES,
            ("order", "order"),
        ),
        "sawtooth": FormShape(
            "+= A (2 frac({0:g} q_{j} / (2 pi) - {1:.4g}) - 1)",
            lambda at, teeth, start: _saw(at.q, teeth, start),
            _A,
            ("teeth", "start"),
        ),
        "square": FormShape(
            "+= A sgn sin({0:g} q_{j} - 2 pi {1:.4g})",
            lambda at, teeth, start: np.sign(-_saw(at.q, teeth, start)),
            _A,
            ("teeth", "start"),
        ),
        "step": FormShape(
            "+= A where q_{j} > {0:.4g}", lambda at, q: (at.q > q) * 1.0, _A, ("threshold",)
        ),
        "torque_squared": FormShape("-= c tau_{j}^2", lambda at: -(at.tau**2), _C2),
        "torque_abs_torque": FormShape(
            "-= c tau_{j} |tau_{j}|", lambda at: -at.tau * np.abs(at.tau), _C2
        ),
        "torque_cubed": FormShape("-= c tau_{j}^3", lambda at: -(at.tau**3), _C3),
        "sign_of_torque": FormShape("-= A sgn(tau_{j})", lambda at: -np.sign(at.tau), _A),
        "torque_beyond": FormShape(
            "-= c sgn(tau_{j}) max(|tau_{j}| - {0:.4g}, 0)",
            lambda at, tau: -beyond(at.tau, tau),
            _C1,
            ("threshold",),
        ),
        "torque_by_angle": FormShape(
            "-= tau_{j} A sin({0:g} q_{j} + phi)",
            lambda at, k: sines(k * at.q, -at.tau),
            _SINES_NM,
            ("order",),
        ),
        "arrival_by_torque": FormShape(
            "+= h s_{j} |tau_{j}|", lambda at: at.arrival * np.abs(at.tau), _H1
        ),
        "arrival_by_torque_squared": FormShape(
            "+= h s_{j} tau_{j}^2", lambda at: at.arrival * at.tau**2, _H2
        ),
        "arrival_by_angle": FormShape(
            "+= s_{j} A sin({0:g} q_{j} + phi)",
            lambda at, k: sines(k * at.q, at.arrival),
            _SINES,
            ("order",),
        ),
        "other_angle": FormShape(
            "+= A sin({1:g} q_{0:g} + phi)",
            lambda at, joint, k: sines(k * at.q_of(joint)),
            _SINES,
            ("joint", "order"),
        ),
        "product_of_angles": FormShape(
            "+= c q_{j} q_{0:g}", lambda at, joint: at.q * at.q_of(joint), _C_ANGLE, ("joint",)
        ),
        "product_of_sines": FormShape(
            "+= a sin q_{j} sin q_{0:g} + b sin q_{j} cos q_{0:g} "
            "+ c cos q_{j} sin q_{0:g} + d cos q_{j} cos q_{0:g}",
            _product_of_sines,
            _FOUR,
            ("joint",),
        ),
        "other_torque": FormShape(
            "+= c tau_{0:g}", lambda at, joint: at.tau_of(joint), _C1, ("joint",)
        ),
        "settling": FormShape(
            "+= A exp(-(t - {1:.6g}) / {0:.4g}), t in s", settled_since, _A, ("time",)
        ),
    }

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.joint}",)

    def per_unit(self, states: PoseStates) -> Array:
        return self.values(states)


@dataclass(frozen=True)
class PullForm(JointTorqueOnly, Form):
    """A torque that the joint carries in addition to that of the weights."""

    acts_on_joint = True
    adds_to = "tau_{j} "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "pull": FormShape("+= k (q_{j} - q0)", lambda at: (at.q, np.ones_like(at.q)), _PULL_FROM),
        "pull_beyond": FormShape(
            "+= k max(q_{j} - {0:.4g}, 0)",
            lambda at, q: np.maximum(at.q - q, 0.0),
            _PULL,
            ("threshold",),
        ),
        "pull_below": FormShape(
            "+= k min(q_{j} - {0:.4g}, 0)",
            lambda at, q: np.minimum(at.q - q, 0.0),
            _PULL,
            ("threshold",),
        ),
        "pull_harmonic": FormShape(
            "+= A sin({0:g} q_{j} + phi)", lambda at, k: sines(k * at.q), _PULL_SINES, ("order",)
        ),
    }

    def per_unit(self, states: PoseStates) -> Array:
        return self.values(states)


# Short forms of the base, and of the readings of the instrument.

#: Plausible tilt of a base [rad] at this moment [N m], and shift in the course of time [m].
_TILT_RAD, _MOMENT_NM = 2e-4, 300.0
_SHIFT_M = 1e-4
#: Plausible error of a reading [m], at this distance from the middle of the measured places [m].
_READING_M, _FROM_MIDDLE_M = 3e-5, 0.3
_M = ", M the overturning moment"
_TILT_1, _TILT_2, _TILT_3 = (
    sized("cx cy", unit, _TILT_RAD / _MOMENT_NM**k)
    for k, unit in ((1, "rad/(N m)"), (2, "rad/(N m)²"), (3, "rad/(N m)³"))
)


@dataclass(frozen=True)
class TiltForm(Form):
    """A tilt of the base about x and y, by its overturning moment M."""

    coordinates = ("base.rx", "base.ry")
    adds_to = "base.rx += "
    shapes: ClassVar[Mapping[str, FormShape]] = {
        "moment_abs_moment": FormShape(
            f"cx M_x |M_x|, base.ry += cy M_y |M_y|{_M}",
            lambda at: tuple(M * np.abs(M) for M in at.moments),
            _TILT_2,
        ),
        "moment_cubed": FormShape(
            f"cx M_x^3, base.ry += cy M_y^3{_M}",
            lambda at: tuple(M**3 for M in at.moments),
            _TILT_3,
        ),
        "moment_beyond": FormShape(
            "cx sgn(M_x) max(|M_x| - {0:.4g}, 0), base.ry likewise with cy and M_y" + _M,
            lambda at, threshold: tuple(beyond(M, threshold) for M in at.moments),
            _TILT_1,
            ("threshold",),
        ),
        "sign_of_moment": FormShape(
            f"cx sgn(M_x), base.ry += cy sgn(M_y){_M}",
            lambda at: tuple(np.sign(M) for M in at.moments),
            sized("cx cy", "rad", _TILT_RAD),
        ),
    }

    def per_unit(self, states: PoseStates) -> Array:
        """Return the columns, each for the tilt about its own axis, (P, 2, 2)."""
        static_loads_in(states, self)
        return self.values(states)[:, :, None] * np.eye(2)


@dataclass(frozen=True)
class ShiftForm(Form):
    """A shift of the base in the course of time."""

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
#: Least curvature of an error of reading whose vertex is told [1/m] (computing).
_FLAT = 1e-12


@dataclass(frozen=True)
class ReadingForm(Form, FalseReading):
    """An error of the reading of one axis of the instrument, by the place.

    Its first number is the axis with the error, the next ones are those along which the place
    counts, 0 to 2 for x to z. Coordinates are counted from a middle, in the instrument's frame.
    """

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
        columns = self.shape.columns_at(at, self.numbers)
        field = np.zeros((*p_instr_m.shape, columns.shape[-1]))
        field[:, :, int(self.numbers[0])] = columns
        return field

    def report(self, x: Array) -> Report:
        if self.form != "quadratic":
            return super().report(x)
        # A parabola so flat has its vertex beyond any place: neither is of a size that means much.
        c = np.copysign(max(abs(x[0]), _FLAT), x[0])
        along = int(self.numbers[1])
        vertex = self.middle_instr_m[along] - 0.5 * x[1] / c
        jacobian = np.array([[1.0, 0.0], [0.5 * x[1] / c**2, -0.5 / c]])
        names = (self.shape.solved[0], TermParameter(f"{'xyz'[along]}0", "m", 1.0))
        return Report(names, np.array([x[0], vertex]), jacobian)
