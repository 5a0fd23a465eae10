"""Motion of the instrument or the base in the course of time: jumps, and a slow wander.

A jump is six motions of the base times a unit step. A wander is a random walk of the base in its
first waves (Karhunen and Loève), of a size chosen. Gaussian sizes are expected of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Index
from pa10cal.discovery.linear import by_terms, error_mm, position_noise, residual, rms
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA, same_circumstances
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.term import base_frame

#: Waves of a random walk over the campaign: beyond them 4 % of its variance is left.
WAVES = 16


@dataclass(frozen=True)
class Jump:
    """A sudden motion of the base against the instrument."""

    time_s: float  # its most likely time
    # before_s and after_s: times of the readings between which it happened
    before_s: float
    after_s: float
    size_m: float = 0.0  # standard deviation expected of its shift
    turn: float = 0.0  # expected turn a shift [rad/m]


@dataclass(frozen=True, eq=False)
class Wander:
    """Motion of the base in the course of time, its mean over the readings zero."""

    times_s: Array  # (P,) times of the readings, in order; the walk goes with their number
    jumps: tuple[Jump, ...]  # sudden motions, the most certain first
    walk_m: float = 0.0  # root mean square expected of the walk's shift; 0 without a walk
    walk_turn: float = 0.0  # its expected turn a shift [rad/m]
    # (6 c,) most likely motions for each course, in their expected sizes
    amounts: Array | None = None
    # root mean square of the motion at the readings, and of the walk alone
    rms_mm: tuple[float, float] = (0.0, 0.0)

    def courses(self, time_s: Array) -> Array:
        """Return the courses in time, (P, c): jumps, then waves of the walk."""
        return courses_at(self.times_s, time_s, [j.time_s for j in self.jumps], self.walk_m > 0.0)

    @property
    def sizes(self) -> Array:
        """Return the standard deviation expected of each motion of each course, (6 c,)."""
        parts = [sizes_of_six(jump.size_m, jump.turn) for jump in self.jumps]
        if self.walk_m:
            waves = self.walk_m * np.sqrt(6.0) / (np.pi * np.arange(1, WAVES + 1))
            parts += [sizes_of_six(size, self.walk_turn) for size in waves]
        return np.concatenate([np.zeros(0), *parts])

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how measured less predicted components follow it, a unit each, (P, b, 6 c)."""
        return motions_along(by_base(at, poses), self.courses(poses.states.time_s)) * self.sizes

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return by how much it moves the components of poses, (P, b)."""
        assert self.amounts is not None
        return self.columns(at, poses) @ self.amounts

    def motions(self, time_s: Array) -> Array:
        """Return the most likely motions of the base at times (P,), (P, 6) [m, rad]."""
        return self.courses(time_s) @ self.unit_motions

    @property
    def unit_motions(self) -> Array:
        """Return the most likely six motions for each course, of jumps first, (c, 6) [m, rad]."""
        assert self.amounts is not None
        return (self.amounts * self.sizes).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class InTime:
    """What readings show of time."""

    wander: Wander | None  # jumps and walk; None where the data prefer neither
    drifts: bool  # whether an effect of time shows beside them
    # joints, rails and loads, in words, that the order goes with where more was seen: errors that
    # go with them explain that as well
    rivals: tuple[str, ...] = ()
    rivals_mm: float = 0.0  # root mean square of all that was seen before they were held against it


STILL = InTime(None, drifts=False)


def by_base(at: FittedModel, poses: Observations) -> Array:
    """Return how measured less predicted components follow six motions of the base, (P, b, 6)."""
    return by_terms(at, poses, [base_frame()], [np.zeros(6)])[0]


def courses_at(times_s: Array, time_s: Array, jumps_s: list[float], walk: bool) -> Array:
    """Return unit steps, then waves of a walk, at times (P,), their mean over `times_s` zero."""

    def bare(at_s: Array) -> Array:
        steps = [(at_s > jump_s).astype(float) for jump_s in jumps_s]
        part = np.interp(at_s, times_s, np.linspace(0.0, 1.0, len(times_s)))
        waves = np.arange(1, WAVES + 1) if walk else np.zeros(0)
        return np.column_stack(
            [np.zeros((len(at_s), 0)), *steps, np.sqrt(2.0) * np.cos(np.pi * np.outer(part, waves))]
        )

    return np.asarray(bare(time_s) - bare(times_s).mean(axis=0))


def moved_frames(motions: Array) -> Array:
    """Return the frames (P, 4, 4) of a base that has made six small motions (P, 6)."""
    T = np.tile(np.eye(4), (len(motions), 1, 1))
    T[:, :3, 3] = motions[:, :3]
    T[:, :3, :3] = Rotation.from_euler("XYZ", motions[:, 3:]).as_matrix()
    return T


def motions_along(by_motions: Array, courses: Array) -> Array:
    """Return columns (P, b, 6 c) of six motions (P, b, 6) in each course (P, c)."""
    both = courses[:, None, :, None] * by_motions[:, :, None, :]
    found: Array = both.reshape(*by_motions.shape[:2], -1)
    return found


def sizes_of_six(size_m: float, turn: float) -> Array:
    """Return the sizes of six motions: three shifts, three turns."""
    return np.array([size_m] * 3 + [size_m * turn] * 3)


# What moved between repeats, by running medians: gross errors do not sway it.

#: Readings over which a median runs.
_WINDOW = 11


def moved_between_repeats(readings: Observations, left: Array, group: Index) -> Array:
    """Return by how much the components of readings moved with time, (P, b).

    Zero where the motion is smaller than the scatter about it, as where nothing moved.

    Args:
        readings: P single readings.
        left: (P, b) what a model leaves of them.
        group: (P,) number of the pose, load and direction of arrival of each, from 0.
    """
    found = np.zeros_like(left)
    several = np.bincount(group)[group] > 1
    if np.count_nonzero(several) <= _WINDOW:
        return found
    apart = np.empty_like(left)  # less the median of the group
    for own in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
        apart[own] = left[own] - np.median(left[own], axis=0)
    rows = np.flatnonzero(several)
    rows = rows[np.argsort(readings.states.time_s[rows], kind="stable")]
    running = median_filter(apart[rows], size=(_WINDOW, 1), mode="nearest")
    for _, at in readings.measured.component_kinds:
        seen = readings.measured.components_seen[rows, at]
        moved, rest = running[:, at], apart[rows, at] - running[:, at]
        if not seen.any():
            continue
        scatter = MEDIAN_TO_SIGMA * float(np.median(np.abs(rest[seen])))
        if float(np.sqrt(np.mean(moved[seen] ** 2))) > scatter:
            found[rows, at] = np.where(seen, moved, 0.0)
    return found


# How the base moves is found by evidence.
#
# Readings of one pose at different times differ by noise and by what moved in between, whatever the
# model of the arm lacks. All single readings are compared: Gaussian parameters are integrated out,
# among them the model's own, every effect of the vocabulary, and an error that the readings of a
# pose share. The time of a jump is scanned. Where the data prefer neither jump nor walk, nothing of
# the search changes.

#: Root mean square of the walk, and standard deviation of a jump, that are tried [m].
_WALKS_M = np.geomspace(3e-6, 3e-3, 9)
_JUMPS_M = (3e-5, 3e-4, 3e-3)
#: Turns expected with a shift, or none [rad/m].
_TURNS = (0.0, 1.0)
#: Sizes of effects that are tried, in their plausible size.
_SCALES = (0.1, 1.0, 3.0)
#: Variances of the error that readings of a pose share, in those of one reading.
_SHARED = (0.0, *np.geomspace(0.1, 1e4, 7))
#: Probability allowed of seeing a motion where there is none.
_FALSE_RATE = 1e-3
#: Jumps that may be found, readings that there must be on either side, and times first scanned.
_MOST_JUMPS = 4
_LEAST_SIDE = 4
_COARSE = 40
#: A motion counts from this part of the noise of one reading on, root mean squares.
_LEAST_PART = 0.5
#: Noise is no less than this part of that by which rows are whitened: more columns than rows could
#: else explain it all.
_LEAST_NOISE = 0.3
#: Log evidence by which another time of a jump may be worse.
_AS_GOOD = 3.0
#: Log evidence from which a drift shows between the readings of a pose.
_DRIFTS = 5.0


def find_in_time(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    own: Array,
    static: Array,
    in_time: Array,
    *,
    walks: bool = True,
) -> InTime:
    """Find how the base moves in the course of time.

    Args:
        at: the model, with a term of its own for the base.
        poses: P single readings, complete.
        whitener: (P, b, b) makes the noise of a reading independent and of unit size.
        own: (P, b, k) columns of the model's own parameters, at their possible size.
        static: (P, b, s) columns of effects that do not go with time, at their plausible size.
        in_time: (P, b, t) columns of effects of time, at their possible size.
        walks: whether a walk is sought; else jumps alone.
    """
    rows = _Rows(at, poses, whitener, (own, static, in_time))
    found = Wander(rows.times_s, ())
    best = rows.evidence(found)
    needed_jump = float(np.log(len(poses) * len(_JUMPS_M) * len(_TURNS) / _FALSE_RATE))
    needed_walk = float(np.log(len(_WALKS_M) * len(_TURNS) / _FALSE_RATE))
    while len(found.jumps) < _MOST_JUMPS:
        value, more = rows.best_jump(found)
        beyond = value - best - needed_jump
        if walks and not found.walk_m:
            of_walk, with_walk = rows.best_walk(found)
            if of_walk - best - needed_walk >= beyond:
                value, more, beyond = of_walk, with_walk, of_walk - best - needed_walk
        if beyond <= 0.0:
            break
        best, found = value, more
    for jump in found.jumps if walks else ():  # a first jump may have stood for a walk
        less = replace(found, jumps=tuple(other for other in found.jumps if other != jump))
        value, less = rows.best_walk(less)
        if best - value < needed_jump - needed_walk:
            best, found = value, less
    drifts = rows.loses(found) > _DRIFTS if in_time.shape[2] else False
    if not found.jumps and not found.walk_m:
        return InTime(None, drifts)
    amounts = rows.amounts(found, drifts=drifts)
    along = motions_along(rows.motions, found.courses(poses.states.time_s))
    shift = along * (found.sizes * amounts)
    of_all, of_walk = shift.sum(axis=2), shift[:, :, 6 * len(found.jumps) :].sum(axis=2)
    rms_mm = rms(error_mm(poses.measured, of_all)), rms(error_mm(poses.measured, of_walk))
    cov = np.asarray(np.linalg.inv(np.swapaxes(whitener, 1, 2) @ whitener), dtype=np.float64)
    position = np.trace(position_noise(poses.measured, cov), axis1=1, axis2=2)
    noise_mm = 1e3 * float(np.sqrt(np.median(position))) * rows.about(found)[2]
    if rms_mm[0] < _LEAST_PART * noise_mm:
        return InTime(None, drifts)
    return InTime(replace(found, amounts=amounts, rms_mm=rms_mm), drifts)


class _Rows:
    """Whitened rows of single readings, and the evidence of motions in time."""

    def __init__(
        self,
        at: FittedModel,
        poses: Observations,
        whitener: Array,
        held: tuple[Array, Array, Array],
    ) -> None:
        self.time_s = poses.states.time_s
        self.times_s = np.sort(self.time_s)
        self.motions = by_base(at, poses)
        self._white = whitener @ self.motions
        seen = poses.measured.components_seen
        self._seen = int(seen.sum())
        self._group = same_circumstances(poses)
        self._count = np.bincount(self._group)
        self._shared = _SHARED if self._count.max() > 1 else (0.0,)
        self._components = self._seen / len(seen)
        self._held = whitener @ np.concatenate(held, axis=2)
        self._widths = tuple(columns.shape[2] for columns in held)
        self._data = whitener @ -residual(at, poses)[:, :, None]
        walk = courses_at(self.times_s, self.time_s, [], walk=True)
        self._walk = motions_along(self._white, walk)
        self._products: dict[tuple[float, ...], list[tuple[Array, float]]] = {}
        # The size of effects, in their plausible one, is chosen by the evidence.
        self._scale, self._with_time = 1.0, True
        found, still = [], Wander(self.times_s, ())
        for scale in _SCALES:
            self._scale = scale
            found.append(max(self.evidence(still), self.best_walk(still)[0]))
        self._scale = _SCALES[int(np.argmax(found))]

    def evidence(self, wander: Wander) -> float:
        """Return the log evidence of jumps and a walk, the shared error chosen."""
        return self.about(wander)[0]

    def best_walk(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with another walk, and jumps and walk."""
        walks = [(float(size), turn) for size in _WALKS_M for turn in _TURNS]
        tried = [replace(wander, walk_m=size, walk_turn=turn) for size, turn in walks]
        reduced = self._reduced(wander.jumps)
        values = [self.about(walk, reduced)[0] for walk in tried]
        return max(values), tried[int(np.argmax(values))]

    def best_jump(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with one more jump, and jumps and walk."""
        times_s = self.times_s
        apart = np.flatnonzero(np.diff(times_s) > 0.0)
        apart = apart[(apart >= _LEAST_SIDE - 1) & (apart < len(times_s) - _LEAST_SIDE)]
        taken = {jump.time_s for jump in wander.jumps}
        best = (-np.inf, wander)
        places = np.unique(np.linspace(0, len(apart) - 1, _COARSE).round().astype(int))
        for _ in range(2):
            gaps = [times_s[apart[k] : apart[k] + 2].tolist() for k in places if len(apart)]
            tried = [Jump(0.5 * (first + last), first, last) for first, last in gaps]
            tried = [jump for jump in tried if jump.time_s not in taken]
            if not tried:
                break
            values, sizes = self._scan(tried, wander)
            k = int(np.argmax(values))
            close = [tried[other] for other in np.flatnonzero(values >= values[k] - _AS_GOOD)]
            between_s = close[0].before_s, close[-1].after_s
            more = Jump(tried[k].time_s, *between_s, *sizes[k])
            best = float(values[k]), replace(wander, jumps=(*wander.jumps, more))
            middle = int(np.searchsorted(times_s[apart], tried[k].before_s))
            wide = -(-len(apart) // _COARSE)
            places = np.arange(max(middle - wide, 0), min(middle + wide + 1, len(apart)))
        return best

    def loses(self, wander: Wander) -> float:
        """Return the log evidence that is lost without the effects of time."""
        whole = self.evidence(wander)
        self._with_time = False
        without = self.evidence(wander)
        self._with_time = True
        return whole - without

    def amounts(self, wander: Wander, *, drifts: bool) -> Array:
        """Return the most likely amounts of all courses, in their sizes.

        Where no effect of time shows, what goes with time is theirs.
        """
        self._with_time = drifts
        _, products, _ = self.about(wander)
        self._with_time = True
        sizes, at = wander.sizes, self._places(wander)
        gram = products[np.ix_(at, at)] * np.outer(sizes, sizes)
        found: Array = np.linalg.solve(np.eye(len(at)) + gram, products[at, -1] * sizes)
        return found

    def _scan(self, tried: list[Jump], wander: Wander) -> tuple[Array, list[tuple[float, float]]]:
        """Return the greatest log evidence of each as one more jump, with its size and turn."""
        reduced = self._reduced((*wander.jumps, *tried), keep=False)
        at = self._places(wander, more=len(tried))
        first, values = 6 * len(wander.jumps), np.full(len(tried), -np.inf)
        chosen = [(0.0, 0.0)] * len(tried)
        for products, constant in reduced:
            taken, determinant = _without(products, at, wander.sizes)
            for k, size, turn in product(range(len(tried)), _JUMPS_M, _TURNS):
                own = np.arange(first + 6 * k, first + 6 * k + 6)
                six = sizes_of_six(size, turn)
                inner = taken[np.ix_(own, own)] * np.outer(six, six)
                factor = np.linalg.cholesky(np.eye(6) + inner)
                explained = np.linalg.solve(factor, taken[own, -1] * six)
                squares = taken[-1, -1] - explained @ explained
                more = determinant + 2.0 * float(np.log(np.diag(factor)).sum())
                value = self._log(squares, more + constant)
                if value > values[k]:
                    values[k], chosen[k] = value, (size, turn)
        return values, chosen

    def about(
        self, wander: Wander, reduced: list[tuple[Array, float]] | None = None
    ) -> tuple[float, Array, float]:
        """Return the log evidence at the best shared error, its products and scale of noise.

        That scale is in the noise by which rows are whitened.
        """
        at = self._places(wander)
        best: tuple[float, Array, float] = (-np.inf, np.zeros((0, 0)), 1.0)
        for products, constant in reduced or self._reduced(wander.jumps):
            taken, determinant = _without(products, at, wander.sizes)
            value = self._log(taken[-1, -1], determinant + constant)
            if value > best[0]:
                noise = float(np.sqrt(taken[-1, -1] / self._seen))
                best = value, products, max(noise, _LEAST_NOISE)
        return best

    def _log(self, squares: float, determinant: float) -> float:
        variance = max(squares / self._seen, _LEAST_NOISE**2)
        logarithm = self._seen * np.log(variance) + squares / variance
        return float(-0.5 * logarithm - 0.5 * determinant)

    def _places(self, wander: Wander, more: int = 0) -> Index:
        """Return the places of jumps and walk among the products, with so many jumps between."""
        of_jumps, first = np.arange(6 * len(wander.jumps)), 6 * (len(wander.jumps) + more)
        of_walk = np.arange(first, first + 6 * WAVES) if wander.walk_m else of_jumps[:0]
        return np.concatenate([of_jumps, of_walk])

    def _reduced(self, jumps: tuple[Jump, ...], *, keep: bool = True) -> list[tuple[Array, float]]:
        """Return products of jumps, walk and data, all held integrated out, at each shared error.

        With each, the logarithm of the determinant of what was integrated out and of the noise.
        """
        key = tuple(jump.time_s for jump in jumps)
        every = self._products.get(key) or self._multiplied(jumps)
        if keep:
            self._products[key] = every
        own, static, in_time = self._widths
        held, size = own + static + in_time, np.ones(len(every[0][0]))
        size[own : own + static] = self._scale
        size[own + static : held] = float(self._with_time)
        found = []
        for products, determinant in every:
            reduced, more = _integrated_out(products * np.outer(size, size), held)
            found.append((reduced, determinant + more))
        return found

    def _multiplied(self, jumps: tuple[Jump, ...]) -> list[tuple[Array, float]]:
        """Return products of all columns and the data at each shared error.

        With each, the logarithm of the determinant of the noise.
        """
        at_s = [jump.time_s for jump in jumps]
        courses = courses_at(self.times_s, self.time_s, at_s, walk=False)
        steps = motions_along(self._white, courses)
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
            found.append((products, determinant))
        return found


def _integrated_out(products: Array, held: int) -> tuple[Array, float]:
    """Return the products of the columns past the first `held`, those integrated out."""
    factor = np.linalg.cholesky(products[:held, :held] + np.eye(held))
    across = np.linalg.solve(factor, products[:held, held:])
    left: Array = products[held:, held:] - across.T @ across
    return left, 2.0 * float(np.log(np.diag(factor)).sum())


def _without(products: Array, at: Index, sizes: Array) -> tuple[Array, float]:
    """Return the products with some columns of given sizes integrated out, all in place."""
    factor = np.linalg.cholesky(np.eye(len(at)) + products[np.ix_(at, at)] * np.outer(sizes, sizes))
    across = np.linalg.solve(factor, products[at] * sizes[:, None])
    left: Array = products - across.T @ across
    return left, 2.0 * float(np.log(np.diag(factor)).sum())
