"""Campaigns of one robot joined: measured in one frame, poses labelled, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.joined import Joined
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Start

#: Between the name of a campaign and the label of a pose.
_OF_CAMPAIGN = "/"
#: One campaign begins so long after the one before it has ended [s]: clocks are their own.
_APART_S = 3600.0


@dataclass(frozen=True)
class Member:
    """A campaign of a group."""

    name: str
    observations: Observations  # single readings of all kinds, as its instrument measured them
    start: Start  # about where base, tool and targets are, as its instrument sees them


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
    each = []
    for member in members:
        placed = with_arrivals(_placed(member.observations, member.start, frames))[0]
        labels = np.char.add(member.name + _OF_CAMPAIGN, placed.pose)
        each.append(replace(placed, pose=labels))
    times_s = _one_after_the_other([every.states.time_s for every in each])
    each = [
        every.with_states(replace(every.states, time_s=time_s))
        for every, time_s in zip(each, times_s, strict=True)
    ]
    return joined(each, tuple(member.name for member in members))


def joined(each: Sequence[Observations], names: tuple[str, ...]) -> Observations[Joined]:
    """Join campaigns that stand in one frame, and whose labels and times are apart.

    Args:
        each: single readings of every campaign.
        names: of the campaigns.
    """
    campaign = np.repeat(np.arange(len(each)), [len(every) for every in each])
    return Observations(
        pose=np.concatenate([every.pose for every in each]),
        states=_states([every.states for every in each], campaign),
        measured=Joined(names, tuple(every.measured for every in each), campaign),
        kind=np.concatenate([every.kind for every in each]),
        repeat=np.concatenate([every.repeat for every in each]),
        readings=np.concatenate([every.readings for every in each]),
        log=_log([every.log for every in each]),
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


def _one_after_the_other(times_s: Sequence[Array]) -> list[Array]:
    """Return the times of all campaigns, each on its own clock, one after the other."""
    shifted, end_s = [times_s[0]], times_s[0].max(initial=0.0)
    for time_s in times_s[1:]:
        begins_s = time_s.min(initial=np.inf)
        shifted.append(time_s - begins_s + end_s + _APART_S if len(time_s) else time_s)
        end_s = shifted[-1].max(initial=end_s)
    return shifted


def _states(each: Sequence[PoseStates], campaign: Index) -> PoseStates:
    return PoseStates(
        q_rad=np.concatenate([states.q_rad for states in each]),
        tau_Nm=np.concatenate([states.tau_Nm for states in each]),
        arrival=np.concatenate([states.arrival for states in each]),
        load_N=np.concatenate([states.load_N for states in each]),
        temperature_C=np.concatenate([states.temperature_C for states in each]),
        time_s=np.concatenate([states.time_s for states in each]),
        campaign=campaign,
        timed=_timed(each),
    )


def _timed(each: Sequence[PoseStates]) -> NDArray[np.bool_] | None:
    """Return which poses of all campaigns have a time; None where all do."""
    if all(states.tells_time for states in each):
        return None
    known = [np.ones(len(s), dtype=bool) if s.timed is None else s.timed for s in each]
    return np.concatenate(known)


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
