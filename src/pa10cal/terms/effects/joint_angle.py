"""Errors of a joint's angle that are no harmonic of it: ratio, lost motion, coupled wrist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, JointEffect, NamedEffect, turning_joints
from pa10cal.terms.of_campaign import of_campaign
from pa10cal.terms.term import Parameter


@dataclass(frozen=True)
class GearRatioError(JointEffect):
    """A gear ratio off its nominal value: eps q_j [rad], eps without unit."""

    id: ClassVar[str] = "gear_ratio_error"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.joint} += eps q_{self.joint}"

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the relative error."""
        return (Parameter("eps", "1", 1e-5, plausible=3e-4),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return q_j, (P, 1, 1)."""
        del x
        return states.q_rad[:, self.joint - 1, None, None]


@dataclass(frozen=True)
class Backlash(JointEffect):
    """Lost motion: b s_j [rad], s_j the direction in which the joint arrived."""

    id: ClassVar[str] = "backlash"
    positive: ClassVar[bool] = True

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.joint} += b s_{self.joint}"

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return half the lost motion."""
        return (Parameter("b", "rad", 1e-5, plausible=3e-4),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return s_j, (P, 1, 1)."""
        del x
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

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns, where positions are those commanded."""
        joints = turning_joints(context) if context.commanded else ()
        return tuple(cls(f"joint {joint}", context.campaigns) for joint in joints)

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return (
            f"theta_{self.joint} += c, the sign that of the move to here, 0 of a joint that stayed"
        )

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

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.last} += c q_{self.last - 1}"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at the wrist, where the last two joints turn."""
        last = context.arm.n
        return (cls("wrist", last),) if {last - 1, last} <= {*turning_joints(context)} else ()

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the coupling."""
        return (Parameter("c", "1", 3e-5, plausible=1e-3),)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the angle of the last joint."""
        return (f"theta_{self.last}",)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the angle of the joint before the last, (P, 1, 1)."""
        del x
        return states.q_rad[:, self.last - 2, None, None]
