"""Stands: times in which the arm stood still while readings were repeated.

Repeats of a stand scatter by the noise of a reading alone. What instrument and arm err by from pose
to pose is the same in all of them. So an uncertainty that is stated above their scatter is no
mistake, and their mean is no better than one of them: they count as one reading.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.campaign.screens import OFF_STAND, STAND_DISAGREES
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.rules import ORDER, STANDS


@dataclass(frozen=True)
class StandsAveraged:
    """P single readings, those of each stand averaged where they count as one."""

    readings: Observations  # one of each stand; all, as they were, where none was averaged
    why_left_out: NDArray[np.str_]  # (P,) why a reading is in no mean; "" where it is in one
    off_m: Array  # (P,) how far a reading is off the median of its stand; 0 where not judged
    notes: tuple[str, ...]  # what the user should know, one clause each


def with_stands_averaged(readings: Observations) -> StandsAveraged:
    """Average the readings of each stand, where more is stated of a position than they scatter by.

    A mean is as uncertain as is stated of one reading. Readings stay as they are where few are
    repeated, or where they scatter by about what is stated or not at all. A reading far off the
    others of its stand is in no mean, and a stand whose readings contradict each other has none.
    """
    stand = standing(readings)
    scatter_m = _scatter_m(readings, stand)
    stated_m = _stated_m(readings) if scatter_m else 0.0
    if scatter_m * STANDS.stated_ratio >= stated_m:  # also where both are 0
        none_off = np.zeros(len(readings))
        return StandsAveraged(readings, np.full(len(readings), ""), none_off, ())
    off_m = _off_median_m(readings, stand)
    why = _why_left_out(off_m > STANDS.off_errors * stated_m, stand)
    used = np.flatnonzero(why == "")
    averaged = _averaged(readings.take(used), stand[used])
    without = ""
    if len(used) < len(readings):
        without = f", {len(readings) - len(used)} far off others of their stand left out"
    note = (
        f"{len(readings)} readings count as {len(averaged)}{without}: as far as the log shows, the "
        "arm did not move between those of a pose, and their scatter of "
        f"{1e3 * scatter_m:.2g} mm is the noise of a reading, not the {1e3 * stated_m:.2g} mm "
        "stated of a position"
    )
    return StandsAveraged(averaged, why, off_m, (note,))


def standing(readings: Observations) -> Index:
    """Return the number (P,), from 0 on in order of time, of each reading's stand.

    Readings of a stand follow each other in time, with the same label, kind and load and at the
    same joint positions, and no log shows that the arm came there anew. An arm that left and came
    back between two rows, without a log of its motion, cannot be told from one that stood.
    """
    order = np.argsort(readings.states.time_s, kind="stable")
    in_time = readings.take(order)
    states = in_time.states
    moved = np.abs(np.diff(states.q_rad, axis=0)).max(axis=1, initial=0.0) > ORDER.stood_still
    begins = np.ones(len(readings), dtype=bool)
    begins[1:] = moved | _came_anew(in_time)
    for labels in (in_time.pose, in_time.kind, states.load_N):
        begins[1:] |= labels[1:] != labels[:-1]
    number = np.empty(len(readings), dtype=np.intp)
    number[order] = np.cumsum(begins) - 1
    return number


def _came_anew(in_time: Observations) -> Mask:
    """Return which readings (P - 1,), from the second on, a log of joints shows the arm came to.

    Such a log gives all readings of one dwell the same mean positions, directions of arrival and
    number of samples. A dwell at which the arm did not arrive is part of the one before.
    """
    states, log = in_time.states, in_time.log
    samples = np.zeros((len(in_time), 1)) if log is None else log.samples[:, None]
    of_dwell = np.hstack([states.q_rad, states.arrival, samples])
    other_dwell = (of_dwell[1:] != of_dwell[:-1]).any(axis=1)
    return np.asarray(other_dwell & (states.arrival[1:] != 0.0).any(axis=1))


def _scatter_m(readings: Observations, stand: Index) -> float:
    """Return the standard deviation of one coordinate of a reading within stands [m].

    It is found from neighbours in time; 0 where too few are repeated, or all are equal.
    """
    order = np.lexsort((readings.states.time_s, stand))
    first = np.flatnonzero(np.diff(stand[order]) == 0)  # of two neighbours in the same stand
    places_m = _coordinates_m(readings)
    apart_m = np.abs(places_m[order[first + 1]] - places_m[order[first]])
    if np.isfinite(apart_m).any(axis=1).sum() < STANDS.least_pairs:
        return 0.0
    # Of readings in few digits most differ by nothing. The mean times the factor of the median is
    # 0.9 of their scatter then; the factor of a normal mean would give less still.
    usual_m = float(np.nanmedian(apart_m)) or float(np.nanmean(apart_m))
    return MEDIAN_TO_SIGMA * usual_m / float(np.sqrt(2.0))


def _stated_m(readings: Observations) -> float:
    """Return the standard uncertainty stated of one coordinate of a position, their median [m]."""
    measured = readings.measured
    at = measured.position_columns
    variance_m2 = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)[:, at]
    return float(np.sqrt(np.median(variance_m2[measured.components_seen[:, at]])))


def _off_median_m(readings: Observations, stand: Index) -> Array:
    """Return how far each reading (P,) is off the median of its stand, at most of its coordinates.

    A coordinate that fewer readings of the stand have than tell which of them is off counts as 0.
    """
    places_m = pd.DataFrame(_coordinates_m(readings))
    of_stands = places_m.groupby(stand)
    judged = of_stands.transform("count") >= STANDS.least_for_median
    off_m = (places_m - of_stands.transform("median")).abs().where(judged)
    return np.asarray(off_m.max(axis=1).fillna(0.0))


def _why_left_out(off: Mask, stand: Index) -> NDArray[np.str_]:
    """Return why readings (P,), `off` the median of their stand or not, are left out; "" if not.

    Where less than half of a stand are near its median, that lies between groups that contradict
    each other, and none of them is known to be right.
    """
    near_share = np.bincount(stand, ~off) / np.bincount(stand)
    disagrees = near_share[stand] < 0.5
    return np.select([disagrees, off], [STAND_DISAGREES, OFF_STAND], default="")


def _averaged(readings: Observations, stand: Index) -> Observations:
    """Return the mean of the readings of each stand, as certain as one of them is stated."""
    _, first, number = np.unique(stand, return_index=True, return_inverse=True)
    return replace(
        average_groups(readings, number),
        measured=readings.measured.averaged_at_rest(number),
        readings=readings.readings[first],
        log=None if readings.log is None else readings.log.take(first),
        base=None if readings.base is None else readings.base.take(first),
    )


def _coordinates_m(readings: Observations) -> Array:
    """Return the measured coordinates of all targets (P, k), or distances; nan where not seen."""
    return readings.measured.places_m.reshape(len(readings), -1)
