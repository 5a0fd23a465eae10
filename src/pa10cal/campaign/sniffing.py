"""How an unknown file is written: separator, decimal sign, line of the names, numbers, times."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
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
from pa10cal.campaign.recognise import MOST_LETTERS, canonical_unit, unit_alone
from pa10cal.campaign.text_lines import TextLine, binary_kind, encoding_of
from pa10cal.errors import RawDataError

#: So many lines, or letters, are looked at.
LINES, LETTERS = 3000, 1 << 21
#: So many at least of the lines below them, spread to the end.
SPREAD = 500
LEAST_FIELDS = 3
_COMMENT = "//"  # of SpatialAnalyzer; such a line names no columns
_SEPARATORS = (";", "tab", ",", "|", "blanks")
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
    name = None if of is None else of.name
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
    written = [
        Layout.model_validate({"format": name, "separator": separator, "decimal": decimal})
        for separator in ((",",) if of else ("tab",) if binary else _SEPARATORS)
        for decimal in ("." if binary else ".,")
    ]
    ways = [_judged(lines, layout) for layout in written if layout.sign != layout.decimal]
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
        layout = layout.model_copy(update={"header": titles[0], "first_row": first})
        names = tuple(numbered_apart(titles[1]))
    else:
        first = rows[0][0] if rows[0][0] > 1 else 0
        layout = layout.model_copy(update={"header": 0, "first_row": first})
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


# Columns of dates and times: in which format they are, and which unit numbers have.

#: The format of times as ISO 8601 has them.
ISO = "iso"
#: A date alone, and a time of day alone, which together are a time.
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?", re.I)
#: Numbers of days since 1900, as workbooks count time, between 1982 and 2064.
_SERIAL_DAYS = (30_000.0, 60_000.0)


def time_columns(
    sniffed: Sniffed, name: str, others: Sequence[str], stated: str | None
) -> tuple[dict[str, Any], str]:
    """Return what `columns` says of the time, and what is to be checked of it; empty for nothing.

    Args:
        sniffed: the file.
        name: column of times.
        others: every column that may hold a date or a time of day.
        stated: unit of the column, where its name says it.
    """
    words, numbers = sniffed.words(name), sniffed.column(name)
    names: str | list[str] = name
    first = {other: sniffed.words(other)[0] for other in others}
    days = [other for other, word in first.items() if _DAY.fullmatch(word)]
    clocks = [other for other, word in first.items() if _CLOCK.fullmatch(word)]
    if days and clocks:
        names = [days[0], clocks[0]]
        words = [" ".join(row) for row in zip(*map(sniffed.words, names), strict=True)]
        numbers = np.full(len(words), np.nan)
    if len(set(words)) <= 1 or len(set(words)) < 0.01 * len(words):
        return {}, f"time: {name} is the same in all rows, so rows are numbered instead"
    digits = pd.Series(words[:JUDGED]).str.fullmatch(r"\d{14}").mean() > 0.9
    if np.isfinite(numbers).mean() > 0.9 and not digits:
        unit, check = (stated, "") if stated else _unit_of_time(name, numbers)
        return {"time": {"names": name} | ({} if unit == "s" else {"unit": unit})}, check
    how, alike = format_of(words)
    if how is None:
        return {}, f"time: the format of {name} was not recognised ({words[0]!r})"
    check = f"time.format: {how}; {words[0]} may be {alike[0]} as well" if alike else ""
    return {"time": {"names": names, "format": how}}, check


def _unit_of_time(name: str, numbers: Array) -> tuple[str, str]:
    """Return the unit of times by their size: since 1970, days of a workbook, or since any."""
    finite = numbers[np.isfinite(numbers)]
    least, most = finite.min(), finite.max()
    if most > 1e11:
        return "ns" if most > 1e17 else "us" if most > 1e14 else "ms", ""
    parts = np.mod(finite, 1.0)
    if _SERIAL_DAYS[0] < least and most < _SERIAL_DAYS[1] and (parts > 1e-9).mean() > 0.5:
        if most - least < 60.0:  # of days, such as a campaign takes
            return "d", ""
        return "s", f"time.unit: s, by the size of the numbers of {name}"
    return "s", ""


# Formats of dates and times.

#: Parts of the formats of dates and times that are tried, the commonest first.
_DATES = ("%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%d-%m-%Y", "%Y/%m/%d", "%d.%m.%y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M:%S %p", "%H:%M", "%H.%M.%S")
_BETWEEN = (" ", "T", ", ", "  ")
_ZONES = ("", "%z", " %z")
#: Rows that formats and conventions are judged by.
JUDGED = 200


def format_of(words: Sequence[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the format of dates and times, for `time.format`, and others that fit as well.

    Where day and month may be exchanged, that in which the times lie closest together is taken.
    None where no format fits.
    """
    fits: dict[str, float] = {}
    for how in _formats(words[0]):
        moments = moments_of(words[:JUDGED], how)
        if moments.notna().mean() > 0.9:
            fits[how] = float((moments.max() - moments.min()).total_seconds())
    if not fits:
        return None, ()
    shortest = min(fits.values())
    best, *others = [how for how, lasts in fits.items() if lasts <= 1.001 * shortest + 1.0]
    order = [
        how
        for how in others
        if how.find("%m") < how.find("%d") != (best.find("%m") < best.find("%d"))
    ]
    return best, tuple(order)


def moments_of(words: Sequence[str], how: str) -> pd.Series[pd.Timestamp]:
    """Return dates and times read in a format of `time.format`; NaT of those that are none."""
    form = "ISO8601" if how == ISO else how
    some = pd.Series([word if len(word) <= MOST_LETTERS else "" for word in words], dtype=object)
    return pd.to_datetime(some, format=form, errors="coerce", utc=True)


def _formats(word: str) -> Iterator[str]:
    """Yield the formats that a date or time may have: those that read its first row."""
    if len(word) > MOST_LETTERS:
        return
    every = itertools.chain(
        (ISO, "%Y%m%d%H%M%S", "%Y%m%d_%H%M%S", "%Y%m%dT%H%M%S"),
        map("".join, itertools.product(_DATES, _BETWEEN, _CLOCKS, _ZONES)),
        _CLOCKS,
    )
    shape = _shape(word)
    for how in dict.fromkeys(every):
        # To compare shapes is quicker than to read.
        if (how == ISO or _shape(how) == shape) and moments_of([word], how).notna().all():
            yield how


def _shape(moment: str) -> str:
    """Return what stands between the numbers of a date or time, or of its format."""
    bare = re.sub(r"\s*([-+]\d\d:?\d\d(:?\d\d(\.\d+)?)?|Z|%Z)$", "", moment.strip().upper())
    return re.sub(r"\s+", " ", re.sub(r"(%[A-OQ-Z]|\d)+", "0", re.sub("%P|[AP]M", "AM", bare)))
