"""Motion of the instrument or the base in the course of time: jumps, and a slow wander.

A jump is six motions of the base times a unit step. A wander is a random walk of the base in its
first waves (Karhunen and Loève). Gaussian sizes are expected of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Index
from pa10cal.discovery.linear import by_terms
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA
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

    @classmethod
    def between(cls, before_s: float, after_s: float) -> Jump:
        """Return a jump in the middle of the times of two readings."""
        return cls(0.5 * (before_s + after_s), before_s, after_s)


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
            parts += [sizes_of_six(size, self.walk_turn) for size in wave_sizes(self.walk_m)]
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
        assert self.amounts is not None
        found: Array = self.courses(time_s) @ (self.amounts * self.sizes).reshape(-1, 6)
        return found

    def of_jump(self, number: int) -> Array:
        """Return the six motions (6,) of a jump [m, rad]."""
        assert self.amounts is not None
        here = slice(6 * number, 6 * number + 6)
        return np.asarray((self.amounts * self.sizes)[here])


@dataclass(frozen=True, eq=False)
class InTime:
    """What readings show of time."""

    wander: Wander | None  # jumps and walk; None where the data prefer neither
    drifts: bool  # whether an effect of time shows beside them
    # joints, rails and loads, in words, that the order goes with where more was seen: errors that
    # go with them explain that as well
    rivals: tuple[str, ...] = ()
    rivals_mm: float = 0.0  # root mean square of all that was seen before they were held against it

    @property
    def rms_mm(self) -> float:
        """Return the root mean square of jumps and walk at the readings."""
        return 0.0 if self.wander is None else self.wander.rms_mm[0]


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


def wave_sizes(walk_m: float) -> Array:
    """Return the standard deviations of the waves of a walk whose root mean square is given."""
    found: Array = walk_m * np.sqrt(6.0) / (np.pi * np.arange(1, WAVES + 1))
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
    apart = _less_medians(left, group)
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


def _less_medians(left: Array, group: Index) -> Array:
    """Return (P, b) values less the median of their group."""
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(group))[:-1])
    apart = np.empty_like(left)
    for rows in parts:
        apart[rows] = left[rows] - np.median(left[rows], axis=0)
    return apart
