"""Errors of a joint's angle that are no harmonic of it: ratio, lost motion, coupled wrist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms.effects.effect import (
    AtJoint,
    CandidateContext,
    JointEffect,
    NamedEffect,
    turning_joints,
)
from pa10cal.terms.of_campaign import of_campaign
from pa10cal.terms.term import Parameter, Report


@dataclass(frozen=True)
class GearRatioError(JointEffect):
    """A gear ratio off its nominal value: eps q_j [rad], eps without unit."""

    id: ClassVar[str] = "gear_ratio_error"
    words: ClassVar[str] = "theta_{0.joint} += eps q_{0.joint}"
    reported: ClassVar[tuple[Parameter, ...]] = (Parameter("eps", "1", 1e-5, plausible=3e-4),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return states.q_rad[:, self.joint - 1, None, None]


@dataclass(frozen=True)
class Backlash(JointEffect):
    """Lost motion: b s_j [rad], s_j the direction in which the joint arrived."""

    id: ClassVar[str] = "backlash"
    positive: ClassVar[bool] = True
    words: ClassVar[str] = "theta_{0.joint} += b s_{0.joint}"
    reported: ClassVar[tuple[Parameter, ...]] = (Parameter("b", "rad", 1e-5, plausible=3e-4),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return states.arrival[:, self.joint - 1, None, None]


@dataclass(frozen=True)
class ArrivalError(JointEffect):
    """A controller that stops short of its command: c in the direction moved, 0 where it stayed.

    Lost motion acts behind the motor, whatever its controller does, and is a joint's own. A
    controller stops where friction lets it, by another amount in each campaign, and only angles
    that were commanded and not read back hide where it stopped.
    """

    # names of the campaigns of a group, each with an amount of its own; none of one
    campaigns: tuple[str, ...] = ()
    id: ClassVar[str] = "arrival_error"
    words: ClassVar[str] = (
        "theta_{0.joint} += c, the sign that of the move to here, 0 of a joint that stayed"
    )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the campaigns of a group, where positions are those commanded."""
        return (context.campaigns,) if context.commanded else None

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return how far beyond its command the joint stops, in every campaign."""
        names = [of_campaign("c", name) for name in self.campaigns] or ["c"]
        return tuple(Parameter(name, "rad", 1e-5, plausible=1e-4) for name in names)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the direction moved, in the column of the pose's campaign, (P, 1, c)."""
        campaign = np.zeros(len(states), int) if states.campaign is None else states.campaign
        moved = states.since_before[:, self.joint - 1]
        columns: Array = moved[:, None] * (campaign[:, None] == np.arange(len(x)))
        return columns[:, None, :]


@dataclass(frozen=True)
class WristCoupling(NamedEffect):
    """The last joint turns with the one before it: c q_(n-1) [rad], c without unit."""

    last: int  # the last joint, n
    id: ClassVar[str] = "wrist_coupling"
    words: ClassVar[str] = "theta_{0.last} += c q_{0.before}"
    reported: ClassVar[tuple[Parameter, ...]] = (Parameter("c", "1", 3e-5, plausible=1e-3),)

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at the wrist, where the last two joints turn."""
        last = context.arm.n
        return (cls("wrist", last),) if {last - 1, last} <= {*turning_joints(context)} else ()

    @property
    def before(self) -> int:
        """Return the joint before the last."""
        return self.last - 1

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.last}",)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return states.q_rad[:, self.before - 1, None, None]


# Periodic errors of a joint's angle: encoder disks and harmonic drives.


@dataclass(frozen=True)
class JointHarmonic(AtJoint):
    """A sin(order q_j + phi), solved in its parts A cos phi (sine) and A sin phi (cosine)."""

    order: float  # cycles a turn of the joint
    words: ClassVar[str] = "theta_{0.joint} += A sin({0.order:g} q_{0.joint} + phi)"
    order_stated: ClassVar[float]  # of those of one order
    plausible_rad: ClassVar[float] = 3e-4

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return (cls.order_stated,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{self.id}_{self.joint}_{part}", "rad", 1e-5, plausible=self.plausible_rad)
            for part in ("sin", "cos")
        )

    def derivative(self, states: PoseStates, x: Array) -> Array:
        phase = self.order * states.q_rad[:, self.joint - 1]
        return np.stack([np.sin(phase), np.cos(phase)], axis=-1)[:, None, :]

    def report(self, x: Array) -> Report:
        return amplitude_and_phase(x, "rad")


def amplitude_and_phase(x: Array, unit: str) -> Report:
    """Report a sine and a cosine part (2,) as A and phi of A sin(... + phi)."""
    amplitude = float(np.hypot(*x))
    phase = float(np.arctan2(x[1], x[0]))
    size = max(amplitude, np.finfo(float).tiny)
    jacobian = np.array(
        [[np.cos(phase), np.sin(phase)], [-np.sin(phase) / size, np.cos(phase) / size]]
    )
    names = (Parameter("A", unit, 1e-5), Parameter("phi", "rad", 1.0))
    return Report(names, np.array([amplitude, phase]), jacobian)


@dataclass(frozen=True)
class TransmissionError(JointHarmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id: ClassVar[str] = "transmission_error"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return twice the gear ratio; nan where that is not known."""
        return (2.0 * float(context.arm.gear_ratio[joint - 1]),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return sine and cosine of order q_j, (P, 1, 2).

        Raises:
            CalibrationError: when the gear ratio is not known.
        """
        if np.isnan(self.order):
            raise CalibrationError(
                "the gear ratio of the joint is not known",
                where=f"{self.id} of {self.of}",
                allowed="an arm description with gear_ratio",
                remedy="add it to the joint's row",
            )
        return super().derivative(states, x)


@dataclass(frozen=True)
class EncoderEccentricity(JointHarmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id: ClassVar[str] = "encoder_eccentricity"
    order_stated: ClassVar[float] = 1.0


@dataclass(frozen=True)
class EncoderEllipticity(JointHarmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id: ClassVar[str] = "encoder_ellipticity"
    order_stated: ClassVar[float] = 2.0


# An error of a whole number of cycles a turn of a joint, which the data have found.


@dataclass(frozen=True)
class PeriodicError(JointHarmonic):
    """A sin(k q_j + phi), k whole: in the place of a map that is this one line.

    It is not sought: k is found where a map of the joint does no better than one line
    (`discovery/formulas`). One and two cycles, and those of the gear, have names of their own.
    """

    order: float = 3.0  # k, at first the lowest without a name of its own
    id: ClassVar[str] = "periodic_error"
    order_stated: ClassVar[float] = 3.0
    sought: ClassVar[bool] = False

    def report(self, x: Array) -> Report:
        known = super().report(x)
        order = Parameter("k", "1", 1.0)
        return replace(
            known,
            parameters=(*known.parameters, order),
            values=np.append(known.values, self.order),
            jacobian=np.vstack([known.jacobian, np.zeros(2)]),
        )
