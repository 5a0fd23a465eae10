"""Motion of the instrument or the base in the course of time, found by evidence.

Readings of one pose at different times differ by noise and by what moved in between, whatever the
model of the arm lacks. All single readings are compared: Gaussian parameters are integrated out,
among them the model's own, every effect of the vocabulary, and an error that the readings of a
pose share. The time of a jump is scanned. Where the data prefer neither jump nor walk, nothing of
the search changes.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from itertools import product

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery import linear
from pa10cal.discovery.noise import same_circumstances
from pa10cal.discovery.other_numbers import none_and_spaced
from pa10cal.discovery.preparation import by_pose_and_time
from pa10cal.discovery.rules import MOTION
from pa10cal.discovery.wander import (
    NO_MOTION,
    Jump,
    TimeFindings,
    Wander,
    motions_along,
    sizes_of_six,
)
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import (
    Parting,
    drivers,
    like_a_scan,
    measured_again,
    partings,
    slow_joints,
    spread_over_time,
    with_places,
)
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map

#: Root mean square of the walk, and standard deviation of a jump, that are tried [m].
_WALKS_M = np.geomspace(*MOTION.walks_m)
#: Variances of the error that readings of a pose share, in those of one reading.
_SHARED = tuple(none_and_spaced(*MOTION.pose_variances).tolist())


def _found(rows: _Rows, *, walks: bool) -> TimeFindings:
    """Find how the base moves in the course of time; jumps alone, where no walk is sought."""
    poses = rows.poses
    needed_jump = float(
        np.log(len(poses) * len(MOTION.jumps_m) * len(MOTION.turns_rad_per_m) / MOTION.false_rate)
    )
    needed_walk = float(np.log(len(_WALKS_M) * len(MOTION.turns_rad_per_m) / MOTION.false_rate))
    found = rows.in_pauses(needed_jump)
    best, paused = rows.about(found)[0], found.jumps
    while not paused and len(found.jumps) < MOTION.most_jumps:
        value, more = rows.best_jump(found)
        beyond = value - best - needed_jump
        if walks and not found.walk_m:
            of_walk, with_walk = rows.best_walk(found)
            if of_walk - best - needed_walk >= beyond:
                value, more, beyond = of_walk, with_walk, of_walk - best - needed_walk
        if beyond <= 0.0:
            break
        best, found = value, more
    for jump in found.jumps[len(paused) :] if walks else ():  # it may have stood for a walk
        less = replace(found, jumps=tuple(other for other in found.jumps if other != jump))
        value, less = rows.best_walk(less)
        if best - value < needed_jump - needed_walk:
            best, found = value, less
    static = rows.without_time()
    has_drift = rows.about(found)[0] - static.about(found)[0] > MOTION.drift_nats
    if not found.jumps and not found.walk_m:
        return TimeFindings(None, has_drift)
    # Where no effect of time shows, what goes with time is that of the courses.
    amounts = (rows if has_drift else static).about(found)[1].mean
    found = replace(found, amounts=amounts)
    walk = replace(found, jumps=(), amounts=amounts[6 * len(found.jumps) :])
    all_mm, walk_mm = (
        linear.rms(linear.error_mm(poses.measured, each.shift(rows.at, poses)))
        for each in (found, walk)
    )
    cov = np.asarray(np.linalg.inv(np.swapaxes(rows.whitener, 1, 2) @ rows.whitener))
    position = np.trace(linear.position_noise(poses.measured, cov), axis1=1, axis2=2)
    noise_mm = 1e3 * float(np.sqrt(np.median(position))) * rows.about(found)[2]
    if all_mm < MOTION.least_noise_ratio * noise_mm:
        return TimeFindings(None, has_drift)
    return TimeFindings(replace(found, rms_mm=(all_mm, walk_mm)), has_drift)


class _Rows:
    """Whitened rows of single readings, and the evidence of motions in time."""

    def __init__(self, at: FittedModel, poses: Observations, whitener: Array, *held: Array) -> None:
        """Whiten P single readings, complete, about a model with a term of its own for the base.

        Held are columns (P, b, k) of the model's own parameters, of effects that do not go with
        time and of those that do, each at the size expected of it.
        """
        self.at, self.poses, self.whitener = at, poses, whitener
        self.time_s = poses.states.time_s
        self.times_s = np.sort(self.time_s)
        self._white = whitener @ linear.by_base(at, poses)
        seen = poses.measured.components_seen
        self._seen = int(seen.sum())
        self._group = same_circumstances(poses)
        self._count = np.bincount(self._group)
        self._shared = _SHARED if self._count.max() > 1 else (0.0,)
        self._components = self._seen / len(seen)
        self._held = whitener @ np.concatenate(held, axis=2)
        self._widths = [columns.shape[2] for columns in held]
        self._data = whitener @ -linear.residual(at, poses)[:, :, None]
        walk = Wander(self.times_s, (), walk_m=1.0)
        self._walk = motions_along(self._white, walk.courses(self.time_s))
        self._products: dict[tuple[float, ...], list[Gaussian]] = {}
        # The size of effects, in their plausible one, is chosen by the evidence.
        self._scale, self._with_time = 1.0, True
        found, still = [], Wander(self.times_s, ())
        for scale in MOTION.effect_sizes:
            self._scale = scale
            found.append(max(self.about(still)[0], self.best_walk(still)[0]))
        self._scale = MOTION.effect_sizes[int(np.argmax(found))]

    def best_walk(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with another walk, and jumps and walk."""
        every = product(_WALKS_M.tolist(), MOTION.turns_rad_per_m)
        tried = [replace(wander, walk_m=size, walk_turn=turn) for size, turn in every]
        reduced = self._reduced(wander.jumps)
        values = [self.about(walk, reduced)[0] for walk in tried]
        return max(values), tried[int(np.argmax(values))]

    def best_jump(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with one more jump, and jumps and walk."""
        times_s = self.times_s
        apart = np.flatnonzero(np.diff(times_s) > 0.0)
        apart = apart[(apart >= MOTION.least_side - 1) & (apart < len(times_s) - MOTION.least_side)]
        taken = {jump.time_s for jump in wander.jumps}
        best = (-np.inf, wander)
        places = np.unique(np.linspace(0, len(apart) - 1, MOTION.coarse_times).round().astype(int))
        for _ in range(2):
            gaps = [times_s[apart[k] : apart[k] + 2].tolist() for k in places if len(apart)]
            tried = [Jump(0.5 * (first + last), first, last) for first, last in gaps]
            tried = [jump for jump in tried if jump.time_s not in taken]
            if not tried:
                break
            best = self.best_of(tried, wander)
            middle = int(np.searchsorted(times_s[apart], best[1].jumps[-1].time_s)) - 1
            wide = -(-len(apart) // MOTION.coarse_times)
            places = np.arange(max(middle - wide, 0), min(middle + wide + 1, len(apart)))
        return best

    def in_pauses(self, needed: float) -> Wander:
        """Return jumps in long pauses where these do as well as all that goes with time.

        What goes steadily with time, or with a temperature, follows a step in a pause: readings
        then show no more than the step. Each must gain so much of log evidence.
        """
        gaps_s = np.diff(self.times_s)
        long = gaps_s > max(MOTION.pause_ratio * float(np.median(gaps_s)), MOTION.pause_s)
        long[: MOTION.least_side - 1], long[len(gaps_s) + 1 - MOTION.least_side :] = (False, False)
        ends = zip(self.times_s[:-1][long].tolist(), self.times_s[1:][long].tolist(), strict=True)
        pauses = {Jump(0.5 * sum(each), *each, pause=True) for each in ends}
        static, still = self.without_time(), Wander(self.times_s, ())
        if not pauses:
            return still
        found, best = still, static.about(still)[0]
        while pauses and len(found.jumps) < MOTION.most_jumps:
            value, more = static.best_of(sorted(pauses, key=lambda each: each.time_s), found)
            if value < best + needed:
                break
            pauses = {each for each in pauses if each.time_s != more.jumps[-1].time_s}
            best, found = value, more
        return found if best > self.about(still)[0] - MOTION.as_good_nats else still

    def best_of(self, tried: list[Jump], wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with one of some jumps more, and jumps and walk."""
        values, sizes = self._scan(tried, wander)
        k = int(np.argmax(values))
        close = [
            tried[other] for other in np.flatnonzero(values >= values[k] - MOTION.as_good_nats)
        ]
        first, last = (tried[k], tried[k]) if tried[k].pause else (close[0], close[-1])
        between_s = first.before_s, last.after_s
        more = Jump(tried[k].time_s, *between_s, *sizes[k], pause=tried[k].pause)
        return float(values[k]), replace(wander, jumps=(*wander.jumps, more))

    def without_time(self) -> _Rows:
        """Return the same without the effects of time."""
        found = copy(self)
        found._with_time = False
        return found

    def _scan(self, tried: list[Jump], wander: Wander) -> tuple[Array, list[tuple[float, float]]]:
        """Return the greatest log evidence of each as one more jump, with its size and turn."""
        reduced = self._reduced((*wander.jumps, *tried), keep=False)
        at = self._places(wander, more=len(tried))
        values = np.full(len(tried), -np.inf)
        chosen = [(0.0, 0.0)] * len(tried)
        for every in reduced:
            sizes = np.ones(every.unknowns)
            sizes[at] = wander.sizes
            steps = every.in_sizes(sizes).without(at)  # of those tried, six of each
            for k in range(len(tried)):
                one = steps.along(np.arange(6 * k, 6 * k + 6))
                for size, turn in product(MOTION.jumps_m, MOTION.turns_rad_per_m):
                    value, _ = self._log(one.in_sizes(sizes_of_six(size, turn)))
                    if value > values[k]:
                        values[k], chosen[k] = value, (size, turn)
        return values, chosen

    def about(
        self, wander: Wander, reduced: list[Gaussian] | None = None
    ) -> tuple[float, Gaussian, float]:
        """Return the log evidence at the best shared error, its courses and scale of noise.

        That scale is in the noise by which rows are whitened.
        """
        at = self._places(wander)
        best = (-np.inf, Gaussian.none(0), 1.0)
        for every in reduced or self._reduced(wander.jumps):
            courses = every.along(at).in_sizes(wander.sizes)
            value, variance = self._log(courses)
            if value > best[0]:
                best = value, courses, float(np.sqrt(variance))
        return best

    def _log(self, courses: Gaussian) -> tuple[float, float]:
        """Return the log evidence at the likeliest variance of the noise, and that."""
        alone = courses.without(np.arange(courses.unknowns))
        variance = max(alone.squares / self._seen, MOTION.least_noise_share**2)
        logarithm = self._seen * float(np.log(variance)) + alone.squares / variance
        return -0.5 * (logarithm + alone.log_det), variance

    def _places(self, wander: Wander, more: int = 0) -> Index:
        """Return the places of jumps and walk among the unknowns, with so many jumps between."""
        of_jumps, first = np.arange(6 * len(wander.jumps)), 6 * (len(wander.jumps) + more)
        of_walk = np.arange(first, first + 6 * MOTION.walk_waves) if wander.walk_m else of_jumps[:0]
        return np.concatenate([of_jumps, of_walk])

    def _reduced(self, jumps: tuple[Jump, ...], *, keep: bool = True) -> list[Gaussian]:
        """Return what is said of jumps and walk, all held integrated out, at each shared error."""
        key = tuple(jump.time_s for jump in jumps)
        every = self._products.get(key) or self._multiplied(jumps)
        if keep:
            self._products[key] = every
        sizes, held = np.ones(every[0].unknowns), np.arange(sum(self._widths))
        sizes[held] = np.repeat([1.0, self._scale, float(self._with_time)], self._widths)
        return [each.in_sizes(sizes).without(held) for each in every]

    def _multiplied(self, jumps: tuple[Jump, ...]) -> list[Gaussian]:
        """Return what is said of held columns, jumps and walk at each shared error."""
        steps = motions_along(self._white, Wander(self.times_s, jumps).courses(self.time_s))
        rows = np.concatenate([self._held, steps, self._walk, self._data], axis=2)
        flat = rows.reshape(-1, rows.shape[2])
        total = flat.T @ flat
        sums = np.zeros((len(self._count), *rows.shape[1:]))
        np.add.at(sums, self._group, rows)
        # Of what groups of m readings share; last come poses read once.
        between: dict[int, Array] = {}
        for m in sorted(set(self._count.tolist()), key=lambda m: (m == 1, m)):
            own = sums[self._count == m] if m > 1 else rows[self._count[self._group] == 1]
            part = own.reshape(-1, rows.shape[2]) / np.sqrt(m)
            between[m] = part.T @ part
        found = []
        for variance in self._shared:
            products, determinant = total, 0.0
            for m, shared in between.items() if variance else ():
                products = products - (1.0 - 1.0 / (1.0 + m * variance)) * shared
                many = int(np.sum(self._count == m))
                determinant += self._components * many * float(np.log1p(m * variance))
            found.append(Gaussian(products, determinant))
        return found


def in_time_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Iterable[Effect],
    *,
    logged: bool,
    weights: bool,
) -> TimeFindings:
    """Find how the base moves in time, beside what candidate effects and loads can explain.

    Nothing is found where times were not recorded, and where poses are read once and follow each
    other like those of a scan that comes back to no place: what goes with time and with place are
    then the same. What is found where a joint or the load goes from one side to the other, or a
    joint moves slowly, is held against errors that go with it: only what these do not take is told
    of time.

    The model has a term of its own for the base; the P single readings are complete, and their
    noise whitened by (P, b, b). Torques may have been logged, those of the weights be known.
    """
    once, again = len(np.unique(poses.pose)) == len(poses), measured_again(poses)
    if not poses.states.tells_time or (once and not again and like_a_scan(poses)):
        return NO_MOTION
    poses = with_places(poses) if again else poses
    if len(poses) > MOTION.most_readings:
        shown: Index = spread_over_time(poses, MOTION.most_readings)
        poses, whitener = poses.take(shown), whitener[shown]
    own = [term for term in at.model.terms if not is_error_map(term)]
    load_N = poses.states.load_N
    by_load = motions_along(linear.by_base(at, poses), load_N[:, None] == np.unique(load_N)[1:])
    held = [
        *linear.by_own_terms(at, poses, own),
        linear.by_targets(at, poses) * MOTION.targets_m,
        MOTION.by_load_m * by_load,
    ]
    static, of_time = by_pose_and_time(at, poses, effects, logged=logged, weights=weights)

    def find(rivals: tuple[Parting, ...]) -> TimeFindings:
        own = np.concatenate([*held, _motions_by(rivals, at, poses)], axis=2)
        walks = all(np.isfinite(rival.at) for rival in rivals)
        return _found(_Rows(at, poses, whitener, own, static, of_time), walks=walks)

    shows = find(())
    if again:
        return shows
    rivals: tuple[Parting, ...] = ()
    first_mm = 0.0 if shows.wander is None else shows.wander.rms_mm[0]
    prismatic = at.model.chain.arm.prismatic
    for _ in range(MOTION.most_rivals):
        more = _rivals_of(shows, poses.states, prismatic)
        if not more:
            break
        if set(more) <= set(rivals):  # what is left beside them still goes with the order
            shows = NO_MOTION
            break
        both = dict.fromkeys((*rivals, *more))
        rivals = tuple(sorted(both, key=lambda rival: rival.at == np.inf))
        shows = find(rivals)
    else:
        shows = NO_MOTION
    if not rivals:
        return shows
    said = tuple(dict.fromkeys(str(rival.driver) for rival in rivals))
    return replace(shows, rivals=said, rivals_mm=first_mm)


def _rivals_of(found: TimeFindings, states: PoseStates, prismatic: Mask) -> tuple[Parting, ...]:
    """Return the errors by joints and the load that explain as well what was found of time.

    Places that part the rows as a jump does; for a walk joints that move slowly, parted nowhere.
    """
    if (wander := found.wander) is None:
        return ()
    rivals = [each for jump in wander.jumps for each in partings(states, jump.time_s, prismatic)]
    if wander.walk_m:
        slow = slow_joints(states)
        moving = [one for one in drivers(states, prismatic) if one.joint]
        rivals += [Parting(one, np.inf) for one in moving if slow[one.joint - 1]]
    return tuple(rivals)


def _motions_by(rivals: tuple[Parting, ...], at: FittedModel, poses: Observations) -> Array:
    """Return how the base's motion by rivals moves the components of poses, (P, b, c)."""
    from scipy.stats import rankdata  # late: half a second, for few campaigns

    states = poses.states
    courses = [np.zeros((len(poses), 0))]
    courses += [
        (rival.driver.of(states) > rival.at).astype(np.float64)[:, None]
        for rival in rivals
        if np.isfinite(rival.at)
    ]
    waves = np.arange(1, MOTION.rival_waves + 1)
    for driver in dict.fromkeys(rival.driver for rival in rivals):
        rank = rankdata(driver.of(states)) / len(poses)
        courses.append(np.cos(np.pi * np.outer(rank, waves)) / waves)
    together = np.column_stack(courses)
    six = np.tile(sizes_of_six(MOTION.rival_m, 1.0), together.shape[1])
    return motions_along(linear.by_base(at, poses), together - np.mean(together, axis=0)) * six
