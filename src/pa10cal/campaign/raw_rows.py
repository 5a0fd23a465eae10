"""Rows of a raw file: their columns and lines, and the rows that are quarantined or excluded."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.statics import loads_as_named
from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.column_map import CONTRACT_COLUMNS, ColumnMap
from pa10cal.errors import RawDataError
from pa10cal.files.table_cells import csv_text, from_csv_cell
from pa10cal.observe.observations import Observations

#: Columns of text; all others hold numbers.
TEXT = ("id", "kind", "pose", "ball")
#: Ends the value of a row that is quarantined for it.
COMMA = " (a decimal comma)"
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+")


@dataclass(frozen=True)
class InFile:
    """Where N rows stand among the F rows of their file, those that cannot be used included.

    Rows of one target each that were made one row a pose are counted as poses.
    """

    number: Index  # (N,) of each row, from 0
    repeats: Mask  # (F,) whether a row repeats an earlier one exactly
    unread: Mask  # (F,) whether nothing is known of a row
    labels: NDArray[Any]  # (F,) label of each row in the file's own column; "" where not known

    @property
    def count(self) -> int:
        """Return how many rows the file has."""
        return len(self.repeats)

    @classmethod
    def of_all(cls, count: int) -> InFile:
        """Return the places of rows that are all that the file has."""
        none = np.zeros(count, dtype=bool)
        return cls(np.arange(count), none, none, np.full(count, "", dtype=object))


@dataclass(frozen=True)
class RawRows:
    """The N rows of one file, or of two joined files, before they become `Observations`."""

    file: str  # name of the file; of two files that of the readings
    # (N,) requested columns: numbers, nan where a field is no number; columns of `TEXT` as text
    columns: dict[str, NDArray[Any]]
    line: NDArray[np.int64]  # (N,) physical line of every row, the header being line 1
    totals: Mapping[str, int]  # number of rows in each file, quarantined ones included, by name
    unused: tuple[str, ...]  # columns that were not requested
    quarantined: tuple[Quarantined, ...]  # rows that are not used
    # fields that hold no finite number in a column of numbers, by column and line; without blanks
    non_numeric: dict[str, dict[int, str]] = field(default_factory=dict)
    own: ColumnMap = CONTRACT_COLUMNS  # the file's own columns
    notes: tuple[str, ...] = ()  # what the user should know, one clause each
    warnings: tuple[str, ...] = ()  # what the user should correct first, one sentence each
    in_file: InFile | None = None  # where the rows stand in one file, by a reader that counts them

    def __len__(self) -> int:
        return len(self.line)

    @property
    def numbered(self) -> InFile:
        """Return where the rows stand in their file; as if there were no others if not counted."""
        return InFile.of_all(len(self)) if self.in_file is None else self.in_file

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def text_of(self, name: str) -> NDArray[np.str_]:
        """Return a column of text."""
        return self.columns[name].astype(str)

    def numbers_of(self, names: Sequence[str]) -> Array:
        """Return columns of numbers (N, len(names)); nan for a column that is not there."""
        stacked = np.full((len(self), len(names)), np.nan)
        for k, name in enumerate(names):
            stacked[:, k] = self.columns.get(name, np.nan)
        return stacked

    def with_columns(self, columns: Mapping[str, NDArray[Any]]) -> RawRows:
        """Return the rows with columns added or replaced."""
        return replace(self, columns={**self.columns, **columns})

    def name_of(self, name: str) -> str:
        """Return the file's own name of a column."""
        return self.own.sources[name].name if name in self.own else name

    def shown(self, name: str, row: int) -> str:
        """Return `name = value` of a column in a row, both as the file has them."""
        value, non_numeric = float(self.columns[name][row]), self.non_numeric.get(name, {})
        line = int(self.line[row])
        text = repr(non_numeric[line]) if line in non_numeric else f"{value:.10g}"
        if name not in self.own:
            return f"{name} = {text}"
        own = self.own.sources[name]
        if not np.isfinite(value) or (own.factor, own.offset) == (1.0, 0.0):
            return f"{own.name} = {text}"
        return f"{own.name} = {(value - own.offset) / own.factor:.10g} {own.unit} ({name} = {text})"

    def take(self, keep: Mask, reason: str, values: Iterable[object] | None = None) -> RawRows:
        """Return the rows to keep (N,); quarantine the others, each with a reason and its value."""
        if keep.all():
            return self
        lost = quarantined(self.file, self.line[~keep], reason, values)
        return replace(self.at(np.flatnonzero(keep)), quarantined=(*self.quarantined, *lost))

    def at(self, rows: NDArray[np.intp]) -> RawRows:
        """Return the rows with these numbers, in their order."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        numbered = self.in_file
        if numbered is not None:
            numbered = replace(numbered, number=numbered.number[rows])
        return replace(self, columns=columns, line=self.line[rows], in_file=numbered)

    def finite(self, names: Sequence[str], *, may_be_blank: bool = False) -> RawRows:
        """Quarantine rows with no finite number in one of the columns; blanks may be allowed."""
        wrong = np.zeros((len(self), len(names)), dtype=bool)
        for k, name in enumerate(names):
            wrong[:, k] = np.isin(self.line, list(self.non_numeric.get(name, {})))
            if not may_be_blank and name in self.columns:
                wrong[:, k] |= np.isnan(self.columns[name])
        values, lost = [], np.asarray(wrong.any(axis=1))
        for row in np.flatnonzero(lost).tolist():
            name = names[int(wrong[row].argmax())]
            text = self.non_numeric.get(name, {}).get(int(self.line[row]), "")
            comma = COMMA if _DECIMAL_COMMA.fullmatch(text) else ""
            values.append(f"{self.name_of(name)} = {text!r}{comma}")
        return self.take(~lost, "not a finite number", values)

    def choices(self, name: str, allowed: Sequence[str]) -> RawRows:
        """Quarantine the rows whose column holds none of the allowed words."""
        column = self.text_of(name)
        keep = np.isin(column, list(allowed))
        values = [f"{self.name_of(name)} = {str(value)!r}" for value in column[~keep]]
        return self.take(keep, f"{name} is none of {', '.join(allowed)}", values)

    def in_time(self) -> RawRows:
        """Return the rows in order of time, with notes on rows out of order and unused columns."""
        time_s, rows, notes = self.columns["time_s"], self, list(self.notes)
        late = time_s[1:] < np.maximum.accumulate(time_s)[:-1] if len(time_s) else np.zeros(0, bool)
        if late.any():
            rows = self.at(np.argsort(time_s, kind="stable"))
            notes.append(f"rows of {self.file} out of order: {late.sum()}")
        notes += [
            f"column {name} of {self.file} is not used{load_hint([name])}" for name in self.unused
        ]
        return replace(rows, notes=tuple(notes))

    @property
    def configurations(self) -> Index:
        """Return the number (N,) of each row's configuration, in order of first appearance.

        Rows of one configuration agree in kind, pose, load and repeat.
        """
        keys = {name: self.columns[name] for name in ("kind", "pose", "load_N", "repeat")}
        groups = pd.DataFrame(keys).groupby(list(keys), sort=False)
        return np.asarray(groups.ngroup(), dtype=np.intp)

    @property
    def in_words(self) -> list[str]:
        """Return the configuration of each row in words."""
        return _in_words(self.text_of("pose"), self["load_N"], self["repeat"])


def load_hint(unused: Iterable[str]) -> str:
    """Return how a load is read, for a line about columns that are not; empty if none names one."""
    is_load = any("load" in name.lower() for name in unused)
    return " (a load is read as load_N, in newtons)" if is_load else ""


@dataclass(frozen=True, order=True)
class Quarantined:
    """One row of a raw file that is not used."""

    file: str  # name of the raw file
    line: int  # line in it, the header being line 1
    reason: str  # why it is not used
    value: str = ""  # the value that was found, as text
    place: str = ""  # its configuration, in words; empty where that is not known


@dataclass(frozen=True)
class Ingested:
    """A campaign's readings and the rows that are quarantined."""

    observations: Observations  # single readings of all kinds, in order of time
    quarantined: tuple[Quarantined, ...]  # rows that are not used, each once
    notes: tuple[str, ...]  # what the user should know, one clause each
    warnings: tuple[str, ...] = ()  # what the user should correct first, one sentence each
    timed: bool = True  # whether the file has a column of times


def quarantined(
    file: str,
    lines: NDArray[np.int64] | Sequence[int],
    reason: str,
    values: Iterable[object] | None = None,
    places: Iterable[object] | None = None,
) -> tuple[Quarantined, ...]:
    """List rows quarantined for one reason, with the value found in each, and its configuration."""
    value_texts = [""] * len(lines) if values is None else list(map(str, values))
    place_texts = [""] * len(lines) if places is None else list(map(str, places))
    return tuple(
        Quarantined(file, int(line), reason, value, place)
        for line, value, place in zip(lines, value_texts, place_texts, strict=True)
    )


def configurations(readings: Observations) -> list[str]:
    """Return the configuration of each reading in words."""
    return _in_words(readings.pose, readings.states.load_N, readings.repeat)


def _in_words(poses: Iterable[str], loads_N: Array, repeats: NDArray[np.int64]) -> list[str]:
    """Return configurations in the words in which `exclude` of campaign.yaml takes them."""
    parts = zip(poses, loads_N, repeats, strict=True)
    return [f"pose {pose}, {load:g} N, repeat {k}" for pose, load, k in parts]


def quarantine_csv(rows: Iterable[Quarantined]) -> str:
    """Return the quarantine table as CSV text."""
    header = ("file", "line", "reason", "value")
    return csv_text(header, ((row.file, row.line, row.reason, row.value) for row in rows))


def joined_listings(listings: Mapping[str, Path]) -> str:
    """Return the quarantine tables of a group's campaigns as one, with files as `campaign/file`.

    A table that is not there has no rows.
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
#: Rows by their lines: `line 17`, `lines 17 to 20`, `poses.csv:17`.
_LINES = re.compile(
    r"(?:(?:.*[/\\])?(?P<file>[^/\\]*\.\w+):|lines?\s+)"
    r"(?P<first>\d+)(?:\s*(?:-|–|to)\s*(?P<last>\d+))?"
)
#: Rows by their label: `P012`, or `pose P012, 0 N, repeat 3`.
_READING = re.compile(
    r"(?P<label>(?:pose )?(?P<bare>.+?))"
    r"(?:, (?P<load>[-+]?\d+(?:\.\d*)?) N)?(?:, repeat (?P<repeat>\d+))?"
)


@dataclass
class Exclusions:
    """Exclusions that campaign.yaml states, and those of them that have met a row."""

    stated: Sequence[tuple[str, str]]  # rows, and the reason to exclude them
    where: str  # file and key, for a refusal
    met: set[int] = field(default_factory=set)  # numbers of the exclusions that met a row
    lines: list[str] = field(default_factory=list)  # those of them that are lines

    def without(self, raw: RawRows) -> RawRows:
        """Quarantine rows that are excluded, each for the first reason that is stated.

        An exclusion by a column that is made later is left for then. What is made counts no line
        that was excluded before: a warning says so.
        """
        every, left, lines_before = raw, np.ones(len(raw), dtype=bool), ", ".join(self.lines)
        for number, (where, why) in enumerate(self.stated):
            if number in self.met:  # else `pose 5`, now gone, would be taken for the label `5`
                continue
            place = where.removeprefix(f"{raw.file}: ")  # as messages have it
            excluded = _in_lines(every, place)
            if excluded is not None:
                self.lines.append(where)
            else:
                excluded = _labelled(every, place)
            if excluded is None:
                continue
            self.met.add(number)
            lost = excluded[left]
            poses = raw.text_of("pose")[lost] if "pose" in raw.columns else None
            raw = raw.take(~lost, f"{EXCLUDED}: {why}", poses)
            left &= ~excluded
            if lines_before:
                told = ", ".join(map(str, every.line[excluded].tolist()))
                warning = (
                    f"{self.where}: {where} is line {told} of {raw.file}, as labels and repeats "
                    f"that the file lacks are counted without {lines_before}: if another row is "
                    "meant, state its line"
                )
                raw = replace(raw, warnings=(*raw.warnings, warning))
        return raw

    def refuse_missed(self, file: str) -> None:
        """Refuse exclusions, of lines or of labels, that have met no row of a file."""
        missed = [where for k, (where, _) in enumerate(self.stated) if k not in self.met]
        if missed:
            raise RawDataError(
                "nothing is there to exclude",
                where=self.where,
                value=missed[0],
                allowed="the label of a pose, such as P012; pose P012, 0 N, repeat 3; line 17, or "
                f"lines 17 to 20, of {file}",
                remedy="correct it, or remove it from exclude",
            )


def _in_lines(raw: RawRows, where: str) -> Mask | None:
    """Return the rows (N,) in the lines of their file that are named; None where none is there.

    A line that could not be read is there, without a row.
    """
    lines = _LINES.fullmatch(where)
    if lines is None or lines["file"] not in (None, raw.file):
        return None
    first, last = int(lines["first"]), int(lines["last"] or lines["first"])
    excluded = (raw.line >= first) & (raw.line <= last)
    unread = (row.line for row in raw.quarantined if row.file == raw.file)
    return excluded if excluded.any() or any(first <= k <= last for k in unread) else None


def _labelled(raw: RawRows, where: str) -> Mask | None:
    """Return the rows (N,) of the label, load and repeat that are named; None where none is."""
    reading = _READING.fullmatch(where)
    if reading is None or "pose" not in raw.columns:
        return None
    poses = raw.text_of("pose")
    labelled = poses == reading["label" if reading["label"] in poses else "bare"]
    for name, key in (("load_N", "load"), ("repeat", "repeat")):
        if reading[key] is None:
            continue
        if name not in raw.columns:
            return None
        same = loads_as_named if name == "load_N" else np.asarray
        labelled &= same(raw[name]) == same(np.array([float(reading[key])]))
    return labelled if labelled.any() else None
