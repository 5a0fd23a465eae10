"""What is known of an arm and a campaign, by which it is decided where effects are possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

#: Share of its rated torque that a joint must have carried to show how it winds up.
_LOADED_SHARE = 0.01
#: Range of angles that a joint must have covered to show the shape of an error.
_LEAST_SPAN_RAD = 1e-3


def _of_some_length(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("must be a lower and a higher position")
    return ends


#: Lowest and highest measured position of a joint [rad, m], as checked where a file states it.
Span = Annotated[tuple[float, float], AfterValidator(_of_some_length)]


@dataclass(frozen=True)
class CandidateContext:
    """What is known of arm and campaign, by which it is decided where effects are possible."""

    arm: Arm  # the nominal arm
    flexible_joints: tuple[int, ...]  # joints, from 1, to which the model gives a spring
    reference_temperature_C: float  # temperature at which lengths are nominal
    largest_tau_Nm: Array  # (n,) largest torque that each joint carried
    p_instr_middle_m: Array  # (3,) middle of the measured places in the instrument's frame
    q_span_rad: Array  # (n, 2) lowest and highest angle that each joint took
    time_span_s: tuple[float, float]  # first and last reading of the campaign
    loads_N: tuple[float, ...] = ()  # external loads that were measured at
    tool_kg: float = 0.0  # mass stated of the tool; 0 where it is not known
    # the same of the tool of each campaign of a group; empty for no group
    campaign_tools_kg: tuple[float, ...] = ()
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)  # as stated, in the base frame
    # where torques come from: `logged`, `masses`, or `none`
    torques: Literal["logged", "masses", "none"] = "none"
    commanded: bool = False  # whether joint positions are those commanded, and not read back
    campaigns: tuple[str, ...] = ()  # names of the campaigns of a group; none of a single one
    # whether the instrument moves along axes of its own, each with its scale; None where not known
    three_axes: bool | None = None
    # the first joint, from 1, that lifts the arm; sine and cosine part, by its angle, of the torque
    # that the described weights put there [N m]. None where none lifts, or nothing is known of it
    lifts: tuple[int, float, float] | None = None

    @property
    def rated_Nm(self) -> Array:
        """Return the rated torque of every joint, (n,) [N m].

        The largest torque carried where no rating is stated, and 1 N m where that is zero as well.
        """
        rated_Nm = self.arm.rated_Nm(self.largest_tau_Nm)
        return np.where(rated_Nm == 0.0, 1.0, rated_Nm)

    def rated_at(self, joint: int) -> float:
        """Return the rated torque of a joint, from 1 [N m]; see `rated_Nm`."""
        return float(self.rated_Nm[joint - 1])

    def carried_at(self, joint: int) -> float:
        """Return the largest torque that a joint, from 1, carried [N m]; 0 if it is negligible."""
        carried_Nm = float(self.largest_tau_Nm[joint - 1])
        return carried_Nm if carried_Nm > _LOADED_SHARE * self.rated_at(joint) else 0.0

    def span_at(self, joint: int) -> tuple[float, float] | None:
        """Return lowest and highest position of a joint, from 1; None if it did not move."""
        low, high = self.q_span_rad[joint - 1].tolist()
        return (low, high) if high - low > _LEAST_SPAN_RAD else None


def turning_joints(context: CandidateContext) -> tuple[int, ...]:
    """Return the joints, from 1, that turn."""
    return tuple(int(joint) for joint in np.flatnonzero(~context.arm.prismatic) + 1)


def driven_joints(context: CandidateContext) -> tuple[int, ...]:
    """Return the joints, from 1, that turn by a motor of their own."""
    own = context.arm.coupling.own
    return tuple(joint for joint in turning_joints(context) if joint - 1 in own)


def slides_before_turns(context: CandidateContext) -> tuple[int, ...]:
    """Return the joints, from 1, that slide before any that turns: rails and columns."""
    leading = np.logical_and.accumulate(context.arm.prismatic)
    return tuple((np.flatnonzero(leading) + 1).tolist())


def joint_of(place: str) -> int:
    """Return the number of the joint, from 1, that a place names."""
    return int(place.removeprefix("joint "))
