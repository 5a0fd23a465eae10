"""Readings that go on while the arm moves: their dwells, and the clock of the joints' log.

In a dwell the readings are averaged. Between two dwells both logs show the same motion. The nominal
arm, corrected at both ends, is ahead of the readings by some time, which is one estimate of the
offset of the clocks. Many motions give the offset with its uncertainty, and the ratio of the rates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.special import stdtrit

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, spread, take_rows
from pa10cal.campaign.column_map import QUATERNION
from pa10cal.campaign.dwells import SPEED_WINDOW_S, Samples, Stations, find_dwells, scatter_at_rest
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.raw_rows import RawRows

#: Readings of a dwell, at least, and where their median interval is longer than this [s].
LEAST_READINGS, LEAST_SLOW_READINGS, SLOW_S = 4, 2, 0.15
#: A slower target is at rest whatever the noise [mm/s].
STILL_MM_S = 0.3
#: Readings of the running median that suppresses single outliers, and where a dwell has few.
MEDIAN, MEDIAN_OF_FEW = 5, 3
#: A motion shows the offset if it is at least as long [m] and has at least so many readings.
LEAST_WAY_M, LEAST_MOVING = 0.02, 3
#: Samples within this time of a motion belong to it [s]; readings of one motion used, at most.
BESIDE_S, MOST_OF_A_MOTION = 0.3, 300
#: Motions used, at most; iterations of the clock, and the largest step of the offset [s].
MOST_MOTIONS, STEPS, LONGEST_S = 150, 6, 0.2
#: An estimate is an outlier beyond so many standard deviations of all.
STRAY = 4.0
#: Motions that a clock needs; a rate counts beyond so many of its standard uncertainties.
LEAST_MOTIONS, SURE = 6, 3.0
#: Regressions, each without the outliers of the one before.
REGRESSIONS = 5
#: Edges that scatter by less than this part of what sampling gives were sampled at one rate.
LOCKED = 0.5
#: Least standard uncertainty of an offset [s].
LEAST_U_S = 1e-4


@dataclass(frozen=True)
class Clock:
    """The joints' clock as a linear function of the readings' clock."""

    offset_s: float  # to add to the time of the first reading
    u_s: float  # its standard uncertainty, so that 2 u_s covers 95 %; 0 where it is stated
    first_s: float  # time of the first reading
    last_s: float  # time of the last reading
    rate: float = 0.0  # relative excess of the rate of the joints' clock
    u_rate: float = 0.0  # its standard uncertainty

    def joints_s(self, time_s: Array) -> Array:
        """Return times of readings by the joints' clock."""
        return time_s + self.offset_s + self.rate * (time_s - self.first_s)

    @property
    def words(self) -> str:
        """Return it in words that follow "the joints' clock is that of the readings"."""
        if not self.u_s:
            return f"{self.offset_s:+.2f} s"
        digits = int(np.clip(1 - np.floor(np.log10(2.0 * self.u_s)), 2, 4))
        offset = f"{self.offset_s:+.{digits}f} s ± {2.0 * self.u_s:.2g} s"
        if not self.rate:
            return offset
        last_s = self.offset_s + self.rate * (self.last_s - self.first_s)
        way = "fast" if self.rate > 0.0 else "slow"
        ppm, u_ppm = 1e6 * abs(self.rate), 2e6 * self.u_rate
        return (
            f"{offset} at the first of them and {last_s:+.{digits}f} s at the last: it runs "
            f"{ppm:.0f} ± {u_ppm:.2g} ppm {way}"
        )


def least_readings(time_s: Array) -> int:
    """Return how many readings at times (N,), in order, a dwell has at least."""
    slow = len(time_s) > 1 and np.median(np.diff(time_s)) > SLOW_S
    return LEAST_SLOW_READINGS if slow else LEAST_READINGS


def spread_times(time_s: Array) -> Array:
    """Return times (N,) in order; rows under one time stamp are spread evenly about it."""
    stamps, first, count = np.unique(time_s, return_index=True, return_counts=True)
    if len(stamps) == len(time_s) or len(stamps) < 3:
        return time_s
    middle = first + 0.5 * (count - 1)
    rows = np.arange(len(time_s))
    inner = np.interp(rows, middle, stamps)
    # Before the middle of the first stamp, and after that of the last, at the usual rate.
    step_s = float(np.median(np.diff(stamps) / np.diff(middle)))
    early, late = np.minimum(rows - middle[0], 0.0), np.maximum(rows - middle[-1], 0.0)
    return np.asarray(inner + step_s * (early + late))


def resolution_s(time_s: Array) -> float:
    """Return the resolution of times: the largest of 1, 0.1, … 1e-5 s of which all are multiples.

    It is 0 where there is none. Whether times were rounded or truncated is not known.
    """
    tested_s = time_s[np.isfinite(time_s)][:1000]
    tested_s = tested_s - np.floor(tested_s[0]) if len(tested_s) else tested_s
    for decimals in range(6):
        if np.abs(tested_s - np.round(tested_s, decimals)).max(initial=0.0) < 1e-7:
            return float(10.0**-decimals)
    return 0.0


def reading_dwells(time_s: Array, p_mm: Array, window_s: float = SPEED_WINDOW_S) -> Stations:
    """Return the dwells of a target measured at p_mm (N, m), nan where it was not seen."""
    seen = np.flatnonzero(np.isfinite(p_mm).all(axis=1))
    unknown = np.full((len(seen), 1), np.nan)
    least = least_readings(time_s[seen])
    median_of = MEDIAN if least == LEAST_READINGS else MEDIAN_OF_FEW
    smooth = median_filter(p_mm[seen], size=(median_of, 1), mode="nearest")
    samples = Samples(seen, time_s[seen], smooth, unknown, unknown[:, 0])
    ahead = np.searchsorted(samples.time_s, samples.time_s + window_s)
    within = np.flatnonzero(ahead < len(seen))
    if len(within) < 2:
        return _of_all(find_dwells(samples, STILL_MM_S, window_s), seen, len(time_s), least)
    way_mm = smooth[ahead[within]] - smooth[within]
    speed_mm_s = max(STILL_MM_S, scatter_at_rest(way_mm) / window_s)
    return _of_all(find_dwells(samples, speed_mm_s, window_s), seen, len(time_s), least)


def _of_all(dwells: Stations, seen: Index, count: int, least: int) -> Stations:
    """Return dwells with readings numbered among all, not among those `seen`; omit short dwells."""
    long = np.flatnonzero(dwells.samples >= least)
    number = np.full(len(dwells) + 1, -1)  # the last entry is for -1, in no dwell
    number[long] = np.arange(len(long))
    of_all = np.full(count, -1)
    of_all[seen] = number[dwells.of_sample]
    kept = take_rows(dwells, long, "of_sample")
    return replace(kept, first=seen[kept.first], of_sample=of_all)


def averaged(read: RawRows, group: Index) -> RawRows:
    """Return one row for each group of readings, numbered from 0; those of group -1 are omitted.

    Numbers are averaged, without nan; quaternions with their signs aligned. Text and line are those
    of the first reading of the group.
    """
    rows = np.flatnonzero(group >= 0)
    of_group = group[rows]
    _, first = np.unique(of_group, return_index=True)
    columns = {}
    for name, values in read.columns.items():
        if values.dtype.kind == "f":
            columns[name] = pd.Series(values[rows]).groupby(of_group).mean().to_numpy()
        else:
            columns[name] = values[rows][first]
    if set(QUATERNION) <= set(read.columns):
        quaternion = read.numbers_of(QUATERNION)[rows]
        start = quaternion[first][np.unique(of_group, return_inverse=True)[1]]
        sign = np.where(np.sum(quaternion * start, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        mean = pd.DataFrame(sign * quaternion).groupby(of_group).mean().to_numpy()
        mean = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        columns |= zip(QUATERNION, mean.T, strict=True)
    return replace(read, columns=columns, line=read.line[rows][first], non_numeric={})


def clock_by_edges(
    dwells: Stations, stations: Stations, station: Index, sampled_s: tuple[float, float]
) -> tuple[float, float]:
    """Return the clock offset by the edges of dwells, and its standard uncertainty.

    A target is found to start later, and to stop earlier, than the joints. The two edges err by the
    same time in opposite directions, so their median offsets are averaged. Edges are found to an
    interval of sampling. Logs sampled at one rate err by the same part of it at all edges: these
    scatter less than that, and their mean is no better than one.

    Args:
        dwells: R dwells of the readings.
        stations: stations of the joints.
        station: (R,) station of each dwell, -1 for none.
        sampled_s: the interval of the readings, and that of the joints' log.
    """
    both = np.flatnonzero(station >= 0)
    start_s = stations.start_s[station[both]] - dwells.start_s[both]
    end_s = stations.end_s[station[both]] - dwells.end_s[both]
    median_start_s, median_end_s = float(np.median(start_s)), float(np.median(end_s))
    off = np.concatenate([start_s - median_start_s, end_s - median_end_s])
    scatter_s = MEDIAN_TO_SIGMA * float(np.median(np.abs(off)))
    u_s = scatter_s / np.sqrt(max(len(off), 1))
    of_sampling_s = float(np.hypot(*sampled_s)) / np.sqrt(12.0)
    if scatter_s < LOCKED * of_sampling_s:
        u_s = max(u_s, of_sampling_s)
    half_difference_s = 0.25 * abs(median_start_s - median_end_s)
    return 0.5 * (median_start_s + median_end_s), max(u_s, half_difference_s, LEAST_U_S)


def clock_of_motion(
    samples: Samples,
    stations: Stations,
    time_s: Array,
    p_m: Array,
    dwell: Index,
    offset_s: float,
    forward: Callable[[Array], Array],
) -> Clock | None:
    """Return the clock with which readings follow the arm from dwell to dwell.

    None where too few motions show it.

    Args:
        samples: the log of the joints.
        stations: where the arm was at rest.
        time_s: (N,) time of each reading.
        p_m: (N, 3) place of the target, nan where not seen.
        dwell: (N,) dwell of each reading, -1 in motion.
        offset_s: the offset, approximately.
        forward: returns the nominal end (P, 4, 4) at joint positions (P, n) [deg, mm].
    """
    station = np.where(dwell >= 0, stations.at(time_s + offset_s), -1)
    seen: Mask = np.asarray(np.isfinite(p_m).all(axis=1))
    rows = np.flatnonzero((station >= 0) & seen)
    count = np.bincount(station[rows], minlength=len(stations))
    known = np.flatnonzero(count >= least_readings(time_s))
    if len(known) < LEAST_MOTIONS:
        return None
    mean_m = np.full((len(stations), 3), np.nan)
    frame = pd.DataFrame(p_m[rows]).groupby(station[rows]).median()
    mean_m[frame.index] = frame.to_numpy()
    T_stations = forward(stations.q_deg)
    located = placed_by_points(T_stations[known], mean_m[known, None])
    if located is None:
        return None
    off_m = mean_m - located.targets(T_stations)[:, 0, :3, 3]
    before = known[:-1][np.diff(known) == 1]  # stations whose next one is known, too
    motions = []
    for k in before[spread(len(before), MOST_MOTIONS)].tolist():
        start_s, end_s = stations.end_s[k], stations.start_s[k + 1]
        inside = (samples.time_s >= start_s - BESIDE_S) & (samples.time_s <= end_s + BESIDE_S)
        motion_s, which = np.unique(samples.time_s[inside], return_index=True)
        if len(motion_s) < 2 * LEAST_MOVING:
            continue
        T = forward(samples.q_deg[inside][which])
        motions.append(_Motion(motion_s, located.targets(T)[:, 0, :3, 3], off_m[k], off_m[k + 1]))
    clock = Clock(offset_s, 0.0, float(time_s[0]), float(time_s[-1]))
    for _ in range(STEPS):
        joints_s = clock.joints_s(time_s)
        estimates = []
        for motion in motions:
            estimate = motion.ahead(joints_s, p_m, seen)
            if estimate is not None:
                estimates.append((*estimate, motion.middle_s))
        if len(estimates) < LEAST_MOTIONS - 1:
            return None
        corrected = _regression(np.array(estimates), clock)
        if corrected is None:
            return None
        step_s = abs(corrected.offset_s - clock.offset_s)
        clock = corrected
        if step_s < 0.1 * LEAST_U_S:
            break
    return clock


@dataclass(frozen=True)
class _Motion:
    """The motion of the target by the nominal arm, from one dwell to the next."""

    time_s: Array  # (S,) times of the joints' log
    p_m: Array  # (S, 3) places by the nominal arm
    off_before_m: Array  # (3,) measured minus nominal place in the dwell before
    off_after_m: Array  # (3,) the same in the dwell after

    @property
    def middle_s(self) -> float:
        return 0.5 * float(self.time_s[0] + self.time_s[-1])

    def ahead(self, at_s: Array, p_m: Array, seen: Mask) -> tuple[float, float] | None:
        """Return the time by which readings are ahead of the motion, and its weight.

        Readings p_m (N, 3) were taken at `at_s` by the joints' clock. The time is the weighted
        least-squares solution of residual = speed * time; the weight is the sum of squared speeds.
        """
        rows = np.flatnonzero(seen & (at_s > self.time_s[0]) & (at_s < self.time_s[-1]))
        rows = rows[spread(len(rows), MOST_OF_A_MOTION)]
        way_m = self.p_m[-1] - self.p_m[0]
        length_m = float(np.linalg.norm(way_m))
        if length_m < LEAST_WAY_M or len(rows) < LEAST_MOVING:
            return None
        spline = CubicSpline(self.time_s, self.p_m)
        modelled, speed = spline(at_s[rows]), spline(at_s[rows], 1)
        # The correction goes from that of the dwell before to that after, by the part of the way.
        part = np.clip((modelled - self.p_m[0]) @ way_m / length_m**2, 0.0, 1.0)[:, None]
        modelled = modelled + (1.0 - part) * self.off_before_m + part * self.off_after_m
        speed = speed + (speed @ way_m / length_m**2)[:, None] * (
            self.off_after_m - self.off_before_m
        )
        residual = p_m[rows] - modelled
        size = np.linalg.norm(residual, axis=1)
        weight = np.minimum(1.0, 5.0 * np.median(size) / np.maximum(size, 1e-9))
        power = float(weight @ np.sum(speed**2, axis=1))
        if power <= 0.0:
            return None
        ahead_s = float(weight @ np.sum(speed * residual, axis=1)) / power
        return float(np.clip(ahead_s, -LONGEST_S, LONGEST_S)), power


def _regression(estimates: Array, clock: Clock) -> Clock | None:
    """Return the clock corrected by a weighted line through estimates, without outliers.

    The uncertainties follow from the scatter about the line (sandwich formula), so that they hold
    whatever the weights. None where too few estimates remain.

    Args:
        estimates: (M, 3) time ahead [s], its weight, and the time by the joints' clock [s].
        clock: the clock to correct.
    """
    ahead_s, weight, at_s = estimates.T
    at_s = at_s - clock.first_s - clock.offset_s  # since the first reading
    off = ahead_s - np.median(ahead_s)
    for _ in range(REGRESSIONS):
        scatter_s = MEDIAN_TO_SIGMA * float(np.median(np.abs(off)))
        keep = np.abs(off) <= STRAY * max(scatter_s, LEAST_U_S)
        count = int(keep.sum())
        if count < LEAST_MOTIONS - 1:
            return None
        w = np.where(keep, weight, 0.0) / weight[keep].sum()
        centre_s = float(w @ at_s)
        from_centre = at_s - centre_s
        level, variance = float(w @ ahead_s), float(w @ from_centre**2)
        slope = float(w @ (from_centre * ahead_s)) / variance if variance > 0.0 else 0.0
        off = ahead_s - level - slope * from_centre
    # Student's t of few estimates over that of many, so that twice u covers 95 %.
    of_few = float(stdtrit(count - 2, 0.975) / stdtrit(1000, 0.975))
    scale = of_few * np.sqrt(count / (count - 2))
    u_level = scale * float(np.sqrt(w**2 @ off**2))
    u_slope = np.inf
    if variance:
        u_slope = scale * float(np.sqrt(w**2 @ (from_centre * off) ** 2)) / variance
    rate = clock.rate + slope
    if abs(rate) <= SURE * u_slope:
        # No rate is significant: one offset, that in the middle of the readings.
        offset_s = clock.offset_s + clock.rate * centre_s + level
        return replace(clock, offset_s=offset_s, u_s=max(u_level, LEAST_U_S), rate=0.0)
    offset_s, u_s = clock.offset_s + level - slope * centre_s, np.hypot(u_level, u_slope * centre_s)
    return replace(
        clock, offset_s=offset_s, u_s=max(float(u_s), LEAST_U_S), rate=rate, u_rate=u_slope
    )
