"""How an unknown file is written: separator, decimal sign, line of the names, numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.csv_rows import (
    MOST_COLUMNS,
    Layout,
    empty_file,
    numbered_apart,
    part_of,
    too_many_columns,
)
from pa10cal.campaign.formats import Format, format_of_columns, format_of_file, table_lines
from pa10cal.campaign.recognise import canonical_unit, unit_alone
from pa10cal.campaign.text_lines import TextLine, binary_kind, encoding_of
from pa10cal.errors import RawDataError

#: So many lines, or letters, are looked at.
LINES, LETTERS = 3000, 1 << 21
#: So many at least of the lines below them, spread to the end.
SPREAD = 500
LEAST_FIELDS = 3
_COMMENT = "//"  # of SpatialAnalyzer; such a line names no columns
_SEPARATORS = (";", "\t", ",", "|", None)
#: Lines of names and units over the rows, at most, in which a column is named.
_MOST_NAMES = 3
#: A name of words, one of which may be a number, a letter, or a unit in brackets.
_NAME = re.compile(r"[^\W\d_][^\s\[(]+(?:\s+(?:\d+|[^\W\d_](?!\S)|[\[(][^\])]*[\])]))*|\S+")


@dataclass(frozen=True)
class Sniffed:
    """A file, as far as it was looked at."""

    layout: Layout  # how it is written
    encoding: str  # of its text; empty of a workbook
    names: tuple[str, ...]  # of its columns
    units: tuple[str, ...]  # what a line of units below the names says of each; empty without one
    lines: tuple[int, ...]  # (N,) physical line of each row
    text: NDArray[np.object_]  # (N, k) fields of the rows
    numbers: Array  # (N, k) the same as numbers, nan where a field is none
    format: Format | None = None  # the known format of the file that the table is made of
    notes: tuple[str, ...] = ()  # what of the file is not in the table
    # what the columns are called in a line that is not written as the rows are; then their names
    # are 1, 2, …; empty where names are what they are called
    titles: tuple[str, ...] = ()
    file: str = ""  # its name

    def column(self, name: str) -> Array:
        """Return a column of numbers."""
        return self.numbers[:, self.names.index(name)]

    def columns(self, names: Sequence[str]) -> Array:
        """Return columns of numbers (N, len(names))."""
        return np.column_stack([self.column(name) for name in names])

    def words(self, name: str) -> list[str]:
        """Return a column as it is written."""
        return [str(each) for each in self.text[:, self.names.index(name)]]

    @property
    def texts(self) -> dict[str, list[str]]:
        """Return columns that may hold labels: words, or whole numbers that do not count rows."""
        counts = self.counts
        every = zip(self.names, self.numbers.T, strict=True)
        return {
            name: self.words(name)
            for name, values in every
            if name not in counts and (_few_numbers(values) or _whole(values))
        }

    @property
    def counts(self) -> dict[str, list[str]]:
        """Return columns of whole numbers that count rows."""
        every = zip(self.names, self.numbers.T, strict=True)
        return {
            name: self.words(name)
            for name, values in every
            if not _few_numbers(values)
            and _whole(values)
            and len(np.unique(np.diff(values[np.isfinite(values)]))) <= 1
        }

    def titled(self, name: str) -> str:
        """Return a name with the unit that a line below the names gives it."""
        at = self.names.index(name)
        unit, title = self.units[at] if self.units else "", self.titles[at] if self.titles else name
        return f"{title} [{unit}]" if unit else title


def _few_numbers(values: Array) -> bool:
    return bool(np.isfinite(values).mean() < 0.5)


def _whole(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return bool((known == np.round(known)).all())


def sniff(path: Path) -> Sniffed:
    """Find out how a file of rows of numbers is written; refuse one without such rows."""
    of, notes = format_of_file(path), list[str]()
    found = of
    of = None if of is None or of.table is None else of  # the table is made of the file
    name = "" if of is None else of.name
    below = table_lines(path, name, notes=notes)
    head = part_of(below, LINES, LETTERS)
    lines = [(line.number, line.text) for line in (*head, *_spread(below))]
    lines = [line for line in lines if not line[1].startswith(_COMMENT)] or lines
    if not lines:
        raise empty_file(path)
    for number, line in lines:
        if (most := max(len(line.split()), *map(line.count, ";\t,|"))) > MOST_COLUMNS:
            raise too_many_columns(f"{path}:{number}", most)
    binary = binary_kind(path)
    of_table = Layout.of_table(name)
    ways = [
        _judged(lines, replace(of_table, separator=separator, decimal=decimal))
        for separator in (("\t",) if binary or of else _SEPARATORS)
        for decimal in ("." if binary else ".,")
        if separator != decimal and lines
    ]
    share, width, layout = max(
        ways or [(0.0, 0, Layout())], key=lambda way: (round(way[0], 3), way[1])
    )
    if of is not None:
        width = len(layout.fields(lines[0][1]))
    elif share < 0.3 or width < LEAST_FIELDS:
        arrays = any("[[" in text for _, text in lines)
        raise RawDataError(
            "fields hold whole matrices as text" if arrays else "no rows of numbers were found",
            where=str(path),
            allowed="a text file or a workbook with a row for each configuration: joint "
            "positions, and what was measured",
            remedy="write each element of a matrix into a column of its own: 12 or 16 columns"
            if arrays
            else "export the rows as text; a binary log is not read",
        )
    if of is None and _last_is_empty(lines, layout, width):
        width += 1
    rows = [(number, layout.row(text, width)) for number, text in lines]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    every = np.array([[layout.number(field) for field in fields] for _, fields in rows])
    starts = np.mean(~np.isnan(every), axis=1)
    usual = float(np.median(starts))
    body = next(k for k, share in enumerate(starts) if share >= 0.6 * usual) if of is None else 1
    if len(rows) == body:
        raise RawDataError(
            "there is no whole row under the names of the columns",
            where=str(path),
            allowed="a row for each configuration, with a field for each column",
            remedy="export the file again",
        )
    named = body > 0
    units: tuple[str, ...] = ()
    called: tuple[str, ...] = ()
    if of is not None:
        names = tuple(numbered_apart(rows[0][1]))
    elif named:
        titles = rows[body - 1]
        # Most words of a line of units are known ones.
        known = [canonical_unit(unit_alone(field)) != "" for field in titles[1] if field]
        if body > 1 and known and np.mean(known) > 0.6:
            units, titles = tuple(map(unit_alone, titles[1])), rows[body - 2]
        follows = rows[body][0] > titles[0] + 1 + bool(units)
        first = rows[body][0] if units or follows else 0
        layout = replace(layout, header=titles[0], first=first)
        names = tuple(numbered_apart(titles[1]))
    else:
        layout = replace(layout, header=0, first=rows[0][0] if rows[0][0] > 1 else 0)
        above = [text for number, text in lines if number < rows[0][0]]
        called = _titles(above[-1], width) if above else ()
        names = tuple(str(k) for k in range(1, width + 1))
    text = np.array([fields for _, fields in rows[body:]], dtype=object)
    encoding = "" if binary else encoding_of(path)
    of_rows = tuple(number for number, _ in rows[body:])
    return Sniffed(
        layout,
        encoding,
        names,
        units,
        of_rows,
        text.reshape(-1, width),
        every[body:],
        found or format_of_columns(names, every[body:]),
        tuple(dict.fromkeys(notes)),
        called,
        path.name,
    )


def _last_is_empty(lines: Sequence[tuple[int, str]], layout: Layout, width: int) -> bool:
    """Return whether a column is named after those in which something stands."""
    rows = [layout.fields(text) for _, text in lines]
    last = [row[-1] for row in rows if len(row) == width + 1]
    named = [k for k, field in enumerate(last[:_MOST_NAMES]) if field != ""]
    return bool(named) and len(last) - len(named) > 0.5 * len(rows)


def _titles(text: str, width: int) -> tuple[str, ...]:
    """Return what so many columns are called in a line with other separators than the rows have.

    Names that run on, such as Joint 1, are told apart by wider blanks, or as words that a number, a
    letter or a unit follows. Of more names than columns the first are taken. Nothing where the line
    holds no names.
    """
    ways = [[word.strip(' "') for word in text.strip().split(each)] for each in ("\t", ";", ",")]
    ways.append(re.split(r"\s{2,}", text.strip()))
    ways.append(_NAME.findall(text))
    equal = [fields for fields in ways if len(fields) == width]
    longer = [fields for fields in ways[:3] if len(fields) > width]
    for fields in (*equal, *longer):
        words = [field for field in fields[:width] if re.search(r"[^\W\d_]", field)]
        if len(words) > 0.6 * width:
            return tuple(numbered_apart(fields[:width]))
    return ()


def _spread(lines: Iterator[TextLine]) -> list[TextLine]:
    """Return some of the lines, evenly spread, however many there are."""
    kept, every = [], 1
    for k, line in enumerate(lines):
        if k % every == 0:
            kept.append(line)
        if len(kept) > 2 * SPREAD:
            kept, every = kept[::2], 2 * every
    return kept


def rows_at(path: Path, sniffed: Sniffed, lines: Collection[int]) -> Sniffed:
    """Return a file as it was looked at, with the rows of these lines in place of the first."""
    layout, wanted = sniffed.layout, set(lines)
    found = (line for line in table_lines(path, layout.format) if line.number in wanted)
    width = len(sniffed.names)
    rows = [(line.number, layout.row(line.text, width)) for line in found]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    every = np.array([[layout.number(field) for field in fields] for _, fields in rows])
    text = np.array([fields for _, fields in rows], dtype=object).reshape(-1, width)
    of_rows = tuple(number for number, _ in rows)
    return replace(sniffed, lines=of_rows, text=text, numbers=every.reshape(-1, width))


def _judged(lines: Sequence[tuple[int, str]], layout: Layout) -> tuple[float, int, Layout]:
    """Return the share of fields that are numbers in rows of the usual width, and that width."""
    rows = [layout.fields(text) for _, text in lines]
    # A separator at the end of each line makes an empty field, which is none.
    rows = [row[:-1] if row[-1] == "" else row for row in rows]
    width, times = Counter(map(len, rows)).most_common(1)[0]
    usual = [row for row in rows if len(row) == width]
    shares = [
        np.mean([not np.isnan(layout.number(field)) for field in row]) for row in usual[-200:]
    ]
    share = float(np.mean(shares))
    return share * times / len(rows), width, layout
