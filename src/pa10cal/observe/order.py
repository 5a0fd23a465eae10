"""What the order of rows goes with: rows are not time where they follow a joint, a rail or a load.

What moved between two rows, and an error that goes with a joint, look the same where that joint
moved between the same two rows, and never back. Only poses that are measured again later, or that
come in an order of their own, tell one from the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import rankdata

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.observe.observations import Observations

#: Rank correlation with time from which on the order goes with a joint or a load.
ORDERED = 0.9
#: Part of the spread in time that readings of the same pose and load must have between them for
#: these to tell time, whatever the order goes with.
_AGAIN = 0.01
#: Moves from one pose to the next, in those between any two, that are small: time then goes with
#: the joint's angle, in pieces.
_SMALL_MOVES = 0.3
#: Part of the rows on either side that a place of a joint or load must sort rightly, in the mean of
#: both sides, to part them as a time does; and rows beside that time that are looked at alone.
_PARTS = 0.95
_NEAR = 15
#: Rows below which no order is one.
_LEAST_ROWS = 8


@dataclass(frozen=True)
class Driver:
    """A joint or the load: what the order of rows may go with."""

    joint: int  # its number, from 1; 0 of the load
    slides: bool = False  # whether it is a joint that slides

    def of(self, states: PoseStates) -> Array:
        """Return its values, (P,)."""
        return states.q_rad[:, self.joint - 1] if self.joint else states.load_N

    def __str__(self) -> str:
        if not self.joint:
            return "the load"
        return f"joint {self.joint}{' (a rail)' if self.slides else ''}"


@dataclass(frozen=True)
class Parting:
    """A place of a joint or load that parts the rows before a time from those after it."""

    driver: Driver  # the joint or the load
    at: float  # the place [rad, m or N]


def drivers(states: PoseStates, prismatic: Mask | None = None) -> tuple[Driver, ...]:
    """Return the joints that move and, where there are several, the load."""
    slides = np.zeros(states.n, dtype=bool) if prismatic is None else prismatic
    every = [*(Driver(k + 1, bool(slides[k])) for k in range(states.n)), Driver(0)]
    return tuple(each for each in every if len(states) and np.ptp(each.of(states)) > 0.0)


def goes_with(
    every: Observations, prismatic: Mask | None = None
) -> tuple[tuple[Driver, float], ...]:
    """Return the joints and loads that the order of rows goes with, and their rank correlations.

    None where poses are measured again at other times, under the same load: those tell time.

    Args:
        every: single readings, of one campaign.
        prismatic: (n,) which joints slide.
    """
    states = every.states
    if len(every) < _LEAST_ROWS or measured_again(every):
        return ()
    time = rankdata(states.time_s)
    found = []
    for driver in drivers(states, prismatic):
        correlation = _correlation(time, rankdata(driver.of(states)))
        if abs(correlation) > ORDERED:
            found.append((driver, correlation))
    return tuple(found)


def with_what_tells_time(
    every: Observations, prismatic: Mask, *, recorded: bool
) -> tuple[Observations, tuple[str, ...]]:
    """Mark readings whose rows give an order and no time, and say why, one clause.

    Args:
        every: single readings of a campaign, of all kinds.
        prismatic: (n,) which joints slide.
        recorded: whether their times were recorded.
    """
    if recorded:
        fitted = every.take(np.flatnonzero(every.kind == "grid"))
        along = goes_with(fitted, prismatic)
        if not along:
            return every, ()
        named = " and ".join(f"{driver} (rank correlation {rho:.2f})" for driver, rho in along)
        why = f"the order of the rows goes with {named}"
    else:
        why = "time was not recorded, rows give an order alone"
    states = replace(every.states, timed=np.zeros(len(every), dtype=bool))
    return every.with_states(states), (f"{why}: no step, drift or wander is sought",)


def measured_again(every: Observations) -> bool:
    """Return whether readings of the same pose and load are spread over time: they tell it."""
    load = np.unique(every.states.load_N, return_inverse=True)[1].ravel()
    pose = np.unique(every.pose, return_inverse=True)[1].ravel()
    group = np.unique(pose * (load.max() + 1) + load, return_inverse=True)[1].ravel()
    time = rankdata(every.states.time_s)
    middle = np.bincount(group, time) / np.bincount(group)
    within = float(np.mean((time - middle[group]) ** 2))
    return within > _AGAIN * float(np.var(time))


def slow_joints(states: PoseStates) -> Mask:
    """Return (n,) which joints move little from one pose to the next."""
    q_rad = states.q_rad[np.argsort(states.time_s, kind="stable")]
    steps = np.median(np.abs(np.diff(q_rad, axis=0)), axis=0)
    spread = np.median(np.abs(q_rad - np.median(q_rad, axis=0)), axis=0)
    return np.asarray(steps < _SMALL_MOVES * spread)


def partings(states: PoseStates, time_s: float, prismatic: Mask | None = None) -> Iterator[Parting]:
    """Yield the places of joints and loads that part rows as a time does.

    All rows are looked at, and then those near that time alone, where it is enough that these go
    with the order: a rail that goes out and comes back parts each stretch, and never the whole.

    Args:
        states: of the readings.
        time_s: the time.
        prismatic: (n,) which joints slide.
    """
    order = np.argsort(states.time_s, kind="stable")
    middle = int(np.searchsorted(states.time_s[order], time_s))
    near = order[max(middle - _NEAR, 0) : middle + _NEAR]
    for driver in drivers(states, prismatic):
        value = driver.of(states)
        rank = _correlation(rankdata(value[near]), rankdata(states.time_s[near]))
        ordered = len(near) >= _LEAST_ROWS and abs(rank) > ORDERED
        for rows, least in ((order, _PARTS), (near, 0.0 if ordered else _PARTS)):
            at = _parted_at(value[rows], states.time_s[rows] > time_s, least)
            if at is not None:
                yield Parting(driver, at)
                break


def _parted_at(value: Array, after: Mask, least: float) -> float | None:
    """Return the place that best parts rows into those before and after a time; None of none.

    Args:
        value: (R,) where the joint or the load is.
        after: (R,) which rows are after it.
        least: part that must be sorted rightly.
    """
    if not after.any() or after.all():
        return None
    order = np.argsort(value, kind="stable")
    sorted_value, later = value[order], after[order]
    below_after = np.cumsum(later) / after.sum()
    below_before = np.cumsum(~later) / (~after).sum()
    ends = np.flatnonzero(np.diff(sorted_value) > 0.0)
    if not len(ends):
        return None
    apart = np.abs(below_after - below_before)[ends]  # twice the mean part sorted rightly, less one
    best = int(np.argmax(apart))
    if 0.5 * (1.0 + apart[best]) < least:
        return None
    return float(0.5 * (sorted_value[ends[best]] + sorted_value[ends[best] + 1]))


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two lists of ranks; 0 where one of them is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else 0.0
