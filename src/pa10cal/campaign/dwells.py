"""Where an arm stood, and a target that is read while it moves; the clocks of their two logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import label, median_filter
from scipy.special import stdtrit

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, spread, taken
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.raw_rows import QUATERNION, RawRows

#: Speeds are taken over at least this time, so that noise of a fast log is no movement. Dwells are
#: found shorter than they are by as much at both ends; brief ones are sought over a shorter time.
SPEED_WINDOW_S, BRIEF_WINDOW_S = 0.3, 0.1
#: A standing arm may creep no further between two samples than at the still speed in this time.
CREEP_S = 1.0
#: An interval this many times the usual one is a pause of the log.
PAUSE = 5.0
#: Movements beyond so many noise sigmas, and beyond the still speed in so much time, are real.
REAL_SIGMAS = 10.0
REAL_S = 0.1
#: Times by which clocks are compared, where there are more.
COMPARED = 250


@dataclass(frozen=True)
class Samples:
    """Samples of the log of an arm with n joints, in order of time."""

    line: NDArray[np.int64]  # (N,) physical line in the file
    time_s: Array  # (N,) time
    q_deg: Array  # (N, n) motor-side joint positions after the gear ratio
    tau_Nm: Array  # (N, n) torques that hold the arm; nan where not logged
    temperature_C: Array  # (N,) temperature; nan where not logged

    def __len__(self) -> int:
        return len(self.line)


@dataclass(frozen=True)
class Stations:
    """Where an arm with n joints stood, K places in order, and what was logged there."""

    start_s: Array  # (K,) when it came
    end_s: Array  # (K,) when it went on
    first: Index  # (K,) sample at which each begins
    of_sample: Index  # (N,) station of every sample, -1 while the arm moved
    samples: NDArray[np.int64]  # (K,) samples of it
    q_deg: Array  # (K, n) mean joint positions [deg, mm]
    # (K, n) standard uncertainties of these means, from the scatter; nan of a single sample
    q_u_deg: Array
    tau_Nm: Array  # (K, n) mean torques; nan where not logged
    tau_u_Nm: Array  # (K, n) standard uncertainties of these means
    temperature_C: Array  # (K,) mean temperature; nan where not logged
    # (K, n) sign of each joint's last real movement in the logged approach; 0 where it made none
    arrival: Array

    def __len__(self) -> int:
        return len(self.first)

    def at(self, time_s: Array) -> Index:
        """Return the station at each time, -1 where the arm moved or nothing was logged."""
        if not len(self):
            return np.full(len(time_s), -1)
        before = np.searchsorted(self.start_s, time_s, side="right") - 1
        inside = (before >= 0) & (time_s <= self.end_s[before])
        return np.where(inside, before, -1)


def find_dwells(
    samples: Samples, still_speed_deg_s: float, window_s: float = SPEED_WINDOW_S
) -> Stations:
    """Find dwells: at least two successive samples in which every joint is slower than allowed.

    The limit is `ingest.still_speed_deg_s`, of speeds over `window_s` at least.

    The direction of arrival is that of the last movement larger than noise: the sign of the dwell's
    mean position minus that of the latest sample of the approach that differs from it by more. The
    approach is what was logged since the dwell before.
    """
    time_s, q_deg = samples.time_s, samples.q_deg
    steps_s = np.diff(time_s)
    travel = np.abs(np.diff(q_deg, axis=0))
    slow = _slow_intervals(time_s, q_deg, still_speed_deg_s, window_s)
    # The deviation of one reading, from differences of neighbours at rest.
    noise = MEDIAN_TO_SIGMA * np.median(travel[slow], axis=0) / np.sqrt(2.0) if slow.any() else 0.0
    least = np.full(q_deg.shape[1], REAL_S * still_speed_deg_s)
    real_deg = np.maximum(REAL_SIGMAS * noise, least)
    if len(steps_s):
        pause = steps_s > PAUSE * np.median(steps_s)
        slow &= ~pause | (travel <= real_deg).all(axis=1)
    # Each slow interval is of the dwell of both its ends; its number from 1, 0 while the arm moved.
    number = label(slow)[0]
    of_sample = np.maximum(np.append(number, 0), np.append(0, number)) - 1
    stands = np.flatnonzero(of_sample >= 0)
    dwell = of_sample[stands]
    _, begins, count = np.unique(dwell, return_index=True, return_counts=True)
    first = stands[begins]
    mean_deg, q_u_deg = _mean(q_deg[stands], dwell, count)
    tau_Nm, tau_u_Nm = _mean(samples.tau_Nm[stands], dwell, count)
    temperature_C, _ = _mean(samples.temperature_C[stands, None], dwell, count)
    return Stations(
        time_s[first],
        time_s[first + count - 1],
        first,
        of_sample,
        count,
        mean_deg,
        q_u_deg,
        tau_Nm,
        tau_u_Nm,
        temperature_C[:, 0],
        _arrival(q_deg, np.flatnonzero(of_sample < 0), first, mean_deg, real_deg),
    )


def best_clock_offset(time_s: Array, stations: Stations) -> tuple[float, float]:
    """Find the offset of the clock of touches (N,) that brings most of them into dwells.

    Where a range of offsets does, it is its middle, and of several ranges that nearest to zero. The
    part of the touches that then lies in dwells is returned with it.
    """
    ranges = offset_ranges(stations, time_s)
    offset_s = min((0.5 * (low + high) for low, high in ranges), key=abs)
    return offset_s, float(np.mean(stations.at(time_s + offset_s) >= 0))


def offset_ranges(
    stations: Stations, time_s: Array, nearly: float = 1.0
) -> list[tuple[float, float]]:
    """Return ranges of clock offsets that bring the most times (N,) into stations, the best first.

    Every time and station allow a range of offsets; those that most times share are found along the
    ends of all, in order. Of many times some stand for all. Ranges count that bring in `nearly` as
    many as the best does, each by its best part.
    """
    some = spread(len(time_s), COMPARED)
    low = (stations.start_s[:, None] - time_s[some]).ravel()
    high = (stations.end_s[:, None] - time_s[some]).ravel()
    ends = np.concatenate([low, high])
    order = np.argsort(ends, kind="stable")
    count = np.cumsum(np.where(order < len(low), 1, -1))
    allowed = count[:-1] >= nearly * count.max()
    found = []
    for run in _runs(np.flatnonzero(allowed)):
        best = run[count[run] == count[run].max()]
        bounds = [(ends[order[part[0]]], ends[order[part[-1] + 1]]) for part in _runs(best)]
        widest = max(bounds, key=lambda ends: ends[1] - ends[0])
        found.append((-int(count[best[0]]), widest[0] - widest[1], widest))
    return [bounds for _, _, bounds in sorted(found)]


def _runs(numbers: Index) -> list[Index]:
    """Return runs of neighbouring numbers."""
    return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)


def _slow_intervals(
    time_s: Array, q_deg: Array, still_speed_deg_s: float, window_s: float
) -> NDArray[np.bool_]:
    """Return (N-1,) whether the arm stood still between neighbouring samples."""
    count = len(time_s)
    here = np.arange(count - 1)
    there = np.searchsorted(time_s, time_s[:-1] + window_s)
    there = np.clip(there, here + 1, count - 1)
    allowed = still_speed_deg_s * np.minimum(time_s[there] - time_s[here], CREEP_S)
    moves = np.abs(q_deg[there] - q_deg[here]).max(axis=1, initial=0.0) > allowed
    edges = np.zeros(count, dtype=int)
    np.add.at(edges, here[moves], 1)
    np.add.at(edges, there[moves], -1)
    return np.asarray(np.cumsum(edges)[:-1] == 0)


def _mean(values: Array, dwell: Index, count: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the mean over each dwell and its standard uncertainty, (D, m) each."""
    mean = np.zeros((len(count), values.shape[1]))
    np.add.at(mean, dwell, values)
    mean /= count[:, None]
    square = np.zeros_like(mean)
    np.add.at(square, dwell, (values - mean[dwell]) ** 2)
    return mean, np.sqrt(square / (count * (count - 1))[:, None])


def _arrival(q_deg: Array, moving: Index, first: Index, mean_deg: Array, real_deg: Array) -> Array:
    """Return the direction (K, n) of arrival at stations that begin at some samples."""
    following = np.searchsorted(first, moving)
    moving, following = moving[following < len(first)], following[following < len(first)]
    way = mean_deg[following] - q_deg[moving]
    rows, joints = np.nonzero(np.abs(way) > real_deg)
    latest = np.full(mean_deg.shape, -1)
    np.maximum.at(latest, (following[rows], joints), rows)
    signs = np.sign(way)
    last = np.take_along_axis(signs, np.maximum(latest, 0), axis=0) if len(way) else latest
    return np.where(latest >= 0, last, 0.0)


# Where the arm stood when readings were taken by another instrument.

#: A log with so many times the rows of the other holds the motion, not one row a pose.
DENSE = 3.0
#: A standing joint's read-back may scatter by so many times what most of its small steps are.
SCATTER = 6.0
#: Part of the rows at which the arm surely stands; and the least part, by which the scatter is at
#: most so many times as large.
STANDS, BRIEFLY, SCATTER_BRIEFLY = 0.2, 0.05, 1.8


def scatter_at_rest(travel: Array) -> float:
    """Return how far apart two readings of what stands may be, by all (N,) that follow each other.

    The median of the smaller ones is motion where the arm stands for a part of the time alone.
    """
    small = travel[travel <= np.quantile(travel, 2.0 * STANDS)]
    briefly = SCATTER_BRIEFLY * float(np.quantile(travel, BRIEFLY))
    return SCATTER * min(float(np.median(small)), briefly)


def stations_of(
    samples: Samples, readings: int, still_deg_s: float, window_s: float = SPEED_WINDOW_S
) -> Stations:
    """Return where the arm stood: the dwells of a log of motion, or every row of a list of poses.

    The still speed is raised to the scatter of the joints' read-back.
    """
    if len(samples) >= DENSE * readings:
        step_s = np.diff(samples.time_s)
        travel = np.abs(np.diff(samples.q_deg, axis=0)).max(axis=1, initial=0.0)
        scatter_deg_s = scatter_at_rest(travel) / max(window_s, float(np.median(step_s)))
        dwells = find_dwells(samples, max(still_deg_s, scatter_deg_s), window_s)
        if len(dwells) >= 2:
            return dwells
    half_s = 0.45 * np.diff(samples.time_s, prepend=np.nan, append=np.nan)
    usual = float(np.nanmedian(half_s)) if len(samples) > 1 else 1.0
    unknown, rows = np.full(samples.q_deg.shape, np.nan), np.arange(len(samples))
    return Stations(
        samples.time_s - np.fmin(half_s[:-1], usual),
        samples.time_s + np.fmin(half_s[1:], usual),
        rows,
        rows,
        np.ones(len(samples), dtype=np.int64),
        samples.q_deg,
        unknown,
        samples.tau_Nm,
        unknown,
        samples.temperature_C,
        np.zeros(samples.q_deg.shape),
    )


# Readings that go on while the arm moves: their dwells, and the clock that fits the joints' log.
#
# In a dwell the readings are averaged. Between two dwells both logs show the same motion: the time
# by which the nominal arm, put right at both ends, is ahead of the readings is one estimate of the
# offset of the clocks; many motions give it with its uncertainty, and how much faster one clock
# runs.

#: Readings this close in time are a stream, if there are so many.
STREAM_S, STREAM_ROWS = 0.25, 100
#: Readings that make a dwell, and the speed below which a target stands whatever the noise.
LEAST_READINGS, STILL_MM_S = 4, 0.3
#: Readings of a running median, against single stray ones.
MEDIAN = 5
#: A motion shows the offset if it is as long [m] and has so many readings.
LEAST_WAY_M, LEAST_MOVING = 0.02, 3
#: Readings beside a motion that are looked at with it [s], and of one motion at the most.
BESIDE_S, MOST_OF_A_MOTION = 0.3, 300
#: Motions that are looked at, spread over all; steps of the offset, and the longest of them [s].
MOST_MOTIONS, STEPS, LONGEST_S = 150, 6, 0.2
#: A motion is left out whose offset is so many times the usual scatter off.
STRAY = 4.0
#: Motions that show that a clock runs fast, and how sure that has to be.
LEAST_MOTIONS, SURE = 6, 3.0
REGRESSIONS = 5
#: No scatter shows less than this [s].
LEAST_U_S = 1e-4


@dataclass(frozen=True)
class Clock:
    """The joints' clock by that of the readings."""

    offset_s: float  # to add to the time of the first reading
    u_s: float  # its standard uncertainty: twice it holds 95 %; 0 where it is stated
    first_s: float  # time of the first reading
    last_s: float
    rate: float = 0.0  # by how much the joints' clock runs faster
    u_rate: float = 0.0

    def joints_s(self, time_s: Array) -> Array:
        """Return times of readings by the joints' clock."""
        return time_s + self.offset_s + self.rate * (time_s - self.first_s)

    @property
    def words(self) -> str:
        """Return it in words, after: the joints' clock is that of the readings."""
        if not self.u_s:
            return f"{self.offset_s:+.2f} s"
        digits = int(np.clip(1 - np.floor(np.log10(2.0 * self.u_s)), 2, 4))
        said = f"{self.offset_s:+.{digits}f} s ± {2.0 * self.u_s:.2g} s"
        if not self.rate:
            return said
        last_s = self.offset_s + self.rate * (self.last_s - self.first_s)
        way = "fast" if self.rate > 0.0 else "slow"
        ppm, u_ppm = 1e6 * abs(self.rate), 2e6 * self.u_rate
        return (
            f"{said} at the first of them and {last_s:+.{digits}f} s at the last: it runs "
            f"{ppm:.0f} ± {u_ppm:.2g} ppm {way}"
        )


def is_stream(time_s: Array) -> bool:
    """Return whether readings at these times go on while the arm moves."""
    known_s = np.sort(time_s[np.isfinite(time_s)])
    return len(known_s) >= STREAM_ROWS and bool(np.median(np.diff(known_s)) <= STREAM_S)


def spread_times(time_s: Array) -> Array:
    """Return times in order, spread evenly where several rows have one stamp, about its middle."""
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
    """Return to how much times were rounded: the smallest unit 1, 0.1, … s that all are wholes of.

    Whether they were rounded or cut is not known.
    """
    some = time_s[np.isfinite(time_s)][:1000]
    some = some - np.floor(some[0]) if len(some) else some
    for decimals in range(6):
        if np.abs(some - np.round(some, decimals)).max(initial=0.0) < 1e-7:
            return float(10.0**-decimals)
    return 0.0


def reading_dwells(time_s: Array, p_mm: Array, window_s: float = SPEED_WINDOW_S) -> Stations:
    """Return where a target (N, m) stood; it is not seen where a coordinate is nan."""
    seen = np.flatnonzero(np.isfinite(p_mm).all(axis=1))
    unknown = np.full((len(seen), 1), np.nan)
    smooth = median_filter(p_mm[seen], size=(MEDIAN, 1), mode="nearest")
    samples = Samples(seen, time_s[seen], smooth, unknown, unknown[:, 0])
    ahead = np.searchsorted(samples.time_s, samples.time_s + window_s)
    within = np.flatnonzero(ahead < len(seen))
    if len(within) < 2:
        return _of_all(find_dwells(samples, STILL_MM_S, window_s), seen, len(time_s))
    travel_mm = np.abs(smooth[ahead[within]] - smooth[within]).max(axis=1)
    speed_mm_s = max(STILL_MM_S, scatter_at_rest(travel_mm) / window_s)
    return _of_all(find_dwells(samples, speed_mm_s, window_s), seen, len(time_s))


def _of_all(dwells: Stations, seen: Index, count: int) -> Stations:
    """Return dwells of readings that were seen by the numbers of all; short ones are none."""
    long = np.flatnonzero(dwells.samples >= LEAST_READINGS)
    number = np.full(len(dwells) + 1, -1)
    number[long] = np.arange(len(long))
    of_all = np.full(count, -1)
    of_all[seen] = number[dwells.of_sample]
    kept = taken(dwells, long, "of_sample")
    return replace(kept, first=seen[kept.first], of_sample=of_all)


def averaged(read: RawRows, group: Index) -> RawRows:
    """Return a row for each group of readings, numbered from 0; readings of group -1 are in none.

    Numbers are averaged over those that are there, quaternions whatever their sign; texts and the
    line are those of the first.
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


def clock_by_edges(dwells: Stations, stations: Stations, station: Index) -> tuple[float, float]:
    """Return the offset at which dwells of readings begin and end with those of the joints.

    A target is seen to move later, and to stand earlier, than the joints: beginnings and ends err
    by as much in opposite directions. Its standard uncertainty is that of the scatter.
    """
    both = np.flatnonzero(station >= 0)
    late = [
        joints_s[station[both]] - readings_s[both]
        for joints_s, readings_s in (
            (stations.start_s, dwells.start_s),
            (stations.end_s, dwells.end_s),
        )
    ]
    middle = [float(np.median(each)) for each in late]
    off = np.concatenate([each - at for each, at in zip(late, middle, strict=True)])
    u_s = MEDIAN_TO_SIGMA * float(np.median(np.abs(off))) / np.sqrt(max(len(off), 1))
    return 0.5 * sum(middle), max(u_s, 0.25 * abs(middle[0] - middle[1]), LEAST_U_S)


def clock_of_motion(
    samples: Samples,
    stations: Stations,
    time_s: Array,
    p_m: Array,
    dwell: Index,
    offset_s: float,
    forward: Callable[[Array], Array],
) -> Clock | None:
    """Return the clock by which readings follow the arm from dwell to dwell; None if none tells.

    Args:
        samples: the log of the joints.
        stations: where the arm stood.
        time_s: (N,) time of each reading.
        p_m: (N, 3) place of the target, nan where not seen.
        dwell: (N,) dwell of each reading, -1 in motion.
        offset_s: about the offset.
        forward: the nominal end (P, 4, 4) at joint positions (P, n) [deg, mm].
    """
    station = np.where(dwell >= 0, stations.at(time_s + offset_s), -1)
    seen: Mask = np.asarray(np.isfinite(p_m).all(axis=1))
    rows = np.flatnonzero((station >= 0) & seen)
    count = np.bincount(station[rows], minlength=len(stations))
    known = np.flatnonzero(count >= LEAST_READINGS)
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
    first = known[:-1][np.diff(known) == 1]
    first = first[spread(len(first), MOST_MOTIONS)]
    motions = []
    for k in first.tolist():
        start_s, end_s = stations.end_s[k], stations.start_s[k + 1]
        inside = (samples.time_s >= start_s - BESIDE_S) & (samples.time_s <= end_s + BESIDE_S)
        t_s, which = np.unique(samples.time_s[inside], return_index=True)
        if len(t_s) < 2 * LEAST_MOVING:
            continue
        T = forward(samples.q_deg[inside][which])
        motions.append(_Motion(t_s, located.targets(T)[:, 0, :3, 3], off_m[k], off_m[k + 1]))
    found: Clock | None = None
    first_s, last_s = float(time_s[0]), float(time_s[-1])
    clock = Clock(offset_s, 0.0, first_s, last_s)
    for _ in range(STEPS):
        at_s = clock.joints_s(time_s)
        each = [motion.ahead(at_s, p_m, seen) for motion in motions]
        estimates = np.array(
            [(*one, m.middle_s) for one, m in zip(each, motions, strict=True) if one]
        )
        found = _regression(estimates, clock) if len(estimates) >= LEAST_MOTIONS - 1 else None
        if found is None:
            return None
        moved = abs(found.offset_s - clock.offset_s)
        clock = found
        if moved < 0.1 * LEAST_U_S:
            break
    return found


@dataclass(frozen=True)
class _Motion:
    """The nominal target from one dwell to the next."""

    time_s: Array  # (S,) of the joints' log
    p_m: Array  # (S, 3) place by the nominal arm
    off_before_m: Array  # (3,) how far the readings of the dwell before are from it
    off_after_m: Array  # (3,) and those of the dwell after

    @property
    def middle_s(self) -> float:
        return 0.5 * float(self.time_s[0] + self.time_s[-1])

    def ahead(self, at_s: Array, p_m: Array, seen: Mask) -> tuple[float, float] | None:
        """Return by what time readings at `at_s` (N,) are ahead of it, and the weight of that."""
        rows = np.flatnonzero(seen & (at_s > self.time_s[0]) & (at_s < self.time_s[-1]))
        rows = rows[spread(len(rows), MOST_OF_A_MOTION)]
        way_m = self.p_m[-1] - self.p_m[0]
        length_m = float(np.linalg.norm(way_m))
        if length_m < LEAST_WAY_M or len(rows) < LEAST_MOVING:
            return None
        spline = CubicSpline(self.time_s, self.p_m)
        modelled, speed = spline(at_s[rows]), spline(at_s[rows], 1)
        part = np.clip((modelled - self.p_m[0]) @ way_m / length_m**2, 0.0, 1.0)[:, None]
        modelled = modelled + (1.0 - part) * self.off_before_m + part * self.off_after_m
        speed = speed + (speed @ way_m / length_m**2)[:, None] * (
            self.off_after_m - self.off_before_m
        )
        left = p_m[rows] - modelled
        size = np.linalg.norm(left, axis=1)
        weight = np.minimum(1.0, 5.0 * np.median(size) / np.maximum(size, 1e-9))
        power = float(weight @ np.sum(speed**2, axis=1))
        if power <= 0.0:
            return None
        late = float(weight @ np.sum(speed * left, axis=1)) / power
        return float(np.clip(late, -LONGEST_S, LONGEST_S)), power


def _regression(estimates: Array, clock: Clock) -> Clock | None:
    """Return a clock put right by estimates (M, 3): time ahead, weight, time by the joints' clock.

    Strays are left out. The uncertainties are those of the scatter about the line, whatever the
    weights are worth.
    """
    late, weight, at_s = estimates.T
    at_s = at_s - clock.first_s - clock.offset_s  # since the first reading
    off = late - np.median(late)
    for _ in range(REGRESSIONS):
        scatter_s = MEDIAN_TO_SIGMA * float(np.median(np.abs(off)))
        keep = np.abs(off) <= STRAY * max(scatter_s, LEAST_U_S)
        count = int(keep.sum())
        if count < LEAST_MOTIONS - 1:
            return None
        w = np.where(keep, weight, 0.0) / weight[keep].sum()
        centre_s = float(w @ at_s)
        from_centre = at_s - centre_s
        level, broad = float(w @ late), float(w @ from_centre**2)
        slope = float(w @ (from_centre * late)) / broad if broad > 0.0 else 0.0
        off = late - level - slope * from_centre
    few = float(stdtrit(count - 2, 0.975) / stdtrit(1000, 0.975))
    scale = few * np.sqrt(count / (count - 2))
    u_level = scale * float(np.sqrt(w**2 @ off**2))
    u_slope = scale * float(np.sqrt(w**2 @ (from_centre * off) ** 2)) / broad if broad else np.inf
    rate = clock.rate + slope
    if abs(rate) <= SURE * u_slope:
        # One offset for all; of clocks that run apart unseen it is that in the middle.
        offset_s = clock.offset_s + clock.rate * centre_s + level
        return replace(clock, offset_s=offset_s, u_s=max(u_level, LEAST_U_S), rate=0.0)
    offset_s, u_s = clock.offset_s + level - slope * centre_s, np.hypot(u_level, u_slope * centre_s)
    return replace(
        clock, offset_s=offset_s, u_s=max(float(u_s), LEAST_U_S), rate=rate, u_rate=u_slope
    )
