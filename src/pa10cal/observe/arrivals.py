"""Directions of arrival from the order of poses, where no approach was logged."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
import pandas as pd

from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations

M = TypeVar("M", bound=Instrument)

#: A joint that turned less [rad, or m of a prismatic joint] has not moved.
_STOOD_STILL = 1e-4
#: Part of the configurations that must have a time of their own for times to give an order.
_OWN_TIMES = 0.95


def with_arrivals(every: Observations[M]) -> tuple[Observations[M], bool]:
    """Return a campaign with directions of arrival, and whether they are those of the order.

    Where no joint of any configuration has one, each joint is taken to come straight from where it
    stood in the configuration measured before, of whatever kind; one that stays keeps the direction
    of its last movement, and the first configuration has none. Times that many configurations share
    give no order: then no direction is known.

    Args:
        every: single readings of all kinds.
    """
    states = every.states
    if not len(every) or states.arrival.any():
        return every, False
    if len(np.unique(states.time_s)) < _OWN_TIMES * len(every):
        return every, False
    in_time = np.argsort(states.time_s, kind="stable")
    moved = np.diff(states.q_rad[in_time], axis=0, prepend=np.nan)
    direction = pd.DataFrame(np.sign(moved)).mask(np.abs(moved) < _STOOD_STILL).ffill().fillna(0.0)
    arrival = np.empty_like(states.arrival)
    arrival[in_time] = direction.to_numpy()
    return every.with_states(replace(states, arrival=arrival)), True
