"""Campaigns of one robot joined: measured in one frame, poses labelled, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.joined import Joined
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Array, Start

#: Between the name of a campaign and the label of a pose.
_OF_CAMPAIGN = "/"
#: One campaign begins so long after the one before it has ended [s]: clocks are their own.
_APART_S = 3600.0


@dataclass(frozen=True)
class Member:
    """A campaign of a group.

    Attributes:
        name: its name.
        observations: single readings of all kinds, as its instrument measured them.
        start: about where base, tool and targets are, as its instrument sees them.
    """

    name: str
    observations: Observations
    start: Start


def join(members: Sequence[Member]) -> Observations[Joined]:
    """Join campaigns of one robot.

    Every campaign is moved to where its base stands with that of the first, and its target turned
    to the attitude of the first: then what its base and tool are off by is small, and an unknown
    of its own.

    Args:
        members: the campaigns; the first gives the frame.

    Returns:
        Single readings of all, labels with the name of their campaign.
    """
    frames = members[0].start
    every = [_placed(member.observations, member.start, frames) for member in members]
    every = [with_arrivals(each)[0] for each in every]
    names = tuple(member.name for member in members)
    campaign = np.repeat(np.arange(len(every)), [len(each) for each in every])
    return Observations(
        pose=np.concatenate(
            [
                np.char.add(name + _OF_CAMPAIGN, each.pose)
                for name, each in zip(names, every, strict=True)
            ]
        ),
        states=_states([each.states for each in every], campaign),
        measured=Joined(names, tuple(each.measured for each in every), campaign),
        kind=np.concatenate([each.kind for each in every]),
        repeat=np.concatenate([each.repeat for each in every]),
        readings=np.concatenate([each.readings for each in every]),
        log=_log([each.log for each in every]),
    )


def to_first(own: Start, first: Start) -> Array:
    """Return where the instrument of a campaign stands in the frame of the first, (4, 4)."""
    T: Array = first.T_instr_base @ np.linalg.inv(own.T_instr_base)
    return T


def _placed(every: Observations, own: Start, first: Start) -> Observations[Instrument]:
    """Return readings with base and target where those of the first campaign are."""
    if own is first:
        return every
    measured = every.measured.moved(to_first(own, first))
    return replace(every, measured=measured.turned(first.R_ee_target.T @ own.R_ee_target))


def _states(each: Sequence[PoseStates], campaign: np.ndarray) -> PoseStates:
    """Return the states of all campaigns, each on its clock, one after the other."""
    times, end_s = [], None
    for states in each:
        time_s = states.time_s
        if end_s is not None and len(time_s):
            time_s = time_s - time_s.min() + end_s + _APART_S
        end_s = time_s.max(initial=-np.inf) if len(time_s) else end_s
        times.append(time_s)
    return PoseStates(
        q_rad=np.concatenate([states.q_rad for states in each]),
        tau_Nm=np.concatenate([states.tau_Nm for states in each]),
        arrival=np.concatenate([states.arrival for states in each]),
        load_N=np.concatenate([states.load_N for states in each]),
        temperature_C=np.concatenate([states.temperature_C for states in each]),
        time_s=np.concatenate(times),
        campaign=campaign,
    )


def _log(logs: Sequence[JointLog | None]) -> JointLog | None:
    """Return how joints were read in all campaigns; None where one does not say."""
    known = [log for log in logs if log is not None]
    if len(known) < len(logs):
        return None
    return JointLog(
        np.concatenate([log.q_u for log in known]),
        np.concatenate([log.tau_u for log in known]),
        np.concatenate([log.samples for log in known]),
    )
