"""Where an arm stood, by the log of its joints: dwells of a motion, or every row of a list."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, spread

#: Speeds are averaged over at least this time, so that noise of a fast log is no movement. Each end
#: of a dwell is found later or earlier than it is by up to as much; for brief dwells the second.
SPEED_WINDOW_S, BRIEF_WINDOW_S = 0.3, 0.1
#: An arm at rest creeps no further between two samples than at the still speed in this time.
CREEP_S = 1.0
#: An interval of more than this many times the median one is a pause of the log.
PAUSE = 5.0
#: A movement is real beyond so many noise sigmas, and beyond the still speed for so long [s].
REAL_SIGMAS, REAL_S = 10.0, 0.1
#: Times by which clocks are compared, at most.
COMPARED = 250
#: A log with so many samples a reading is one of motion, not a list of poses.
DENSE = 3.0
#: Part of the time that the arm is at rest, at least; the quantile of steps that is scatter even
#: where it rests more briefly. Readings at rest differ by at most so many times either quantile of
#: the largest steps of several columns.
STANDS, BRIEFLY = 0.2, 0.05
SCATTER_OF_STANDS, SCATTER_BRIEFLY = 6.0, 10.8
#: Steps near zero are common where fewer columns than this scatter. Readings at rest differ there
#: by at most so many standard deviations of a step, and these by so many times the brief quantile.
FEW_COLUMNS, SCATTER_SIGMAS, MOST_OF_BRIEFLY = 2.5, 4.8, 200.0
#: Estimates of that limit until it stays, at most.
ESTIMATES = 30
#: A column is rounded to its smallest difference [deg, mm], which is no larger than this, if those
#: up to so many times it are whole numbers of it within this part.
COARSEST, SMALL, WHOLE = 1.0, 20.0, 0.05


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
    """The K stations at which an arm with n joints was at rest, in order of time."""

    start_s: Array  # (K,) time of arrival
    end_s: Array  # (K,) time of departure
    first: Index  # (K,) first sample of each
    of_sample: Index  # (N,) station of every sample, -1 while the arm moved
    samples: NDArray[np.int64]  # (K,) number of samples
    q_deg: Array  # (K, n) mean joint positions [deg, mm]
    # (K, n) standard uncertainties of these means, from the scatter; nan of a single sample
    q_u_deg: Array
    tau_Nm: Array  # (K, n) mean torques; nan where not logged
    tau_u_Nm: Array  # (K, n) standard uncertainties of these means
    temperature_C: Array  # (K,) mean temperature; nan where not logged
    # (K, n) sign of each joint's last real movement before the station; 0 where it made none
    arrival: Array

    def __len__(self) -> int:
        return len(self.first)

    def take(self, stations: Index) -> Stations:
        """Return some stations, or one several times; `of_sample` stays that of all."""
        own = (field.name for field in fields(self) if field.name != "of_sample")
        return replace(self, **{name: getattr(self, name)[stations] for name in own})

    def of_rows(self, order: Index) -> Stations:
        """Return the stations of samples that were taken in an order (N,), by their own numbers."""
        of_sample = np.empty_like(self.of_sample)
        of_sample[order] = self.of_sample
        return replace(self, first=order[self.first], of_sample=of_sample)

    def at(self, time_s: Array) -> Index:
        """Return the station (N,) at each time, -1 where the arm moved or nothing was logged."""
        if not len(self):
            return np.full(len(time_s), -1)
        before = np.searchsorted(self.start_s, time_s, side="right") - 1
        inside = (before >= 0) & (time_s <= self.end_s[before])
        return np.where(inside, before, -1)


def find_dwells(
    samples: Samples, still_speed_deg_s: float, window_s: float = SPEED_WINDOW_S
) -> Stations:
    """Find dwells: at least two successive samples in which every joint is slower than a limit.

    The limit is `ingest.still_speed_deg_s`; speeds are averaged over at least `window_s`.

    The approach of a dwell begins with the last sample of the dwell before. A joint's direction of
    arrival is the sign of its mean position in the dwell minus that of the last sample of the
    approach that differs from the mean by more than noise.
    """
    time_s, q_deg = samples.time_s, samples.q_deg
    steps_s = np.diff(time_s)
    way = np.diff(q_deg, axis=0)
    travel = np.abs(way)
    slow = _slow_intervals(time_s, q_deg, still_speed_deg_s, window_s)
    noise = _rounding(way) / np.sqrt(12.0)
    if slow.any():
        # Standard deviation of one reading: that of differences of neighbours at rest over root 2.
        of_readings = MEDIAN_TO_SIGMA * np.median(travel[slow], axis=0) / np.sqrt(2.0)
        noise = np.maximum(noise, of_readings)
    least = np.full(q_deg.shape[1], REAL_S * still_speed_deg_s)
    real_deg = np.maximum(REAL_SIGMAS * noise, least)
    if len(steps_s):
        pause = steps_s > PAUSE * np.median(steps_s)
        slow &= ~pause | (travel <= real_deg).all(axis=1)
    # Runs of slow intervals are numbered from 1; both samples of an interval belong to its dwell.
    number = label(slow)[0]
    of_sample = np.maximum(np.append(number, 0), np.append(0, number)) - 1
    at_rest = np.flatnonzero(of_sample >= 0)
    dwell = of_sample[at_rest]
    _, begins, count = np.unique(dwell, return_index=True, return_counts=True)
    first = at_rest[begins]
    last = at_rest[begins + count - 1]
    mean_deg, q_u_deg = _mean(q_deg[at_rest], dwell, count)
    tau_Nm, tau_u_Nm = _mean(samples.tau_Nm[at_rest], dwell, count)
    temperature_C, _ = _mean(samples.temperature_C[at_rest, None], dwell, count)
    return Stations(
        time_s[first],
        time_s[last],
        first,
        of_sample,
        count,
        mean_deg,
        q_u_deg,
        tau_Nm,
        tau_u_Nm,
        temperature_C[:, 0],
        _arrival(q_deg, np.union1d(np.flatnonzero(of_sample < 0), last), first, mean_deg, real_deg),
    )


def while_loaded(
    samples: Samples,
    stations: Stations,
    station: Index,
    load_N: Array,
    begin_s: Array,
    end_s: Array,
) -> Stations:
    """Return the station of each of U configurations; if its load was changed there, a part of it.

    That part is the time in which the configuration was measured, or the two samples nearest to it:
    a weight that is hung on while the arm stands changes torques, and joints a little.

    Args:
        station: (U,) station of each configuration.
        load_N: (U,) its load.
        begin_s: (U,) time of its first reading.
        end_s: (U,) time of its last reading.
    """
    found = stations.take(station)
    # A station stands here once for each of its loads.
    of_load = np.unique(np.column_stack([station, load_N]), axis=0)[:, 0]
    changed = np.flatnonzero(np.isin(station, of_load[:-1][np.diff(of_load) == 0.0]))
    parts = []
    for use in changed:
        own = np.flatnonzero(stations.of_sample == station[use])
        outside_s = np.maximum(begin_s[use] - samples.time_s[own], samples.time_s[own] - end_s[use])
        outside_s = np.maximum(outside_s, 0.0)
        furthest_s = np.sort(outside_s)[min(1, len(own) - 1)]
        parts.append(own[outside_s <= furthest_s])
    if not parts:
        return found
    count = np.array([len(part) for part in parts])
    part, rows = np.repeat(np.arange(len(parts)), count), np.concatenate(parts)
    for values, mean, u in (
        (samples.q_deg, found.q_deg, found.q_u_deg),
        (samples.tau_Nm, found.tau_Nm, found.tau_u_Nm),
    ):
        mean[changed], u[changed] = _mean(values[rows], part, count)
    found.temperature_C[changed] = _mean(samples.temperature_C[rows, None], part, count)[0][:, 0]
    found.samples[changed] = count
    first, last = np.array([part[[0, -1]] for part in parts]).T
    found.first[changed] = first
    found.start_s[changed], found.end_s[changed] = samples.time_s[first], samples.time_s[last]
    return found


def best_clock_offset(time_s: Array, stations: Stations) -> tuple[float, float]:
    """Return the clock offset that brings most touches (N,) into dwells, and their share then.

    The offset is the middle of the range of such offsets; of several ranges the nearest to zero.
    There must be one touch and one station at least.
    """
    ranges = offset_ranges(stations, time_s)
    offset_s = min((0.5 * (low + high) for low, high in ranges), key=abs)
    return offset_s, float(np.mean(stations.at(time_s + offset_s) >= 0))


def offset_ranges(
    stations: Stations, time_s: Array, nearly: float = 1.0
) -> list[tuple[float, float]]:
    """Return ranges of clock offsets that bring the most times (N,) into stations, the best first.

    Each pair of a time and a station allows an interval of offsets. Sweeping over the sorted ends
    of all intervals counts how many times an offset brings in. A range is returned where the count
    is at least `nearly` times the largest, by its part with the highest count. There is none
    without times or stations.
    """
    if not len(time_s) or not len(stations):
        return []
    some = spread(len(time_s), COMPARED)
    low = (stations.start_s[:, None] - time_s[some]).ravel()
    high = (stations.end_s[:, None] - time_s[some]).ravel()
    ends = np.concatenate([low, high])
    order = np.argsort(ends, kind="stable")
    count = np.cumsum(np.where(order < len(low), 1, -1))
    allowed = count[:-1] >= nearly * count.max()
    ranked = []  # most times first, then the widest
    for run in _runs(np.flatnonzero(allowed)):
        best = run[count[run] == count[run].max()]
        ranges = [(ends[order[part[0]]], ends[order[part[-1] + 1]]) for part in _runs(best)]
        widest = max(ranges, key=lambda bounds: bounds[1] - bounds[0])
        ranked.append((-int(count[best[0]]), widest[0] - widest[1], widest))
    return [widest for _, _, widest in sorted(ranked)]


def _runs(numbers: Index) -> list[Index]:
    """Return runs of neighbouring numbers."""
    return np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)


def _slow_intervals(time_s: Array, q_deg: Array, still_speed_deg_s: float, window_s: float) -> Mask:
    """Return (N-1,) whether the arm was at rest between neighbouring samples.

    A window of `window_s` begins at every sample. An interval that lies in any window in which a
    joint moved by more than allowed is motion.
    """
    count = len(time_s)
    begin = np.arange(count - 1)
    end = np.searchsorted(time_s, time_s[:-1] + window_s)
    end = np.clip(end, begin + 1, count - 1)
    allowed = still_speed_deg_s * np.minimum(time_s[end] - time_s[begin], CREEP_S)
    moves = np.abs(q_deg[end] - q_deg[begin]).max(axis=1, initial=0.0) > allowed
    steps = np.zeros(count, dtype=int)  # of the number of moving windows over an interval
    np.add.at(steps, begin[moves], 1)
    np.add.at(steps, end[moves], -1)
    return np.asarray(np.cumsum(steps)[:-1] == 0)


def _mean(values: Array, dwell: Index, count: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the mean of values (N, m) over each dwell, and its standard uncertainty, (D, m).

    The uncertainty is nan of a single sample.
    """
    mean = np.zeros((len(count), values.shape[1]))
    np.add.at(mean, dwell, values)
    mean /= count[:, None]
    square = np.zeros_like(mean)
    np.add.at(square, dwell, (values - mean[dwell]) ** 2)
    pairs = np.where(count > 1, count * (count - 1.0), np.nan)
    return mean, np.sqrt(square / pairs[:, None])


def _arrival(q_deg: Array, before: Index, first: Index, mean_deg: Array, real_deg: Array) -> Array:
    """Return the directions (K, n) of arrival; see `find_dwells`.

    Args:
        q_deg: (N, n) samples.
        before: samples of approaches: while the arm moved, and the last of each dwell.
        first: (K,) first sample of each dwell.
        mean_deg: (K, n) mean positions in the dwells.
        real_deg: (n,) movements above this are no noise.
    """
    following = np.searchsorted(first, before)  # dwell that follows each of them
    before, following = before[following < len(first)], following[following < len(first)]
    way_deg = mean_deg[following] - q_deg[before]
    rows, joints = np.nonzero(np.abs(way_deg) > real_deg)
    latest = np.full(mean_deg.shape, -1)
    np.maximum.at(latest, (following[rows], joints), rows)
    signs = np.sign(way_deg)
    last = np.take_along_axis(signs, np.maximum(latest, 0), axis=0) if len(way_deg) else latest
    return np.where(latest >= 0, last, 0.0)


def scatter_at_rest(way: Array) -> float:
    """Return the largest difference of two readings at rest, from differences (N, m) of readings.

    It is a multiple of a low quantile of the largest of the m differences. Where the arm rests only
    briefly that quantile is motion, and a lower one bounds it.
    """
    travel = np.abs(way).max(axis=1)
    stands, briefly = np.quantile(travel, [STANDS, BRIEFLY]).tolist()
    limit = float(min(SCATTER_OF_STANDS * stands, SCATTER_BRIEFLY * briefly))
    rounding = float(_rounding(way).max())
    if rounding or _scattering_columns(way[travel <= stands]) < FEW_COLUMNS:
        limit = max(limit, _scatter_of_few_columns(travel, briefly, rounding))
    return limit


def _scattering_columns(way: Array) -> float:
    """Return how many columns scatter, from differences at rest (N, m).

    It is m where each is as often the largest, and 1 where one always is.
    """
    largest = np.bincount(np.abs(way).argmax(axis=1))
    return float(largest.sum() ** 2 / np.sum(largest**2))


def _scatter_of_few_columns(travel: Array, briefly: float, rounding: float) -> float:
    """Return the largest difference of two readings at rest, from sizes of differences (N,).

    It is a multiple of the median of all that it does not exceed: most of those are at rest, where
    the arm rests for a part `STANDS` of the time. Where that grows until most are motion, the arm
    rests more briefly. The quantile `briefly` and the median are known to half a step of rounding.
    """
    briefly = max(briefly, 0.5 * rounding)
    limit = SCATTER_BRIEFLY * briefly
    for _ in range(ESTIMATES):
        usual = max(float(np.median(travel[travel <= limit])), 0.5 * rounding)
        before, limit = limit, SCATTER_SIGMAS * MEDIAN_TO_SIGMA * usual
        if limit > MOST_OF_BRIEFLY * briefly:
            return SCATTER_BRIEFLY * briefly
        if limit == before:
            break
    return limit


def _rounding(way: Array) -> Array:
    """Return the steps (m,) to which readings are rounded, by differences (N, m) of neighbours.

    It is 0 of a column without a rounding, or in which none shows at rest: the last digit of an arm
    that stands on the edge of a step goes there, back and there again.
    """
    found = np.zeros(way.shape[1])
    for column, changes in enumerate(way.T):
        changes = changes[changes != 0.0]
        sizes = np.abs(changes)
        step = float(sizes.min(initial=np.inf))
        small = sizes[sizes < SMALL * step] / step
        by_one = sizes < 1.5 * step
        back = by_one[1:] & by_one[:-1] & (changes[1:] * changes[:-1] < 0.0)
        is_whole = np.abs(small - np.round(small)) < WHOLE
        if step <= COARSEST and (back[1:] & back[:-1]).any() and is_whole.all():
            found[column] = step
    return found


def stations_of(
    samples: Samples, readings: int, still_deg_s: float, window_s: float = SPEED_WINDOW_S
) -> Stations:
    """Return the dwells of a log of motion, or every row of a list of poses as a station.

    A log of motion has many samples for each of the readings. Its limit of speed is raised to the
    scatter of the joints' read-back.
    """
    if len(samples) >= max(DENSE * readings, 2):
        step_s = max(window_s, float(np.median(np.diff(samples.time_s))))
        scatter = scatter_at_rest(np.diff(samples.q_deg, axis=0))
        scatter_deg_s = scatter / min(step_s, CREEP_S)
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
