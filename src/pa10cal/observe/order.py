"""What the order of rows goes with, and the directions of arrival that it gives.

Rows are not time where they follow a joint, a rail or a load.
What moved between two rows, and an error that goes with a joint, look the same where that joint
moved between the same two rows, and never back. Only poses that are measured again later, or that
come in an order of their own, tell one from the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.rules import ORDER

#: Poses whose frames are worked out at once: they take kilobytes each (computing).
_MOST_AT_ONCE = 10_000


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

    Empty where places are measured again at other times, under the same load: those show time.
    Readings are single ones of one campaign.
    """
    states = every.states
    if len(every) < ORDER.least_rows or measured_again(every):
        return ()
    time = _ranks(states.time_s)
    found = []
    for driver in drivers(states, prismatic):
        correlation = _correlation(time, _ranks(driver.of(states)))
        if abs(correlation) > ORDER.ordered:
            found.append((driver, correlation))
    return tuple(found)


def with_time_validity(
    every: Observations, prismatic: Mask, *, recorded: bool
) -> tuple[Observations, tuple[str, ...]]:
    """Mark single readings whose rows give an order and no time, and say why, one clause.

    Args:
        recorded: whether the file has times.
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


def with_places(every: Observations) -> Observations:
    """Return readings, those that were taken at one place under one label, whatever theirs were."""
    _, first, pose = np.unique(every.pose, return_index=True, return_inverse=True)
    places = cKDTree(every.states.q_rad[first])
    near = places.count_neighbors(places, ORDER.one_place, p=np.inf)
    if near <= len(first) or near > ORDER.most_pairs * len(first):
        return every
    pairs = places.query_pairs(ORDER.one_place, p=np.inf, output_type="ndarray")
    place = np.arange(len(first))
    np.minimum.at(place, pairs.max(axis=1), pairs.min(axis=1))
    return replace(every, pose=every.pose[first][place][pose.ravel()])


def measured_again(every: Observations) -> bool:
    """Return whether readings of the same place and load are spread over time: they tell it.

    Of a group each campaign has its own clock and base: only within one do they tell anything.
    """
    states = every.states
    pose = np.unique(with_places(every).pose, return_inverse=True)[1].ravel()
    same = np.column_stack([pose, states.load_N, _campaign(states)])
    group = np.unique(same, axis=0, return_inverse=True)[1].ravel()
    time = _ranks(every.states.time_s)
    middle = np.bincount(group, time) / np.bincount(group)
    within = float(np.mean((time - middle[group]) ** 2))
    return within > ORDER.again_share * float(np.var(time))


def _campaign(states: PoseStates) -> Index:
    """Return the number (N,) of the campaign of a group that each is of."""
    return np.zeros(len(states), np.intp) if states.campaign is None else states.campaign


def _ranks(values: Array) -> Array:
    """Return ranks (N,) from 1, of equal values their mean."""
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[group.ravel()])


def slow_joints(states: PoseStates) -> Mask:
    """Return (n,) which joints move little from one pose to the next."""
    q_rad = states.q_rad[np.lexsort((states.time_s, _campaign(states)))]
    steps = np.median(np.abs(np.diff(q_rad, axis=0)), axis=0)
    spread = np.median(np.abs(q_rad - np.median(q_rad, axis=0)), axis=0)
    return np.asarray(steps < ORDER.small_moves * spread)


def partings(states: PoseStates, time_s: float, prismatic: Mask | None = None) -> Iterator[Parting]:
    """Yield the places of joints and loads that part rows as a time does.

    All rows are looked at, and then those near that time alone, where it is enough that these go
    with the order: a rail that goes out and comes back parts each stretch, and never the whole.
    """
    order = np.argsort(states.time_s, kind="stable")
    middle = int(np.searchsorted(states.time_s[order], time_s))
    near = order[max(middle - ORDER.near_rows, 0) : middle + ORDER.near_rows]
    for driver in drivers(states, prismatic):
        value = driver.of(states)
        rank = _correlation(_ranks(value[near]), _ranks(states.time_s[near]))
        ordered = len(near) >= ORDER.least_rows and abs(rank) > ORDER.ordered
        for rows, least in (
            (order, ORDER.parted_share),
            (near, 0.0 if ordered else ORDER.parted_share),
        ):
            at = _parted_at(value[rows], states.time_s[rows] > time_s, least)
            if at is not None:
                yield Parting(driver, at)
                break


def _parted_at(value: Array, after: Mask, least: float) -> float | None:
    """Return the value that best parts rows (R,) into those before and after a time, if any."""
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
    if (1.0 + apart[best]) / 2.0 < least:
        return None
    return float(0.5 * (sorted_value[ends[best]] + sorted_value[ends[best] + 1]))


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two lists of ranks; 0 where one of them is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else 0.0


# Directions of arrival from the order of poses, where no approach was logged, or a wrong one.

M = TypeVar("M", bound=Instrument)


def with_arrivals(every: Observations[M], arm: Arm | None = None) -> tuple[Observations[M], bool]:
    """Return a campaign with directions of arrival, and whether they are those of the order.

    Where no joint of any configuration has one, each joint is taken to come straight from where it
    stood in the configuration measured before, of whatever kind; one that stays keeps the direction
    of its last movement, and the first configuration has none. `moved` has the direction of the
    last move alone, 0 where the joint stayed, also where the directions logged are those of the
    order, as in a table of a group. `move_share` is known wherever the order is, and of a nominal
    arm how far its end went.
    Times that many configurations share give no order: then no direction is known. Logged
    directions of joints that are reversed (`reversed_joints`) are put right.
    """
    states = every.states
    by_order = _by_order(every) if len(every) else None
    if by_order is not None:
        share = by_order[2]
        end_m = None if arm is None else end_travel(arm, states.q_rad, share)
        states = replace(states, move_share=share, move_end_m=end_m)
    if not states.arrival.any():
        if by_order is None:
            return every, False
        arrival, moved, _ = by_order
        return every.with_states(replace(states, arrival=arrival, moved=moved)), True
    wrong = reversed_joints(every)
    if wrong.any():
        states = replace(states, arrival=np.where(wrong, -states.arrival, states.arrival))
    elif by_order and states.moved is None and np.array_equal(by_order[0], states.arrival):
        states = replace(states, moved=by_order[1])
    return every if states is every.states else every.with_states(states), False


def reversed_joints(every: Observations) -> NDArray[np.bool_]:
    """Return the joints whose logged direction of arrival is reversed in the whole log, (n,).

    Those that are said to arrive from the other side than where they stood before, nearly always,
    where the other joints nearly always arrive from there.
    """
    logged, by_order = every.states.arrival, _by_order(every)
    none = np.zeros(logged.shape[1], dtype=bool)
    if by_order is None or not logged.any():
        return none
    ordered, _, _ = by_order
    known = (logged != 0.0) & (ordered != 0.0)
    times = known.sum(axis=0)
    agree = np.sum(known & (logged == ordered), axis=0) / np.maximum(times, 1)
    judged = times >= ORDER.least_arrivals
    wrong = judged & (agree < 1.0 - ORDER.nearly_always)
    right = judged & (agree > ORDER.nearly_always)
    return wrong if right.sum() > wrong.sum() else none


def _by_order(every: Observations) -> tuple[Array, Array, Array] | None:
    """Return directions (P, n) from where joints stood before, and those of joints that moved.

    Then the moves, see `PoseStates.move_share`. None where no order is known.
    """
    import pandas as pd  # late: few campaigns need it

    states = every.states
    if len(np.unique(states.time_s)) < ORDER.own_times_share * len(every):
        return None
    campaign = _campaign(states)
    in_time = np.lexsort((states.time_s, campaign))
    of_campaign = pd.DataFrame(states.q_rad[in_time]).groupby(campaign[in_time])
    moved = of_campaign.diff().to_numpy()
    last = pd.DataFrame(np.sign(moved)).mask(np.abs(moved) < ORDER.stood_still)
    direction = last.groupby(campaign[in_time]).ffill().fillna(0.0)
    arrival, move_from_previous, share = np.zeros((3, *states.arrival.shape))
    arrival[in_time] = direction.to_numpy()
    move_from_previous[in_time] = np.where(np.abs(moved) < ORDER.stayed, 0.0, np.sign(moved))
    share[in_time] = move_shares(moved)
    return arrival, np.nan_to_num(move_from_previous), share


def move_shares(moved: Array) -> Array:
    """Return moves (P, n) over that of the joint that went furthest; 0 where none is known."""
    known = np.nan_to_num(moved)
    furthest = np.abs(known).max(axis=1, initial=0.0)
    return np.asarray(known / np.where(furthest > ORDER.stayed, furthest, np.inf)[:, None])


def end_travel(arm: Arm, q_rad: Array, share: Array) -> Array:
    """Return how far moves (P, n) take the end of a nominal arm from poses (P, n), (P,) [m]."""
    chain, parts = Chain.of(arm), []
    for rows in np.array_split(np.arange(len(q_rad)), len(q_rad) // _MOST_AT_ONCE + 1):
        at = frames(chain, chain.coordinates(q_rad[rows]))
        axes, origins = at.T_base_joints[:, :, :3, 2], at.T_base_joints[:, :, :3, 3]
        turning = np.cross(axes, at.T_base_ee[:, :3, 3] - origins)
        by_joint = np.where(arm.prismatic[:, None, None], axes, turning)
        parts.append(np.linalg.norm(np.einsum("jpx,pj->px", by_joint, share[rows]), axis=1))
    return np.concatenate(parts)


def like_a_scan(poses: Observations) -> bool:
    """Return whether poses follow each other so closely that time and place go together."""
    return float(slow_joints(poses.states).mean()) > ORDER.scan_share


def spread_over_time(poses: Observations, most: int) -> Index:
    """Return readings in order of time; of more than `most` some, spread evenly."""
    order = np.argsort(poses.states.time_s, kind="stable")
    part = np.linspace(0, len(order) - 1, min(len(order), most))
    return np.asarray(order[part.round().astype(int)])


# Rows along a path: poses that follow each other so closely that each is known by its neighbours.
#
# Where every n-th of them is held out, an error there says what happens between measured places.
# How well poses are predicted where nothing was measured, only whole stretches show that are held
# out (block cross-validation: Roberts et al., Ecography 40, 2017). A scan, above, follows places
# without being dense.


def spread_of(q: Array) -> float:
    """Return the root mean square distance of joint positions (P, n) from their mean [rad, m]."""
    return float(np.sqrt(np.mean(np.sum((q - q.mean(axis=0)) ** 2, axis=1))))


def along_a_path(q: Array) -> bool:
    """Return whether joint positions (P, n), in order of time, follow each other along a path."""
    moves = np.linalg.norm(np.diff(q, axis=0), axis=1)
    moves = moves[moves > ORDER.stood_still]
    return bool(len(moves)) and float(np.median(moves)) < ORDER.neighbours * spread_of(q)


def stretches_held_out(count: int, held: int) -> Index:
    """Return which of so many poses along a path are held out, so many of them.

    Most go in stretches of equal length, the last one at the end of the path. Others go singly, out
    of what stays: they show the error between measured places.
    """
    singly, away = round(ORDER.singly_share * held), np.zeros(count, dtype=bool)
    parts = np.array_split(np.arange(count), ORDER.stretches)
    for part, out in zip(
        parts, np.array_split(np.arange(held - singly), ORDER.stretches), strict=True
    ):
        away[part[len(part) - len(out) :]] = True
    rest = np.flatnonzero(~away)
    away[rest[np.linspace(0, len(rest) - 1, singly + 2).round().astype(np.intp)[1:-1]]] = True
    return np.flatnonzero(away)


@dataclass(frozen=True, eq=False)
class HeldOutPlaces:
    """Which of P held-out poses lie where nothing was measured, and which beside fitted ones."""

    unseen: Mask | None = None  # (P,) at unseen stretches; None where none does
    between: Mask | None = None  # (P,) between measured places; None where none does

    @classmethod
    def of(cls, held_out: Observations, fitted: Observations) -> HeldOutPlaces:
        """Return where held-out poses lie, both averaged; neither where poses are well apart."""
        away, near = held_out.states, fitted.states
        return cls.of_positions((away.q_rad, away.time_s), (near.q_rad, near.time_s))

    @classmethod
    def of_positions(
        cls, held_out: tuple[Array, Array], fitted: tuple[Array, Array]
    ) -> HeldOutPlaces:
        """Return the same of joint positions (P, n), each with the times of its poses (P,) [s]."""
        q, away = fitted[0], held_out[0]
        if not len(q) or not len(away):
            return cls()
        beside = np.asarray(cKDTree(q).query(away)[0] < ORDER.neighbours * spread_of(q))
        time_s = np.concatenate([fitted[1], held_out[1]])
        path = along_a_path(np.concatenate([q, away])[np.argsort(time_s, kind="stable")])
        if not path and np.mean(beside) < ORDER.beside_share:
            return cls()
        if np.mean(beside) >= 1.0 - ORDER.few_share:
            beside[:] = True
        return cls(*(rows if rows.any() else None for rows in (~beside, beside)))

    def counted(self, trusted: Mask) -> Mask:
        """Return the poses (P,) of a headline: those trusted (P,), at unseen stretches if any."""
        if self.unseen is None:
            return trusted
        rows = self.unseen & trusted
        return rows if rows.any() else self.unseen
