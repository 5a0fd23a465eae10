"""What a short form is: a few parameters, a shape that numbers fix, and the formula in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, NamedEffect, joint_of
from pa10cal.terms.effects.joint_angle import amplitude_and_phase
from pa10cal.terms.term import Parameter, Report, report_as_solved

Numbers = tuple[float, ...]

#: Size in which forms are fitted, in the plausible one.
_ANY_SIZE = 10.0


class At(NamedTuple):
    """Where the columns of a form are taken: poses, a joint, and what fixes the form."""

    states: PoseStates
    joint: int  # from 1; 0 where the form sits at none
    numbers: Numbers

    @property
    def q(self) -> Array:
        """Return the joint's angle, (P,) [rad]."""
        return self.q_of(self.joint)

    @property
    def tau(self) -> Array:
        """Return the joint's torque, (P,) [N m]."""
        return self.tau_of(self.joint)

    @property
    def arrival(self) -> Array:
        """Return the direction in which the joint arrived, (P,)."""
        return self.states.arrival[:, self.joint - 1]

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


@dataclass(frozen=True)
class Shape:
    """One kind of form."""

    words: str  # the formula, with `{j}` for the joint and `{0}`, `{1}`, … for the numbers
    # what each parameter is multiplied with: (P,) each of an `At`; of readings see `ReadingForm`
    columns: Callable[[Any], tuple[Array, ...]]
    solved: tuple[Parameter, ...]  # the parameters it is solved in
    numbers: tuple[str, ...] = ()  # names of the numbers that fix it and a reader has to be given
    # `as solved`; `turning` where a sine and a cosine part are an amplitude A and a phase phi;
    # `offset` where a slope and a constant are a slope and the place of its zero
    reported: Literal["as solved", "turning", "offset"] = "as solved"
    between: int | None = None  # which number, from 0, may have any value; None where all are whole


@dataclass(frozen=True)
class Form(NamedEffect):
    """A short form at a place, proportional to its parameters."""

    form: str  # which of `shapes`
    numbers: Numbers = ()  # what fixes it: orders, thresholds, other joints
    id: ClassVar[str] = "short_form"
    shapes: ClassVar[Mapping[str, Shape]]

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return none: forms are tried where something without a name was found."""
        return ()

    @property
    def shape(self) -> Shape:
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
    def reported(self) -> tuple[Parameter, ...]:
        return self.shape.solved

    @property
    def joint(self) -> int:
        """Return the joint, from 1; 0 where it sits at none."""
        return joint_of(self.of) if self.of.startswith("joint ") else 0

    @property
    def formula(self) -> str:
        words = self.shape.words.format(*self.numbers, j=self.joint)
        return words.replace("(1 q_", "(q_")

    @property
    def prior_factor(self) -> Array:
        """Return L (k, k) with L L^T the covariance expected of the parameters: hardly a bound."""
        found: Array = _ANY_SIZE * super().prior_factor
        return found

    def values(self, states: PoseStates) -> Array:
        """Return what each parameter is multiplied with, (P, k)."""
        return np.stack(self.shape.columns(At(states, self.joint, self.numbers)), axis=1)

    def report(self, x: Array) -> Report:
        if self.shape.reported == "turning":
            return amplitude_and_phase(x, self.shape.solved[0].unit)
        if self.shape.reported == "offset":
            return _slope_and_zero(x, self.shape.solved)
        return report_as_solved(self.reported, x)


def _slope_and_zero(x: Array, solved: tuple[Parameter, ...]) -> Report:
    """Report x_0 v + x_1 as x_0 (v - v_0)."""
    slope = x[0] if x[0] != 0.0 else np.finfo(float).tiny
    zero = -x[1] / slope
    jacobian = np.array([[1.0, 0.0], [-zero / slope, -1.0 / slope]])
    return Report(solved, np.array([x[0], zero]), jacobian)


def sines(angle: Array, times: Array | float = 1.0) -> tuple[Array, Array]:
    """Return sine and cosine of angles, times so much."""
    return times * np.sin(angle), times * np.cos(angle)


def beyond(value: Array, threshold: float) -> Array:
    """Return by how much values are beyond a threshold, either way; 0 where they are not."""
    return np.asarray(np.sign(value) * np.maximum(np.abs(value) - threshold, 0.0))


def sized(names: str, unit: str, plausible: float) -> tuple[Parameter, ...]:
    """Return parameters, their names with blanks between them, by their plausible size."""
    scale = 0.03 * plausible
    return tuple(Parameter(name, unit, scale, plausible=plausible) for name in names.split())
