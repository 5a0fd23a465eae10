"""What a short form is: a few parameters, a shape that numbers fix, and the formula in words.

And those at a joint: its angle is off, or it carries a torque beyond the weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, Effect, joint_of
from pa10cal.terms.effects.joint import amplitude_and_phase
from pa10cal.terms.term import JointTorqueOnly, Report, TermParameter, report_as_solved

Numbers = tuple[float, ...]

#: Size in which forms are fitted, in the plausible one.
_ANY_SIZE = 10.0
#: Names of numbers that need not be whole.
_ANY_VALUE = ("threshold", "start", "time", "period")


class At(NamedTuple):
    """Where the columns of a form are taken: poses, and a joint."""

    states: PoseStates
    # (P,) the joint's angle [rad], its torque [N m] and the direction in which it arrived
    q: Array
    tau: Array
    arrival: Array

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
    """Where the columns of a reading's form are taken, from its middle on [m]."""

    u: Array  # coordinates along the first axis
    v: Array  # along the second one; the first again where there is none


@dataclass(frozen=True)
class FormShape:
    """One kind of form."""

    # the formula after what it adds to (`Form.adds_to`), `{j}` for the joint and `{0}`, `{1}`, …
    # for the numbers
    words: str
    # what each parameter is multiplied with, (P,) or several of these, at an `At` (of readings an
    # `Along`) and the numbers
    columns: Callable[..., Array | tuple[Array, ...]]
    solved: tuple[TermParameter, ...]  # the parameters it is solved in
    numbers: tuple[str, ...] = ()  # names of the numbers that fix it and a reader has to be given

    def at(self, place: At | Along, numbers: Numbers) -> Array:
        """Return what each parameter is multiplied with, (P, k), at places (..., k)."""
        columns = self.columns(place, *numbers)
        return np.stack(columns if isinstance(columns, tuple) else (columns,), axis=-1)

    @property
    def between(self) -> int | None:
        """Return which number, from 0, may have any value; None where all are whole."""
        return next((k for k, name in enumerate(self.numbers) if name in _ANY_VALUE), None)


@dataclass(frozen=True)
class Form(Effect):
    """A short form at a place, proportional to its parameters."""

    form: str  # which of `shapes`
    numbers: Numbers = ()  # what fixes it: orders, thresholds, other joints
    id = "short_form"
    shapes: ClassVar[Mapping[str, FormShape]]
    adds_to: ClassVar[str] = ""  # what formulas start with

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return none: forms are tried where something without a name was found."""
        return ()

    @property
    def shape(self) -> FormShape:
        """Return the kind of form it is."""
        return self.shapes[self.form]

    @property
    def length(self) -> int:
        """Return how many numbers a reader has to be given: parameters, orders, thresholds."""
        return len(self.shape.solved) + len(self.shape.numbers)

    @property
    def order(self) -> int | None:
        """Return how often it comes again in a turn; None where it does not."""
        for name, number in zip(self.shape.numbers, self.numbers, strict=False):
            if name in ("order", "teeth"):
                return int(number)
        return None

    @property
    def between(self) -> float:
        """Return the number that may have any value."""
        assert self.shape.between is not None
        return self.numbers[self.shape.between]

    def at(self, value: float) -> Self:
        """Return the form with another such number."""
        place = self.shape.between
        assert place is not None
        return replace(self, numbers=(*self.numbers[:place], value, *self.numbers[place + 1 :]))

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return self.shape.solved

    @property
    def joint(self) -> int:
        """Return the joint, from 1; 0 where it sits at none."""
        return joint_of(self.of) if self.of.startswith("joint ") else 0

    @property
    def formula(self) -> str:
        words = f"{self.adds_to}{self.shape.words}".format(*self.numbers, j=self.joint)
        return words.replace("(1 q_", "(q_")

    @property
    def prior_factor(self) -> Array:
        """Return L (k, k) with L L^T the covariance expected of the parameters: hardly a bound."""
        found: Array = _ANY_SIZE * super().prior_factor
        return found

    def values(self, states: PoseStates) -> Array:
        """Return what each parameter is multiplied with, (P, k)."""
        own = (of[:, self.joint - 1] for of in (states.q_rad, states.tau_Nm, states.arrival))
        return self.shape.at(At(states, *own), self.numbers)

    def report(self, x: Array) -> Report:
        solved = self.shape.solved
        names = [parameter.name for parameter in solved]
        if names == ["s", "c"]:  # a sine and a cosine part
            return amplitude_and_phase(x, solved[0].unit)
        if names == ["k", "q0"]:  # a slope and a constant: as a slope and the place of its zero
            slope = x[0] if x[0] != 0.0 else np.finfo(float).tiny
            zero = -x[1] / slope
            jacobian = np.array([[1.0, 0.0], [-zero / slope, -1.0 / slope]])
            return Report(solved, np.array([x[0], zero]), jacobian)
        return report_as_solved(solved, x)


def sines(angle: Array, times: Array | float = 1.0) -> tuple[Array, Array]:
    """Return sine and cosine of angles, times so much."""
    return times * np.sin(angle), times * np.cos(angle)


def beyond(value: Array, threshold: float) -> Array:
    """Return by how much values are beyond a threshold, either way; 0 where they are not."""
    return np.asarray(np.sign(value) * np.maximum(np.abs(value) - threshold, 0.0))


def sized(names: str, unit: str, plausible: float) -> tuple[TermParameter, ...]:
    """Return parameters, their names with blanks between them, by their plausible size."""
    scale = 0.03 * plausible
    return tuple(TermParameter(name, unit, scale, plausible=plausible) for name in names.split())


# Short forms at a joint.

#: Errors of angles to be expected [rad], and torques that go with an angle [N m].
_ANGLE_RAD = 3e-4
_TORQUE_NM = 10.0
#: Torque of which a joint's error is expected to be about `_ANGLE_RAD` [N m].
_LOAD_NM = 30.0


def _saw(q: Array, teeth: float, start: float) -> Array:
    turns = teeth * q / (2.0 * np.pi) - start
    return np.asarray(2.0 * (turns - np.floor(turns)) - 1.0)


def _product_of_sines(at: At, joint: float) -> tuple[Array, ...]:
    of_own, of_other = sines(at.q), sines(at.q_of(joint))
    return tuple(own * other for own in of_own for other in of_other)


def settled_since(at: At, time_s: float, first_s: float) -> Array:
    """Return what is left (P,) of something that settles with a time constant from a time on."""
    return np.exp(-(at.states.time_s - first_s) / time_s)


_A = sized("A", "rad", _ANGLE_RAD)
_SINES = sized("s c", "rad", _ANGLE_RAD)
_FOUR = sized("a b c d", "rad", _ANGLE_RAD)
_TWO_SINES = sized("s1 c1 s2 c2", "rad", _ANGLE_RAD)
_C_ANGLE = sized("c", "1/rad", _ANGLE_RAD)
#: Of torques: parts of a compliance, and of its square and cube.
_UNITS_NM = {1: "rad/(N m)", 2: "rad/(N m)²", 3: "rad/(N m)³"}
_C1, _C2, _C3 = (sized("c", unit, _ANGLE_RAD / _LOAD_NM**k) for k, unit in _UNITS_NM.items())
_H1, _H2 = (sized("h", _UNITS_NM[k], _ANGLE_RAD / _LOAD_NM**k) for k in (1, 2))
_SINES_NM = sized("s c", _UNITS_NM[1], _ANGLE_RAD / _LOAD_NM)
_PULL = sized("k", "N m/rad", _TORQUE_NM)
_PULL_FROM = (*_PULL, *sized("q0", "rad", _TORQUE_NM))
_PULL_SINES = sized("s c", "N m", _TORQUE_NM)


@dataclass(frozen=True)
class AngleForm(Form):
    """The joint's angle is off by a short form."""

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
    """The joint carries, beyond the weights, a torque of a short form."""

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
