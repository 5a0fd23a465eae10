"""Directions of arrival from the order of poses, where no approach was logged, or a wrong one."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations

M = TypeVar("M", bound=Instrument)

#: A joint that turned less [rad, or m of a prismatic joint] has not moved.
_STOOD_STILL = 1e-4
#: One that turned less [rad, m] has not left the place where its controller had stopped it.
_STAYED = 2e-3
#: Part of the configurations that must have a time of their own for times to give an order.
_OWN_TIMES = 0.95
#: Directions that must be known to say that all of a joint are reversed, and how many must be.
_LEAST_ARRIVALS = 30
_NEARLY_ALWAYS = 0.85


def with_arrivals(every: Observations[M]) -> tuple[Observations[M], bool]:
    """Return a campaign with directions of arrival, and whether they are those of the order.

    Where no joint of any configuration has one, each joint is taken to come straight from where it
    stood in the configuration measured before, of whatever kind; one that stays keeps the direction
    of its last movement, and the first configuration has none; which joints moved at all is told
    apart (`moved`), also where directions are those of the order already, as in a table of a group.
    Times that many configurations share give no order: then no direction is known. Logged
    directions of joints that are reversed (`reversed_joints`) are put right.

    Args:
        every: single readings of all kinds.
    """
    states = every.states
    if not len(every):
        return every, False
    if states.arrival.any():
        wrong = reversed_joints(every)
        if not wrong.any():
            by_order = None if states.moved is not None else _by_order(every)
            if by_order is None or not np.array_equal(by_order[0], states.arrival):
                return every, False
            return every.with_states(replace(states, moved=by_order[1])), False
        arrival = np.where(wrong, -states.arrival, states.arrival)
        return every.with_states(replace(states, arrival=arrival)), False
    ordered = _by_order(every)
    if ordered is None:
        return every, False
    arrival, moved = ordered
    return every.with_states(replace(states, arrival=arrival, moved=moved)), True


def reversed_joints(every: Observations) -> NDArray[np.bool_]:
    """Return the joints whose logged direction of arrival is reversed in the whole log, (n,).

    Those that are said to arrive from the other side than where they stood before, nearly always,
    where the other joints nearly always arrive from there.

    Args:
        every: single readings of all kinds.
    """
    logged, by_order = every.states.arrival, _by_order(every)
    none = np.zeros(logged.shape[1], dtype=bool)
    if by_order is None or not logged.any():
        return none
    ordered, _ = by_order
    known = (logged != 0.0) & (ordered != 0.0)
    times = known.sum(axis=0)
    agree = np.sum(known & (logged == ordered), axis=0) / np.maximum(times, 1)
    judged = times >= _LEAST_ARRIVALS
    wrong = judged & (agree < 1.0 - _NEARLY_ALWAYS)
    right = judged & (agree > _NEARLY_ALWAYS)
    return wrong if right.sum() > wrong.sum() else none


def _by_order(every: Observations) -> tuple[Array, Array] | None:
    """Return directions (P, n) from where joints stood before, and those of joints that moved.

    None where no order is known.
    """
    states = every.states
    if len(np.unique(states.time_s)) < _OWN_TIMES * len(every):
        return None
    campaign = np.zeros(len(every), int) if states.campaign is None else states.campaign
    in_time = np.lexsort((states.time_s, campaign))
    of_campaign = pd.DataFrame(states.q_rad[in_time]).groupby(campaign[in_time])
    moved = of_campaign.diff().to_numpy()
    last = pd.DataFrame(np.sign(moved)).mask(np.abs(moved) < _STOOD_STILL)
    direction = last.groupby(campaign[in_time]).ffill().fillna(0.0)
    arrival, since_before = np.zeros((2, *states.arrival.shape))
    arrival[in_time] = direction.to_numpy()
    since_before[in_time] = np.where(np.abs(moved) < _STAYED, 0.0, np.sign(moved))
    return arrival, np.nan_to_num(since_before)
