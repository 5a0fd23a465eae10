"""Whether effects of time can be separated from those of joints and loads, by the order of poses.

If a joint moves in one direction through the whole campaign, an error that depends on that joint
and a change in time cannot be separated. Only poses that are measured again later, or in an order
that no joint follows, separate them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.observations import Observations
from pa10cal.observe.paths import outside_ranges
from pa10cal.results.number_text import duration_text
from pa10cal.rules import ORDER


@dataclass(frozen=True)
class Covariate:
    """A joint or the load, which may change in the order of the poses."""

    joint: int | None  # number of the joint, from 1; None for the load
    slides: bool = False  # whether it is a prismatic joint

    def values(self, states: PoseStates) -> Array:
        """Return the joint's position [rad, m] or the load [N] in each pose, (P,)."""
        return states.load_N if self.joint is None else states.q_rad[:, self.joint - 1]

    def __str__(self) -> str:
        if self.joint is None:
            return "the load"
        return f"joint {self.joint}{' (sliding)' if self.slides else ''}"


@dataclass(frozen=True)
class Threshold:
    """A value of a covariate that separates the poses before a time from those after it."""

    covariate: Covariate
    value: float  # [rad, m or N]; inf where all values matter, not whether they are above one


def covariates(states: PoseStates, prismatic: Mask | None = None) -> tuple[Covariate, ...]:
    """Return the joints that move, and the load if it changes."""
    if not len(states):
        return ()
    slides = np.zeros(states.n, dtype=bool) if prismatic is None else prismatic
    candidates = [*(Covariate(k + 1, bool(slides[k])) for k in range(states.n)), Covariate(None)]
    return tuple(
        each
        for each in candidates
        if np.ptp(each.values(states)) > (0.0 if each.joint is None else ORDER.stood_still)
    )


def confounded_with_time(
    every: Observations, prismatic: Mask | None = None
) -> tuple[tuple[Covariate, float], ...]:
    """Return the covariates that the order of readings follows, with their rank correlations.

    A correlation is relative to the largest of such values, which is below 1 where many are equal.
    Empty where the same places are measured again at other times under the same load: these
    separate time from everything else. Readings are single readings of one campaign.
    """
    states = every.states
    if len(every) < ORDER.least_rows or measured_again(every):
        return ()
    time_rank = _ranks(states.time_s)
    followed = []
    for covariate in covariates(states, prismatic):
        rank = _ranks(covariate.values(states))
        largest = _correlation(np.sort(time_rank), np.sort(rank))
        # Where hardly any value differs from the others, these have times of their own.
        correlation = _correlation(time_rank, rank) / max(largest, ORDER.of_two_halves)
        if abs(correlation) > ORDER.ordered:
            followed.append((covariate, correlation))
    return tuple(followed)


def with_time_validity(
    every: Observations, prismatic: Mask, *, recorded: bool
) -> tuple[Observations, tuple[str, ...]]:
    """Mark all single readings as not timed if their order gives no time; also return the reason.

    Args:
        recorded: whether the file has times.

    Returns:
        The readings, and one clause that says why they are not timed; none where they are.
    """
    if recorded and len(every) > 1 and not np.ptp(every.states.time_s):
        why = "all rows have the same time"
    elif recorded:
        calibration_poses = every.take(np.flatnonzero(every.kind == "grid"))
        followed = confounded_with_time(calibration_poses, prismatic)
        if not followed:
            return every, ()
        named = " and ".join(f"{each} (rank correlation {rho:.2f})" for each, rho in followed)
        why = f"the order of the rows goes with {named}"
    else:
        why = "time was not recorded, rows give an order alone"
    states = replace(every.states, timed=np.zeros(len(every), dtype=bool))
    of_table = sorted_rows(states)
    no_order = "" if of_table is None else f"; {of_table}: no directions of arrival are derived"
    return every.with_states(states), (f"{why}: no step, drift or wander is sought{no_order}",)


@dataclass(frozen=True)
class SortedRows:
    """Rows in a run that some joint sorts, as in a table: none is the order of measurement."""

    joint: int  # number of the joint, from 1
    first: int  # number of the first row of the longest run, from 1
    last: int

    def __str__(self) -> str:
        return f"rows {self.first} to {self.last} are sorted by joint {self.joint}, as a table is"


def sorted_rows(states: PoseStates) -> SortedRows | None:
    """Return the longest run of rows, in order of time, that a joint sorts; None if none is long.

    In a run that counts, a joint rises or falls in every row while most others jump to and fro: an
    arm that is swept along one joint, or along a path, moves its others little, not at all, or on
    in the same direction from most rows to the next.
    """
    order = np.argsort(states.time_s, kind="stable")
    q_rad = states.q_rad[order]
    at = _stands(q_rad)
    if len(at) < ORDER.sorted_rows:
        return None
    q_rad = q_rad[at]
    best: SortedRows | None = None
    for joint in range(states.n):
        side = np.sign(np.diff(q_rad[:, joint]))
        for own in np.split(np.arange(len(side)), np.flatnonzero(np.diff(side)) + 1):
            rows = np.arange(own[0], own[-1] + 2)
            if not side[own[0]] or len(rows) < ORDER.sorted_rows:
                continue
            if _mostly_jump(np.delete(q_rad[rows], joint, axis=1)):
                last = int(at[rows[-1] + 1]) if rows[-1] + 1 < len(at) else len(order)
                found = SortedRows(joint + 1, int(at[rows[0]]) + 1, last)
                best = max(best or found, found, key=lambda each: each.last - each.first)
    return best


def with_place_labels(every: Observations) -> Observations:
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
    near_counts = tree.query_ball_point(q, ORDER.one_place, p=np.inf, return_length=True)
    place = np.where(near_counts == 1, np.arange(len(first)), -1)
    for row in np.flatnonzero(near_counts > 1):
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
    label = np.unique(with_place_labels(every).pose, return_inverse=True)[1].ravel()
    same = np.column_stack([label, states.load_N, campaign_numbers(states)])
    group = np.unique(same, axis=0, return_inverse=True)[1].ravel()
    time_rank = _ranks(states.time_s)
    mean_of_group = np.bincount(group, time_rank) / np.bincount(group)
    variance_within = float(np.mean((time_rank - mean_of_group[group]) ** 2))
    return variance_within > ORDER.again_share * float(np.var(time_rank))


def campaign_numbers(states: PoseStates) -> Index:
    """Return the number of the campaign of each pose, (P,); 0 where there is one campaign only."""
    return np.zeros(len(states), np.intp) if states.campaign is None else states.campaign


def _ranks(values: Array) -> Array:
    """Return ranks (N,) from 1; equal values have the mean of their ranks."""
    _, group, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[group.ravel()])


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation coefficient of two lists of ranks; 0 where one is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else 0.0


def slow_joints(states: PoseStates) -> Mask:
    """Return which joints move little from one pose to the next, (n,).

    Readings repeated while the arm stood still count once, unless it hardly moved in any row.
    """
    q_rad = states.q_rad[np.lexsort((states.time_s, campaign_numbers(states)))]
    at = _stands(q_rad)
    if len(at) >= ORDER.least_rows:
        q_rad = q_rad[at]
    steps = np.abs(np.diff(q_rad, axis=0))
    # The mean: the median is zero for a rail that stands at one of two stations mostly.
    spread = np.mean(np.abs(q_rad - np.mean(q_rad, axis=0)), axis=0)
    small = np.median(steps, axis=0) < ORDER.small_moves * spread
    # A rail that goes to and fro at random stands still in half of the moves.
    return np.asarray(small & (np.mean(steps, axis=0) < spread))


def _stands(q_rad: Array) -> Index:
    """Return the first row of each stand: of rows (P, n) in order of time that repeat, one."""
    moves = np.abs(np.diff(q_rad, axis=0)).max(axis=1) > ORDER.stood_still
    return np.concatenate([[0], 1 + np.flatnonzero(moves)])


def _mostly_jump(q_rad: Array) -> bool:
    """Return whether most joints jump to and fro from row to row of positions (P, n).

    Of rows drawn at random, a move and the next correlate by -1/2; along a path they are alike.
    """
    moves = np.diff(q_rad, axis=0)
    steps = np.median(np.abs(moves), axis=0)
    spread = np.mean(np.abs(q_rad - np.mean(q_rad, axis=0)), axis=0)
    to_and_fro = np.sum(moves[1:] * moves[:-1], axis=0) < 0.0
    jumps = (steps > ORDER.stood_still) & (steps >= ORDER.small_moves * spread) & to_and_fro
    return 2 * int(jumps.sum()) > len(jumps)


def like_a_scan(poses: Observations) -> bool:
    """Return whether most joints move so slowly that time and place cannot be separated."""
    return float(slow_joints(poses.states).mean()) > ORDER.scan_share


def may_show_changes(poses: Observations) -> bool:
    """Return whether poses of one campaign tell a change in time from one by the place.

    So they do even in the order of a scan, once they are measured again in the course of time.
    """
    if not poses.states.tells_time or poses.measured.campaigns:
        return False
    return not like_a_scan(poses) or measured_again(poses)


def spread_over_time(poses: Observations, most: int) -> Index:
    """Return at most `most` row numbers in order of time, evenly spread."""
    order = np.argsort(poses.states.time_s, kind="stable")
    chosen = np.linspace(0, len(order) - 1, min(len(order), most))
    return np.asarray(order[chosen.round().astype(int)])


# Values of a joint or load that separate the poses as a step in time does.


def step_thresholds(
    states: PoseStates, time_s: float, prismatic: Mask | None = None
) -> Iterator[Threshold]:
    """Yield the thresholds of covariates that separate poses in the same way as a time does.

    For each covariate all poses are tried first, then only those near the time: a rail that goes
    out and comes back separates each stretch, but never the whole campaign.
    """
    order = np.argsort(states.time_s, kind="stable")
    middle = int(np.searchsorted(states.time_s[order], time_s))
    near = order[max(middle - ORDER.near_rows, 0) : middle + ORDER.near_rows]
    after = states.time_s > time_s
    for covariate in covariates(states, prismatic):
        values = covariate.values(states)
        best = _best_threshold(values, after)
        if best is None or best.share < ORDER.parted_share:
            best = _best_threshold(values[near], after[near])
            if best is None:
                continue
            # Where the poses near the time follow the covariate, any threshold counts.
            correlation = _correlation(_ranks(values[near]), _ranks(states.time_s[near]))
            ordered = len(near) >= ORDER.least_rows and abs(correlation) > ORDER.ordered
            if not ordered and best.share < ORDER.parted_share:
                continue
        yield Threshold(covariate, best.value)


@dataclass(frozen=True)
class _Separation:
    """How well a threshold separates poses before a time from those after it."""

    value: float  # the threshold
    share: float  # of the poses on the right side of it, mean of those before and those after


def _best_threshold(values: Array, after: Mask) -> _Separation | None:
    """Return the threshold of values (R,) that best separates poses before a time from those after.

    None where all poses are on one side of the time, or all values are equal.
    """
    if not after.any() or after.all():
        return None
    order = np.argsort(values, kind="stable")
    sorted_values, later = values[order], after[order]
    ends = np.flatnonzero(np.diff(sorted_values) > 0.0)
    if not len(ends):
        return None
    # |F_after - F_before| of the distribution functions: (1 + it) / 2 is the share sorted rightly.
    below_after = np.cumsum(later) / after.sum()
    below_before = np.cumsum(~later) / (~after).sum()
    difference = np.abs(below_after - below_before)[ends]
    best = int(np.argmax(difference))
    middle = 0.5 * (sorted_values[ends[best]] + sorted_values[ends[best] + 1])
    return _Separation(float(middle), float((1.0 + difference[best]) / 2.0))


# Poses that lie together at the beginning or at the end of a campaign.


def at_one_end(states: PoseStates, chosen: Mask) -> str:
    """Return in words that poses lie together in the first or last part of a campaign, and why.

    By the probability that as many of so many poses, drawn at random, lie in a part as short
    (hypergeometric distribution), times the number of parts tried. Empty where chance may put them
    there, and where the rows give no time or are of several campaigns.

    Args:
        states: of P poses.
        chosen: (P,) which poses, such as suspected outliers.
    """
    chosen_count, count = int(chosen.sum()), len(chosen)
    if chosen_count < 2 or not states.tells_time or states.campaign is not None:
        return ""
    from scipy.stats import hypergeom  # late: half a second, for few campaigns

    order = np.argsort(states.time_s, kind="stable")
    rank = np.flatnonzero(chosen[order])
    inside = np.arange(1, chosen_count + 1)
    lengths = {"first": rank + 1, "last": count - rank[::-1]}  # parts that hold `inside` of them
    chance = {
        end: np.asarray(hypergeom.sf(inside - 1, count, chosen_count, length))
        for end, length in lengths.items()
    }
    end = min(chance, key=lambda each: float(chance[each].min()))
    best = int(np.argmin(chance[end]))
    length = int(lengths[end][best])
    if 2 * chosen_count * chance[end][best] > ORDER.end_rate or length > ORDER.end_share * count:
        return ""
    part, others = order[:length], order[length:]
    if end == "last":
        part, others = order[-length:], order[:-length]
    apart = outside_ranges(states.q_rad[part[chosen[part]]], states.q_rad[others])
    if 2 * np.count_nonzero(apart) > len(apart):
        why = (
            "most of these are at joint positions outside those of all others, so the model may "
            "lack something that only they show; keep them, and measure more there"
        )
    elif end == "first":
        why = (
            "something had not yet settled, such as joints that warm up, or moved; warm the arm up "
            "before measuring, or leave these poses out"
        )
    else:
        why = "something changed there; measure these poses again, or leave them out"
    durations = [
        duration_text(float(np.ptp(each))) for each in (states.time_s[part], states.time_s)
    ]
    return (
        f"{best + 1} of {chosen_count} are among the {end} {length} of {count} poses, the {end} "
        f"{durations[0]} of {durations[1]}: {why}"
    )
