"""Directions in which joints arrive at poses, and the moves before them, by the order of poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import campaign_numbers, sorted_rows
from pa10cal.rules import ORDER

#: Poses whose frames are computed at once: they take kilobytes each (computing).
_BLOCK = 10_000

M = TypeVar("M", bound=Instrument)


def with_arrivals(every: Observations[M], arm: Arm | None = None) -> tuple[Observations[M], bool]:
    """Return a campaign with directions of arrival, and whether these were derived from the order.

    If the log has no direction of arrival at all, each joint is assumed to come straight from its
    position in the previous configuration, of whatever kind. A joint that stays keeps the direction
    of its last movement; the first configuration has none. `moved` holds the direction of the last
    move alone, 0 where the joint stayed; of readings repeated while the arm stood still, that of
    the move before them all. It is also set where logged directions equal those of the
    order, as in the table of a group. `move_share` is set wherever the order is known; the travel
    of the end, where a nominal arm is given too. If many configurations share a time, or rows
    without times are sorted as in a table, there is no order, and no direction is known. Logged
    directions of `reversed_joints` change their sign.
    """
    states = every.states
    previous = _moves_by_order(every) if len(every) else None
    if previous is not None:
        end_m = None if arm is None else end_travel(arm, states.q_rad, previous.share)
        states = replace(states, move_share=previous.share, move_end_m=end_m)
    if not states.arrival.any():
        if previous is None:
            return every, False
        states = replace(states, arrival=previous.arrival, moved=previous.moved)
        return every.with_states(states), True
    wrong = reversed_joints(every)
    if wrong.any():
        states = replace(states, arrival=np.where(wrong, -states.arrival, states.arrival))
    elif previous and states.moved is None and np.array_equal(previous.arrival, states.arrival):
        states = replace(states, moved=previous.moved)
    return every if states is every.states else every.with_states(states), False


def reversed_joints(every: Observations) -> Mask:
    """Return the joints whose logged direction of arrival has the wrong sign throughout, (n,).

    A joint counts if its logged direction nearly always contradicts the move from the previous
    configuration, while those of more joints nearly always agree with it.
    """
    logged, previous = every.states.arrival, _moves_by_order(every)
    none = np.zeros(logged.shape[1], dtype=bool)
    if previous is None or not logged.any():
        return none
    known = (logged != 0.0) & (previous.arrival != 0.0)
    known_count = known.sum(axis=0)
    agree_share = np.sum(known & (logged == previous.arrival), axis=0) / np.maximum(known_count, 1)
    judged = known_count >= ORDER.least_arrivals
    wrong = judged & (agree_share < 1.0 - ORDER.nearly_always)
    right = judged & (agree_share > ORDER.nearly_always)
    return wrong if right.sum() > wrong.sum() else none


@dataclass(frozen=True)
class _MovesByOrder:
    """Moves from the previous configuration to each of P configurations."""

    arrival: Array  # (P, n) direction of the last movement of each joint, -1, 0 or 1
    moved: Array  # (P, n) direction of the last move alone; 0 where the joint stayed
    share: Array  # (P, n) as `PoseStates.move_share`


def _moves_by_order(every: Observations) -> _MovesByOrder | None:
    """Return the moves in order of time, campaign by campaign; None where no order is known."""
    import pandas as pd  # late: few campaigns need it

    states = every.states
    if len(np.unique(states.time_s)) < ORDER.own_times_share * len(every):
        return None
    campaign = campaign_numbers(states)
    of_table = _of_tables(states, campaign)
    if of_table.all():
        return None
    in_time = np.lexsort((states.time_s, campaign))
    q_rad = np.where(of_table[:, None], np.nan, states.q_rad)[in_time]
    move = pd.DataFrame(q_rad).groupby(campaign[in_time]).diff().to_numpy()
    direction = pd.DataFrame(np.sign(move)).mask(np.abs(move) < ORDER.stood_still)
    arrival, moved, share = np.zeros((3, *states.arrival.shape))
    arrival[in_time] = direction.groupby(campaign[in_time]).ffill().fillna(0.0).to_numpy()
    last_move = pd.DataFrame(np.where(np.abs(move) < ORDER.stayed, 0.0, np.sign(move)))
    stood_still = (np.abs(move) < ORDER.stood_still).all(axis=1)
    last_move[stood_still] = np.nan
    moved[in_time] = last_move.groupby(campaign[in_time]).ffill().to_numpy()
    share[in_time] = move_shares(move)
    return _MovesByOrder(arrival, np.nan_to_num(moved), share)


def _of_tables(states: PoseStates, campaign: Index) -> Mask:
    """Return the poses of campaigns whose rows, without times, are sorted as in a table, (P,)."""
    found = np.zeros(len(states), dtype=bool)
    if states.timed is None:
        return found
    for number in np.unique(campaign[~states.timed]):
        own = np.flatnonzero(campaign == number)
        found[own] = sorted_rows(states.take(own)) is not None
    return found


def move_shares(move: Array) -> Array:
    """Return moves (P, n), each over that of the joint that moved furthest; 0 where not known."""
    known = np.nan_to_num(move)
    furthest = np.abs(known).max(axis=1, initial=0.0)
    return np.asarray(known / np.where(furthest > ORDER.stayed, furthest, np.inf)[:, None])


def end_travel(arm: Arm, q_rad: Array, share: Array) -> Array:
    """Return how far the end of a nominal arm moves at positions (P, n) along moves, (P,) [m].

    Moves are scaled so that the joint that moves furthest moves by one radian: `move_shares`.
    """
    chain, parts = Chain.of(arm), []
    for rows in np.array_split(np.arange(len(q_rad)), len(q_rad) // _BLOCK + 1):
        at = frames(chain, chain.coordinates(q_rad[rows]))
        axes, origins = at.T_base_joints[:, :, :3, 2], at.T_base_joints[:, :, :3, 3]
        by_turning = np.cross(axes, at.T_base_ee[:, :3, 3] - origins)
        by_joint = np.where(arm.prismatic[:, None, None], axes, by_turning)
        parts.append(np.linalg.norm(np.einsum("jpx,pj->px", by_joint, share[rows]), axis=1))
    return np.concatenate(parts)
