"""Short forms at a joint: its angle is off, or it carries a torque beyond the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.forms.form import At, Form, Shape, beyond, sines, sized
from pa10cal.terms.term import JointTorqueOnly

#: Errors of angles to be expected [rad], and torques that go with an angle [N m].
_ANGLE_RAD = 3e-4
_TORQUE_NM = 10.0
#: Torque of which a joint's error is expected to be about `_ANGLE_RAD` [N m].
_LOAD_NM = 30.0


def _two_orders(at: At) -> tuple[Array, ...]:
    first, second = at.numbers
    return (*sines(first * at.q), *sines(second * at.q))


def _saw(at: At) -> Array:
    teeth, start = at.numbers
    turns = teeth * at.q / (2.0 * np.pi) - start
    return np.asarray(2.0 * (turns - np.floor(turns)) - 1.0)


def _product_of_sines(at: At) -> tuple[Array, ...]:
    of_own, of_other = sines(at.q), sines(at.q_of(at.numbers[0]))
    return tuple(own * other for own in of_own for other in of_other)


def _settling(at: At) -> tuple[Array]:
    time_constant_s, start_s = at.numbers
    return (np.exp(-(at.states.time_s - start_s) / time_constant_s),)


_A = sized("A", "rad", _ANGLE_RAD)
_SINES = sized("s c", "rad", _ANGLE_RAD)
_A_NM = _ANGLE_RAD / _LOAD_NM
_PER_NM2, _PER_NM3 = _ANGLE_RAD / _LOAD_NM**2, _ANGLE_RAD / _LOAD_NM**3
_PULL = sized("k", "N m/rad", _TORQUE_NM)


@dataclass(frozen=True)
class AngleForm(Form):
    """The joint's angle is off by a short form."""

    shapes: ClassVar[Mapping[str, Shape]] = {
        "harmonic": Shape(
            "theta_{j} += A sin({0:g} q_{j} + phi)",
            lambda at: sines(at.numbers[0] * at.q),
            _SINES,
            ("order",),
            "turning",
        ),
        "two_harmonics": Shape(
            "theta_{j} += s1 sin({0:g} q_{j}) + c1 cos({0:g} q_{j}) + s2 sin({1:g} q_{j}) "
            "+ c2 cos({1:g} q_{j})",
            _two_orders,
            sized("s1 c1 s2 c2", "rad", _ANGLE_RAD),
            ("order", "order"),
        ),
        "sawtooth": Shape(
            "theta_{j} += A (2 frac({0:g} q_{j} / (2 pi) - {1:.4g}) - 1)",
            lambda at: (_saw(at),),
            _A,
            ("teeth", "start"),
            between=1,
        ),
        "square": Shape(
            "theta_{j} += A sgn sin({0:g} q_{j} - 2 pi {1:.4g})",
            lambda at: (np.sign(-_saw(at)),),
            _A,
            ("teeth", "start"),
            between=1,
        ),
        "step": Shape(
            "theta_{j} += A where q_{j} > {0:.4g}",
            lambda at: ((at.q > at.numbers[0]).astype(float),),
            _A,
            ("threshold",),
            between=0,
        ),
        "torque_squared": Shape(
            "theta_{j} -= c tau_{j}^2",
            lambda at: (-(at.tau**2),),
            sized("c", "rad/(N m)²", _PER_NM2),
        ),
        "torque_abs_torque": Shape(
            "theta_{j} -= c tau_{j} |tau_{j}|",
            lambda at: (-at.tau * np.abs(at.tau),),
            sized("c", "rad/(N m)²", _PER_NM2),
        ),
        "torque_cubed": Shape(
            "theta_{j} -= c tau_{j}^3",
            lambda at: (-(at.tau**3),),
            sized("c", "rad/(N m)³", _PER_NM3),
        ),
        "sign_of_torque": Shape("theta_{j} -= A sgn(tau_{j})", lambda at: (-np.sign(at.tau),), _A),
        "torque_beyond": Shape(
            "theta_{j} -= c sgn(tau_{j}) max(|tau_{j}| - {0:.4g}, 0)",
            lambda at: (-beyond(at.tau, at.numbers[0]),),
            sized("c", "rad/(N m)", _A_NM),
            ("threshold",),
            between=0,
        ),
        "torque_by_angle": Shape(
            "theta_{j} -= tau_{j} A sin({0:g} q_{j} + phi)",
            lambda at: sines(at.numbers[0] * at.q, -at.tau),
            sized("s c", "rad/(N m)", _A_NM),
            ("order",),
            "turning",
        ),
        "arrival_by_torque": Shape(
            "theta_{j} += h s_{j} |tau_{j}|",
            lambda at: (at.arrival * np.abs(at.tau),),
            sized("h", "rad/(N m)", _A_NM),
        ),
        "arrival_by_torque_squared": Shape(
            "theta_{j} += h s_{j} tau_{j}^2",
            lambda at: (at.arrival * at.tau**2,),
            sized("h", "rad/(N m)²", _PER_NM2),
        ),
        "arrival_by_angle": Shape(
            "theta_{j} += s_{j} A sin({0:g} q_{j} + phi)",
            lambda at: sines(at.numbers[0] * at.q, at.arrival),
            _SINES,
            ("order",),
            "turning",
        ),
        "other_angle": Shape(
            "theta_{j} += A sin({1:g} q_{0:g} + phi)",
            lambda at: sines(at.numbers[1] * at.q_of(at.numbers[0])),
            _SINES,
            ("joint", "order"),
            "turning",
        ),
        "product_of_angles": Shape(
            "theta_{j} += c q_{j} q_{0:g}",
            lambda at: (at.q * at.q_of(at.numbers[0]),),
            sized("c", "1/rad", _ANGLE_RAD),
            ("joint",),
        ),
        "product_of_sines": Shape(
            "theta_{j} += a sin q_{j} sin q_{0:g} + b sin q_{j} cos q_{0:g} "
            "+ c cos q_{j} sin q_{0:g} + d cos q_{j} cos q_{0:g}",
            _product_of_sines,
            sized("a b c d", "rad", _ANGLE_RAD),
            ("joint",),
        ),
        "other_torque": Shape(
            "theta_{j} += c tau_{0:g}",
            lambda at: (at.tau_of(at.numbers[0]),),
            sized("c", "rad/(N m)", _A_NM),
            ("joint",),
        ),
        "settling": Shape(
            "theta_{j} += A exp(-(t - {1:.6g}) / {0:.4g}), t in s",
            _settling,
            _A,
            ("time",),
            between=0,
        ),
    }

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.joint}",)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return self.values(states)[:, None, :]


@dataclass(frozen=True)
class PullForm(JointTorqueOnly, Form):
    """The joint carries, beyond the weights, a torque of a short form."""

    carried: ClassVar[bool] = True
    shapes: ClassVar[Mapping[str, Shape]] = {
        "pull": Shape(
            "tau_{j} += k (q_{j} - q0)",
            lambda at: (at.q, np.ones(len(at.states))),
            (*_PULL, *sized("q0", "rad", _TORQUE_NM)),
            reported="offset",
        ),
        "pull_beyond": Shape(
            "tau_{j} += k max(q_{j} - {0:.4g}, 0)",
            lambda at: (np.maximum(at.q - at.numbers[0], 0.0),),
            _PULL,
            ("threshold",),
            between=0,
        ),
        "pull_below": Shape(
            "tau_{j} += k min(q_{j} - {0:.4g}, 0)",
            lambda at: (np.minimum(at.q - at.numbers[0], 0.0),),
            _PULL,
            ("threshold",),
            between=0,
        ),
        "pull_harmonic": Shape(
            "tau_{j} += A sin({0:g} q_{j} + phi)",
            lambda at: sines(at.numbers[0] * at.q),
            sized("s c", "N m", _TORQUE_NM),
            ("order",),
            "turning",
        ),
    }

    def per_unit(self, states: PoseStates) -> Array:
        return self.values(states)
