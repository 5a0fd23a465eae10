"""Which joint angles the poses of the fit have seen; beyond them a map only guesses.

An angle counts as seen where enough poses of the fit lie close by. That is a matter of the poses
alone, the same whatever the model: a posterior uncertainty would call an angle known because a map
was taken for smooth, or unknown because it was allowed to be rough.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pa10cal.arrays import Array
from pa10cal.results import maps
from pa10cal.rules import ANGLES
from pa10cal.terms.field import embedded

_TURN = 2.0 * np.pi
#: A distance that is none [m] (computing).
_NO_DISTANCE_M = 1e-9


@dataclass(frozen=True)
class AngleCoverage:
    """Angles of n joints that the poses of a fit have seen."""

    # for each joint (m, 2) first and last angle of stretches without a gap, in order [rad];
    # between 0 and a turn for a revolute joint, one that begins before 0 or goes on past the turn
    # cut in two. Of a prismatic joint the span of its positions [m].
    intervals: tuple[Array, ...]
    turns: tuple[bool, ...]  # (n,) whether the joint turns

    @property
    def nowhere(self) -> bool:
        """Return whether no angle of any joint is among them."""
        return not any(len(stretches) for stretches in self.intervals)

    def inside(self, q_rad: Array) -> NDArray[np.bool_]:
        """Return which poses (P, n) keep to the angles covered in all joints, (P,)."""
        return np.asarray(self.each(q_rad).all(axis=1), dtype=np.bool_)

    def each(self, q_rad: Array) -> NDArray[np.bool_]:
        """Return which joint angles (P, n) were covered by the fit."""
        found = np.empty(q_rad.shape, dtype=bool)
        for j, (stretches, turns) in enumerate(zip(self.intervals, self.turns, strict=True)):
            angle = np.mod(q_rad[:, j], _TURN) if turns else q_rad[:, j]
            place = np.searchsorted(stretches[:, 0], angle, side="right") - 1
            last = np.append(stretches[:, 1], -np.inf)
            found[:, j] = (place >= 0) & (angle <= last[place])
        return found

    @property
    def record(self) -> tuple[maps.AnglesSeen, ...]:
        """Return the stretches joint by joint, as they are written."""
        return tuple(
            maps.AnglesSeen(turns=turns, stretches=stretches)
            for stretches, turns in zip(self.intervals, self.turns, strict=True)
        )

    def to_plain(self) -> list[dict[str, Any]]:
        """Return the stretches joint by joint, as the file of a model has them."""
        return [
            {"turns": turns, "intervals": stretches.tolist()}
            for stretches, turns in zip(self.intervals, self.turns, strict=True)
        ]

    @classmethod
    def from_plain(cls, content: Any) -> Self:
        """Return what `to_plain` wrote."""
        return cls(
            tuple(np.array(joint["intervals"], dtype=float).reshape(-1, 2) for joint in content),
            tuple(bool(joint["turns"]) for joint in content),
        )


def span_visited(q_rad: Array) -> AngleCoverage:
    """Return the positions of every joint that poses (P, n) have visited, gaps as usual bridged.

    Beyond them nothing that depends on a joint's angle was fitted. A gap is usual up to
    `ANGLES.usual_gaps` times the mean distance of neighbours, or twice `ANGLES.reach_rad`; half of
    that is added at both ends.
    """
    stretches = []
    for q in q_rad.T:
        angle = np.sort(q)
        spacing = float(angle[-1] - angle[0]) / max(len(angle) - 1, 1)
        reach = max(ANGLES.usual_gaps * spacing / 2.0, ANGLES.reach_rad)
        begins = np.concatenate([[True], np.diff(angle) / 2.0 > reach])
        starts = angle[begins] - reach
        ends = angle[np.append(begins[1:], True)] + reach
        stretches.append(np.column_stack([starts, ends]))
    return AngleCoverage(tuple(stretches), (False,) * q_rad.shape[1])


def nothing_seen(joints: int) -> AngleCoverage:
    """Return that no position of any joint was seen."""
    return AngleCoverage((np.zeros((0, 2)),) * joints, (False,) * joints)


def angles_seen(q_rad: Array, order: Array | None = None) -> AngleCoverage:
    """Return the angles that poses (P, n) of a fit have seen.

    Args:
        order: (n,) cycles a turn of the finest waves of each joint's map, 0 of a joint without
            one: of those the span of positions counts, between which what a model without maps
            has learnt holds. None where no joint has a map.
    """
    order = np.zeros(q_rad.shape[1]) if order is None else order
    return AngleCoverage(
        tuple(
            _stretches(q, ANGLES.within_rad * ANGLES.fine_order / finest)
            if finest
            else np.array([[q.min(), q.max()]])
            for q, finest in zip(q_rad.T, order, strict=True)
        ),
        tuple(bool(finest) for finest in order),
    )


def _stretches(angle_rad: Array, within_rad: float) -> Array:
    """Return the stretches (m, 2) of a turn in which enough angles lie close by."""
    once = np.sort(np.mod(angle_rad, _TURN))
    around = np.concatenate([once - _TURN, once, once + _TURN])
    more = ANGLES.least_poses - 1
    first, last = around[:-more], around[more:]
    # From `last` on back, and from `first` on ahead, all of these poses are within reach.
    close = (last - first) / 2.0 <= within_rad
    low, high = last[close] - within_rad, first[close] + within_rad
    if not len(low):
        return np.zeros((0, 2))
    begins = np.concatenate([[True], low[1:] > np.maximum.accumulate(high)[:-1]])
    starts = low[begins]
    ends = np.maximum.reduceat(high, np.flatnonzero(begins))
    here = (ends > 0.0) & (starts < _TURN)
    return np.column_stack([np.maximum(starts[here], 0.0), np.minimum(ends[here], _TURN)])


# What a fitted model lacks, by the distance from the poses that it was fitted to.


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What a fitted model lacks, by the distance from the poses that it was fitted to."""

    q: Array  # (R, n) some of these poses, well spread [rad, m]
    # (n,) how far a joint moves the end: metres a radian where it turns, 1 where it slides
    lever_m: Array
    turns: NDArray[np.bool_]  # (n,) whether a joint turns
    distance_m: Array  # (m,) distances from the nearest pose at which errors were judged, rising
    error_mm: Array  # (m,) root mean square of the position error there, never falling
    near_m: float  # a pose within this distance is near those measured

    @classmethod
    def from_plain(cls, content: Mapping[str, Any], n: int) -> Self:
        """Return what the file of a model of n joints has of it.

        Raises:
            ValueError: when it is not made of finite numbers for this arm, or is none.
        """
        numbers = {
            name: np.array(content[name], dtype=float)
            for name in ("q", "lever_m", "distance_m", "error_mm")
        }
        found = cls(
            **numbers,
            turns=np.array(content["turns"], dtype=bool),
            near_m=float(content["near_m"]),
        )
        every = np.concatenate([each.ravel() for each in numbers.values()])
        shapes = found.q.shape[1:] == found.lever_m.shape == found.turns.shape == (n,)
        steps = found.distance_m.shape == found.error_mm.shape == (len(found),)
        if not (shapes and steps and len(found) and len(found.q) and np.isfinite(every).all()):
            raise ValueError("discrepancy is not made of finite numbers for this arm")
        if (np.diff(found.distance_m) < 0.0).any() or (found.error_mm < 0.0).any():
            raise ValueError("discrepancy has distances that fall, or an error below zero")
        return found

    def __len__(self) -> int:
        return len(self.distance_m)

    def distance_of(self, q: Array) -> Array:
        """Return how far joint positions (N, n) are from the nearest pose, (N,) [m].

        Each joint counts by how far it moves the end, along the chord of its angle.
        """
        return np.asarray(self._tree.query(embedded(q, self.lever_m, self.turns))[0])

    def error_at_mm(self, q: Array) -> Array:
        """Return the standard uncertainty that it adds at joint positions (N, n), (N,).

        Between the distances that were judged the variance is linear; beyond, the error grows in
        proportion to the distance, as it does where a model is carried on in a straight line.
        """
        distance_m = self.distance_of(q)
        variance = np.interp(distance_m, self.distance_m, self.error_mm**2)
        beyond = np.maximum(distance_m / max(float(self.distance_m[-1]), _NO_DISTANCE_M), 1.0)
        return np.asarray(np.sqrt(variance) * beyond)

    def near(self, q: Array) -> NDArray[np.bool_]:
        """Return which joint positions (N, n) are near measured poses, (N,)."""
        return np.asarray(self.distance_of(q) <= self.near_m)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(embedded(self.q, self.lever_m, self.turns))
