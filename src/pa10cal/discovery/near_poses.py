"""Poses that are nearly the same, which stand for repeats where nothing is repeated.

A wrong model errs nearly alike in both poses of a pair: what their errors differ by is noise.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.rules import NOISE
from pa10cal.observe.observations import Observations


def noise_of_near_poses(poses: Observations, residual: Array) -> Noise:
    """Find the noise of readings from poses that are nearly the same; else return the stated one.

    The difference of the residuals (P, b) of two nearly equal poses is noise: a wrong model errs
    nearly alike in both. Each pose is in one pair at most; the median decides. Where there are too
    few pairs, as along a path, the noise is the nugget of a variogram of pairs farther apart.
    """
    first, second = nearly_same(poses)
    measured, within, distance = poses.measured, NOISE.same_pose, None
    seen, stated = measured.components_seen, measured.stated_covariance
    both = seen[first] & seen[second]
    if both.any(axis=1).sum() < NOISE.least_differences:
        first, second, distance = _near_neighbours(poses)
        both, within = seen[first] & seen[second], NOISE.near_pose
        if both.any(axis=1).sum() < NOISE.near_steps * NOISE.least_differences:
            return Noise(stated, 0)
    difference = np.abs(residual[first] - residual[second]) / np.sqrt(2.0)
    variance = np.zeros(residual.shape[1])
    for _, at in measured.component_kinds:
        here = both[:, at]
        if not here.any():  # a campaign of a group without poses that are nearly the same
            own = np.diagonal(stated[:, at, at], axis1=1, axis2=2)[measured.components_seen[:, at]]
            variance[at] = np.median(own)
            continue
        variance[at] = _variance(difference[:, at], here, distance)
    if not variance.all():  # readings that were copied
        return Noise(stated, 0)
    cov = np.tile(np.diag(variance), (len(poses), 1, 1))
    return Noise(cov, len(first), within=within)


def _variance(difference: Array, seen: Mask, distance: Array | None) -> float:
    """Return the variance of readings by the differences (D, c) of pairs, of those seen (D, c).

    With the distances (D,) of the poses, it is the intercept of a straight line through medians of
    steps of distance, of non-negative slope; None where poses count as the same.
    """
    if distance is None:
        return float(np.square(NOISE.median_to_sigma * np.median(difference[seen])))
    steps = np.array_split(np.argsort(distance, kind="stable"), NOISE.near_steps)
    steps = [step for step in steps if seen[step].any()]
    square = [_variance(difference[step], seen[step], None) for step in steps]
    line = np.column_stack(
        [np.ones(len(steps)), [distance[step].mean() / NOISE.near_pose for step in steps]]
    )
    return float(nnls(line, np.array(square))[0][0])


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
