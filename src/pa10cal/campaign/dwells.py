"""Where an arm stood by the log of its joints: dwells of a log of motion, or rows of a list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, spread

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
