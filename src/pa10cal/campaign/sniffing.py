"""How an unknown file is written: separator, decimal sign, line of the names, dates and times."""

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
from pa10cal.campaign.column_names import MOST_LETTERS, canonical_unit, parts_of_stamps, unit_alone
from pa10cal.campaign.csv_rows import (
    MOST_COLUMNS,
    Layout,
    empty_file,
    numbered_apart,
    part_of,
    too_many_columns,
)
from pa10cal.campaign.formats import Format, format_of_columns, format_of_file, table_lines
from pa10cal.campaign.text_lines import TextLine, binary_kind, encoding_of
from pa10cal.errors import RawDataError

#: Lines, or letters, at the beginning that are looked at.
LINES, LETTERS = 3000, 1 << 21
#: Lines below them, spread to the end, at least.
SPREAD = 500
#: Columns of a table at least, and part of its fields that are numbers: of two columns, as of times
#: and distances, each row has to hold a number.
LEAST_FIELDS, LEAST_NUMBERS, LEAST_NUMBERS_OF_TWO = 2, 0.3, 0.4
_COMMENT = "//"  # of SpatialAnalyzer; such a line names no columns
_SEPARATORS = (";", "tab", ",", "|", "blanks")
#: Lines of names and units above the rows, at most.
_MOST_NAMES = 3
#: A name of words, one of which may be a number, a letter, or a unit in brackets.
_NAME = re.compile(r"[^\W\d_][^\s\[(]+(?:\s+(?:\d+|[^\W\d_](?!\S)|[\[(][^\])]*[\])]))*|\S+")


@dataclass(frozen=True)
class Sniffed:
    """A file, as far as it was looked at."""

    layout: Layout  # how it is written
    encoding: str  # of its text; empty for a binary file
    names: tuple[str, ...]  # of its columns
    units: tuple[str, ...]  # of its columns, by a line of units below the names; empty without one
    lines: tuple[int, ...]  # (N,) physical line of each row
    text: NDArray[np.object_]  # (N, k) fields of the rows
    numbers: Array  # (N, k) the same as numbers, nan where a field is none
    format: Format | None = None  # the known format of the file
    notes: tuple[str, ...] = ()  # what of the file is not in the table
    # names in a line with other separators than the rows; `names` are 1, 2, … then; else empty
    titles: tuple[str, ...] = ()
    file: str = ""  # its name

    def column(self, name: str) -> Array:
        """Return a column of numbers."""
        return self.numbers[:, self.names.index(name)]

    def columns(self, names: Sequence[str]) -> Array:
        """Return columns of numbers (N, len(names))."""
        return np.column_stack([self.column(name) for name in names])

    def without(self, names: Sequence[str]) -> Sniffed:
        """Return the file without some columns."""
        kept = [k for k, name in enumerate(self.names) if name not in names]
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            units=tuple(self.units[k] for k in kept if self.units),
            titles=tuple(self.titles[k] for k in kept if self.titles),
            text=self.text[:, kept],
            numbers=self.numbers[:, kept],
        )

    def words(self, name: str) -> list[str]:
        """Return a column as it is written."""
        return [str(each) for each in self.text[:, self.names.index(name)]]

    @property
    def texts(self) -> dict[str, list[str]]:
        """Return columns that may hold labels: words, or whole numbers that do not count rows."""
        counts = self.counts
        return {
            name: self.words(name)
            for name, values in zip(self.names, self.numbers.T, strict=True)
            if name not in counts and (_few_numbers(values) or _whole(values))
        }

    @property
    def counts(self) -> dict[str, list[str]]:
        """Return columns of whole numbers that count rows."""
        return {
            name: self.words(name)
            for name, values in zip(self.names, self.numbers.T, strict=True)
            if not _few_numbers(values)
            and _whole(values)
            and len(np.unique(np.diff(values[np.isfinite(values)]))) <= 1
        }

    def holds_numbers(self, name: str) -> bool:
        """Return whether most fields of a column are numbers."""
        return not _few_numbers(self.column(name))

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
    known, notes = format_of_file(path), list[str]()
    made = known is not None and known.table is not None  # whether the table is made of the file
    name = known.name if known is not None and made else None
    lines, binary = _lines_looked_at(path, name, notes), binary_kind(path) != ""
    layout, width = _best_layout(path, lines, name, binary=binary)
    rows = [(number, layout.row(text, width)) for number, text in lines]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    values = np.array([[layout.number(field) for field in fields] for _, fields in rows])
    shares = np.mean(~np.isnan(values), axis=1)
    # The first row has nearly as many numbers as most rows; the table of a format has one header.
    usual = float(np.median(shares))
    body = 1 if made else next(k for k, share in enumerate(shares) if share >= 0.6 * usual)
    if not made and body > 1:
        body = _first_row(rows, values, body)
    if len(rows) == body:
        raise RawDataError(
            "there is no whole row under the names of the columns",
            where=str(path),
            allowed="a row for each configuration, with a field for each column",
            remedy="export the file again",
        )
    units: tuple[str, ...] = ()
    titles: tuple[str, ...] = ()
    if made:
        names = tuple(numbered_apart(rows[0][1]))
    elif body > 0:
        layout, names, units = _named_columns(rows, body, layout)
    else:
        first = rows[0][0]
        layout = layout.model_copy(update={"header": 0, "first_row": first if first > 1 else 0})
        above = [text for number, text in lines if number < first]
        titles = _titles(above[-1], width) if above else ()
        names = tuple(str(k) for k in range(1, width + 1))
    return Sniffed(
        layout,
        "" if binary else encoding_of(path),
        names,
        units,
        tuple(number for number, _ in rows[body:]),
        np.array([fields for _, fields in rows[body:]], dtype=object).reshape(-1, width),
        values[body:],
        known or format_of_columns(names, values[body:]),
        tuple(dict.fromkeys(notes)),
        titles,
        path.name,
    )


def _first_row(rows: Sequence[tuple[int, list[str]]], values: Array, body: int) -> int:
    """Return where rows begin, of which the first ones may lack most numbers, as of hidden targets.

    Such a row has numbers or blanks where the rows from `body` on have numbers; it is no header.
    """
    text = np.isnan(values[body:]).mean(axis=0) > 0.5
    while body > 1:
        blank = np.array([field.strip() == "" for field in rows[body - 1][1]])
        known = ~np.isnan(values[body - 1])
        if known.sum() < LEAST_FIELDS or not (blank | known | text).all():
            break
        body -= 1
    return body


def _lines_looked_at(path: Path, name: str | None, notes: list[str]) -> list[tuple[int, str]]:
    """Return lines of a file, or of the table of a format, each with its number.

    They are those at the beginning, and some that are spread to the end, without comments.
    """
    following = table_lines(path, name, notes=notes)
    head = part_of(following, LINES, LETTERS)
    lines = [(line.number, line.text) for line in (*head, *_spread(following))]
    lines = [line for line in lines if not line[1].startswith(_COMMENT)] or lines
    if not lines:
        raise empty_file(path)
    for number, line in lines:
        if (most := max(len(line.split()), *map(line.count, ";\t,|"))) > MOST_COLUMNS:
            raise too_many_columns(f"{path}:{number}", most)
    return lines


def _best_layout(
    path: Path, lines: Sequence[tuple[int, str]], name: str | None, *, binary: bool
) -> tuple[Layout, int]:
    """Return the separator and decimal sign that make most fields numbers, and the columns' count.

    Rows of a binary file, and of the table of the format `name`, have tabs; those of a binary file
    have decimal points. Another file without rows of numbers is refused.
    """
    written = [
        Layout.model_validate({"format": name, "separator": separator, "decimal": decimal})
        for separator in ((",",) if name else ("tab",) if binary else _SEPARATORS)
        for decimal in ("." if binary else ".,")
    ]
    ways = [_judged(lines, layout) for layout in written if layout.sign != layout.decimal]
    share, width, layout = max(ways, key=lambda way: (round(way[0], 3), way[1]))
    if name is not None:
        return layout, len(layout.fields(lines[0][1]))
    least = LEAST_NUMBERS if width > LEAST_FIELDS else LEAST_NUMBERS_OF_TWO
    if share < least or width < LEAST_FIELDS:
        raise _no_rows(path, lines)
    return layout, width + _last_is_empty(lines, layout, width)


def _no_rows(path: Path, lines: Sequence[tuple[int, str]]) -> RawDataError:
    """Return the refusal of a file without rows of numbers."""
    matrices = any("[[" in text for _, text in lines)
    return RawDataError(
        "fields hold whole matrices as text" if matrices else "no rows of numbers were found",
        where=str(path),
        allowed="a text file or a workbook with a row for each configuration: joint "
        "positions, and what was measured",
        remedy="write each element of a matrix into a column of its own: 12 or 16 columns"
        if matrices
        else "export the rows as text; a binary log is not read",
    )


def _named_columns(
    rows: Sequence[tuple[int, list[str]]], body: int, layout: Layout
) -> tuple[Layout, tuple[str, ...], tuple[str, ...]]:
    """Return layout, names and units of columns that are named above the row `body`."""
    (line, fields), units = rows[body - 1], tuple[str, ...]()
    # Most words of a line of units are known ones.
    known = [canonical_unit(unit_alone(field)) != "" for field in fields if field]
    if body > 1 and known and np.mean(known) > 0.6:
        units = tuple(map(unit_alone, fields))
        line, fields = rows[body - 2]
    first = rows[body][0]
    follows = not units and first <= line + 1
    layout = layout.model_copy(update={"header": line, "first_row": 0 if follows else first})
    return layout, tuple(numbered_apart(fields)), units


def _last_is_empty(lines: Sequence[tuple[int, str]], layout: Layout, width: int) -> bool:
    """Return whether the last named column is empty in most rows."""
    rows = [layout.fields(text) for _, text in lines]
    last = [row[-1] for row in rows if len(row) == width + 1]
    named = [k for k, field in enumerate(last[:_MOST_NAMES]) if field != ""]
    return bool(named) and len(last) - len(named) > 0.5 * len(rows)


def _titles(text: str, width: int) -> tuple[str, ...]:
    """Return names of `width` columns in a line with other separators than the rows.

    Names with blanks in them, such as Joint 1, are parted by wider blanks, or as words followed by
    a number, a letter or a unit. Surplus names are dropped. Empty where there are no names.
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
    """Return between `SPREAD` and twice as many lines, evenly spread over all."""
    kept, every = [], 1
    for k, line in enumerate(lines):
        if k % every == 0:
            kept.append(line)
        if len(kept) > 2 * SPREAD:
            kept, every = kept[::2], 2 * every
    return kept


def rows_at(path: Path, sniffed: Sniffed, lines: Collection[int]) -> Sniffed:
    """Return a sniffed file with the rows in these lines in place of its rows."""
    layout, wanted, width = sniffed.layout, set(lines), len(sniffed.names)
    rows = [
        (line.number, layout.row(line.text, width))
        for line in table_lines(path, layout.format)
        if line.number in wanted
    ]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    numbers = np.array([[layout.number(field) for field in fields] for _, fields in rows])
    text = np.array([fields for _, fields in rows], dtype=object).reshape(-1, width)
    numbers_of_lines = tuple(number for number, _ in rows)
    return replace(sniffed, lines=numbers_of_lines, text=text, numbers=numbers.reshape(-1, width))


def _judged(lines: Sequence[tuple[int, str]], layout: Layout) -> tuple[float, int, Layout]:
    """Return the share of numbers among fields, times that of rows as wide as most; that width."""
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


# Dates and times: their format, or the unit of their numbers.

#: The format of times as ISO 8601 has them.
ISO = "iso"
#: A date, and a time of day.
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?", re.I)
#: Directives of a format that states a time of day alone.
_OF_DAY = frozenset("HIMSfpzTRX")
#: Days since 1900, as workbooks count time: from 1982 to 2064.
_SERIAL_DAYS = (30_000.0, 60_000.0)


def time_columns(
    sniffed: Sniffed, name: str, others: Sequence[str], stated: str | None
) -> tuple[dict[str, Any], str]:
    """Return `time` of `columns` in campaign.yaml, and what to check; both may be empty.

    Args:
        sniffed: the file.
        name: column of times.
        others: all columns that may hold a date or a time of day.
        stated: unit of the column, where its name states it.
    """
    words, numbers = sniffed.words(name), sniffed.column(name)
    names: str | list[str] = name
    parts = next((each for each in parts_of_stamps(others) if each[0] == name), None)
    unit_of_part = None if parts is None else _unit_of_part(sniffed, *parts)
    if parts is not None and unit_of_part is not None:
        return {"time": {"names": list(parts), "unit": ["s", unit_of_part]}}, ""
    first = {other: sniffed.words(other)[0] for other in others}
    days = [other for other, word in first.items() if _DAY.fullmatch(word)]
    clocks = [other for other, word in first.items() if _CLOCK.fullmatch(word)]
    if days and clocks:
        names = [days[0], clocks[0]]
        words = [" ".join(row) for row in zip(*map(sniffed.words, names), strict=True)]
        numbers = np.full(len(words), np.nan)
    if len(set(words)) <= 1 or len(set(words)) < 0.01 * len(words):
        rows = "all" if len(set(words)) <= 1 else "many"
        return {}, f"time: {name} is the same in {rows} rows, so rows are numbered instead"
    digits = pd.Series(words[:JUDGED]).str.fullmatch(r"\d{14}").mean() > 0.9
    if np.isfinite(numbers).mean() > 0.9 and not digits:
        unit, check = (stated, "") if stated else _unit_of_time(name, numbers)
        return {"time": {"names": name} | ({} if unit == "s" else {"unit": unit})}, check
    form, others_possible = time_format(words)
    if form is None:
        return {}, f"time: the format of {name} was not recognised ({words[0]!r})"
    check = ""
    if others_possible:
        check = f"time.format: {form}; {words[0]} may be {others_possible[0]} as well"
    return {"time": {"names": names, "format": form}}, check


def _unit_of_part(sniffed: Sniffed, seconds: str, part: str) -> str | None:
    """Return the unit of the part of a second beside whole seconds; None where it is none."""
    whole, parts = sniffed.column(seconds), sniffed.column(part)
    known = np.isfinite(whole) & np.isfinite(parts)
    whole, parts = whole[known], parts[known]
    unit = canonical_unit(re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", part))[-1])
    a_second = {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit]
    right = known.mean() > 0.9 and _whole(whole) and _whole(parts) and np.ptp(parts) > 0.0
    return unit if right and parts.min() >= 0.0 and parts.max() < a_second else None


def _unit_of_time(name: str, numbers: Array) -> tuple[str, str]:
    """Return the unit of times by their size, and what to check.

    Large numbers are since 1970; others are days of a workbook, or seconds.
    """
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


#: Parts of the formats of dates and times that are tried, the commonest first.
_DATES = ("%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%d-%m-%Y", "%Y/%m/%d", "%d.%m.%y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M:%S %p", "%H:%M", "%H.%M.%S")
_BETWEEN = (" ", "T", ", ", "  ")
_ZONES = ("", "%z", " %z")
#: Rows that formats and conventions are judged by.
JUDGED = 200


def time_format(words: Sequence[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the format of dates and times, for `time.format`, and others that the user may mean.

    The format in which the times span the shortest period is taken; None where no format fits.
    """
    duration_s: dict[str, float] = {}
    for form in _formats(next(filter(None, words), "")):
        moments = moments_of(words[:JUDGED], form)
        if moments.notna().mean() > 0.9:
            duration_s[form] = float((moments.max() - moments.min()).total_seconds())
    if not duration_s:
        return None, ()
    longest_s = 1.001 * min(duration_s.values()) + 1.0
    best, *others = [form for form, period_s in duration_s.items() if period_s <= longest_s]
    # Days and months exchanged are another meaning; other blanks between date and time are none.
    meant = [form for form in others if _is_month_first(form) != _is_month_first(best)]
    return best, tuple(meant[:1])


def _is_month_first(form: str) -> bool:
    return form == ISO or form.find("%m") < form.find("%d")


def moments_of(words: Sequence[str], how: str) -> pd.Series[pd.Timestamp]:
    """Return dates and times read in a format of `time.format`; NaT where a word does not fit."""
    form = "ISO8601" if how == ISO else how
    some = pd.Series([word if len(word) <= MOST_LETTERS else "" for word in words], dtype=object)
    return pd.to_datetime(some, format=form, errors="coerce", utc=True)


def seconds_of(words: Sequence[str], how: str) -> Array:
    """Return dates and times as seconds since 1970, nan where a word does not fit.

    Times of day alone are those of one day, or of days that follow each other: from word to word
    less than half a day passes.
    """
    since_1970 = moments_of(words, how) - pd.Timestamp(0, tz="UTC")
    seconds: Array = np.array(since_1970.dt.total_seconds(), dtype=np.float64)
    if how != ISO and _OF_DAY.issuperset(re.findall(r"%(\w)", how)):
        known = np.isfinite(seconds)
        seconds[known] = np.unwrap(seconds[known], period=86400.0)
    return seconds


def _formats(word: str) -> Iterator[str]:
    """Yield the formats that read a date or time."""
    if len(word) > MOST_LETTERS:
        return
    candidates = itertools.chain(
        (ISO, "%Y%m%d%H%M%S", "%Y%m%d_%H%M%S", "%Y%m%dT%H%M%S"),
        map("".join, itertools.product(_DATES, _BETWEEN, _CLOCKS, _ZONES)),
        _CLOCKS,
    )
    shape = _shape(word)
    for form in dict.fromkeys(candidates):
        # To compare shapes is quicker than to read.
        if (form == ISO or _shape(form) == shape) and moments_of([word], form).notna().all():
            yield form


def _shape(moment: str) -> str:
    """Return the signs between the numbers of a date or time, or of a format, numbers as 0."""
    bare = re.sub(r"\s*([-+]\d\d:?\d\d(:?\d\d(\.\d+)?)?|Z|%Z)$", "", moment.strip().upper())
    return re.sub(r"\s+", " ", re.sub(r"(%[A-OQ-Z]|\d)+", "0", re.sub("%P|[AP]M", "AM", bare)))
