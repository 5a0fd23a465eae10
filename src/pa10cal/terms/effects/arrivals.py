"""Where joints stand when the arm is read: short of a command, or elsewhere than logged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects import effect
from pa10cal.terms.effects.context import CandidateContext, driven_joints, turning_joints
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.term import ErrorOf, TermParameter, Transferred
from pa10cal.terms.wrapped import of_campaign

#: Lost motion that is usual where all joints have it, as with standard planetary gears [rad].
OF_PLANETARY_RAD = 2e-3


def _of_each(campaigns: tuple[str, ...], amount: TermParameter) -> tuple[TermParameter, ...]:
    """Return an amount for each campaign of a group, or the one of a single campaign."""
    names = [of_campaign(amount.name, campaign) for campaign in campaigns] or [amount.name]
    return tuple(replace(amount, name=name) for name in names)


def _in_campaign(states: PoseStates, count: int) -> Array:
    """Return 1 in the column of each pose's campaign, and else 0, (P, count)."""
    campaign = np.zeros(len(states), int) if states.campaign is None else states.campaign
    return np.asarray(campaign[:, None] == np.arange(count), dtype=float)


@dataclass(frozen=True)
class ArrivalError(effect.JointEffect):
    """A controller that stops short of its command: c in the direction moved, 0 where it stayed.

    Lost motion acts behind the motor, whatever its controller does, and is a joint's own. A
    controller stops where friction lets it, by another amount in each campaign, and only angles
    that were commanded and not read back hide where it stopped.
    """

    campaigns: tuple[str, ...] = ()  # those of a group, each with an amount of its own
    id = "arrival_error"
    sits = "driven joint"
    varies_with = "the direction of arrival"
    clauses = (
        "{at} stops in another place for each direction that it comes from",
        "{at} stop in other places for each direction that they come from",
    )
    words = "theta_{0.joint} += c, the sign that of the move to here, 0 of a joint that stayed"
    stays_with_arm = False

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the campaigns of a group, where positions are those commanded."""
        return (context.campaigns,) if context.commanded else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return how far beyond its command the joint stops, in every campaign."""
        return _of_each(self.campaigns, TermParameter("c", "rad", 1e-5, plausible=1e-4))

    @property
    def arriving(self) -> tuple[int, ...]:
        return (self.joint,)

    def per_unit(self, states: PoseStates) -> Array:
        """Return the direction moved, in the column of the pose's campaign."""
        moved = states.move_from_previous[:, self.joint - 1]
        return moved[:, None] * _in_campaign(states, len(self.reported))

    def elsewhere(self) -> Transferred:
        """Return the same of one campaign: there it has another amount."""
        return Transferred(ArrivalError(self.of), same_amounts=False)


@dataclass(frozen=True)
class LostMotion(effect.Effect):
    """Lost motion of several joints at once: -b_j s_j [rad] of each; see `Backlash`.

    A rival of `along_move`, which predicts readings as it does and moves no robot.
    """

    joints: tuple[int, ...]  # those that have it, from 1
    id = "lost_motion"
    sits = "arm"
    role_in_search = "proposed"
    varies_with = "the direction of arrival"
    nouns = ("lost motion",)
    clauses = ("joints have lost motion",)
    limits = Backlash.limits
    words = "theta_j -= b_j s_j"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        joints = driven_joints(context)
        return (joints,) if joints else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return half of the reversal error of each joint."""
        return tuple(
            TermParameter(f"b_{joint}", "rad", 1e-5, plausible=OF_PLANETARY_RAD)
            for joint in self.joints
        )

    @property
    def arriving(self) -> tuple[int, ...]:
        return self.joints

    @property
    def coordinates(self) -> tuple[str, ...]:
        return tuple(f"theta_{joint}" for joint in self.joints)

    @property
    def of_each(self) -> tuple[Backlash, ...]:
        """Return the same as effects of single joints."""
        return tuple(Backlash(f"joint {joint}") for joint in self.joints)

    def per_unit(self, states: PoseStates) -> Array:
        sides = states.arrival[:, [joint - 1 for joint in self.joints]]
        return -sides[:, :, None] * np.eye(len(self.joints))


@dataclass(frozen=True)
class AlongMove(effect.Effect):
    """Log and reading are not of one instant: all joints are off along the move to the pose.

    A controller ends a move with all joints at once, so what is left of it, or was already gone of
    it, is a part of the move of the pose before to this one. Moves differ in length and not in how
    they end: c [rad] is what the joint that went furthest is off. How long a reading waits is its
    campaign's.
    """

    joints: tuple[int, ...]  # those that turn, from 1
    campaigns: tuple[str, ...] = ()  # those of a group, each with an amount of its own
    #: The amount of a campaign.
    amount: ClassVar[TermParameter] = TermParameter("c", "rad", 1e-5, plausible=3e-4)
    of_moves = True
    id = "along_move"
    varies_with = "the move before each pose"
    clauses = ("the log of joints and the readings are not of one instant",)
    sits = "arm"
    words = "theta_j += c m_j / max |m|, m the move of all joints from the pose before"
    error_of: ClassVar[ErrorOf] = "log"
    stays_with_arm = False

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return turning_joints(context), context.campaigns

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return what the joint that went furthest is off, in every campaign."""
        return _of_each(self.campaigns, self.amount)

    def elsewhere(self) -> Transferred:
        """Return the same of one campaign: there it has another amount."""
        return Transferred(replace(self, campaigns=()), same_amounts=False)

    @property
    def arriving(self) -> tuple[int, ...]:
        return self.joints

    @property
    def coordinates(self) -> tuple[str, ...]:
        return tuple(f"theta_{joint}" for joint in self.joints)

    def per_unit(self, states: PoseStates) -> Array:
        share = effect.move_share_in(states, self)[:, [joint - 1 for joint in self.joints]]
        return share[..., None] * _in_campaign(states, len(self.reported))[:, None, :]


@dataclass(frozen=True)
class MoveSettling(AlongMove):
    """The arm still settles when it is read, or its log is of another instant, by the end's speed.

    A controller that brakes the end of the arm as hard in every move has the more of a move before
    it at any instant the faster the end comes: c v [rad] is what the joint that went furthest is
    off, v how far the end goes for a radian of it.
    """

    id = "move_settling"
    nouns = ("settling after moves",)
    clauses = ("the arm still settles when it is read, the more the faster its end came",)
    words = (
        "theta_j += c v m_j / max |m|, m the move from the pose before, v that of the end for it"
    )
    # As along_move, with the end at a third of a metre.
    amount = TermParameter("c", "rad/m", 3e-5, plausible=1e-3)

    def per_unit(self, states: PoseStates) -> Array:
        return super().per_unit(states) * effect.move_end_in(states, self)[:, None, None]
