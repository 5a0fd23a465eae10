"""Short forms at a joint: its angle is off, or it carries a torque beyond the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import joint_of
from pa10cal.terms.forms.form import Form, Numbers, Shape, sines, size
from pa10cal.terms.term import Parameter, TorqueOnly

#: Errors of angles to be expected [rad], and torques that go with an angle [N m].
_ANGLE_RAD = 3e-4
_TORQUE_NM = 10.0
#: Torque of which a joint's error is expected to be about `_ANGLE_RAD` [N m].
_LOAD_NM = 30.0


def _q(states: PoseStates, joint: int) -> Array:
    return np.asarray(states.q_rad[:, joint - 1])


def _tau(states: PoseStates, joint: int) -> Array:
    return np.asarray(states.tau_Nm[:, joint - 1])


def _arrived(states: PoseStates, joint: int) -> Array:
    return np.asarray(states.arrival[:, joint - 1])


def _two_orders(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array, ...]:
    first, second = numbers
    return (*sines(first * _q(states, joint)), *sines(second * _q(states, joint)))


def _teeth(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array]:
    teeth, start = numbers
    turns = teeth * _q(states, joint) / (2.0 * np.pi) - start
    return (2.0 * (turns - np.floor(turns)) - 1.0,)


def _steps_of_teeth(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array]:
    (saw,) = _teeth(states, joint, numbers)
    return (np.sign(-saw),)


def _other_sines(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array, Array]:
    del joint
    other, order = numbers
    return sines(order * _q(states, int(other)))


def _product_of_sines(states: PoseStates, joint: int, numbers: Numbers) -> tuple[Array, ...]:
    of_own, of_other = sines(_q(states, joint)), sines(_q(states, int(numbers[0])))
    return tuple(own * other for own in of_own for other in of_other)


def _beyond(value: Array, threshold: float) -> Array:
    return np.asarray(np.sign(value) * np.maximum(np.abs(value) - threshold, 0.0))


def _by_torque(sine: Array, cosine: Array, tau: Array) -> tuple[Array, Array]:
    return tau * sine, tau * cosine


def _settling(states: PoseStates, numbers: Numbers) -> Array:
    time_constant_s, start_s = numbers
    return np.asarray(np.exp(-(states.time_s - start_s) / time_constant_s))


_A = (size("A", "rad", _ANGLE_RAD),)
_SINES = (size("s", "rad", _ANGLE_RAD), size("c", "rad", _ANGLE_RAD))
_SINES_NM = (size("s", "N m", _TORQUE_NM), size("c", "N m", _TORQUE_NM))
_SINES_A_NM = tuple(size(name, "rad/(N m)", _ANGLE_RAD / _LOAD_NM) for name in "sc")


def _power(power: int) -> tuple[Parameter, ...]:
    return (size("c", f"rad/(N m){'²³'[power - 2]}", _ANGLE_RAD / _LOAD_NM**power),)


@dataclass(frozen=True)
class AngleForm(Form):
    """The joint's angle is off by a short form."""

    shapes: ClassVar[Mapping[str, Shape]] = {
        "harmonic": Shape(
            "theta_{j} += A sin({0:g} q_{j} + phi)",
            lambda states, j, numbers: sines(numbers[0] * _q(states, j)),
            _SINES,
            ("order",),
            "turning",
        ),
        "two_harmonics": Shape(
            "theta_{j} += s1 sin({0:g} q_{j}) + c1 cos({0:g} q_{j}) + s2 sin({1:g} q_{j}) "
            "+ c2 cos({1:g} q_{j})",
            _two_orders,
            tuple(size(name, "rad", _ANGLE_RAD) for name in ("s1", "c1", "s2", "c2")),
            ("order", "order"),
        ),
        "sawtooth": Shape(
            "theta_{j} += A (2 frac({0:g} q_{j} / (2 pi) - {1:.4g}) - 1)",
            _teeth,
            _A,
            ("teeth", "start"),
            between=1,
        ),
        "square": Shape(
            "theta_{j} += A sgn sin({0:g} q_{j} - 2 pi {1:.4g})",
            _steps_of_teeth,
            _A,
            ("teeth", "start"),
            between=1,
        ),
        "step": Shape(
            "theta_{j} += A where q_{j} > {0:.4g}",
            lambda states, j, numbers: ((_q(states, j) > numbers[0]).astype(float),),
            _A,
            ("threshold",),
            between=0,
        ),
        "torque_squared": Shape(
            "theta_{j} -= c tau_{j}^2",
            lambda states, j, _: (-(_tau(states, j) ** 2),),
            _power(2),
        ),
        "torque_abs_torque": Shape(
            "theta_{j} -= c tau_{j} |tau_{j}|",
            lambda states, j, _: (-_tau(states, j) * np.abs(_tau(states, j)),),
            _power(2),
        ),
        "torque_cubed": Shape(
            "theta_{j} -= c tau_{j}^3",
            lambda states, j, _: (-(_tau(states, j) ** 3),),
            _power(3),
        ),
        "sign_of_torque": Shape(
            "theta_{j} -= A sgn(tau_{j})",
            lambda states, j, _: (-np.sign(_tau(states, j)),),
            _A,
        ),
        "torque_beyond": Shape(
            "theta_{j} -= c sgn(tau_{j}) max(|tau_{j}| - {0:.4g}, 0)",
            lambda states, j, numbers: (-_beyond(_tau(states, j), numbers[0]),),
            (size("c", "rad/(N m)", _ANGLE_RAD / _LOAD_NM),),
            ("threshold",),
            between=0,
        ),
        "torque_by_angle": Shape(
            "theta_{j} -= tau_{j} A sin({0:g} q_{j} + phi)",
            lambda states, j, numbers: _by_torque(
                *sines(numbers[0] * _q(states, j)), -_tau(states, j)
            ),
            _SINES_A_NM,
            ("order",),
            "turning",
        ),
        "arrival_by_torque": Shape(
            "theta_{j} += h s_{j} |tau_{j}|",
            lambda states, j, _: (_arrived(states, j) * np.abs(_tau(states, j)),),
            (size("h", "rad/(N m)", _ANGLE_RAD / _LOAD_NM),),
        ),
        "arrival_by_torque_squared": Shape(
            "theta_{j} += h s_{j} tau_{j}^2",
            lambda states, j, _: (_arrived(states, j) * _tau(states, j) ** 2,),
            (size("h", "rad/(N m)²", _ANGLE_RAD / _LOAD_NM**2),),
        ),
        "arrival_by_angle": Shape(
            "theta_{j} += s_{j} A sin({0:g} q_{j} + phi)",
            lambda states, j, numbers: _by_torque(
                *sines(numbers[0] * _q(states, j)), _arrived(states, j)
            ),
            _SINES,
            ("order",),
            "turning",
        ),
        "other_angle": Shape(
            "theta_{j} += A sin({1:g} q_{0:g} + phi)",
            _other_sines,
            _SINES,
            ("joint", "order"),
            "turning",
        ),
        "product_of_angles": Shape(
            "theta_{j} += c q_{j} q_{0:g}",
            lambda states, j, numbers: (_q(states, j) * _q(states, int(numbers[0])),),
            (size("c", "1/rad", _ANGLE_RAD),),
            ("joint",),
        ),
        "product_of_sines": Shape(
            "theta_{j} += a sin q_{j} sin q_{0:g} + b sin q_{j} cos q_{0:g} "
            "+ c cos q_{j} sin q_{0:g} + d cos q_{j} cos q_{0:g}",
            _product_of_sines,
            tuple(size(name, "rad", _ANGLE_RAD) for name in "abcd"),
            ("joint",),
        ),
        "other_torque": Shape(
            "theta_{j} += c tau_{0:g}",
            lambda states, _, numbers: (_tau(states, int(numbers[0])),),
            (size("c", "rad/(N m)", _ANGLE_RAD / _LOAD_NM),),
            ("joint",),
        ),
        "settling": Shape(
            "theta_{j} += A exp(-(t - {1:.6g}) / {0:.4g}), t in s",
            lambda states, _, numbers: (_settling(states, numbers),),
            _A,
            ("time",),
            between=0,
        ),
    }

    @property
    def joint(self) -> int:
        """Return the joint, from 1."""
        return joint_of(self.of)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the joint's angle."""
        return (f"theta_{self.joint}",)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return what each parameter is multiplied with, (P, 1, k)."""
        del x
        return self.values(states)[:, None, :]


@dataclass(frozen=True)
class PullForm(TorqueOnly, Form):
    """The joint carries, beyond the weights, a torque of a short form."""

    shapes: ClassVar[Mapping[str, Shape]] = {
        "pull": Shape(
            "tau_{j} += k (q_{j} - q0)",
            lambda states, j, _: (_q(states, j), np.ones(len(states))),
            (size("k", "N m/rad", _TORQUE_NM), size("q0", "rad", _TORQUE_NM)),
            reported="offset",
        ),
        "pull_beyond": Shape(
            "tau_{j} += k max(q_{j} - {0:.4g}, 0)",
            lambda states, j, numbers: (np.maximum(_q(states, j) - numbers[0], 0.0),),
            (size("k", "N m/rad", _TORQUE_NM),),
            ("threshold",),
            between=0,
        ),
        "pull_below": Shape(
            "tau_{j} += k min(q_{j} - {0:.4g}, 0)",
            lambda states, j, numbers: (np.minimum(_q(states, j) - numbers[0], 0.0),),
            (size("k", "N m/rad", _TORQUE_NM),),
            ("threshold",),
            between=0,
        ),
        "pull_harmonic": Shape(
            "tau_{j} += A sin({0:g} q_{j} + phi)",
            lambda states, j, numbers: sines(numbers[0] * _q(states, j)),
            _SINES_NM,
            ("order",),
            "turning",
        ),
    }

    @property
    def joint(self) -> int:
        """Return the joint, from 1."""
        return joint_of(self.of)

    @property
    def carried(self) -> bool:
        """Return that the joint carries it."""
        return True

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return what each parameter is multiplied with, at its joint, (P, n, k)."""
        derivative = np.zeros((*states.tau_Nm.shape, len(x)))
        derivative[:, self.joint - 1] = self.values(states)
        return derivative
