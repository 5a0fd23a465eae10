"""Poses that are nearly the same, which stand for repeats where nothing is repeated.

A wrong model errs nearly alike in both poses of a pair: what their errors differ by is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.rules import NOISE
from pa10cal.observe.observations import Observations


class _Pairs(NamedTuple):
    """D pairs of poses, each with a component that both have."""

    first: Index  # (D,)
    second: Index  # (D,)
    seen: Mask  # (D, b) components that both poses have
    distance: Array | None  # (D,) of their joint positions; None where they count as the same


def noise_of_near_poses(poses: Observations, residual: Array, slides: bool = False) -> Noise:
    """Find the noise of readings from poses that are nearly the same; else return the stated one.

    Of components of one kind it is one variance, without covariances: pairs are too few for more.
    A kind that no pair has, or whose pairs show no noise, keeps what the instrument states.

    Args:
        residual: (P, b) predicted less measured components.
        slides: whether a joint of the arm slides, for the words of the origin.
    """
    cov = poses.measured.stated_covariance.copy()
    pairs = _pairs_of(poses)
    if pairs is None:
        return Noise(cov, 0)
    difference = np.abs(residual[pairs.first] - residual[pairs.second]) / np.sqrt(2.0)
    kinds, as_stated = poses.measured.component_kinds, []
    for kind, at in kinds:
        variance = _variance(difference[:, at], pairs.seen[:, at], pairs.distance)
        if variance > 0.0:
            cov[:, at, :] = cov[:, :, at] = 0.0
            cov[:, at, at] = variance * np.eye(difference[:, at].shape[1])
        else:
            as_stated.append(kind)
    if len(as_stated) == len(kinds):
        return Noise(cov, 0)
    return Noise(cov, len(pairs.first), pairs_are=_in_words(pairs, slides, as_stated))


def _in_words(pairs: _Pairs, slides: bool, as_stated: Sequence[str]) -> str:
    within = NOISE.same_pose if pairs.distance is None else NOISE.near_pose
    size = f"{1e3 * within:g} mrad" + f" or {1e3 * within:g} mm" * slides
    carried_on = "" if pairs.distance is None else ", carried on to the same pose"
    stated = f"; {' and '.join(as_stated)} as stated" if as_stated else ""
    return f"pairs of poses closer than {size} in every joint{carried_on}{stated}"


def _pairs_of(poses: Observations) -> _Pairs | None:
    """Return pairs of poses that count as the same, else of near neighbours; None of too few."""
    same = _sharing(poses, *nearly_same(poses))
    if len(same.first) >= NOISE.least_differences:
        return same
    near = _sharing(poses, *_near_neighbours(poses))
    return near if len(near.first) >= NOISE.near_steps * NOISE.least_differences else None


def _sharing(
    poses: Observations, first: Index, second: Index, distance: Array | None = None
) -> _Pairs:
    """Return those pairs of which both poses have some component."""
    seen = poses.measured.components_seen
    both = seen[first] & seen[second]
    some = both.any(axis=1)
    distance = None if distance is None else distance[some]
    return _Pairs(first[some], second[some], both[some], distance)


def _variance(difference: Array, seen: Mask, distance: Array | None) -> float:
    """Return the variance of readings by the differences (D, c) of pairs, of those seen (D, c).

    It is 0 where there is none to be seen. With the distances (D,) of the poses it is the nugget of
    a variogram: what squares in steps of distance start from.
    """
    if distance is None:
        return _typical_square(difference, seen)
    steps = np.array_split(np.argsort(distance, kind="stable"), NOISE.near_steps)
    steps = [step for step in steps if seen[step].any()]
    if not steps:
        return 0.0
    squares = np.array([_typical_square(difference[step], seen[step]) for step in steps])
    away = np.array([distance[step].mean() / NOISE.near_pose for step in steps])
    return _nugget(squares, away)


def _typical_square(difference: Array, seen: Mask) -> float:
    """Return the variance of normal deviates of this median."""
    if not seen.any():
        return 0.0
    return float(np.square(NOISE.median_to_sigma * np.median(difference[seen])))


def _nugget(squares: Array, away: Array) -> float:
    """Return what squares (s,) of steps of distances (s,) start from, 0 or more.

    By a straight line, as an error that wanders along a path rises; where that leaves no noise, by
    the square of the distance, as smooth errors of a model rise.
    """
    for rising in (away, away**2):
        nugget = float(nnls(np.column_stack([np.ones(len(away)), rising]), squares)[0][0])
        if nugget > 0.0:
            return nugget
    return 0.0


def nearly_same(poses: Observations) -> tuple[Index, Index]:
    """Return pairs of poses that are nearly the same, nearest first, each pose in one at most."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    pairs = cKDTree(keys).query_pairs(NOISE.same_pose, p=np.inf, output_type="ndarray")
    distance = np.abs(keys[pairs[:, 0]] - keys[pairs[:, 1]]).max(axis=1, initial=0.0)
    paired = np.zeros(len(poses), dtype=bool)
    chosen = []
    for k in np.argsort(distance, kind="stable"):
        if not paired[pairs[k]].any():
            paired[pairs[k]] = True
            chosen.append(k)
    found = pairs[np.array(chosen, dtype=np.intp)]
    return found[:, 0], found[:, 1]


def _near_neighbours(poses: Observations) -> tuple[Index, Index, Array]:
    """Return the poses of pairs of near neighbours, and their distances."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    distance, other = map(
        np.asarray, cKDTree(keys).query(keys, NOISE.most_neighbours + 1, p=np.inf)
    )
    first, k = np.nonzero(distance <= NOISE.near_pose)
    pairs = np.sort(np.column_stack([first, other[first, k]]), axis=1)
    pairs, at = np.unique(pairs, axis=0, return_index=True)
    distance, differ = distance[first, k][at], pairs[:, 0] != pairs[:, 1]
    return pairs[differ, 0], pairs[differ, 1], distance[differ]
