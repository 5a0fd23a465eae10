"""A log of joints and a log of readings joined: by row, by label, or by time with two clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.campaign.base_motion import base_target_names
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription, Join
from pa10cal.campaign.dwells import Samples, Stations, dwell_readings, find_dwells, offset_ranges
from pa10cal.campaign.nominal_fit import EXPECTED_M, Fit, nominal_fit, refuse_shifted, shifted
from pa10cal.campaign.own_words import OwnWords
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import RawRows, in_radians, position_columns
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import RawColumns

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


@dataclass(frozen=True)
class Clocks:
    """Readings joined by time."""

    station: Index  # (N,) where the arm stood at each reading; -1 where it moved
    offset_s: float  # what to add to the time of a reading for that of the joints
    u_s: float  # its standard uncertainty: readings stay in their steady phases within it
    inside: int  # readings in steady phases


def stations_of(samples: Samples, readings: int, still_deg_s: float) -> Stations:
    """Return where the arm stood: the dwells of a log of motion, or every row of a list of poses.

    There are so many readings. The still speed is raised to what the joints' read-back scatters.
    """
    if len(samples) >= DENSE * readings:
        dwells = find_dwells(samples, max(still_deg_s, _scatter_deg_s(samples)))
        if len(dwells) >= 2:
            return dwell_readings(samples, dwells)
    half_s = 0.45 * np.diff(samples.time_s, prepend=np.nan, append=np.nan)
    usual = float(np.nanmedian(half_s)) if len(samples) > 1 else 1.0
    before, after = (np.where(np.isfinite(side), side, usual) for side in (half_s[:-1], half_s[1:]))
    unknown = np.full(samples.q_deg.shape, np.nan)
    return Stations(
        samples.time_s - np.minimum(before, usual),
        samples.time_s + np.minimum(after, usual),
        np.arange(len(samples)),
        np.ones(len(samples), dtype=np.int64),
        samples.q_deg,
        unknown,
        samples.tau_Nm,
        unknown,
        samples.temperature_C,
        np.zeros(samples.q_deg.shape),
    )


def _scatter_deg_s(samples: Samples) -> float:
    """Return the speed that the scatter of standing joints feigns."""
    step_s = np.diff(samples.time_s)
    travel = np.abs(np.diff(samples.q_deg, axis=0)).max(axis=1, initial=0.0)
    small = travel[travel <= np.quantile(travel, 2.0 * STANDS)]
    return SCATTER * float(np.median(small)) / max(0.3, float(np.median(step_s)))


def by_time(stations: Stations, time_s: Array, fit: Fit, offset_s: float | None = None) -> Clocks:
    """Join readings (N,), timed by their own clock, to where the arm stood.

    Offsets that bring most readings into steady phases are compared by the nominal arm: a plan
    whose poses take equally long fits as well a pose later, the positions do not. An offset that
    is given is not looked for.
    """
    if offset_s is not None:
        station = stations.at(time_s + offset_s)
        return Clocks(station, offset_s, 0.0, int((station >= 0).sum()))
    tried = []
    known_s = time_s[np.isfinite(time_s)]
    if not len(known_s):
        return Clocks(np.full(len(time_s), -1), 0.0, 0.0, 0)
    allowed = offset_ranges(stations.start_s, stations.end_s, known_s, NEARLY)
    for low, high in allowed[:CANDIDATES]:
        middle = 0.5 * (low + high)
        station = stations.at(time_s + middle)
        inside = np.flatnonzero(station >= 0)
        left_m = fit(inside, station[inside], len(inside)) if len(allowed) > 1 else None
        size = np.inf if left_m is None else float(np.median(left_m))
        tried.append((size, -len(inside), middle, high - low, station))
        if size < EXPECTED_M:
            break  # offsets that bring in fewer readings need not be tried
    best_m = min(each[0] for each in tried)
    near = [each for each in tried if each[0] <= 1.5 * best_m or not np.isfinite(best_m)]
    best = min(near, key=lambda each: (each[1], each[0]))
    return Clocks(best[4], float(best[2]), float(best[3] / np.sqrt(12.0)), -best[1])


def by_label(joints: NDArray[np.str_], readings: NDArray[np.str_]) -> Index:
    """Return the row of the joints under each reading's label, -1 where there is none.

    Of a label that both logs have several times, the k-th reading has the k-th joints; joints that
    were logged once are those of all readings under their label.
    """
    logged = pd.DataFrame({"label": joints.astype(str), "row": np.arange(len(joints))})
    read = pd.DataFrame({"label": readings.astype(str)})
    for each in (logged, read):
        each["number"] = each.groupby("label").cumcount()
    once = logged[~logged["label"].duplicated(keep=False)].set_index("label")["row"]
    of_many = logged.set_index(["label", "number"])["row"]
    found = of_many.reindex(pd.MultiIndex.from_frame(read)).to_numpy(dtype=float)
    alone = read["label"].map(once).to_numpy(dtype=float)
    station = np.where(np.isnan(alone), found, alone)
    return np.where(np.isnan(station), -1, station).astype(np.intp)


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
    def measured(self) -> RawColumns:
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
        """Read columns of the contract, joined; see `RawFile.read`."""
        self._refuse_exchanged()
        q = position_columns(self.arm.prismatic)
        of_joints = {*q, *together, *(f"u_{name}" for name in (*q, *together))}
        own, theirs = set(self.readings.names), set(self.joints.names)
        there = [name for name in required if name not in of_joints]
        # Labels that the joints' log has, or that are made; of the kinds of rows none is.
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
        by = self._by(read, logged)
        station, stations, note = self._joined(by, read, logged, samples)
        columns, odd, at = {}, dict(read.odd), np.maximum(station, 0)
        made = {name: (values, True) for name, values in zip(q, stations.q_deg.T, strict=True)}
        made |= {name: (v, False) for name, v in zip(together, stations.tau_Nm.T, strict=False)}
        for name, values in zip(q, stations.q_u_deg.T, strict=True):
            if f"u_{name}" in optional:
                made[f"u_{name}"] = values, False
        if "temperature_C" in optional and "temperature_C" not in read.columns:
            known = bool(np.isfinite(stations.temperature_C).all())
            made |= {"temperature_C": (stations.temperature_C, True)} if known else {}
        for name, (values, always) in made.items():
            if always or np.isfinite(values).any():
                columns[name] = values[at]
        first = stations.first[at]
        counted = {"load_N": 0.0 * first, "time_s": np.arange(float(len(first)))}
        for name in labels:
            # Poses and repeats that neither log has are made of the joint positions.
            if name in logged.columns:
                columns[name] = logged[name][first]
                unread, lines = logged.odd.get(name, {}), logged.line[first].tolist()
                of_row = zip(read.line.tolist(), lines, strict=True)
                odd[name] = {row: unread[line] for row, line in of_row if line in unread}
            elif name in counted:
                columns[name] = counted[name]
        columns = {**read.columns, **columns}
        if "time_s" in columns and np.nanmin(columns["time_s"], initial=np.inf) >= SINCE_1970:
            columns["time_s"] = columns["time_s"] - np.nanmin(columns["time_s"])
        for k, values in enumerate(stations.arrival.T, start=1):
            columns[f"arrival{k}"] = values[at]
        whole = replace(
            read,
            columns=columns,
            odd=odd,
            totals={**read.totals, **logged.totals},
            unused=(*read.unused, *logged.unused),
            quarantined=(*read.quarantined, *logged.quarantined),
            own={**logged.own, **read.own},
            notes=(note,),
        )
        return whole.take(station >= 0, NOT_JOINED[by])

    def _refuse_exchanged(self) -> None:
        """Stop when each of the two files has the columns that are mapped of the other."""
        files = (self.joints, self.readings)
        mapped = [file.own_names for file in files]
        headers = [file.header for file in files]
        lacks = [set(own) - set(header) for own, header in zip(mapped, headers, strict=True)]
        has = [set(own) <= set(header) for own, header in zip(mapped, headers[::-1], strict=True)]
        if not all(lacks) or not all(has) or not all(mapped):
            return
        missing = [name for name in mapped[0] if name in lacks[0]]
        raise RawDataError(
            f"missing columns {', '.join(missing)}, which {self.readings.path.name} has",
            where=f"{self.joints.path}:1",
            value=", ".join(headers[0]),
            allowed=f"the columns of columns.joints in files.joints: {', '.join(mapped[0])}",
            remedy=f"exchange files.joints and files.readings in {DESCRIPTION_FILE}",
        )

    def _joints_logged(self, q: Sequence[str], together: Sequence[str]) -> tuple[RawRows, Samples]:
        """Read the joints' log, in order of time where it has one."""
        text = [name for name in LABELS if name in self.joints.names]
        raw = self.joints.read([*q, *text], ["temperature_C"], together)
        logged = [*q, *(name for name in together if name in raw.columns)]
        raw = raw.finite([*logged, *(["time_s"] if "time_s" in text else [])])
        if not len(raw):
            raise RawDataError(
                "no row of the joints' log can be used",
                where=str(self.joints.path),
                value=raw.quarantined[0].reason if raw.quarantined else None,
                allowed="rows of joint positions",
                remedy="correct columns.joints",
            )
        time_s = raw["time_s"] if "time_s" in text else np.arange(float(len(raw)))
        order = np.argsort(time_s, kind="stable")
        raw = raw.at(order)
        tau_Nm = raw.numbers_of([f"tau{k}_Nm" for k in range(1, len(q) + 1)])
        temperature_C = raw.numbers_of(["temperature_C"])[:, 0]
        return raw, Samples(raw.line, time_s[order], raw.numbers_of(q), tau_Nm, temperature_C)

    @property
    def _join(self) -> Join:
        return self.campaign.join or Join()

    def _by(self, read: RawRows, logged: RawRows) -> Literal["row", "label", "time"]:
        """Return what joins the two: what campaign.yaml says, else labels, times or rows."""
        if self._join.by is not None:
            return self._join.by
        if "pose" in read.columns and "pose" in logged.columns:
            return "label"
        timed = "time_s" in self.joints.names and "time_s" in self.readings.names
        return "time" if timed else "row"

    def _joined(
        self, by: str, read: RawRows, logged: RawRows, samples: Samples
    ) -> tuple[Index, Stations, str]:
        """Return where the arm stood at each reading, and how that was found, in one clause."""
        count = len(read)
        stations = stations_of(samples, count if by == "time" else len(samples), self.still_deg_s)
        fit = self._fit(read, stations)
        files = f"{self.joints.path.name} and {self.readings.path.name}"
        if by == "time":
            stated_s = self._join.clock_offset_s
            clocks = by_time(stations, read["time_s"], fit, stated_s)
            self._refuse_apart(clocks.inside, count, stations, read["time_s"], fit)
            u = "" if stated_s is not None else f" ± {2.0 * clocks.u_s:.2g} s"
            note = (
                f"{files} joined by time: the joints' clock is that of the readings "
                f"{clocks.offset_s:+.2f} s{u}; {clocks.inside} of {count} readings lie in "
                f"{len(stations)} steady phases"
            )
            return clocks.station, stations, note
        if by == "label":
            station = by_label(logged.text_of("pose"), read.text_of("pose"))
        else:
            station = np.where(np.arange(count) < len(stations), np.arange(count), -1)
        if (shift := shifted(station, len(stations), fit)) is not None:
            joints, joined = self.joints.path.name, f"as they are joined by {by}"
            refuse_shifted(shift, self.readings.path, read.line, joined, joints)
        if by == "row" and count != len(stations):
            raise RawDataError(
                "the two logs have different numbers of rows, and nothing else joins them",
                where=str(self.readings.path),
                value=f"{count} readings and {len(stations)} rows of joints",
                allowed="one row of joints for each reading, or labels or times in both",
                remedy="exclude the rows that the other lacks, or map a time or a label",
            )
        return station, stations, f"{files} joined by {by}"

    def _fit(self, read: RawRows, stations: Stations) -> Fit:
        """Return how far readings are from the nominal arm, base and target fitted."""
        measured, instrument = self.measured, self.campaign.instrument.type
        values = read.numbers_of(measured.names)
        usable = np.asarray(measured.may_be_blank | np.isfinite(values).all(axis=1))
        for found in instrument.unusable(measured, values):
            usable &= ~found.rows
        unknown = np.full(values.shape, np.nan)
        seen = instrument.from_raw(measured, values, unknown, self.campaign.stated)
        T_base_ee = Chain.of(self.arm).forward(in_radians(stations.q_deg, self.arm.prismatic))
        return nominal_fit(seen, T_base_ee, usable)

    def _refuse_apart(
        self, inside: int, count: int, stations: Stations, time_s: Array, fit: Fit
    ) -> None:
        if 2 * inside > count:
            return
        stated = self._join.clock_offset_s
        found = None if stated is None else by_time(stations, time_s, fit)
        other = found is not None and 2 * found.inside > count
        raise RawDataError(
            "the two logs cannot be joined by time",
            where=str(self.readings.path.parent / DESCRIPTION_FILE) + ": join.clock_offset_s"
            if other
            else str(self.readings.path),
            value=f"{inside} of {count} readings lie where the arm stood, at "
            + ("the best offset of the clocks" if stated is None else f"{stated:+g} s"),
            allowed="readings taken while the arm stands still",
            remedy=f"remove join.clock_offset_s: it is then found, {found.offset_s:+.2f} s"
            if other and found is not None
            else "check that both logs are of the same run, and the units and formats of "
            "columns.joints.time and columns.readings.time",
        )
