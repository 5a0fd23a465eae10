"""Where a fitted model holds: joint angles that its poses cover, and its error away from them.

An angle is covered where enough poses of the fit are near; elsewhere a map of a joint extrapolates.
Coverage follows from the poses alone. A posterior uncertainty would depend on how smooth a map was
assumed to be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pa10cal.arrays import Array
from pa10cal.results import maps
from pa10cal.rules import ANGLES, LEVELS
from pa10cal.terms.field import embedded

_TURN = 2.0 * np.pi
#: Divisor in place of a distance of zero [m] (computing).
_NO_DISTANCE_M = 1e-9


@dataclass(frozen=True)
class AngleCoverage:
    """Intervals of the positions of n joints that poses cover."""

    # for each joint (m, 2) first and last position of its intervals, ascending [rad or m]; angles
    # modulo a turn are from 0 to 2 pi, and an interval that passes 0 is cut in two
    intervals: tuple[Array, ...]
    turns: tuple[bool, ...]  # (n,) whether the positions of a joint are angles modulo a turn

    @property
    def nowhere(self) -> bool:
        """Return whether no position of any joint is covered."""
        return not any(len(stretches) for stretches in self.intervals)

    def inside(self, q_rad: Array) -> NDArray[np.bool_]:
        """Return which poses (P, n) are covered in all joints, (P,)."""
        return np.asarray(self.covers(q_rad).all(axis=1), dtype=np.bool_)

    def covers(self, q_rad: Array) -> NDArray[np.bool_]:
        """Return which positions of the joints (P, n) are covered, (P, n)."""
        covered = np.empty(q_rad.shape, dtype=bool)
        for j, (intervals, turns) in enumerate(zip(self.intervals, self.turns, strict=True)):
            position = np.mod(q_rad[:, j], _TURN) if turns else q_rad[:, j]
            number = np.searchsorted(intervals[:, 0], position, side="right") - 1
            last = np.append(intervals[:, 1], -np.inf)
            covered[:, j] = (number >= 0) & (position <= last[number])
        return covered

    def beyond(self, joint: int, position: Array) -> Array:
        """Return how far positions (N,) of a joint, from 0, are from the nearest covered one, (N,).

        It is negative below that one, and 0 where covered, or where no position is.
        """
        ends = self.intervals[joint].ravel()
        if not len(ends):
            return np.zeros(len(position))
        away = apart(position, ends, turns=self.turns[joint])
        nearest = np.take_along_axis(away, np.abs(away).argmin(axis=1)[:, None], axis=1)[:, 0]
        q = np.zeros((len(position), len(self.intervals)))
        q[:, joint] = position
        return np.asarray(np.where(self.covers(q)[:, joint], 0.0, nearest))

    def intervals_within(self, joint: int, low: float, high: float) -> Array:
        """Return the covered intervals (m, 2) of a joint, from 0, between two positions.

        Those of angles modulo a turn are repeated turn by turn.
        """
        intervals = self.intervals[joint]
        if self.turns[joint]:
            turns = np.arange(np.floor(low / _TURN), np.floor(high / _TURN) + 1.0)
            intervals = (_TURN * turns[:, None, None] + intervals).reshape(-1, 2)
        return overlaps(np.array([[low, high]]), intervals)

    @property
    def record(self) -> tuple[maps.AnglesSeen, ...]:
        """Return the intervals joint by joint, as results hold them."""
        return tuple(
            maps.AnglesSeen(turns=turns, stretches=intervals)
            for intervals, turns in zip(self.intervals, self.turns, strict=True)
        )

    def to_plain(self) -> list[dict[str, Any]]:
        """Return the intervals joint by joint, as the file of a model holds them."""
        return [
            {"turns": turns, "intervals": intervals.tolist()}
            for intervals, turns in zip(self.intervals, self.turns, strict=True)
        ]

    @classmethod
    def from_plain(cls, content: Any, n: int) -> Self:
        """Return the coverage in the file of a model of n joints.

        Raises:
            ValueError: when it is of another number of joints, or its intervals do not ascend.
        """
        intervals = tuple(
            np.array(joint["intervals"], dtype=float).reshape(-1, 2) for joint in content
        )
        ascending = (np.all(np.diff(of_joint.ravel()) >= 0.0) for of_joint in intervals)
        if len(intervals) != n or not all(ascending):
            raise ValueError(f"joint positions seen are not ascending intervals of {n} joints")
        return cls(intervals, tuple(bool(joint["turns"]) for joint in content))


def overlaps(intervals: Array, others: Array) -> Array:
    """Return where intervals (m, 2) and other intervals (k, 2) overlap, (o, 2), if in one point."""
    low = np.maximum.outer(intervals[:, 0], others[:, 0])
    high = np.minimum.outer(intervals[:, 1], others[:, 1])
    both = low <= high
    return np.column_stack([low[both], high[both]])


def span_visited(q_rad: Array) -> AngleCoverage:
    """Return the positions that each joint visits in poses (P, n), small gaps included.

    Beyond them nothing that depends on a joint's position was fitted. A gap is small up to
    `ANGLES.usual_gaps` times the mean distance of neighbours, or twice `ANGLES.reach_rad`; half of
    that is added at both ends.
    """
    intervals = []
    for q in q_rad.T:
        angle = np.sort(q)
        spacing = float(angle[-1] - angle[0]) / max(len(angle) - 1, 1)
        reach = max(ANGLES.usual_gaps * spacing / 2.0, ANGLES.reach_rad)
        begins = np.concatenate([[True], np.diff(angle) / 2.0 > reach])
        starts = angle[begins] - reach
        ends = angle[np.append(begins[1:], True)] + reach
        intervals.append(np.column_stack([starts, ends]))
    return AngleCoverage(tuple(intervals), (False,) * q_rad.shape[1])


def nothing_seen(joints: int) -> AngleCoverage:
    """Return the coverage of no position of any joint."""
    return AngleCoverage((np.zeros((0, 2)),) * joints, (False,) * joints)


def angles_seen(q_rad: Array, order: Array | None = None) -> AngleCoverage:
    """Return the joint positions that poses (P, n) of a fit cover.

    Args:
        order: (n,) cycles a turn of the finest waves of each joint's map; 0 for a joint without a
            map, whose positions are covered from the least to the largest. None where no joint has
            a map.
    """
    order = np.zeros(q_rad.shape[1]) if order is None else order
    return AngleCoverage(
        tuple(
            _intervals_near(q, ANGLES.within_rad * ANGLES.fine_order / finest)
            if finest
            else np.array([[q.min(), q.max()]])
            for q, finest in zip(q_rad.T, order, strict=True)
        ),
        tuple(bool(finest) for finest in order),
    )


def _intervals_near(angle_rad: Array, within_rad: float) -> Array:
    """Return the intervals (m, 2) of a turn with `ANGLES.least_poses` angles within a distance."""
    once = np.sort(np.mod(angle_rad, _TURN))
    periodic = np.concatenate([once - _TURN, once, once + _TURN])
    more = ANGLES.least_poses - 1
    first, last = periodic[:-more], periodic[more:]  # of so many successive angles
    # All of these are near each angle from last - within to first + within, if there is any.
    close = (last - first) / 2.0 <= within_rad
    low, high = last[close] - within_rad, first[close] + within_rad
    if not len(low):
        return np.zeros((0, 2))
    # The union of these intervals: a new one begins where all before have ended.
    begins = np.concatenate([[True], low[1:] > np.maximum.accumulate(high)[:-1]])
    starts = low[begins]
    ends = np.maximum.reduceat(high, np.flatnonzero(begins))
    inside = (ends > 0.0) & (starts < _TURN)
    return np.column_stack([np.maximum(starts[inside], 0.0), np.minimum(ends[inside], _TURN)])


def apart(position: Array, others: Array, *, turns: bool) -> Array:
    """Return how far positions (N,) of a joint are from others (m,), (N, m), within half a turn."""
    away: Array = position[:, None] - others
    return np.mod(away + 0.5 * _TURN, _TURN) - 0.5 * _TURN if turns else away


def _about_within(position: Array, fitted: Array, *, turns: bool) -> NDArray[np.bool_]:
    """Return which positions (N,) of a joint are about in the range of those of a fit (F,).

    The range of a joint that turns is the circle without the largest arc that has none of them.
    """
    first, span = float(fitted.min()), float(np.ptp(fitted))
    along = position - first
    if turns:
        angle = np.sort(np.mod(fitted, _TURN))
        arcs = np.diff(angle, append=angle[0] + _TURN)
        last = int(np.argmax(arcs))
        first, span = float(angle[(last + 1) % len(angle)]), float(_TURN - arcs[last])
        along = np.mod(position - first, _TURN)
        along = np.where(_TURN - along < along - span, along - _TURN, along)
    beyond = np.maximum(np.maximum(-along, along - span), 0.0)
    margin = max(ANGLES.beyond_share * span, ANGLES.reach_rad if turns else 0.0)
    return np.asarray(beyond <= margin)


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Error of a fitted model beyond its covariance, by the distance from the poses of the fit."""

    q: Array  # (R, n) some of these poses, well spread [rad, m]
    # (n,) lever of each joint: motion of the end [m] for a unit of the joint's motion
    lever_m: Array
    turns: NDArray[np.bool_]  # (n,) whether a joint turns
    distance_m: Array  # (m,) distances from the nearest pose at which it was estimated, ascending
    error_mm: Array  # (m,) root mean square of the position error there, non-decreasing
    near_m: float  # a pose within this distance is near those measured
    # position of a single approach beyond the mean of many, rms, beyond what the instrument states;
    # what goes along the moves to poses, and is left to the log, included
    repeatability_mm: float = 0.0
    # levels of each joint that stood at few only, ascending, (0,) of others; () of none
    levels: tuple[Array, ...] = ()
    # of each joint, rms of the position error between its levels beyond that at them, (n,); () too
    between_mm: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def from_plain(cls, content: Mapping[str, Any], n: int) -> Self:
        """Return the discrepancy in the file of a model of n joints.

        Raises:
            ValueError: when it is not made of finite numbers for this arm, distances descend, or an
                error is negative.
        """
        numbers = {
            name: np.array(content[name], dtype=float)
            for name in ("q", "lever_m", "distance_m", "error_mm")
        }
        lack = cls(
            **numbers,
            turns=np.array(content["turns"], dtype=bool),
            near_m=float(content["near_m"]),
            repeatability_mm=float(content.get("repeatability_mm", 0.0)),
            levels=tuple(np.array(each, dtype=float) for each in content.get("levels", ())),
            between_mm=np.array(content.get("between_mm", ()), dtype=float),
        )
        finite = all(np.isfinite(array).all() for array in numbers.values())
        finite &= bool(np.isfinite([lack.near_m, lack.repeatability_mm, *lack.between_mm]).all())
        finite &= all(np.isfinite(levels).all() for levels in lack.levels)
        of_arm = lack.q.shape[1:] == lack.lever_m.shape == lack.turns.shape == (n,)
        of_steps = lack.distance_m.shape == lack.error_mm.shape == (len(lack),)
        of_arm &= len(lack.levels) == len(lack.between_mm) and len(lack.levels) in (0, n)
        if not (of_arm and of_steps and len(lack) and len(lack.q) and finite):
            raise ValueError("discrepancy is not made of finite numbers for this arm")
        if (
            (np.diff(lack.distance_m) < 0.0).any()
            or (lack.error_mm < 0.0).any()
            or (lack.repeatability_mm < 0.0)
            or (lack.between_mm < 0.0).any()
        ):
            raise ValueError("discrepancy has distances that fall, or an error below zero")
        return lack

    def __len__(self) -> int:
        return len(self.distance_m)

    def distance_of(self, q: Array) -> Array:
        """Return the distance of joint positions (N, n) from the nearest pose, (N,) [m].

        A difference in a joint counts as its lever times the chord of the angle, or times the
        difference of a slide.
        """
        return np.asarray(self._tree.query(embedded(q, self.lever_m, self.turns))[0])

    def error_at_mm(self, q: Array) -> Array:
        """Return the standard uncertainty that it adds at joint positions (N, n), (N,).

        Between the distances at which it was estimated the variance is interpolated linearly;
        beyond the last, the error grows in proportion to the distance. Repeatability is the same
        everywhere. Away from the levels of a joint the error between them is added.
        """
        distance_m = self.distance_of(q)
        variance = np.interp(distance_m, self.distance_m, self.error_mm**2)
        beyond = np.maximum(distance_m / max(float(self.distance_m[-1]), _NO_DISTANCE_M), 1.0)
        found_mm = np.hypot(np.sqrt(variance) * beyond, self.repeatability_mm)
        return np.asarray(np.hypot(found_mm, self._between_levels_mm(q)))

    def _between_levels_mm(self, q: Array) -> Array:
        """Return the error that is added between levels of joints at positions (N, n), (N,)."""
        variance = np.zeros(len(q))
        for joint in np.flatnonzero(self.between_mm):
            levels, turns = self.levels[joint], bool(self.turns[joint])
            away = np.abs(apart(q[:, joint], levels, turns=turns)).min(axis=1)
            reach = LEVELS.reach_share * np.diff(levels).min()
            variance += (self.between_mm[joint] * np.minimum(away / reach, 1.0)) ** 2
        return np.asarray(np.sqrt(variance))

    def mixed_with(self, probability: float, other: Discrepancy) -> Self:
        """Return it where another one, if it is larger, holds with a probability: mean squares."""
        of_distances = np.interp(self.distance_m, other.distance_m, other.error_mm**2)
        of_levels = other.between_mm**2 if other.levels else np.zeros(len(self.turns))
        between_mm = self.between_mm if self.levels else np.zeros(len(self.turns))
        error_mm, between_mm = (
            np.sqrt(own**2 + probability * np.maximum(square - own**2, 0.0))
            for own, square in ((self.error_mm, of_distances), (between_mm, of_levels))
        )
        if not between_mm.any():
            return replace(self, error_mm=error_mm)
        levels = self.levels or other.levels
        return replace(self, error_mm=error_mm, levels=levels, between_mm=between_mm)

    def near(self, q: Array) -> NDArray[np.bool_]:
        """Return which joint positions (N, n) are near measured poses, (N,).

        Each joint is about within the range that it had in these, too: one that hardly moves the
        end, as that of a wrist, may be far beyond it where the end is near.
        """
        within = np.ones(len(q), dtype=bool)
        for fitted, positions, turns in zip(self.q.T, q.T, self.turns.tolist(), strict=True):
            within &= _about_within(positions, fitted, turns=turns)
        return np.asarray(within & (self.distance_of(q) <= self.near_m))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(embedded(self.q, self.lever_m, self.turns))
