"""Rows of a raw file: columns of numbers and of text, their lines, and the rows not used."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.errors import RawDataError
from pa10cal.files.output import csv_cell
from pa10cal.observe.observations import Observations

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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("file", "line", "reason", "value"))
    writer.writerows((row.file, row.line, row.reason, csv_cell(row.value)) for row in rows)
    return text.getvalue()


def joined_listings(listings: Mapping[str, Path]) -> str:
    """Return the quarantine tables of a group's campaigns as one, files by `campaign/file`.

    Args:
        listings: of each campaign by its name; one that is not there has no rows.
    """
    rows = []
    for name, path in listings.items():
        if path.is_file():
            with path.open(encoding="utf-8", newline="") as file:
                rows += [
                    Quarantined(
                        f"{name}/{row['file']}", int(row["line"]), row["reason"], row["value"]
                    )
                    for row in csv.DictReader(file)
                ]
    return quarantine_csv(rows)


#: Beginning of the reason of rows that campaign.yaml excludes.
EXCLUDED = "excluded"
_LINES = re.compile(r"(?:.*:|lines?\s+)(?P<first>\d+)(?:\s*(?:-|–|to)\s*(?P<last>\d+))?")
_READING = re.compile(
    r"(?:pose )?(?P<label>[^,]+?)(?:, (?P<load>[-+.\d]+) N)?(?:, repeat (?P<repeat>\d+))?"
)


@dataclass
class Exclusions:
    """Rows that campaign.yaml excludes, and which of these were met."""

    stated: Sequence[tuple[str, str]]  # where, and why
    where: str  # file and key, for a refusal
    met: set[int] = field(default_factory=set)

    def lines(self, raw: RawRows) -> RawRows:
        """Leave out rows by their lines in the file."""
        for k, (where, why) in enumerate(self.stated):
            if (found := _LINES.fullmatch(where)) is None:
                continue
            first, last = int(found["first"]), int(found["last"] or found["first"])
            struck = (raw.line >= first) & (raw.line <= last)
            if struck.any() or any(first <= row.line <= last for row in raw.quarantined):
                self.met.add(k)
            raw = self._without(raw, struck, why)
        return raw

    def labels(self, raw: RawRows) -> RawRows:
        """Leave out rows by their labels, loads and repeats, and refuse what meets no row."""
        for k, (where, why) in enumerate(self.stated):
            found = _READING.fullmatch(where)
            if _LINES.fullmatch(where) or found is None:
                continue
            struck = raw.text_of("pose") == found["label"]
            for name, number in (("load_N", found["load"]), ("repeat", found["repeat"])):
                if number is not None:
                    struck &= raw.columns[name] == float(number)
            if struck.any():
                self.met.add(k)
            raw = self._without(raw, struck, why)
        missed = [where for k, (where, _) in enumerate(self.stated) if k not in self.met]
        if missed:
            raise RawDataError(
                "nothing is there to exclude",
                where=self.where,
                value=missed[0],
                allowed="the label of a pose, such as P012; pose P012, 0 N, repeat 3; line 17; "
                "lines 17 to 20",
                remedy="correct it, or remove it from exclude",
            )
        return raw

    def _without(self, raw: RawRows, struck: NDArray[np.bool_], why: str) -> RawRows:
        poses = raw.text_of("pose")[struck] if "pose" in raw.columns else None
        return raw.take(~struck, f"{EXCLUDED}: {why}", poses)


#: Columns of text; all others hold numbers.
TEXT = ("id", "kind", "pose", "ball")


@dataclass(frozen=True)
class OwnColumn:
    """What a column of the contract was read from, where the file has names of its own."""

    name: str  # the file's own name of it; of several columns all of them
    unit: str = ""  # the file's own unit
    # factor and offset: what the file's number is multiplied by, and what is added then
    factor: float = 1.0
    offset: float = 0.0
    key: str = ""  # the key of campaign.yaml that maps it, such as columns.poses.joints


@dataclass(frozen=True)
class RawRows:
    """Rows of one CSV file: numbers where a column holds them, else text."""

    file: str  # name of the file
    # (N,) the columns requested: numbers, nan where a field holds none; those of `TEXT` as text
    columns: dict[str, NDArray[Any]]
    line: NDArray[np.int64]  # (N,) physical line of every row, the header being line 1
    total: int  # rows in the file, quarantined ones included
    unused: tuple[str, ...]  # columns that were not requested
    quarantined: tuple[Quarantined, ...]  # rows that are not used
    # what stands where a column of numbers holds no finite one, by its name and the line
    odd: dict[str, dict[int, str]] = field(default_factory=dict)
    # the file's own columns, by the contract's names; empty where it has those
    own: dict[str, OwnColumn] = field(default_factory=dict)

    def name_of(self, name: str) -> str:
        """Return the file's own name of a column."""
        return self.own[name].name if name in self.own else name

    def shown(self, name: str, row: int) -> str:
        """Return a column's name and what stands in a row, as the file has both."""
        value, odd = float(self.columns[name][row]), self.odd.get(name, {})
        line = int(self.line[row])
        text = repr(odd[line]) if line in odd else f"{value:.10g}"
        if name not in self.own:
            return f"{name} = {text}"
        own = self.own[name]
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

    def text_of(self, name: str) -> NDArray[np.str_]:
        """Return a column of text."""
        return self.columns[name].astype(str)


def numbers(
    raw: RawRows, names: Sequence[str], *, may_be_blank: bool = False
) -> tuple[RawRows, Array]:
    """Read columns as finite numbers; rows where one is none are quarantined.

    Args:
        raw: the rows.
        names: columns.
        may_be_blank: whether an empty field is nan, rather than none.

    Returns:
        The remaining rows and their numbers (N, len(names)).
    """
    raw = finite(raw, names, may_be_blank=may_be_blank)
    parsed = np.empty((len(raw.line), len(names)))
    for k, name in enumerate(names):
        parsed[:, k] = raw.columns[name]
    return raw, parsed


COMMA = " (a decimal comma)"
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+")


def finite(raw: RawRows, names: Sequence[str], *, may_be_blank: bool = False) -> RawRows:
    """Quarantine the rows in which a column holds no finite number; see `numbers`."""
    wrong: dict[int, str] = {}
    for name in names:
        for line, text in raw.odd.get(name, {}).items():
            if text != "" or not may_be_blank:
                comma = COMMA if _DECIMAL_COMMA.fullmatch(text) else ""
                wrong.setdefault(line, f"{raw.name_of(name)} = {text!r}{comma}")
    keep = ~np.isin(raw.line, list(wrong))
    return raw.take(keep, "not a finite number", [wrong[line] for line in raw.line[~keep].tolist()])


def choices(raw: RawRows, name: str, allowed: Sequence[str]) -> RawRows:
    """Keep the rows whose column holds one of the allowed words."""
    column = raw.text_of(name)
    keep = np.isin(column, list(allowed))
    values = [f"{raw.name_of(name)} = {str(value)!r}" for value in column[~keep]]
    return raw.take(keep, f"{name} is none of {', '.join(allowed)}", values)
