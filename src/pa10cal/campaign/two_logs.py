"""A log of joints joined with a log of readings: by row, by label, or by time with two clocks.

The two are read as one file whose rows are the readings, each with the joint positions at which it
was taken. The arm's stations are the dwells of a log of motion, or every row of a list of poses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.campaign.bounds import LEAST_U, unwrapped
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.dwells import (
    BRIEF_WINDOW_S,
    DENSE,
    SPEED_WINDOW_S,
    Samples,
    Stations,
    offset_ranges,
    stations_of,
)
from pa10cal.campaign.instrument_motion import is_base_column
from pa10cal.campaign.joint_positions import as_joints, as_logged, in_radians, position_columns
from pa10cal.campaign.nominal_fit import (
    RIGHT_ROWS_M,
    ReadingsAtStations,
    find_shift,
    refuse_shifted,
)
from pa10cal.campaign.own_columns import Inverse
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.campaign.streams import (
    LEAST_READINGS,
    Clock,
    averaged,
    clock_by_edges,
    clock_of_motion,
    is_stream,
    reading_dwells,
    resolution_s,
    spread_times,
)
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import RawColumns
from pa10cal.options import IngestOptions

#: Later times are counted from 1970, not from the first reading [s].
SINCE_1970 = 1e8
#: Columns that either log may have. All but `kind` are made where neither has them.
LABELS = ("time_s", "pose", "load_N", "repeat", "kind")
#: Clock offsets are candidates that bring this part of the readings that the best brings to
#: stations; candidates compared by the nominal arm, at most.
NEARLY, CANDIDATES = 0.85, 12
#: Dwells found over a shorter time are taken where there are so many times as many, or more at all
#: where the dwells found otherwise are short.
MANY_MORE = 1.3
#: Dwells that are found to last less are no poses [s].
SHORT_S = 0.4
#: Stations at which joints and target both were at rest, at least.
LEAST_VISITS = 3
#: Columns of labels share so many labels, and this part of those of the shorter column, at least.
SHARED, SHARED_PART = 3, 0.8
#: Why a reading has no joint positions, by what joins the two logs.
NOT_JOINED = {
    "time": "the arm did not stand still then, by the log of its joints",
    "label": "the log of the joints has no such label",
    "row": "the log of the joints has no such row",
}


def clock_offset(
    stations: Stations, time_s: Array, readings: ReadingsAtStations
) -> tuple[float, float]:
    """Return the offset to add to times of readings for the joints' clock, and its uncertainty.

    Offsets that bring most readings (N,) to stations are compared by the misfit of the nominal arm:
    where all poses take equally long, times agree as well a pose later, but positions do not.
    """
    known_s = time_s[np.isfinite(time_s)]
    if not len(known_s):
        return 0.0, 0.0
    ranges = offset_ranges(stations, known_s, NEARLY)
    tried = []  # number of readings, median misfit, offset, width of its range
    for low, high in ranges[:CANDIDATES]:
        offset_s = 0.5 * (low + high)
        station = stations.at(time_s + offset_s)
        inside = np.flatnonzero(station >= 0)
        residual_m = None
        if len(ranges) > 1:
            residual_m = readings.misfit_m(inside, station[inside], len(inside))
        misfit_m = np.inf if residual_m is None else float(np.nanmedian(residual_m))
        tried.append((len(inside), misfit_m, offset_s, high - low))
        if misfit_m < RIGHT_ROWS_M:
            break  # offsets that bring in fewer readings need not be tried
    best_m = min(misfit_m for _, misfit_m, _, _ in tried)
    near = [one for one in tried if one[1] <= 1.5 * best_m or not np.isfinite(best_m)]
    _, _, offset_s, width_s = min(near, key=lambda one: (-one[0], one[1]))
    return float(offset_s), float(width_s / np.sqrt(12.0))  # uniform over its range


def shared_labels(
    joints: Mapping[str, Sequence[str]], readings: Mapping[str, Sequence[str]]
) -> tuple[str, str] | None:
    """Return the columns of text, one of each log, that hold the same labels; None for none.

    Names of columns do not matter. Most labels must occur only once in the joints' log.
    """
    best, columns = (SHARED_PART, SHARED - 1), None
    for spelling in (str, _bare):
        of_joints, of_readings = (
            {name: set(map(spelling, texts)) - {""} for name, texts in log.items()}
            for log in (joints, readings)
        )
        for (logged, ours), (read, theirs) in product(of_joints.items(), of_readings.items()):
            fewer = min(len(ours), len(theirs))
            if len(ours) < 0.5 * len(joints[logged]) or fewer < SHARED:
                continue
            shared_count = len(ours & theirs)
            if (shared_count / fewer, shared_count) > best:
                best, columns = (shared_count / fewer, shared_count), (logged, read)
    return columns


def _bare(label: str) -> str:
    """Return the letters and digits of a label, in lower case."""
    return re.sub(r"[\W_]+", "", label.casefold())


def by_label(joints: NDArray[np.str_], readings: NDArray[np.str_]) -> Index:
    """Return the row of the joints for each reading by its label, -1 where there is none.

    Joints that were logged once under a label belong to all readings under it. Of a label that the
    joints' log has several times, the k-th reading has the k-th joints. Where the logs share no
    label as written, case and all signs but letters and digits are ignored.
    """
    if not set(joints.tolist()) & set(readings.tolist()):
        joints = np.array(list(map(_bare, joints.tolist())), str)
        readings = np.array(list(map(_bare, readings.tolist())), str)
    logged = pd.DataFrame({"label": joints.astype(str), "row": np.arange(len(joints))})
    read = pd.DataFrame({"label": readings.astype(str)})
    for table in (logged, read):
        table["number"] = table.groupby("label").cumcount()
    once = logged[~logged["label"].duplicated(keep=False)].set_index("label")["row"]
    of_many = read.merge(logged, how="left", on=["label", "number"])["row"]
    station = read["label"].map(once).fillna(of_many)
    return station.fillna(-1).to_numpy(dtype=np.intp)


def _uncertainties(
    logged: RawRows, stations: Stations, names: Sequence[str], own: Index
) -> dict[str, NDArray[Any]]:
    """Return standard uncertainties (K,) at stations, by their columns.

    They are as the log states them, else from the scatter of samples in a dwell. Equal samples of a
    coarse read-back show no scatter, so the uncertainty is unknown then (nan).

    Args:
        logged: rows of the joints' log.
        stations: the stations.
        names: columns of joint positions, then of torques if logged.
        own: the joint, from 0, that belongs to each axis.
    """
    scatter = np.hstack([stations.q_u_deg[:, own], stations.tau_u_Nm])[:, : len(names)]
    scatter = np.where(scatter >= LEAST_U, scatter, np.nan)
    columns = [f"u_{name}" for name in names]
    stated = pd.DataFrame(logged.numbers_of(columns)).groupby(stations.of_sample).mean()
    mean = stated.reindex(range(len(stations))).to_numpy()
    return dict(zip(columns, np.where(np.isfinite(mean), mean, scatter).T, strict=True))


@dataclass(frozen=True)
class TwoLogs:
    """The joints' log and the readings' log of a campaign, read as one file of poses."""

    joints: RawFile
    readings: RawFile
    campaign: CampaignDescription
    arm: Arm
    options: IngestOptions

    @classmethod
    def of(
        cls, campaign: CampaignDescription, folder: Path, arm: Arm, options: IngestOptions
    ) -> TwoLogs:
        """Return the two logs that campaign.yaml names."""
        joints, readings = (
            RawFile.of(campaign, folder, key, arm.axes_slide) for key in ("joints", "readings")
        )
        return cls(joints, readings, campaign, arm, options)

    @property
    def path(self) -> Path:
        """Return the file of the readings, whose lines messages name."""
        return self.readings.path

    @property
    def names(self) -> list[str]:
        """Return the columns of the contract that either file has."""
        return list(dict.fromkeys((*self.readings.names, *self.joints.names)))

    @property
    def measured_columns(self) -> RawColumns:
        """Return the columns that hold what was measured."""
        names = [name for name in self.readings.names if not is_base_column(name)]
        return self.campaign.instrument.type.raw_columns(names)

    @property
    def in_degrees(self) -> Sequence[str]:
        """Return the columns of angles of orientations that are stated to be in degrees."""
        return self.readings.in_degrees

    @property
    def inverse(self) -> Inverse:
        """Return what is stated to be inverse of the measured poses."""
        return self.readings.inverse

    @property
    def words(self) -> ColumnMap:
        """Return the column map of both files."""
        return self.joints.words | self.readings.words

    def read(
        self, required: Sequence[str], optional: Sequence[str] = (), together: Sequence[str] = ()
    ) -> RawRows:
        """Read columns of the contract of both files, joined; see `RawFile.read`."""
        self._refuse_exchanged()
        self._refuse_without_join()
        q = position_columns(self.arm.axes_slide)
        of_joints = {*q, *together, *(f"u_{name}" for name in (*q, *together))}
        in_readings, in_joints = set(self.readings.names), set(self.joints.names)
        others = [name for name in required if name not in of_joints]
        # Labels that only the joints' log has, or that are made; `kind` is never made.
        labels = [
            name
            for name in others
            if name in LABELS and name not in in_readings and (name != "kind" or name in in_joints)
        ]
        read = self.readings.read(
            [name for name in others if name not in labels],
            [name for name in optional if name not in of_joints],
            repeats=self._by == "row",
        )
        if not len(read):  # refused as one file, since there is nothing to join
            most = self.options.max_quarantined_fraction
            refuse_too_many(read.quarantined, read.totals, most, self.words)
        logged, samples = self._joints_logged(q, together)
        if self._by == "time" and is_stream(read["time_s"]):
            read, station, stations, note = self._streams(read, samples)
        else:
            station, stations, note = self._joined(read, logged, samples)
        row = np.maximum(station, 0)  # readings without a station are quarantined below
        columns, non_numeric = dict(read.columns), dict(read.non_numeric)
        columns |= zip(q, as_logged(stations.q_deg[row], self.arm).T, strict=True)
        further = dict(zip(together, stations.tau_Nm.T, strict=False))
        further |= _uncertainties(logged, stations, [*q, *together], self.arm.coupling.own)
        for name, values in further.items():
            if name in (*together, *optional) and np.isfinite(values).any():
                columns[name] = values[row]
        all_known = bool(np.isfinite(stations.temperature_C).all())
        if "temperature_C" in optional and "temperature_C" not in columns and all_known:
            columns["temperature_C"] = stations.temperature_C[row]
        of_labels, texts = self._labels_of(labels, read, logged, stations.first[row])
        columns |= of_labels
        if "time_s" in columns and np.nanmin(columns["time_s"], initial=np.inf) >= SINCE_1970:
            columns["time_s"] = columns["time_s"] - np.nanmin(columns["time_s"])
        columns |= {f"arrival{k}": v[row] for k, v in enumerate(stations.arrival.T, start=1)}
        columns["dwell_samples"] = stations.samples[row]
        whole = replace(
            read,
            columns=columns,
            non_numeric=non_numeric | texts,
            totals={**read.totals, **logged.totals},
            unused=(*read.unused, *logged.unused),
            quarantined=(*read.quarantined, *logged.quarantined),
            own=logged.own | read.own,
            notes=(note, *read.notes, *logged.notes),
        )
        return whole.take(station >= 0, NOT_JOINED[self._by])

    @staticmethod
    def _labels_of(
        labels: Sequence[str], read: RawRows, logged: RawRows, first: Index
    ) -> tuple[dict[str, NDArray[Any]], dict[str, dict[int, str]]]:
        """Return labels of readings by the joints' log, and fields that are no numbers, by column.

        `first` (N,) is the row of the joints' log of each reading. Loads and times that it lacks
        are 0, and count rows; poses and repeats are made later, of the joint positions.
        """
        made = {"load_N": 0.0 * first, "time_s": np.arange(float(len(first)))}
        columns, non_numeric = {}, {}
        for name in labels:
            if name in logged.columns:
                columns[name] = logged[name][first]
                texts = logged.non_numeric.get(name, {})
                lines = zip(read.line.tolist(), logged.line[first].tolist(), strict=True)
                non_numeric[name] = {line: texts[own] for line, own in lines if own in texts}
            elif name in made:
                columns[name] = made[name]
        return columns, non_numeric

    def _refuse_exchanged(self) -> None:
        """Refuse files that each have the columns that are mapped in the other."""
        of_joints, of_readings = self.joints.own_names, self.readings.own_names
        joints_header, readings_header = self.joints.header, self.readings.header
        missing = [name for name in of_joints if name not in joints_header]
        swapped = set(of_joints) <= set(readings_header) and set(of_readings) <= set(joints_header)
        if missing and not set(of_readings) <= set(readings_header) and swapped:
            raise RawDataError(
                f"missing columns {', '.join(missing)}, which {self.readings.path.name} has",
                where=f"{self.joints.path}:1",
                value=", ".join(joints_header),
                allowed=f"the columns of columns.joints in files.joints: {', '.join(of_joints)}",
                remedy="exchange files.joints and files.readings in campaign.yaml",
            )

    def _refuse_without_join(self) -> None:
        """Refuse logs that campaign.yaml joins by times or labels which one of them lacks."""
        name = {"time": "time_s", "label": "pose"}.get(self._by)
        for file in (self.joints, self.readings):
            if name is not None and name not in file.names:
                raise RawDataError(
                    f"{file.path.name} has no column to join the logs by {self._by}",
                    where=f"{file.path.parent / DESCRIPTION_FILE}: join.by",
                    value=self._by,
                    allowed=f"{name} in both logs",
                    remedy=f"set columns.{file.key}.{name.removesuffix('_s')}, or remove join.by",
                )

    def _joints_logged(self, q: Sequence[str], together: Sequence[str]) -> tuple[RawRows, Samples]:
        """Read the joints' log, in order of time where it is joined by time."""
        text = [name for name in LABELS if name in self.joints.names]
        uncertain = [f"u_{name}" for name in (*q, *together)]
        # Joined by row, equal rows are of poses to which the arm came again.
        raw = self.joints.read(
            [*q, *text], ["temperature_C", *uncertain], together, repeats=self._by == "row"
        )
        logged = [*q, *(name for name in together if name in raw.columns)]
        raw = raw.finite([*logged, *(["time_s"] if "time_s" in text else [])])
        raw = raw.finite([name for name in uncertain if name in raw.columns], may_be_blank=True)
        if not len(raw):
            raise RawDataError(
                "no row of the joints' log can be used",
                where=str(self.joints.path),
                value=raw.quarantined[0].reason if raw.quarantined else None,
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
        q_deg = as_joints(raw.numbers_of(q), self.arm)
        return raw, Samples(raw.line, time_s, q_deg, tau_Nm, temperature_C)

    @property
    def _by(self) -> Literal["row", "label", "time"]:
        """Return what joins the logs: as campaign.yaml states, else labels, times or rows."""
        both = set(self.joints.names) & set(self.readings.names)
        stated = None if self.campaign.join is None else self.campaign.join.by
        return stated or ("label" if "pose" in both else "time" if "time_s" in both else "row")

    @property
    def _stated_offset_s(self) -> float | None:
        """Return the offset of the clocks that campaign.yaml states; None where it is found."""
        return None if self.campaign.join is None else self.campaign.join.clock_offset_s

    def _offset(
        self, stations: Stations, time_s: Array, readings: ReadingsAtStations
    ) -> tuple[float, float]:
        """Return the offset of the clocks as stated, of uncertainty 0, else see `clock_offset`."""
        if self._stated_offset_s is not None:
            return self._stated_offset_s, 0.0
        return clock_offset(stations, time_s, readings)

    def _joined(
        self, read: RawRows, logged: RawRows, samples: Samples
    ) -> tuple[Index, Stations, str]:
        """Return the station (N,) of each reading, -1 for none; the stations; and a note."""
        count, by = len(read), self._by
        stations = stations_of(
            samples, count if by == "time" else len(samples), self.options.still_speed_deg_s
        )
        at_stations = self._at_stations(read, stations)
        files = f"{self.joints.path.name} and {self.readings.path.name}"
        if by == "time":
            time_s = read["time_s"]
            offset_s, u_s = self._offset(stations, time_s, at_stations)
            station = stations.at(time_s + offset_s)
            inside = int((station >= 0).sum())
            if 2 * inside <= count:
                raise self._apart(inside, stations, time_s, at_stations)
            plus_minus = "" if self._stated_offset_s is not None else f" ± {2.0 * u_s:.2g} s"
            note = (
                f"{files} joined by time: the joints' clock is that of the readings "
                f"{offset_s:+.2f} s{plus_minus}; {inside} of {count} readings lie in "
                f"{len(stations)} steady phases"
            )
            return station, stations, note
        if by == "label":
            station = by_label(logged.text_of("pose"), read.text_of("pose"))
        else:
            station = np.where(np.arange(count) < len(stations), np.arange(count), -1)
        if (shift := find_shift(at_stations, station)) is not None:
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

    def _streams(self, read: RawRows, samples: Samples) -> tuple[RawRows, Index, Stations, str]:
        """Join readings that go on while the arm moves.

        Returns:
            One row for each station, the mean of readings while joints and target were at rest;
            the station of each; all stations; and a note.
        """
        lost = [row for row in read.quarantined if row.value.endswith("= ''")]  # target not seen
        rest = tuple(row for row in read.quarantined if row not in set(lost))
        read = replace(read.at(np.argsort(read["time_s"], kind="stable")), quarantined=rest)
        read = read.at(np.flatnonzero(np.isfinite(read["time_s"])))
        rounded_s = max(map(resolution_s, (read["time_s"], samples.time_s)))
        time_s, count = spread_times(read["time_s"]), len(read) + len(lost)
        samples = replace(samples, time_s=spread_times(samples.time_s))
        p_mm = self._most_seen(read)
        dwells, stations = self._steady(time_s, p_mm, samples)
        if len(dwells) < 2:
            raise self._no_dwell(self.readings.path, count, "the target never stands still")
        in_motion = len(samples) >= DENSE * len(dwells)
        if in_motion and len(stations) == len(samples):
            what = "the arm is never at rest in the log of its joints"
            raise self._no_dwell(self.joints.path, len(samples), what)
        means = averaged(read, dwells.of_sample)
        at_stations = self._at_stations(means, stations)
        middle_s = 0.5 * (dwells.start_s + dwells.end_s)
        offset_s, u_s = self._offset(stations, middle_s, at_stations)
        station = stations.at(middle_s + offset_s)
        inside = int((station >= 0).sum())
        if 2 * inside <= len(dwells):
            lasts_s = (np.median(each.end_s - each.start_s) for each in (dwells, stations))
            if min(lasts_s) < SHORT_S or 2 * len(stations) < len(dwells):
                raise self._hardly_still(inside, len(stations), len(dwells), count)
            raise self._apart(inside, stations, middle_s, at_stations, "dwells of the target")
        clock = Clock(offset_s, u_s, float(time_s[0]), float(time_s[-1]))
        if self._stated_offset_s is None:
            if in_motion:
                clock = self._clock(clock, samples, stations, station, dwells, time_s, p_mm)
            clock = replace(clock, u_s=float(np.hypot(clock.u_s, rounded_s / np.sqrt(12.0))))
        station = stations.at(clock.joints_s(time_s))
        steady = (dwells.of_sample >= 0) & (station >= 0)
        # Readings at one station are averaged, if there are enough.
        visited, number = np.unique(station[steady], return_inverse=True)
        enough = np.bincount(number, minlength=len(visited)) >= LEAST_READINGS
        group = np.full(len(read), -1)
        group[steady] = np.where(enough[number], (np.cumsum(enough) - 1)[number], -1)
        used, visit_count = int((group >= 0).sum()), int(enough.sum())
        if visit_count < LEAST_VISITS:
            raise self._hardly_still(visit_count, len(stations), len(dwells), count)
        files = f"{self.joints.path.name} and {self.readings.path.name}"
        note = (
            f"{files} joined by time: the joints' clock is that of the readings {clock.words}; "
            f"{used} of {count} readings lie in {visit_count} of {len(stations)} steady "
            f"phases and are averaged there, {count - used} are set aside, taken in motion"
            + (f" or without the target in sight ({len(lost)})" if lost else "")
        )
        return averaged(read, group), visited[enough], stations, note

    def _steady(self, time_s: Array, p_mm: Array, samples: Samples) -> tuple[Stations, Stations]:
        """Return dwells of the target and stations of the arm; brief ones where those are more."""

        def at_rest(window_s: float) -> tuple[int, Stations, Stations]:
            dwells = reading_dwells(time_s, p_mm, window_s)
            stations = stations_of(samples, len(dwells), self.options.still_speed_deg_s, window_s)
            both = min(len(dwells), len(stations) if len(stations) < len(samples) else 0)
            return both, dwells, stations

        count, dwells, stations = at_rest(SPEED_WINDOW_S)
        brief_count, brief_dwells, brief_stations = at_rest(BRIEF_WINDOW_S)
        lasts_s = [each.end_s - each.start_s for each in (dwells, stations) if len(each)]
        short = any(np.median(durations_s) < 2.0 * SPEED_WINDOW_S for durations_s in lasts_s)
        if brief_count > count * (1.0 if short else MANY_MORE):
            return brief_dwells, brief_stations
        return dwells, stations

    def _clock(
        self,
        clock: Clock,
        samples: Samples,
        stations: Stations,
        station: Index,
        dwells: Stations,
        time_s: Array,
        p_mm: Array,
    ) -> Clock:
        """Return the clock by the motion between dwells, else by the edges of R dwells."""
        offset_s, u_s = clock_by_edges(dwells, stations, station)
        by_edges = replace(clock, offset_s=offset_s, u_s=u_s)
        if p_mm.shape[1] != 3:
            return by_edges
        by_motion = clock_of_motion(
            samples, stations, time_s, 1e-3 * p_mm, dwells.of_sample, offset_s, self._ends
        )
        return by_motion or by_edges

    def _most_seen(self, read: RawRows) -> Array:
        """Return the places (N, 3), or distances (N, 1), of the target that was seen most [mm]."""
        places = [read.numbers_of(names) for names in self.measured_columns.targets]
        return max(places, key=lambda p_mm: int(np.isfinite(p_mm).all(axis=1).sum()))

    def _ends(self, q_deg: Array) -> Array:
        """Return the nominal end (P, 4, 4) at joint positions (P, n) [deg, mm]."""
        return Chain.of(self.arm).forward(in_radians(q_deg, self.arm.prismatic))

    def _hardly_still(self, both: int, joints: int, target: int, rows: int) -> RawDataError:
        what = (
            f"the arm hardly stands still: {joints} steady phases of the joints, {target} of the "
            f"target, {both} of them at one time"
        )
        return self._no_dwell(self.readings.path, rows, what)

    def _no_dwell(self, path: Path, rows: int, what: str) -> RawDataError:
        return RawDataError(
            what,
            where=str(path),
            value=f"{rows} rows",
            allowed="a log in which the arm stands at every pose for half a second and more",
            remedy="let the arm stand still at every pose while it is measured, and check the "
            "units of the time and of the positions",
        )

    def _at_stations(self, read: RawRows, stations: Stations) -> ReadingsAtStations:
        """Return what was measured, to be compared with the nominal arm at the stations."""
        measured, instrument = self.measured_columns, self.campaign.instrument.type
        values = read.numbers_of(measured.names)
        usable = np.asarray(measured.may_be_blank | np.isfinite(values).all(axis=1))
        for off in instrument.unusable(measured, values):
            usable &= ~off.rows
        unknown = np.full(values.shape, np.nan)
        seen = instrument.from_raw(measured, values, unknown, self.campaign.stated)
        return ReadingsAtStations(seen, self._ends(stations.q_deg), usable)

    def _apart(
        self,
        inside: int,
        stations: Stations,
        time_s: Array,
        readings: ReadingsAtStations,
        of: str = "readings",
    ) -> RawDataError:
        """Return the refusal of readings of which most lie at no station."""
        stated_s = self._stated_offset_s
        offset = "the best offset of the clocks" if stated_s is None else f"{stated_s:+g} s"
        value = f"{inside} of {len(time_s)} {of} lie where the arm stood, at {offset}"
        where = str(self.readings.path)
        remedy = (
            "check that both logs are of the same run, and the units and formats of "
            "columns.joints.time and columns.readings.time"
        )
        if stated_s is not None:
            other_s, _ = clock_offset(stations, time_s, readings)
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
