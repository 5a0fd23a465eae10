"""Rows of a raw file: what its columns are, their lines, and the rows not used.

One rule for all messages: a column is called as the file calls it, and beside it as the contract
does, `A6 [°]` (`q6`); a remedy is a key of campaign.yaml and what to set it to.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index
from pa10cal.campaign.recognise import unit_of
from pa10cal.errors import RawDataError
from pa10cal.files.output import csv_text, from_csv_cell
from pa10cal.observe.observations import Observations

#: Columns of text; all others hold numbers.
TEXT = ("id", "kind", "pose", "ball")
COMMA = " (a decimal comma)"
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+")


# What the columns of a file are: one type, whoever says it.

#: What one unit of a column is of the contract's unit: mm, degrees, N m, seconds.
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4}
ANGLES = {"deg": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232}
#: Of polar readings too.
ANGLES_OF_POLAR = {**ANGLES, "gon": 0.9}
#: The unit of joint positions that are counts of an encoder.
COUNTS = "counts"
TORQUES = {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0}
FORCES = {"N": 1.0, "kg": 9.80665}
#: What a number is multiplied by, and what is added then, for the contract's unit.
FACTORS = {
    **(LENGTHS | ANGLES | TORQUES | TIMES | FORCES),
    **{"": 1.0, "C": 1.0, "K": 1.0, "F": 5.0 / 9.0},
}
OFFSETS = {"K": -273.15, "F": -160.0 / 9.0}
QUATERNION = ("qw", "qx", "qy", "qz")
_JOINT = re.compile(r"(q\d+)_(?:deg|mm)")
#: A name that YAML reads as it is.
_PLAIN = re.compile(r"[^\W\d][\w.]*")
#: Units that may stand for each other.
_FAMILIES = (LENGTHS, ANGLES, TORQUES, TIMES, FORCES, {"C": 1.0, "K": 1.0, "F": 1.0})
#: Words of units, for sentences.
UNIT_WORDS = {
    **{"um": "micrometres", "mm": "millimetres", "cm": "centimetres", "in": "inches"},
    **{"m": "metres", "deg": "degrees", "rad": "radians", "mrad": "milliradians"},
}


@dataclass(frozen=True)
class OwnColumn:
    """What a column of the contract was read from, where the file has names of its own."""

    names: tuple[str, ...]  # the file's own name of it; of several columns all of them
    unit: str = ""  # the file's own unit
    # factor and offset: what the file's number is multiplied by, and what is added then
    factor: float = 1.0
    offset: float = 0.0
    key: str = ""  # the key of campaign.yaml that maps it, such as columns.poses.joints

    @property
    def name(self) -> str:
        """Return the file's own name; of several columns all of them."""
        return ", ".join(self.names)


@dataclass(frozen=True)
class ColumnMap:
    """What each column of a file is; empty of one that follows the contract."""

    sources: Mapping[str, OwnColumn] = field(default_factory=dict)  # by the contract's names
    section: str = ""  # where campaign.yaml says it, such as columns.poses

    def __or__(self, other: ColumnMap) -> ColumnMap:
        """Return the columns of two files; of a column in both that of the other."""
        return ColumnMap({**self.sources, **other.sources})

    @property
    def own_names(self) -> list[str]:
        """Return the file's own names of the columns that are mapped."""
        names = (name for source in self.sources.values() for name in source.names)
        return list(dict.fromkeys(names))

    def column(self, name: str) -> str:
        """Return a column of the contract as the file calls it, ours beside it; without it ours."""
        if name not in self:
            return name
        joint = _JOINT.fullmatch(name)
        ours = joint[1] if joint else "qw … qz" if name in QUATERNION else name
        own = ", ".join(f"`{part}`" for part in self.sources[name].names)
        return f"{own} (`{ours}`)"

    def joint(self, number: int) -> str:
        """Return the column of a joint, from 1."""
        names = [name for name in (f"q{number}_deg", f"q{number}_mm") if name in self]
        return self.column(names[0]) if names else f"q{number}"

    def __contains__(self, name: str) -> bool:
        return name in self.sources

    def text(self, text: str) -> str:
        """Return a text in which the file's own names stand beside those of the contract."""
        return re.sub(r"\w+", lambda match: self.column(match[0]), text)

    def key(self, name: str) -> str:
        """Return the key of campaign.yaml that maps a column of the contract; nothing for none."""
        return self.sources[name].key if name in self else ""

    def key_called(self, own: str) -> str:
        """Return the key that maps a column by the file's own name; nothing for none."""
        keys = (source.key for source in self.sources.values() if own in source.names)
        return next(keys, "")

    def set_unit(self, name: str, unit: str, right: str) -> str:
        """Return the remedy for a column of the contract that is in another unit than is stated.

        It is in `unit`, as campaign.yaml calls it; that of the contract is `right`, in words.
        """
        if key := self.key(name):
            slides = key.endswith(".joints") and name.endswith("_mm")
            return f"set {key}.{'stroke_unit' if slides else 'unit'}: {unit}"
        return (
            f"convert the columns to {right}, or state their unit under columns in campaign.yaml: "
            f"unit: {unit}"
        )

    def set_names(self, names: Sequence[str]) -> str:
        """Return the remedy for columns of the contract that hold each other's numbers.

        They are in the order in which the file's columns should be named.
        """
        own = [self.sources[name].name for name in names if name in self]
        quoted = (
            name if _PLAIN.fullmatch(name) else "'{}'".format(name.replace("'", "''"))
            for name in own
        )
        return f"set {self.key(names[0])}.names: [{', '.join(quoted)}]"

    def contradicted_units(self, file: str) -> Iterator[str]:
        """Yield where a header says another unit than the column is read in, once a key."""
        said: set[str] = set()
        for name, own in self.sources.items():
            header = unit_of(own.name)
            known = any({header, own.unit} <= family.keys() for family in _FAMILIES)
            if known and header != own.unit and own.key not in said:
                said.add(own.key)
                yield (
                    f"{file}: {self.column(name)}: its header says {header}, and it is read in "
                    f"{own.unit}; {self.set_unit(name, header, own.unit)} if the header is right"
                )

    def called(self, own: str) -> str:
        """Return a column by the file's own name, ours beside it."""
        ours = [name for name, source in self.sources.items() if source.name == own]
        return self.column(ours[0]) if ours else f"`{own}`" if self.key_called(own) else own


#: Of a file that follows the contract.
CONTRACT_COLUMNS = ColumnMap()


# Rows of a file.


@dataclass(frozen=True)
class RawRows:
    """Rows of one file, or of two that were joined: numbers where a column holds them, else text.

    Whatever is done with rows between the file and `Observations` is done with these.
    """

    file: str  # name of the file; of two that of the readings
    # (N,) the columns requested: numbers, nan where a field holds none; those of `TEXT` as text
    columns: dict[str, NDArray[Any]]
    line: NDArray[np.int64]  # (N,) physical line of every row, the header being line 1
    totals: Mapping[str, int]  # rows in each file, quarantined ones included, by its name
    unused: tuple[str, ...]  # columns that were not requested
    quarantined: tuple[Quarantined, ...]  # rows that are not used
    # what stands where a column of numbers holds no finite one, by its name and the line, but for
    # blanks
    non_numeric: dict[str, dict[int, str]] = field(default_factory=dict)
    own: ColumnMap = CONTRACT_COLUMNS  # the file's own columns
    notes: tuple[str, ...] = ()  # what the reader should know, one clause each

    def __len__(self) -> int:
        return len(self.line)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def text_of(self, name: str) -> NDArray[np.str_]:
        """Return a column of text."""
        return self.columns[name].astype(str)

    def numbers_of(self, names: Sequence[str]) -> Array:
        """Return columns of numbers (N, len(names)); of one that is not there nan."""
        stacked = np.full((len(self), len(names)), np.nan)
        for k, name in enumerate(names):
            stacked[:, k] = self.columns.get(name, np.nan)
        return stacked

    def with_columns(self, columns: Mapping[str, NDArray[Any]]) -> RawRows:
        """Return the rows with further columns, or others."""
        return replace(self, columns={**self.columns, **columns})

    def name_of(self, name: str) -> str:
        """Return the file's own name of a column."""
        return self.own.sources[name].name if name in self.own else name

    def shown(self, name: str, row: int) -> str:
        """Return a column's name and what stands in a row, as the file has both."""
        value, non_numeric = float(self.columns[name][row]), self.non_numeric.get(name, {})
        line = int(self.line[row])
        text = repr(non_numeric[line]) if line in non_numeric else f"{value:.10g}"
        if name not in self.own:
            return f"{name} = {text}"
        own = self.own.sources[name]
        if not np.isfinite(value) or (own.factor, own.offset) == (1.0, 0.0):
            return f"{own.name} = {text}"
        return f"{own.name} = {(value - own.offset) / own.factor:.10g} {own.unit} ({name} = {text})"

    def take(
        self, keep: NDArray[np.bool_], reason: str, values: Iterable[object] | None = None
    ) -> RawRows:
        """Keep some rows; quarantine the others with a reason and (for each of them) a value."""
        if keep.all():
            return self
        lost = quarantined(self.file, self.line[~keep], reason, values)
        return replace(self.at(np.flatnonzero(keep)), quarantined=(*self.quarantined, *lost))

    def at(self, rows: NDArray[np.intp]) -> RawRows:
        """Return rows in the order given."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return replace(self, columns=columns, line=self.line[rows])

    def finite(self, names: Sequence[str], *, may_be_blank: bool = False) -> RawRows:
        """Quarantine the rows in which a column holds no finite number; a blank may be nan."""
        known = [self.non_numeric.get(name, {}) for name in names]
        keep = ~np.isin(self.line, [line for texts in known for line in texts])
        if not may_be_blank:
            keep &= ~np.isnan(self.numbers_of([n for n in names if n in self.columns])).any(axis=1)
        values = []
        for row, line in zip(
            np.flatnonzero(~keep).tolist(), self.line[~keep].tolist(), strict=True
        ):
            name, text = next(
                (name, texts.get(line, ""))
                for name, texts in zip(names, known, strict=True)
                if line in texts or (not may_be_blank and np.isnan(self.columns[name][row]))
            )
            comma = COMMA if _DECIMAL_COMMA.fullmatch(text) else ""
            values.append(f"{self.name_of(name)} = {text!r}{comma}")
        return self.take(keep, "not a finite number", values)

    def choices(self, name: str, allowed: Sequence[str]) -> RawRows:
        """Keep the rows whose column holds one of the allowed words."""
        column = self.text_of(name)
        keep = np.isin(column, list(allowed))
        values = [f"{self.name_of(name)} = {str(value)!r}" for value in column[~keep]]
        return self.take(keep, f"{name} is none of {', '.join(allowed)}", values)

    def in_time(self) -> RawRows:
        """Return the rows in order of time, with notes of what was out of order and is not used."""
        time_s = self.columns["time_s"]
        late = time_s[1:] < np.maximum.accumulate(time_s)[:-1] if len(time_s) else np.zeros(0, bool)
        rows = self.at(np.argsort(time_s, kind="stable")) if late.any() else self
        said = (f"rows of {self.file} out of order: {late.sum()}",) if late.any() else ()
        unused = (f"column {name} of {self.file} is not used" for name in self.unused)
        return replace(rows, notes=(*self.notes, *said, *unused))

    @property
    def configurations(self) -> Index:
        """Return the number of each row's configuration, in the order of their appearance."""
        keys = {name: self.columns[name] for name in ("kind", "pose", "load_N", "repeat")}
        groups = pd.DataFrame(keys).groupby(list(keys), sort=False)
        return np.asarray(groups.ngroup(), dtype=np.intp)


# Rows of raw files that are not used, each with its file, line and reason.


@dataclass(frozen=True, order=True)
class Quarantined:
    """One row that is not used."""

    file: str  # name of the raw file
    line: int  # line in it, the header being line 1
    reason: str  # why it is not used
    value: str = ""  # what was found, as text
    place: str = ""  # the configuration that it is of, in words; empty where that is not known


@dataclass(frozen=True)
class Ingested:
    """A campaign's readings and what is quarantined."""

    observations: Observations  # single readings of all kinds, in order of time
    quarantined: tuple[Quarantined, ...]  # rows that are not used, each once
    notes: tuple[str, ...]  # what the reader should know, one clause each
    warnings: tuple[str, ...] = ()  # what the reader should mend before going on, one sentence each
    timed: bool = True  # whether the file has a column of times


def quarantined(
    file: str,
    lines: NDArray[np.int64] | Sequence[int],
    reason: str,
    values: Iterable[object] | None = None,
    places: Iterable[object] | None = None,
) -> tuple[Quarantined, ...]:
    """List rows quarantined for one reason, with the value found in each, and its place."""
    found, there = (
        [""] * len(lines) if each is None else [str(value) for value in each]
        for each in (values, places)
    )
    return tuple(
        Quarantined(file, int(line), reason, value, place)
        for line, value, place in zip(lines, found, there, strict=True)
    )


def configurations(readings: Observations) -> list[str]:
    """Return which configurations readings are of, in words."""
    parts = (readings.pose, readings.states.load_N, readings.repeat)
    return [f"pose {pose}, {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]


def quarantine_csv(rows: Iterable[Quarantined]) -> str:
    """Return the quarantine table as CSV text."""
    header = ("file", "line", "reason", "value")
    return csv_text(header, ((row.file, row.line, row.reason, row.value) for row in rows))


def joined_listings(listings: Mapping[str, Path]) -> str:
    """Return the quarantine tables of a group's campaigns as one, files by `campaign/file`.

    A listing that is not there has no rows.
    """
    rows = []
    for name, path in listings.items():
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        for row in csv.DictReader(io.StringIO(text, newline="")):
            file, reason, value = (from_csv_cell(row[key]) for key in ("file", "reason", "value"))
            rows.append(Quarantined(f"{name}/{file}", int(row["line"]), reason, value))
    return quarantine_csv(rows)


#: Beginning of the reason of rows that campaign.yaml excludes.
EXCLUDED = "excluded"
_LINES = re.compile(
    r"(?:(?:.*[/\\])?(?P<file>[^/\\]*\.\w+):|lines?\s+)"
    r"(?P<first>\d+)(?:\s*(?:-|–|to)\s*(?P<last>\d+))?"
)
_READING = re.compile(
    r"(?P<label>(?:pose )?(?P<bare>[^,]+?))(?:, (?P<load>[-+.\d]+) N)?(?:, repeat (?P<repeat>\d+))?"
)


@dataclass
class Exclusions:
    """Rows that campaign.yaml excludes, and which of these were met."""

    stated: Sequence[tuple[str, str]]  # where, and why
    where: str  # file and key, for a refusal
    met: set[int] = field(default_factory=set)

    def lines(self, raw: RawRows) -> RawRows:
        """Leave out rows by their lines in the file; lines of another file meet none."""
        for k, (where, why) in enumerate(self.stated):
            lines = _LINES.fullmatch(where)
            if lines is not None and lines["file"] in (None, raw.file):
                first, last = int(lines["first"]), int(lines["last"] or lines["first"])
                unread = (row.line for row in raw.quarantined if row.file == raw.file)
                if any(first <= line <= last for line in unread):
                    self.met.add(k)
                raw = self._without(raw, (raw.line >= first) & (raw.line <= last), k, why)
        return raw

    def labels(self, raw: RawRows) -> RawRows:
        """Leave out rows by their labels, loads and repeats, and refuse what meets no row."""
        for k, (where, why) in enumerate(self.stated):
            reading = _READING.fullmatch(where)
            if k in self.met or reading is None:
                continue
            poses = raw.text_of("pose")
            struck = poses == reading["label" if reading["label"] in poses else "bare"]
            for name, number in (("load_N", reading["load"]), ("repeat", reading["repeat"])):
                if number is not None:
                    struck &= raw[name] == float(number)
            raw = self._without(raw, struck, k, why)
        missed = [where for k, (where, _) in enumerate(self.stated) if k not in self.met]
        if missed:
            raise RawDataError(
                "nothing is there to exclude",
                where=self.where,
                value=missed[0],
                allowed="the label of a pose, such as P012; pose P012, 0 N, repeat 3; line 17, or "
                f"lines 17 to 20, of {raw.file}",
                remedy="correct it, or remove it from exclude",
            )
        return raw

    def _without(self, raw: RawRows, struck: NDArray[np.bool_], k: int, why: str) -> RawRows:
        if struck.any():
            self.met.add(k)
        poses = raw.text_of("pose")[struck] if "pose" in raw.columns else None
        return raw.take(~struck, f"{EXCLUDED}: {why}", poses)


# Joint positions as raw files have them: readings of the same ones are repeats of one pose.


def position_columns(prismatic: NDArray[np.bool_]) -> list[str]:
    """Return the raw columns of joint positions: q1_deg …, or q1_mm of a prismatic joint."""
    units = np.where(prismatic, "mm", "deg")
    return [f"q{joint}_{unit}" for joint, unit in enumerate(units, start=1)]


def in_radians(q: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Return logged joint positions (N, n) in radians; in metres of prismatic joints."""
    return np.asarray(np.where(prismatic, 1e-3 * q, np.radians(q)))


def as_joints(logged: Array, arm: Arm) -> Array:
    """Return the positions of an arm's joints (N, n) [deg, mm] of those of its axes (N, m)."""
    if arm.coupling.none:
        return logged
    q = arm.coupling.to_joints(in_radians(logged, arm.axes_slide))
    return np.where(arm.prismatic, 1e3 * q, np.degrees(q))


def as_logged(q: Array, arm: Arm) -> Array:
    """Return the positions of an arm's axes (N, m) [deg, mm] of those of its joints (N, n)."""
    if arm.coupling.none:
        return q
    axes = arm.coupling.to_axes(in_radians(q, arm.prismatic))
    return np.where(arm.axes_slide, 1e3 * axes, np.degrees(axes))


def with_labels(raw: RawRows, q: Sequence[str], same_deg: float) -> RawRows:
    """Label rows whose own file does not: equal joint positions are one pose, its repeats counted.

    Poses and repeats are numbered in order of time.
    """
    if {"pose", "repeat"} <= set(raw.columns):
        return raw
    table = raw.numbers_of(["time_s", "load_N", *q])
    order = np.argsort(table[:, 0], kind="stable")
    if "pose" not in raw.columns:
        raw.columns["pose"] = np.empty(len(order), dtype=object)
        raw.columns["pose"][order] = labels(same_commands(table[order, 2:], same_deg))
    if "repeat" not in raw.columns:
        keys = pd.DataFrame({"pose": raw.text_of("pose"), "load": table[:, 1]}).iloc[order]
        counted = keys.groupby(["pose", "load"], sort=False).cumcount().to_numpy() + 1.0
        raw.columns["repeat"] = np.empty(len(order))
        raw.columns["repeat"][order] = counted
    return raw


#: Places that a chain of neighbours joins over more than so many tolerances are told apart anew.
CHAIN = 3.0
#: Commands that differ by less are one however fine the poses lie [deg, mm].
SAME_COMMAND = 1e-4


def same_commands(q: Array, tolerance: float) -> NDArray[np.intp]:
    """Number the places (N,) of joint positions [deg, mm] from 0, as they first appear.

    Positions within a tolerance of each other are one place: what is read back scatters. Where
    poses lie so densely that a chain of them would be one, only equal ones are.
    """

    def neighbours(q: Array, within: float) -> Index:
        pairs = cKDTree(q).query_pairs(within, p=np.inf, output_type="ndarray")
        return groups_joined(pairs[:, 0], pairs[:, 1], len(q))

    group = neighbours(q, tolerance)
    of_group = pd.DataFrame(q).groupby(group)
    spread = (of_group.max() - of_group.min()).max(axis=1)
    dense = np.isin(group, spread.index[spread > CHAIN * tolerance])
    if dense.any():
        group[dense] = group.max() + 1 + neighbours(q[dense], min(SAME_COMMAND, tolerance))
    return np.asarray(pd.factorize(group)[0], dtype=np.intp)


def groups_joined(one: Index, other: Index, count: int) -> Index:
    """Number the connected groups of things, of which pairs (one[k], other[k]) belong together."""
    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def labels(number: NDArray[np.intp]) -> list[str]:
    """Return labels of commands, which sort as text in the order of their numbers."""
    digits = max(5, len(str(number.max(initial=0) + 1)))
    return [f"P{k:0{digits}d}" for k in number + 1]
