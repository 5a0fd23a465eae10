"""A log of joints joined with a log of readings: by row, by label, or by time with two clocks.

The two are read as one file whose rows are the readings, each with the joint positions at which it
was taken. The arm's stations are the dwells of a log of motion, or every row of a list of poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.campaign.bounds import LEAST_U, unwrapped
from pa10cal.campaign.clock_jumps import join_by_time
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.dwells import Samples, Stations, stations_of
from pa10cal.campaign.instrument_motion import is_base_column
from pa10cal.campaign.joint_positions import (
    as_joints,
    as_logged,
    held_between_changes,
    position_columns,
    same_commands,
)
from pa10cal.campaign.log_labels import Visits, by_visit
from pa10cal.campaign.nominal_fit import find_shift, refuse_shifted
from pa10cal.campaign.own_columns import Inverse
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import InFile, RawRows
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.campaign.time_join import JoinedReadings, NominalArm, TimeJoin
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import RawColumns
from pa10cal.options import IngestOptions

#: Later times are counted from 1970, not from the first reading [s].
SINCE_1970 = 1e8
#: Columns that either log may have. All but `kind` are made where neither has them.
LABELS = ("time_s", "pose", "load_N", "repeat", "kind")
#: Why a reading has no joint positions, by what joins the two logs.
NOT_JOINED = {
    "time": "the arm did not stand still then, by the log of its joints",
    "label": "the log of the joints has no such label",
    "row": "the log of the joints has no such row",
}


def by_row(joints: InFile, readings: InFile) -> Index:
    """Return the row of the joints for each reading with the same number in its file, -1 for none.

    It means something only where both files have equally many rows.
    """
    station = np.full(max(joints.count, readings.count), -1)
    station[joints.number] = np.arange(len(joints.number))
    return station[readings.number]


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
    q_scatter_deg = stations.q_u_deg[:, own]
    torques_logged = len(names) > q_scatter_deg.shape[1]
    scatter = np.hstack([q_scatter_deg, stations.tau_u_Nm]) if torques_logged else q_scatter_deg
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
        others = [name for name in required if name not in of_joints]
        labels = self._labels_by_joints(others)
        read = self.readings.read(
            [name for name in others if name not in labels],
            [name for name in optional if name not in of_joints],
            repeats=self._by == "row",
        )
        if not len(read):  # refused as one file, since there is nothing to join
            most = self.options.max_quarantined_fraction
            refuse_too_many(read.quarantined, read.totals, most, self.words)
        logged = self._joints_logged(q, together)
        joined = self._joined(read, logged)
        rows = self._with_joints(joined, logged, q, together, optional)
        # Readings at no station have any joints and labels here; they are quarantined below.
        rows = _with_labels(rows, labels, logged, joined.stations.first[joined.station])
        rows = _of_both_files(_from_first_time(rows), logged, joined)
        at_station = joined.station >= 0
        rows = rows.take(at_station, NOT_JOINED[self._by])
        columns = self.readings.columns
        if columns is None or columns.target is None:
            return rows
        stand = joined.station[at_station]
        if self._by == "row":  # each reading has a row of joints of its own
            stand = self._stand_of_rows(logged.numbers_of(q))[stand]
        return _one_row_a_stand(rows, stand, self.measured_columns)

    def _stand_of_rows(self, q: Array) -> Index:
        """Return the stand of the arm for each row of joint positions q (M, n) [deg, mm].

        Rows that follow each other with equal commands are one. Equal commands further on are those
        of another visit, to which the arm comes with errors of its own.
        """
        command = same_commands(q, self.campaign.repeat_tolerance_deg)
        return np.cumsum(np.diff(command, prepend=command[:1]) != 0)

    def _labels_by_joints(self, names: Sequence[str]) -> list[str]:
        """Return the labels among names that the joints' log alone has, or that are made.

        `kind` is never made.
        """
        in_readings, in_joints = set(self.readings.names), set(self.joints.names)
        return [
            name
            for name in names
            if name in LABELS and name not in in_readings and (name != "kind" or name in in_joints)
        ]

    def _with_joints(
        self,
        joined: JoinedReadings,
        logged: RawRows,
        q: Sequence[str],
        tau: Sequence[str],
        optional: Sequence[str],
    ) -> RawRows:
        """Return readings with what the joints' log says of their stations.

        That is joint positions (columns `q`), torques (`tau`), uncertainties, temperature and
        directions of arrival.
        """
        stations, columns = joined.stations, dict(joined.readings.columns)
        row = joined.station
        columns |= zip(q, as_logged(stations.q_deg[row], self.arm).T, strict=True)
        further = dict(zip(tau, stations.tau_Nm.T, strict=False))
        further |= _uncertainties(logged, stations, [*q, *tau], self.arm.coupling.own)
        if "temperature_C" not in columns:
            further["temperature_C"] = stations.temperature_C
        for name, values in further.items():
            if name in (*tau, *optional) and np.isfinite(values).any():
                columns[name] = values[row]
        columns |= {f"arrival{k}": v[row] for k, v in enumerate(stations.arrival.T, start=1)}
        columns["dwell_samples"] = stations.samples[row]
        return replace(joined.readings, columns=columns)

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

    def _joints_logged(self, q: Sequence[str], together: Sequence[str]) -> RawRows:
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
        if self._by != "time":
            return raw
        return held_between_changes(raw.at(np.argsort(raw["time_s"], kind="stable")), q)

    def _samples(self, logged: RawRows) -> Samples:
        """Return the samples of the joints' log; without times they are numbered."""
        q = position_columns(self.arm.axes_slide)
        return Samples(
            logged.line,
            logged.columns.get("time_s", np.arange(float(len(logged)))),
            as_joints(logged.numbers_of(q), self.arm),
            logged.numbers_of([f"tau{k}_Nm" for k in range(1, len(q) + 1)]),
            logged.numbers_of(["temperature_C"])[:, 0],
        )

    @property
    def _by(self) -> Literal["row", "label", "time"]:
        """Return what joins the logs: as campaign.yaml states, else labels, times or rows."""
        both = set(self.joints.names) & set(self.readings.names)
        stated = None if self.campaign.join is None else self.campaign.join.by
        return stated or ("label" if "pose" in both else "time" if "time_s" in both else "row")

    def _joined(self, read: RawRows, logged: RawRows) -> JoinedReadings:
        """Return the readings with the stations at which they were taken."""
        samples, still_deg_s = self._samples(logged), self.options.still_speed_deg_s
        nominal = NominalArm(self.arm, self.campaign, self.measured_columns)
        if self._by == "time":
            offset_s = None if self.campaign.join is None else self.campaign.join.clock_offset_s
            files = self.joints.path, self.readings.path
            return join_by_time(TimeJoin(*files, samples, nominal, still_deg_s, offset_s), read)
        stations = stations_of(samples, len(samples), still_deg_s)  # each row of the joints is one
        note = f"{self.joints.path.name} and {self.readings.path.name} joined by {self._by}"
        if self._by == "label":
            read, station, unused = self._joined_by_label(read, logged)
            note += unused
        else:
            station = by_row(logged.numbered, read.numbered)
        shift = find_shift(nominal.at_stations(read, stations), station)
        if shift is not None:
            how = f"as they are joined by {self._by}"
            refuse_shifted(shift, self.readings.path, read.line, how, self.joints.path.name)
        if self._by == "row":
            self._refuse_other_numbers_of_rows(read, logged)
        return JoinedReadings(read, station, stations, note)

    def _joined_by_label(self, read: RawRows, logged: RawRows) -> tuple[RawRows, Index, str]:
        """Return the readings, the row of the joints of each, and what else to note.

        Readings whose label the joints' log has, but not for their visit, are quarantined.
        """
        of_joints, of_readings = (
            Visits.of(rows.text_of("pose"), rows.numbered) for rows in (logged, read)
        )
        station, why = by_visit(of_joints, of_readings)
        unused_count = len(logged) - len(set(station[station >= 0].tolist()))
        unused = (
            f"; {unused_count} of {len(logged)} rows of {self.joints.path.name} have no reading"
            if unused_count
            else ""
        )
        for reason in sorted({*why.tolist()} - {""}):
            keep = why != reason
            read, station, why = read.take(keep, reason), station[keep], why[keep]
        return read, station, unused

    def _refuse_other_numbers_of_rows(self, read: RawRows, logged: RawRows) -> None:
        """Refuse logs that are joined by row and have different numbers of rows."""
        joint_count, count = logged.numbered.count, read.numbered.count
        if joint_count == count:
            return
        many, rest = divmod(count, joint_count)
        by_turns = (
            f"; where each pose has {many} rows of readings, write its joints {many} times, "
            "with a column that tells the target where they are of several"
        )
        raise RawDataError(
            "the two logs have different numbers of rows, and nothing else joins them",
            where=str(self.readings.path),
            value=f"{count} readings and {joint_count} rows of joints",
            allowed="one row of joints for each reading, or labels or times in both",
            remedy="take out the rows that the other lacks, or map a time or a label"
            + by_turns * (many > 1 and not rest),
        )


def _from_first_time(rows: RawRows) -> RawRows:
    """Return rows with times from the first reading where they count from 1970."""
    time_s = rows.columns.get("time_s", np.zeros(0))
    first_s = np.nanmin(time_s, initial=np.inf)  # infinite where no row has a time
    if not SINCE_1970 <= first_s < np.inf:
        return rows
    return rows.with_columns({"time_s": time_s - first_s})


def _of_both_files(rows: RawRows, logged: RawRows, joined: JoinedReadings) -> RawRows:
    """Return readings as the rows of both files: with what is known of the joints' log."""
    return replace(
        rows,
        totals={**rows.totals, **logged.totals},
        unused=(*rows.unused, *logged.unused),
        quarantined=(*rows.quarantined, *logged.quarantined),
        own=logged.own | rows.own,
        notes=(joined.note, *rows.notes, *logged.notes),
        warnings=joined.warnings,
    )


def _one_row_a_stand(rows: RawRows, stand: Index, measured: RawColumns) -> RawRows:
    """Return one row for each stand of the arm, of rows that are of one target each.

    A target that occurs again in a stand (N,) belongs to another row of it. Numbers are those of
    the first row that has them.
    """
    seen = [np.isfinite(rows.numbers_of(names)).all(axis=1) for names in measured.targets]
    target = np.where(np.any(seen, axis=0), np.argmax(seen, axis=0), -1)
    keys = pd.DataFrame({"stand": stand})
    for name in ("kind", "load_N", "repeat"):
        if name in rows.columns:
            keys[name] = rows[name]
    again = keys.assign(target=target).groupby([*keys, "target"], dropna=False).cumcount()
    of_row = keys.assign(again=again).groupby([*keys, "again"], sort=False, dropna=False)
    row = of_row.ngroup().to_numpy()
    first = np.unique(row, return_index=True)[1]
    if len(first) == len(rows):
        return rows
    numbers = [name for name, values in rows.columns.items() if values.dtype.kind == "f"]
    firsts = pd.DataFrame({name: rows[name] for name in numbers}).groupby(row).first()
    note = f"{rows.file}: {len(rows)} rows of one target each are {len(first)} configurations"
    merged = rows.at(first).with_columns({name: firsts[name].to_numpy() for name in numbers})
    return replace(merged, notes=(*rows.notes, note))


def _with_labels(read: RawRows, labels: Sequence[str], logged: RawRows, first: Index) -> RawRows:
    """Return readings with labels of the joints' log, from its rows `first` (N,).

    Loads that it lacks are 0, and times count rows. Poses and repeats are made later, of the joint
    positions.
    """
    made = {"load_N": 0.0 * first, "time_s": np.arange(float(len(first)))}
    columns, non_numeric = dict(read.columns), dict(read.non_numeric)
    for name in labels:
        if name in logged.columns:
            columns[name] = logged[name][first]
            texts = logged.non_numeric.get(name, {})
            lines = zip(read.line.tolist(), logged.line[first].tolist(), strict=True)
            non_numeric[name] = {line: texts[own] for line, own in lines if own in texts}
        elif name in made:
            columns[name] = made[name]
    return replace(read, columns=columns, non_numeric=non_numeric)
