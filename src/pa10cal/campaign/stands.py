"""Readings that were repeated while the arm stood still: what they say, and what they do not.

They show the noise of a reading. What the instrument or the arm errs by from pose to pose is in all
of them, so a stated uncertainty above their scatter is no mistake, and their mean is no better than
one of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.rules import ORDER, STANDS


def standing(every: Observations) -> Index:
    """Return the number (P,), from 0, of each reading's stand, in which the arm did not move.

    Readings of a stand follow each other in time, with the same label, kind and load, and in the
    same joint positions.
    """
    order = np.argsort(every.states.time_s, kind="stable")
    ordered = every.take(order)
    states = ordered.states
    began = np.ones(len(every), dtype=bool)
    moved = np.abs(np.diff(states.q_rad, axis=0)).max(axis=1, initial=0.0) > ORDER.stood_still
    began[1:] = moved | (states.load_N[1:] != states.load_N[:-1])
    for words in (ordered.pose, ordered.kind):
        began[1:] |= words[1:] != words[:-1]
    number = np.empty(len(every), dtype=np.intp)
    number[order] = np.cumsum(began) - 1
    return number


def with_stands_averaged(every: Observations) -> tuple[Observations, tuple[str, ...]]:
    """Count readings of a standing arm as one, their mean, where more is stated than they show.

    The mean keeps the stated uncertainty of one reading. Touches of balls stay as they are, and so
    do campaigns whose stands scatter by about what is stated, or show no scatter.

    Returns:
        The readings, and one clause that says so; none where nothing was averaged.
    """
    stand = standing(every)
    if every.measured.from_touches or len(stand) - stand.max(initial=-1) - 1 < STANDS.least_pairs:
        return every, ()
    found_m, stated_m = _scatter(every, stand)
    if not 0.0 < found_m * STANDS.stated_ratio < stated_m:
        return every, ()
    kept = np.flatnonzero(~_off_median(every, stand, STANDS.off_errors * stated_m))
    own, stand = every.take(kept), stand[kept]
    first = np.unique(stand, return_index=True)[1]
    merged = replace(
        average_groups(own, stand),
        measured=own.measured.averaged_at_rest(stand),
        readings=own.readings[first],
        log=None if own.log is None else own.log.take(first),
        base=None if own.base is None else own.base.take(first),
    )
    left_out = len(every) - len(kept)
    without = f", {left_out} far off the others of a pose left out" if left_out else ""
    note = (
        f"{len(every)} readings count as {len(merged)}{without}: the arm did not move between "
        f"those of a pose, and their scatter of {1e3 * found_m:.2g} mm is the noise of a reading, "
        f"not the {1e3 * stated_m:.2g} mm stated of a position"
    )
    return merged, (note,)


def _off_median(every: Observations, stand: Index, most_m: float) -> Mask:
    """Return which readings (P,) are further than that off the median of their stand."""
    off = np.zeros(len(every), dtype=bool)
    places_m: Array = every.measured.places_m.reshape(len(every), -1)
    by_stand = np.split(np.argsort(stand, kind="stable"), np.cumsum(np.bincount(stand))[:-1])
    for rows in (each for each in by_stand if len(each) >= STANDS.least_for_median):
        own_m = places_m[rows][:, np.isfinite(places_m[rows]).all(axis=0)]
        off[rows] = np.abs(own_m - np.median(own_m, axis=0)).max(axis=1, initial=0.0) > most_m
    return off


def _scatter(every: Observations, stand: Index) -> tuple[float, float]:
    """Return what a component of a position scatters by within stands, and what is stated [m]."""
    order = np.lexsort((every.states.time_s, stand))
    pairs = np.flatnonzero(np.diff(stand[order]) == 0)
    places_m: Array = every.measured.places_m.reshape(len(every), -1)
    apart_m = np.abs(places_m[order[pairs + 1]] - places_m[order[pairs]])
    if np.isfinite(apart_m).any(axis=1).sum() < STANDS.least_pairs:
        return 0.0, 0.0
    at = every.measured.position_columns
    variance = np.diagonal(every.measured.stated_covariance, axis1=1, axis2=2)[:, at]
    stated_m = float(np.sqrt(np.median(variance[every.measured.components_seen[:, at]])))
    # Of readings in few digits most differ by nothing.
    usual_m = float(np.nanmedian(apart_m)) or float(np.nanmean(apart_m))
    return MEDIAN_TO_SIGMA * usual_m / float(np.sqrt(2.0)), stated_m
