"""What moved between repeats, by running medians: gross errors do not sway it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from pa10cal.arrays import Array, Index
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA
from pa10cal.observe.observations import Observations

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
