"""Whether the order of rows stands for time, or follows a joint, a rail or the load.

If a joint moves in one direction through the whole campaign, an error that depends on that joint
and a change in time cannot be separated. Only poses that are measured again later, or in an order
that no joint follows, separate them. Poses along a path, and those held out of one, come after it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaln

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.observations import Observations
from pa10cal.results.record import plain_number
from pa10cal.rules import ORDER


@dataclass(frozen=True)
class Driver:
    """A joint or the load, which the order of rows may follow."""

    joint: int  # number of the joint, from 1; 0 for the load
    slides: bool = False  # whether it is a prismatic joint

    def of(self, states: PoseStates) -> Array:
        """Return the joint's position or the load in each pose, (P,)."""
        return states.q_rad[:, self.joint - 1] if self.joint else states.load_N

    def __str__(self) -> str:
        if not self.joint:
            return "the load"
        return f"joint {self.joint}{' (sliding)' if self.slides else ''}"


@dataclass(frozen=True)
class Parting:
    """A value of a joint or load that separates the rows before a time from those after it."""

    driver: Driver  # the joint or the load
    at: float  # the value [rad, m or N]


def drivers(states: PoseStates, prismatic: Mask | None = None) -> tuple[Driver, ...]:
    """Return the joints that move, and the load if it changes."""
    if not len(states):
        return ()
    slides = np.zeros(states.n, dtype=bool) if prismatic is None else prismatic
    candidates = [*(Driver(k + 1, bool(slides[k])) for k in range(states.n)), Driver(0)]
    return tuple(
        driver
        for driver in candidates
        if np.ptp(driver.of(states)) > (ORDER.stood_still if driver.joint else 0.0)
    )


def goes_with(
    every: Observations, prismatic: Mask | None = None
) -> tuple[tuple[Driver, float], ...]:
    """Return the joints and loads that the order of rows follows, with their rank correlations.

    A correlation is relative to the largest of such values, which is below 1 where many are equal.
    Empty where the same places are measured again at other times under the same load: these
    separate time from everything else. Readings are single readings of one campaign.
    """
    states = every.states
    if len(every) < ORDER.least_rows or measured_again(every):
        return ()
    time = _ranks(states.time_s)
    followed = []
    for driver in drivers(states, prismatic):
        ranks = _ranks(driver.of(states))
        largest = _correlation(np.sort(time), np.sort(ranks))
        # Where hardly any value differs from the others, these have times of their own.
        correlation = _correlation(time, ranks) / max(largest, ORDER.of_two_halves)
        if abs(correlation) > ORDER.ordered:
            followed.append((driver, correlation))
    return tuple(followed)


def with_time_validity(
    every: Observations, prismatic: Mask, *, recorded: bool
) -> tuple[Observations, tuple[str, ...]]:
    """Mark all single readings as not timed if their rows give no time; also return the reason.

    Args:
        recorded: whether the file has times.

    Returns:
        The readings, and one clause that says why they are not timed; none where they are.
    """
    if recorded:
        calibration_poses = every.take(np.flatnonzero(every.kind == "grid"))
        followed = goes_with(calibration_poses, prismatic)
        if not followed:
            return every, ()
        named = " and ".join(f"{driver} (rank correlation {rho:.2f})" for driver, rho in followed)
        why = f"the order of the rows goes with {named}"
    else:
        why = "time was not recorded, rows give an order alone"
    states = replace(every.states, timed=np.zeros(len(every), dtype=bool))
    return every.with_states(states), (f"{why}: no step, drift or wander is sought",)


def with_places(every: Observations) -> Observations:
    """Give labels whose first readings have the same joint positions one common pose label."""
    _, first, label = np.unique(every.pose, return_index=True, return_inverse=True)
    q = every.states.q_rad[first]
    tree = cKDTree(q)
    near_count = tree.count_neighbors(tree, ORDER.one_place, p=np.inf)
    if near_count <= len(first):
        return every
    if near_count > ORDER.most_near * len(first):
        moves = np.abs(np.diff(q[np.argsort(every.states.time_s[first], kind="stable")], axis=0))
        if np.median(moves.max(axis=1)) <= ORDER.one_place:
            return every  # the robot stood still, and did not come back
    place = np.full(len(first), -1)
    for row in range(len(first)):
        if place[row] < 0:
            near = np.asarray(tree.query_ball_point(q[row], ORDER.one_place, p=np.inf))
            place[near[place[near] < 0]] = row
    return replace(every, pose=every.pose[first][place][label.ravel()])


def measured_again(every: Observations) -> bool:
    """Return whether repeats of the same place and load are spread over the whole campaign.

    Compares the variance of the time ranks within repeats with that of all readings. Campaigns of
    a group are kept apart, since each has its own clock and base.
    """
    states = every.states
    label = np.unique(with_places(every).pose, return_inverse=True)[1].ravel()
    same = np.column_stack([label, states.load_N, campaign_numbers(states)])
    group = np.unique(same, axis=0, return_inverse=True)[1].ravel()
    time = _ranks(states.time_s)
    mean_of_group = np.bincount(group, time) / np.bincount(group)
    variance_within = float(np.mean((time - mean_of_group[group]) ** 2))
    return variance_within > ORDER.again_share * float(np.var(time))


def campaign_numbers(states: PoseStates) -> Index:
    """Return the number of the campaign of each pose, (P,); 0 where there is one campaign only."""
    return np.zeros(len(states), np.intp) if states.campaign is None else states.campaign


def _ranks(values: Array) -> Array:
    """Return ranks (N,) from 1; equal values have the mean of their ranks."""
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[group.ravel()])


def slow_joints(states: PoseStates) -> Mask:
    """Return which joints move little from one pose to the next, (n,)."""
    q_rad = states.q_rad[np.lexsort((states.time_s, campaign_numbers(states)))]
    steps = np.abs(np.diff(q_rad, axis=0))
    # The mean: the median is zero for a rail that stands at one of two stations mostly.
    spread = np.mean(np.abs(q_rad - np.mean(q_rad, axis=0)), axis=0)
    small = np.median(steps, axis=0) < ORDER.small_moves * spread
    # A rail that goes to and fro at random stands still in half of the moves.
    return np.asarray(small & (np.mean(steps, axis=0) < spread))


def partings(states: PoseStates, time_s: float, prismatic: Mask | None = None) -> Iterator[Parting]:
    """Yield the values of joints and loads that separate rows in the same way as a time does.

    For each joint and load all rows are tried first, then only those near the time: a rail that
    goes out and comes back separates each stretch, but never the whole campaign. Where the rows
    near the time follow the order, the best value counts however well it separates.
    """
    order = np.argsort(states.time_s, kind="stable")
    middle = int(np.searchsorted(states.time_s[order], time_s))
    near = order[max(middle - ORDER.near_rows, 0) : middle + ORDER.near_rows]
    for driver in drivers(states, prismatic):
        value = driver.of(states)
        at = _parted_at(value[order], states.time_s[order] > time_s, ORDER.parted_share)
        if at is None:
            correlation = _correlation(_ranks(value[near]), _ranks(states.time_s[near]))
            ordered = len(near) >= ORDER.least_rows and abs(correlation) > ORDER.ordered
            least_share = 0.0 if ordered else ORDER.parted_share
            at = _parted_at(value[near], states.time_s[near] > time_s, least_share)
        if at is not None:
            yield Parting(driver, at)


def _parted_at(value: Array, after: Mask, least_share: float) -> float | None:
    """Return the value that best separates rows (R,) before a time from those after it.

    None where it puts less than `least_share` of the rows, averaged over both sides, on the right
    side, or where all rows are on one side of the time.
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
    # |F_after - F_before| of the distribution functions: (1 + it) / 2 is the share sorted rightly.
    difference = np.abs(below_after - below_before)[ends]
    best = int(np.argmax(difference))
    if (1.0 + difference[best]) / 2.0 < least_share:
        return None
    return float(0.5 * (sorted_value[ends[best]] + sorted_value[ends[best] + 1]))


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation coefficient of two lists of ranks; 0 where one is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else 0.0


def like_a_scan(poses: Observations) -> bool:
    """Return whether most joints move so slowly that time and place cannot be separated."""
    return float(slow_joints(poses.states).mean()) > ORDER.scan_share


def spread_over_time(poses: Observations, most: int) -> Index:
    """Return at most `most` row numbers in order of time, evenly spread."""
    order = np.argsort(poses.states.time_s, kind="stable")
    chosen = np.linspace(0, len(order) - 1, min(len(order), most))
    return np.asarray(order[chosen.round().astype(int)])


# Rows that lie together at the beginning or at the end of a campaign.

#: Seconds of a minute and of an hour (computing).
_MINUTE_S, _HOUR_S = 60.0, 3600.0


def at_one_end(states: PoseStates, chosen: Mask) -> str:
    """Return in words that rows lie together in the first or last part of a campaign, and why.

    By the probability that as many of so many rows, drawn at random, lie in a part as short
    (hypergeometric distribution), times the number of parts tried. Empty where chance may put them
    there, and where the rows tell no time or are of several campaigns.

    Args:
        states: of P poses.
        chosen: (P,) the rows, such as suspected outliers.
    """
    count, many = int(chosen.sum()), len(chosen)
    if count < 2 or not states.tells_time or states.campaign is not None:
        return ""
    time_s = np.sort(states.time_s)
    rank = np.flatnonzero(chosen[np.argsort(states.time_s, kind="stable")])
    ends = {"first": rank + 1, "last": many - rank[::-1]}  # number of poses up to each, by end
    inside = np.arange(1, count + 1)
    chance = {end: _by_chance(inside, upto, count, many) for end, upto in ends.items()}
    end = min(chance, key=lambda each: float(chance[each].min()))
    best = int(np.argmin(chance[end]))
    upto = int(ends[end][best])
    if 2 * count * chance[end][best] > ORDER.end_rate or upto > ORDER.end_share * many:
        return ""
    part_s = float(time_s[upto - 1] - time_s[0] if end == "first" else time_s[-1] - time_s[-upto])
    why = (
        "something had not yet settled, such as joints that warm up, or moved; warm the arm up "
        "before measuring, or leave these poses out"
        if end == "first"
        else "something changed there; measure these poses again, or leave them out"
    )
    return (
        f"{best + 1} of {count} are among the {end} {upto} of {many} poses, the {end} "
        f"{_duration(part_s)} of {_duration(float(np.ptp(time_s)), _HOUR_S)}: {why}"
    )


def _duration(time_s: float, hours_from_s: float = 2.0 * _HOUR_S) -> str:
    """Return a duration in minutes, or in hours from some duration on."""
    if time_s < hours_from_s:
        return f"{plain_number(time_s / _MINUTE_S, 2)} min"
    return f"{plain_number(time_s / _HOUR_S, 2)} h"


def _by_chance(inside: Index, upto: Index, count: int, many: int) -> Array:
    """Return the probability that as many or more of `count` rows are among the first ones, (R,).

    Args:
        inside: (R,) numbers of rows.
        upto: (R,) numbers of poses among which they are, of `many` in all.
    """
    drawn = np.arange(count + 1)
    ways = _log_ways(upto[:, None], drawn) + _log_ways(many - upto[:, None], count - drawn)
    share = np.exp(ways - _log_ways(np.array(many), np.array(count)))
    return np.asarray(np.sum(np.where(drawn >= inside[:, None], share, 0.0), axis=1))


def _log_ways(of: Index, taken: Index) -> Array:
    """Return the logarithm of the number of ways to take so many of so many; -inf for none."""
    possible = (taken >= 0) & (taken <= of)
    k = np.where(possible, taken, 0)
    ways = gammaln(of + 1.0) - gammaln(k + 1.0) - gammaln(of - k + 1.0)
    return np.where(possible, ways, -np.inf)


# Poses along a path, where each is known by its neighbours, and what may be held out of one.
#
# An error at every n-th pose held out shows only how well the model interpolates between measured
# poses. How well it predicts where nothing was measured needs whole stretches held out (block
# cross-validation: Roberts et al., Ecography 40, 2017).


def spread_of(q: Array) -> float:
    """Return the root mean square distance of joint positions (P, n) from their mean [rad, m]."""
    return float(np.sqrt(np.mean(np.sum((q - q.mean(axis=0)) ** 2, axis=1))))


def along_a_path(q: Array) -> bool:
    """Return whether joint positions (P, n) in order of time lie close together along a path."""
    moves = np.linalg.norm(np.diff(q, axis=0), axis=1)
    moves = moves[moves > ORDER.stood_still]
    return bool(len(moves)) and float(np.median(moves)) < ORDER.neighbours * spread_of(q)


def stretches_held_out(count: int, held: int) -> Index:
    """Return which `held` of `count` poses along a path are held out, rising.

    Most are held out in stretches of equal length, the last one at the end of the path. The others
    are single poses among those that stay: they show the error between measured poses.
    """
    single_count, held_out = round(ORDER.singly_share * held), np.zeros(count, dtype=bool)
    sections = np.array_split(np.arange(count), ORDER.stretches)
    stretches = np.array_split(np.arange(held - single_count), ORDER.stretches)
    for section, stretch in zip(sections, stretches, strict=True):
        held_out[section[len(section) - len(stretch) :]] = True
    stay = np.flatnonzero(~held_out)
    # Evenly spread, without the first and the last.
    single = np.linspace(0, len(stay) - 1, single_count + 2).round().astype(np.intp)[1:-1]
    held_out[stay[single]] = True
    return np.flatnonzero(held_out)


@dataclass(frozen=True, eq=False)
class HeldOutPlaces:
    """Which of P held-out poses lie near fitted poses, and which do not."""

    unseen: Mask | None = None  # (P,) in stretches without fitted poses; None if there is none
    between: Mask | None = None  # (P,) between fitted poses; None if there is none

    @classmethod
    def of(cls, held_out: Observations, fitted: Observations) -> HeldOutPlaces:
        """Return where averaged held-out poses lie; both masks None where poses are well apart."""
        out, fit = held_out.states, fitted.states
        return cls.of_positions((out.q_rad, out.time_s), (fit.q_rad, fit.time_s))

    @classmethod
    def of_positions(
        cls, held_out: tuple[Array, Array], fitted: tuple[Array, Array]
    ) -> HeldOutPlaces:
        """Return the same for joint positions (P, n) and times (P,) [s] of both sets of poses."""
        (q_out, time_out_s), (q_fitted, time_fitted_s) = held_out, fitted
        if not len(q_fitted) or not len(q_out):
            return cls()
        distance = cKDTree(q_fitted).query(q_out)[0]
        beside = np.asarray(distance < ORDER.neighbours * spread_of(q_fitted))
        in_time = np.argsort(np.concatenate([time_fitted_s, time_out_s]), kind="stable")
        path = along_a_path(np.concatenate([q_fitted, q_out])[in_time])
        if not path and np.mean(beside) < ORDER.beside_share:
            return cls()
        if np.mean(beside) >= 1.0 - ORDER.few_share:
            beside[:] = True
        unseen = ~beside
        return cls(unseen if unseen.any() else None, beside if beside.any() else None)

    def counted(self, trusted: Mask) -> Mask:
        """Return the poses (P,) that a reported error is of: the trusted ones, unseen if any.

        Where all unseen poses are suspected they count all the same. The model may be what is wrong
        there, and errors between fitted poses say nothing of it.
        """
        if self.unseen is None:
            return trusted
        rows = self.unseen & trusted
        return rows if rows.any() else self.unseen
