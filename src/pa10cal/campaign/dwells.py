"""Dwells of the arm in a log of its joints: where it stood still, what it read, how it arrived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index

#: Speeds are taken over at least this time, so that noise of a fast log is no movement.
SPEED_WINDOW_S = 0.3
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
class Dwells:
    """Stretches of the log in which every joint stood still."""

    start_s: Array  # (D,) time of the first sample
    end_s: Array  # (D,) time of the last sample
    first: Index  # (D,) index of the first sample
    last: Index  # (D,) index of the last sample
    of_sample: Index  # (N,) dwell of every sample, -1 while the arm moved
    real_deg: Array  # (n,) movement of a joint that noise cannot feign

    def __len__(self) -> int:
        return len(self.first)

    def at(self, time_s: Array) -> Index:
        """Return the dwell at each time, -1 where the arm moved or nothing was logged."""
        return phase_at(self.start_s, self.end_s, time_s)


@dataclass(frozen=True)
class Stations:
    """Where an arm with n joints stood, K places in order, and what was logged there."""

    start_s: Array  # (K,) when it came
    end_s: Array  # (K,) when it went on
    first: Index  # (K,) sample at which each begins
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
        return phase_at(self.start_s, self.end_s, time_s)


def find_dwells(samples: Samples, still_speed_deg_s: float) -> Dwells:
    """Find where all joints were slower than `ingest.still_speed_deg_s`: two samples long."""
    time_s, q_deg = samples.time_s, samples.q_deg
    steps_s = np.diff(time_s)
    travel = np.abs(np.diff(q_deg, axis=0))
    slow = _slow_intervals(time_s, q_deg, still_speed_deg_s)
    # The deviation of one reading, from differences of neighbours at rest.
    noise = 1.4826 * np.median(travel[slow], axis=0) / np.sqrt(2.0) if slow.any() else 0.0
    least = np.full(q_deg.shape[1], REAL_S * still_speed_deg_s)
    real = np.maximum(REAL_SIGMAS * noise, least)
    if len(steps_s):
        pause = steps_s > PAUSE * np.median(steps_s)
        slow &= ~pause | (travel <= real).all(axis=1)
    edges = np.diff(np.concatenate([[False], slow, [False]]).astype(int))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    of_sample = np.full(len(time_s), -1)
    inside = np.zeros(len(time_s) + 1, dtype=int)
    inside[first] += 1
    inside[last + 1] -= 1
    standing = np.cumsum(inside[:-1]) > 0
    of_sample[standing] = np.searchsorted(first, np.flatnonzero(standing), side="right") - 1
    return Dwells(time_s[first], time_s[last], first, last, of_sample, real)


def dwell_readings(samples: Samples, dwells: Dwells) -> Stations:
    """Average the samples of every dwell and find how each joint arrived.

    The direction of arrival is that of the last movement larger than noise: the sign of the dwell's
    position minus that of the latest sample of the approach that differs from it by more than
    `Dwells.real_deg`. The approach is what was logged since the dwell before.
    """
    standing = dwells.of_sample >= 0
    dwell = dwells.of_sample[standing]
    count = np.bincount(dwell, minlength=len(dwells))
    q_deg, q_u_deg = _mean(samples.q_deg[standing], dwell, count)
    tau_Nm, tau_u_Nm = _mean(samples.tau_Nm[standing], dwell, count)
    temperature_C, _ = _mean(samples.temperature_C[standing, None], dwell, count)
    return Stations(
        dwells.start_s,
        dwells.end_s,
        dwells.first,
        count,
        q_deg,
        q_u_deg,
        tau_Nm,
        tau_u_Nm,
        temperature_C[:, 0],
        _arrival(samples.q_deg, dwells, q_deg),
    )


def best_clock_offset(time_s: Array, dwells: Dwells) -> tuple[float, float]:
    """Find the offset of the clock of touches (N,) that brings most of them into dwells.

    Where a range of offsets does, it is its middle, and of several ranges that nearest to zero. The
    part of the touches that then lies in dwells is returned with it.
    """
    ranges = offset_ranges(dwells.start_s, dwells.end_s, time_s)
    offset_s = min((0.5 * (low + high) for low, high in ranges), key=abs)
    return offset_s, float(np.mean(dwells.at(time_s + offset_s) >= 0))


def offset_ranges(
    start_s: Array, end_s: Array, time_s: Array, nearly: float = 1.0
) -> list[tuple[float, float]]:
    """Return ranges of clock offsets that bring the most times into phases, the best first.

    Every time and phase allow a range of offsets; those that most times share are found along the
    ends of all, in order. Of many times some stand for all.

    Args:
        start_s: (K,) begin of each phase, on its clock.
        end_s: (K,) end.
        time_s: (N,) times on another clock.
        nearly: ranges count that bring in this part of what the best does, each by its best part.
    """
    some = np.unique(np.linspace(0, len(time_s) - 1, min(len(time_s), COMPARED)).astype(int))
    low = (start_s[:, None] - time_s[some]).ravel()
    high = (end_s[:, None] - time_s[some]).ravel()
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


def phase_at(start_s: Array, end_s: Array, time_s: Array) -> Index:
    """Return the phase at each time, -1 where there is none."""
    if not len(start_s):
        return np.full(len(time_s), -1)
    before = np.searchsorted(start_s, time_s, side="right") - 1
    inside = (before >= 0) & (time_s <= end_s[before])
    return np.where(inside, before, -1)


def _slow_intervals(time_s: Array, q_deg: Array, still_speed_deg_s: float) -> NDArray[np.bool_]:
    """Return (N-1,) whether the arm stood still between neighbouring samples."""
    count = len(time_s)
    here = np.arange(count - 1)
    there = np.searchsorted(time_s, time_s[:-1] + SPEED_WINDOW_S)
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


def _arrival(q_deg: Array, dwells: Dwells, mean_deg: Array) -> Array:
    moving = np.flatnonzero(dwells.of_sample < 0)
    following = np.searchsorted(dwells.first, moving)
    moving, following = moving[following < len(dwells)], following[following < len(dwells)]
    way = mean_deg[following] - q_deg[moving]
    rows, joints = np.nonzero(np.abs(way) > dwells.real_deg)
    latest = np.full(mean_deg.shape, -1)
    np.maximum.at(latest, (following[rows], joints), rows)
    signs = np.sign(way)
    found = np.take_along_axis(signs, np.maximum(latest, 0), axis=0) if len(way) else latest
    return np.where(latest >= 0, found, 0.0)
