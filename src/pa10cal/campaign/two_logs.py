"""A log of joints: where the arm stood, what was logged there; joined with a log of readings.

The arm's stations are the dwells of a log of motion, or every row of a list of poses. Readings
belong to them by row, by label, or by time with two clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import label

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.campaign.base_motion import base_target_names
from pa10cal.campaign.bounds import LEAST_U, unwrapped
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription, Join
from pa10cal.campaign.nominal_fit import (
    EXPECTED_SHIFTED_M,
    Fit,
    nominal_fit,
    refuse_shifted,
    shifted,
)
from pa10cal.campaign.own_columns import OwnWords
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import RawRows, in_radians, position_columns
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import RawColumns

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


def find_dwells(samples: Samples, still_speed_deg_s: float) -> Stations:
    """Find dwells: at least two successive samples in which every joint is slower than allowed.

    The limit is `ingest.still_speed_deg_s`.

    The direction of arrival is that of the last movement larger than noise: the sign of the dwell's
    mean position minus that of the latest sample of the approach that differs from it by more. The
    approach is what was logged since the dwell before.
    """
    time_s, q_deg = samples.time_s, samples.q_deg
    steps_s = np.diff(time_s)
    travel = np.abs(np.diff(q_deg, axis=0))
    slow = _slow_intervals(time_s, q_deg, still_speed_deg_s)
    # The deviation of one reading, from differences of neighbours at rest.
    noise = 1.4826 * np.median(travel[slow], axis=0) / np.sqrt(2.0) if slow.any() else 0.0
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
    some = np.unique(np.linspace(0, len(time_s) - 1, min(len(time_s), COMPARED)).astype(int))
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

#: Times beyond are counted from 1970, not from the first reading [s].
SINCE_1970 = 1e8
#: Columns that either log may have, and that are made where neither does.
LABELS = ("time_s", "pose", "load_N", "repeat", "kind")

#: A log with so many times the rows of the other holds the motion, not one row a pose.
DENSE = 3.0
#: A standing joint's read-back may scatter by so many times what most of its small steps are.
SCATTER = 6.0
#: Part of the rows at which the arm surely stands.
STANDS = 0.2
#: Clocks are tried that bring so large a part of the readings into steady phases as the best does.
NEARLY = 0.85
CANDIDATES = 12


def stations_of(samples: Samples, readings: int, still_deg_s: float) -> Stations:
    """Return where the arm stood: the dwells of a log of motion, or every row of a list of poses.

    The still speed is raised to the scatter of the joints' read-back.
    """
    if len(samples) >= DENSE * readings:
        step_s = np.diff(samples.time_s)
        travel = np.abs(np.diff(samples.q_deg, axis=0)).max(axis=1, initial=0.0)
        small = travel[travel <= np.quantile(travel, 2.0 * STANDS)]
        scatter_deg_s = (
            SCATTER * float(np.median(small)) / max(SPEED_WINDOW_S, float(np.median(step_s)))
        )
        dwells = find_dwells(samples, max(still_deg_s, scatter_deg_s))
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


def clock_offset(stations: Stations, time_s: Array, fit: Fit) -> tuple[float, float]:
    """Return what to add to the times (N,) of readings for those of the joints, and its deviation.

    Offsets that bring most readings to stations are compared by the nominal arm: a plan whose poses
    take equally long fits as well a pose later, the positions do not.
    """
    known_s = time_s[np.isfinite(time_s)]
    if not len(known_s):
        return 0.0, 0.0
    allowed = offset_ranges(stations, known_s, NEARLY)
    tried = []
    for low, high in allowed[:CANDIDATES]:
        middle = 0.5 * (low + high)
        station = stations.at(time_s + middle)
        inside = np.flatnonzero(station >= 0)
        residual_m = fit(inside, station[inside], len(inside)) if len(allowed) > 1 else None
        size = np.inf if residual_m is None else float(np.median(residual_m))
        tried.append((size, -len(inside), middle, high - low))
        if size < EXPECTED_SHIFTED_M:
            break  # offsets that bring in fewer readings need not be tried
    best_m = min(size for size, *_ in tried)
    near = [offset for offset in tried if offset[0] <= 1.5 * best_m or not np.isfinite(best_m)]
    _, _, offset_s, width_s = min(near, key=lambda offset: (offset[1], offset[0]))
    return float(offset_s), float(width_s / np.sqrt(12.0))


def by_label(joints: NDArray[np.str_], readings: NDArray[np.str_]) -> Index:
    """Return the row of the joints under each reading's label, -1 where there is none.

    Of a label that both logs have several times, the k-th reading has the k-th joints; joints that
    were logged once are those of all readings under their label.
    """
    logged = pd.DataFrame({"label": joints.astype(str), "row": np.arange(len(joints))})
    read = pd.DataFrame({"label": readings.astype(str)})
    for table in (logged, read):
        table["number"] = table.groupby("label").cumcount()
    once = logged[~logged["label"].duplicated(keep=False)].set_index("label")["row"]
    of_many = read.merge(logged, how="left", on=["label", "number"])["row"]
    station = read["label"].map(once).fillna(of_many)
    return station.fillna(-1).to_numpy(dtype=np.intp)


def _uncertainties(
    logged: RawRows, stations: Stations, names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return the uncertainties (K,) of joint positions, and of torques where named, by column.

    They are those that the log states, else what the samples of a dwell scatter by. Equal samples
    of a coarse read-back show no scatter, which says nothing.
    """
    scatter = np.hstack([stations.q_u_deg, stations.tau_u_Nm])[:, : len(names)]
    scatter = np.where(scatter >= LEAST_U, scatter, np.nan)
    columns = [f"u_{name}" for name in names]
    stated = pd.DataFrame(logged.numbers_of(columns)).groupby(stations.of_sample).mean()
    mean = stated.reindex(range(len(stations))).to_numpy()
    return dict(zip(columns, np.where(np.isfinite(mean), mean, scatter).T, strict=True))


# Two files read as one: rows of the readings, each with the joints it was taken at.

#: Why a reading has no joint positions, by what joins the two logs.
NOT_JOINED = {
    "time": "the arm did not stand still then, by the log of its joints",
    "label": "the log of the joints has no such label",
    "row": "the log of the joints has no such row",
}


@dataclass(frozen=True)
class TwoLogs:
    """The joints' log and the readings' log of a campaign, read as one file of poses."""

    joints: RawFile
    readings: RawFile
    campaign: CampaignDescription
    arm: Arm
    still_deg_s: float  # `ingest.still_speed_deg_s`

    @classmethod
    def of(
        cls, campaign: CampaignDescription, folder: Path, arm: Arm, still_deg_s: float
    ) -> TwoLogs:
        """Return the two logs that campaign.yaml names."""
        joints, readings = (
            RawFile.of(campaign, folder, key, arm.prismatic) for key in ("joints", "readings")
        )
        return cls(joints, readings, campaign, arm, still_deg_s)

    @property
    def path(self) -> Path:
        """Return the file of the readings, whose lines messages name."""
        return self.readings.path

    @property
    def names(self) -> list[str]:
        """Return the columns of the contract that the two have between them."""
        return list(dict.fromkeys((*self.readings.names, *self.joints.names)))

    @property
    def measured_columns(self) -> RawColumns:
        """Return the columns that hold what was measured."""
        names = [name for name in self.readings.names if base_target_names([name]) == ()]
        return self.campaign.instrument.type.raw_columns(names)

    @property
    def in_degrees(self) -> Sequence[str]:
        """Return the columns of angles of orientations that are said to be in degrees."""
        return self.readings.in_degrees

    @property
    def words(self) -> OwnWords:
        """Return what the files call their columns."""
        return OwnWords({**self.joints.sources, **self.readings.sources})

    def read(
        self, required: Sequence[str], optional: Sequence[str] = (), together: Sequence[str] = ()
    ) -> RawRows:
        """Read columns of the contract, joined; those `together` all or none (`RawFile.read`)."""
        self._refuse_exchanged()
        q = position_columns(self.arm.prismatic)
        of_joints = {*q, *together, *(f"u_{name}" for name in (*q, *together))}
        own, theirs = set(self.readings.names), set(self.joints.names)
        there = [name for name in required if name not in of_joints]
        # Labels that the joints' log has, or that are made; `kind` is never made.
        labels = [
            name
            for name in there
            if name in LABELS and name not in own and (name != "kind" or name in theirs)
        ]
        read = self.readings.read(
            [name for name in there if name not in labels],
            [name for name in optional if name not in of_joints],
        )
        logged, samples = self._joints_logged(q, together)
        station, stations, note = self._joined(read, logged, samples)
        at = np.maximum(station, 0)
        first = stations.first[at]
        columns, non_numeric = dict(read.columns), dict(read.non_numeric)
        columns |= zip(q, stations.q_deg[at].T, strict=True)
        further = dict(zip(together, stations.tau_Nm.T, strict=False))
        further |= _uncertainties(logged, stations, [*q, *together])
        for name, values in further.items():
            if name in (*together, *optional) and np.isfinite(values).any():
                columns[name] = values[at]
        logged_C = bool(np.isfinite(stations.temperature_C).all())
        if "temperature_C" in optional and "temperature_C" not in columns and logged_C:
            columns["temperature_C"] = stations.temperature_C[at]
        counted = {"load_N": 0.0 * first, "time_s": np.arange(float(len(first)))}
        for name in labels:
            # Poses and repeats that neither log has are made of the joint positions.
            if name in logged.columns:
                columns[name] = logged[name][first]
                unread, lines = logged.non_numeric.get(name, {}), logged.line[first].tolist()
                of_row = zip(read.line.tolist(), lines, strict=True)
                non_numeric[name] = {row: unread[line] for row, line in of_row if line in unread}
            elif name in counted:
                columns[name] = counted[name]
        if "time_s" in columns and np.nanmin(columns["time_s"], initial=np.inf) >= SINCE_1970:
            columns["time_s"] = columns["time_s"] - np.nanmin(columns["time_s"])
        columns |= {f"arrival{k}": v[at] for k, v in enumerate(stations.arrival.T, start=1)}
        columns["dwell_samples"] = stations.samples[at]
        whole = replace(
            read,
            columns=columns,
            non_numeric=non_numeric,
            totals={**read.totals, **logged.totals},
            unused=(*read.unused, *logged.unused),
            quarantined=(*read.quarantined, *logged.quarantined),
            own={**logged.own, **read.own},
            notes=(note, *logged.notes),
        )
        return whole.take(station >= 0, NOT_JOINED[self._by])

    def _refuse_exchanged(self) -> None:
        """Stop when each of the two files has the columns that are mapped of the other."""
        of_joints, of_readings = self.joints.own_names, self.readings.own_names
        headers = self.joints.header, self.readings.header
        lacks, others_lack = set(of_joints) - set(headers[0]), set(of_readings) - set(headers[1])
        swapped = set(of_joints) <= set(headers[1]) and set(of_readings) <= set(headers[0])
        if lacks and others_lack and swapped:
            missing = ", ".join(name for name in of_joints if name in lacks)
            raise RawDataError(
                f"missing columns {missing}, which {self.readings.path.name} has",
                where=f"{self.joints.path}:1",
                value=", ".join(headers[0]),
                allowed=f"the columns of columns.joints in files.joints: {', '.join(of_joints)}",
                remedy="exchange files.joints and files.readings in campaign.yaml",
            )

    def _joints_logged(self, q: Sequence[str], together: Sequence[str]) -> tuple[RawRows, Samples]:
        """Read the joints' log, in order of time where it is joined by time."""
        text = [name for name in LABELS if name in self.joints.names]
        uncertain = [f"u_{name}" for name in (*q, *together)]
        raw = self.joints.read([*q, *text], ["temperature_C", *uncertain], together)
        logged = [*q, *(name for name in together if name in raw.columns)]
        raw = raw.finite([*logged, *(["time_s"] if "time_s" in text else [])])
        raw = raw.finite([name for name in uncertain if name in raw.columns], may_be_blank=True)
        if not len(raw):
            value = raw.quarantined[0].reason if raw.quarantined else None
            raise RawDataError(
                "no row of the joints' log can be used",
                where=str(self.joints.path),
                value=value,
                allowed="rows of joint positions",
                remedy="correct columns.joints",
            )
        raw = unwrapped(raw, q, self.arm)
        time_s = raw["time_s"] if "time_s" in text else np.arange(float(len(raw)))
        if self._by == "time":
            order = np.argsort(time_s, kind="stable")
            raw, time_s = raw.at(order), time_s[order]
        tau_Nm = raw.numbers_of([f"tau{k}_Nm" for k in range(1, len(q) + 1)])
        temperature_C = raw.numbers_of(["temperature_C"])[:, 0]
        return raw, Samples(raw.line, time_s, raw.numbers_of(q), tau_Nm, temperature_C)

    @property
    def _by(self) -> Literal["row", "label", "time"]:
        """Return what joins the two: what campaign.yaml says, else labels, times or rows."""
        both = set(self.joints.names) & set(self.readings.names)
        stated = None if self.campaign.join is None else self.campaign.join.by
        return stated or ("label" if "pose" in both else "time" if "time_s" in both else "row")

    def _joined(
        self, read: RawRows, logged: RawRows, samples: Samples
    ) -> tuple[Index, Stations, str]:
        """Return the station of each reading, the stations, and how they are joined, in words."""
        join, count, by = self.campaign.join or Join(), len(read), self._by
        stations = stations_of(samples, count if by == "time" else len(samples), self.still_deg_s)
        fit = self._fit(read, stations)
        files = f"{self.joints.path.name} and {self.readings.path.name}"
        if by == "time":
            time_s, stated_s = read["time_s"], join.clock_offset_s
            offset_s, u_s = stated_s, 0.0
            if offset_s is None:
                offset_s, u_s = clock_offset(stations, time_s, fit)
            station = stations.at(time_s + offset_s)
            inside = int((station >= 0).sum())
            if 2 * inside <= count:
                raise self._apart(inside, stations, time_s, fit)
            u = "" if stated_s is not None else f" ± {2.0 * u_s:.2g} s"
            note = (
                f"{files} joined by time: the joints' clock is that of the readings "
                f"{offset_s:+.2f} s{u}; {inside} of {count} readings lie in "
                f"{len(stations)} steady phases"
            )
            return station, stations, note
        if by == "label":
            station = by_label(logged.text_of("pose"), read.text_of("pose"))
        else:
            station = np.where(np.arange(count) < len(stations), np.arange(count), -1)
        if (shift := shifted(station, len(stations), fit)) is not None:
            joints, joined = self.joints.path.name, f"as they are joined by {by}"
            refuse_shifted(shift, self.readings.path, read.line, joined, joints)
        if by == "row" and count != len(stations):
            value = f"{count} readings and {len(stations)} rows of joints"
            raise RawDataError(
                "the two logs have different numbers of rows, and nothing else joins them",
                where=str(self.readings.path),
                value=value,
                allowed="one row of joints for each reading, or labels or times in both",
                remedy="exclude the rows that the other lacks, or map a time or a label",
            )
        return station, stations, f"{files} joined by {by}"

    def _fit(self, read: RawRows, stations: Stations) -> Fit:
        """Return how far readings are from the nominal arm, base and target fitted."""
        measured, instrument = self.measured_columns, self.campaign.instrument.type
        values = read.numbers_of(measured.names)
        usable = np.asarray(measured.may_be_blank | np.isfinite(values).all(axis=1))
        for unusable in instrument.unusable(measured, values):
            usable &= ~unusable.rows
        unknown = np.full(values.shape, np.nan)
        seen = instrument.from_raw(measured, values, unknown, self.campaign.stated)
        T_base_ee = Chain.of(self.arm).forward(in_radians(stations.q_deg, self.arm.prismatic))
        return nominal_fit(seen, T_base_ee, usable)

    def _apart(self, inside: int, stations: Stations, time_s: Array, fit: Fit) -> RawDataError:
        """Return the refusal of readings of which few lie where the arm stood."""
        stated_s = None if self.campaign.join is None else self.campaign.join.clock_offset_s
        offset = "the best offset of the clocks" if stated_s is None else f"{stated_s:+g} s"
        value = f"{inside} of {len(time_s)} readings lie where the arm stood, at {offset}"
        where = str(self.readings.path)
        remedy = (
            "check that both logs are of the same run, and the units and formats of "
            "columns.joints.time and columns.readings.time"
        )
        if stated_s is not None:
            other_s, _ = clock_offset(stations, time_s, fit)
            if 2 * (stations.at(time_s + other_s) >= 0).sum() > len(time_s):
                where = f"{self.readings.path.parent / DESCRIPTION_FILE}: join.clock_offset_s"
                remedy = f"remove join.clock_offset_s: it is then found, {other_s:+.2f} s"
        return RawDataError(
            "the two logs cannot be joined by time",
            where=where,
            value=value,
            allowed="readings taken while the arm stands still",
            remedy=remedy,
        )
