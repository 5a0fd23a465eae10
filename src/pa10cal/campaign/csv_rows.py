"""CSV as it comes from instruments: rows with their physical lines, bad rows listed.

What makes a single row unusable quarantines it; what makes the file unusable (another
separator, decimal commas throughout, a missing column, nothing in it) stops with one message.
"""

from __future__ import annotations

import csv
import difflib
import re
import sys
from collections import ChainMap, Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.raw_rows import TEXT, RawRows, quarantined
from pa10cal.campaign.recognise import canonical_unit, mistaken_encoding, unit_alone
from pa10cal.campaign.text_file import Line, encoding_of, is_workbook, lines_of
from pa10cal.errors import RawDataError

#: So many rows are read at a time.
ROWS_A_PART = 20_000
#: Share of rows that must write their last field in one format for a shorter one to count as cut.
SAME_FORMAT = 0.99

OWN_NAMES = "; for a campaign's file pa10cal columns proposes how to read other names"
DESCRIPTION = "campaign.yaml"
#: Lines that may stand over the names of the columns, as they are looked for.
_LINES_ABOVE = 50
CUT = "the last line is cut short"
REPEATED = "repeats an earlier row"
FIELDS = "the number of fields differs from the header"


@dataclass(frozen=True)
class Layout:
    """How a file is written."""

    separator: str | None = ","  # between fields; None for any number of blanks
    decimal: str = "."  # sign before the decimals
    # line of the column names; 0 where there is none, the columns then being 1, 2, …
    header: int = 1
    first: int = 0  # line of the first row; 0 for the one that follows the names
    text: tuple[str, ...] = TEXT  # columns of text
    missing: str = "rename it"  # what to do where a column is missing
    own: bool = False  # whether a campaign describes it: names that occur twice are told apart
    key: str = ""  # where campaign.yaml describes it, such as columns.poses
    keys: Mapping[str, str] = field(default_factory=dict)  # what maps each of its columns

    def fields(self, text: str) -> list[str]:
        """Return the fields of a line."""
        if '"' in text and self.separator is not None:
            try:
                (split,) = csv.reader([text], delimiter=self.separator, skipinitialspace=True)
            except csv.Error:  # a field of more than 131072 characters: no number, quoted or not
                pass
            else:
                return [field.strip() for field in split]
        fields = text.split(self.separator)
        bare = not (" " in text or "\t" in text or '"' in text)  # most are, and no field to strip
        return fields if bare else [field.strip(' \t"') for field in fields]

    def names(self, text: str) -> list[str]:
        """Return the names of the columns, of the line that has them or else of the first."""
        fields = self.fields(text)
        if not self.header:
            return [str(k) for k in range(1, len(fields) + 1)]
        return numbered_apart(fields) if self.own else fields

    def row(self, text: str, width: int) -> list[str]:
        """Return the fields of a row; a separator at the end of each makes no further field."""
        row = self.fields(text)
        own = self.own or self.separator != "," or self.header != 1
        return row[:-1] if own and len(row) == width + 1 and row[-1] == "" else row

    def plain(self, field: str) -> str:
        """Return a number with a decimal point; no number for one with another sign."""
        if self.decimal == ".":
            return field
        return "?" if "." in field else field.replace(self.decimal, ".")

    def number(self, field: str) -> float:
        """Return a number as people write it, with signs between thousands too; nan for none."""
        if "_" not in field:
            with suppress(ValueError):
                return float(self.plain(field))
        bare = _BETWEEN_THOUSANDS.sub("", field.replace("\u2212", "-"))
        other = "." if self.decimal == "," else ","
        if self.own and _IN_THOUSANDS[other].fullmatch(bare):
            bare = bare.replace(other, "")
        try:
            return float(self.plain(bare).replace("_", "?"))
        except ValueError:
            return float("nan")


#: Blanks that do not break, and apostrophes, between the thousands of a number.
_BETWEEN_THOUSANDS = re.compile(r"(?<=\d)[\u00a0\u202f\u2009'’](?=\d{3})")
#: Numbers with points, or commas, between the thousands, and the other sign before decimals.
_IN_THOUSANDS = {
    ".": re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d+"),
    ",": re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d+"),
}
CONTRACT = Layout()


def numbered_apart(names: Sequence[str]) -> list[str]:
    """Return names of columns, with a number behind those that occurred before; blanks named."""
    seen: Counter[str] = Counter()
    apart = []
    for k, name in enumerate(names, start=1):
        seen[name] += 1
        unnamed = f"column {k}" if name == "" else name
        apart.append(unnamed if seen[name] == 1 or name == "" else f"{name} ({seen[name]})")
    return apart


def column_names(path: Path, layout: Layout = CONTRACT) -> list[str]:
    """Return the names of the columns of a file, none where it is empty."""
    first = _first(lines_of(path), layout)
    return [] if first is None else layout.names(first.text)


def _first(lines: Iterator[Line], layout: Layout) -> Line | None:
    """Return the line with the names, or without names the first; None where there is none."""
    start = layout.header or layout.first
    return next((line for line in lines if line.number >= start), None)


def read_rows(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    together: Sequence[str] = (),
    layout: Layout = CONTRACT,
    *,
    repeats: bool = False,
) -> RawRows:
    """Read a CSV file, plain or gzipped, in parts.

    Rows with another number of fields than the header, exact repeats of an earlier row and a last
    line that was cut short are quarantined.

    Args:
        path: the file, in any encoding that `lines_of` tells, or a workbook.
        required: columns that must be there.
        optional: columns that may be there.
        together: columns that are all there or all absent.
        layout: how the file is written.
        repeats: whether exact repeats are kept.

    Raises:
        RawDataError: when the file is empty or too large, is no text, uses another separator or
            decimal commas throughout, or lacks a required column.
    """
    lines = lines_of(path)
    first = _first(lines, layout)
    if first is None:
        raise _refusal(path, 1, "the file is empty", "a header and rows", "export it again")
    header = layout.names(first.text)
    needed = [*required, *(together if set(together) & set(header) else ())]
    _check_header(path, first, header, needed, layout)
    used = [name for name in header if name in needed or name in optional]
    below = lines if layout.header else chain([first], lines)
    if layout.first:
        below = (line for line in below if line.number >= layout.first)
    parts, last = [], first
    while part := list(islice(below, ROWS_A_PART)):
        parts.append(_read_part(part, header, used, layout))
        last = part[-1]
    if not parts:
        raise _refusal(path, first.number, "there is no row under the header", "rows", "export it")
    line, widths, hashes, decimals = (
        np.concatenate([known[name] for known, _, _ in parts])
        for name in ("line", "widths", "hashes", "decimals")
    )
    _refuse_systematic_width(path, widths, len(header), line, layout)
    right = widths == len(header)
    cut = not last.ended and widths[-1] < len(header)
    wrong = ~right
    wrong[-1] &= not cut
    listed = (
        *quarantined(path.name, line[wrong], f"{FIELDS} {len(header)}", widths[wrong]),
        *quarantined(path.name, line[-1:] if cut else [], CUT, [last.text] if cut else []),
    )
    unused = tuple(name for name in header if name not in used)
    columns = {name: np.concatenate([read.pop(name) for _, read, _ in parts]) for name in used}
    odd = {name: dict(ChainMap(*(odd[name] for _, _, odd in parts))) for name in used}
    totals = {path.name: len(line)}
    raw = RawRows(path.name, columns, line[right], totals, unused, listed, odd)
    if not last.ended and right[-1] and _cut_last(decimals):
        kept = np.arange(len(hashes)) < len(hashes) - 1
        raw = raw.take(kept, CUT, [layout.row(last.text, len(header))[-1]])
        hashes = hashes[kept]
    if repeats:
        return raw
    once = ~pd.Series(hashes).duplicated().to_numpy()
    return raw.take(once, REPEATED)


def _read_part(
    lines: Sequence[Line], header: Sequence[str], used: Sequence[str], layout: Layout
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]], dict[str, dict[int, str]]]:
    """Read some lines of a file.

    Returns:
        What is known of them: their numbers, how many fields each has, and of the rows as wide as
        the header a hash of all fields and the digits of the last; the columns, text as it is and
        numbers, nan where there is none; and what stands there, by line.
    """
    every = [layout.row(line.text, len(header)) for line in lines]
    number = np.array([line.number for line in lines], dtype=np.int64)
    widths = np.array([len(row) for row in every], dtype=np.int64)
    rows = [row for row in every if len(row) == len(header)]
    right = number[widths == len(header)]
    columns: dict[str, NDArray[Any]] = {}
    odd: dict[str, dict[int, str]] = {name: {} for name in used}
    for name in used:
        at = header.index(name)
        fields = [row[at] for row in rows]
        if name in layout.text:
            columns[name] = np.array(list(map(sys.intern, fields)), dtype=object)
            continue
        values = columns[name] = _numbers(fields, layout)
        unread = np.flatnonzero(np.isnan(values)).tolist()
        odd[name] = {int(right[k]): fields[k] for k in unread}
    hashes = np.array([hash(tuple(row)) for row in rows], dtype=np.int64)
    after = [row[-1].partition(layout.decimal)[2] for row in rows]
    decimals = np.array(list(map(len, after)), dtype=np.int64)
    known = {"line": number, "widths": widths, "hashes": hashes, "decimals": decimals}
    return known, columns, odd


def _numbers(fields: Sequence[str], layout: Layout) -> Array:
    """Return fields as numbers, nan where one is none, or none that is finite."""
    plain = fields if layout.decimal == "." else [layout.plain(field) for field in fields]
    values = np.array(pd.to_numeric(np.array(plain, dtype=object), errors="coerce"), dtype=float)
    for k in np.flatnonzero(~np.isfinite(values)).tolist():
        value = layout.number(fields[k])
        values[k] = value if np.isfinite(value) else np.nan
    return values


def _check_header(
    path: Path, first: Line, header: Sequence[str], required: Sequence[str], layout: Layout
) -> None:
    line, text = first.number, first.text
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        here = layout.separator
        if here and here != separator and text.count(separator) > text.count(here):
            raise _refusal(
                path,
                line,
                f"the fields are separated by {name}",
                "commas between fields, decimal points"
                if layout.separator == ","
                else f"the separator {here!r}, as campaign.yaml states it",
                f"set {layout.key}.separator: {'tab' if separator == chr(9) else repr(separator)}"
                if layout.key
                else "export the file with commas and decimal points; that of a campaign may stay "
                f"as it is: pa10cal columns {path.name} proposes how campaign.yaml describes it",
            )
    twice = [name for name, times in Counter(header).items() if times > 1]
    if twice:
        raise _refusal(path, line, f"column {twice[0]} occurs twice", "once", "remove one")
    missing = [name for name in required if name not in header]
    if missing:
        raise RawDataError(
            f"missing column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            where=f"{path}:{line}",
            value=", ".join(header),
            allowed=", ".join(required),
            remedy=_remedy_for_missing(path, missing, header, required, layout),
        )


def _remedy_for_missing(
    path: Path,
    missing: Sequence[str],
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
) -> str:
    """Return what to do where columns are missing: what stands in their place, and which key."""
    others = [name for name in header if name not in required]
    if (found := mistaken_encoding(missing[0], others)) is not None:
        name, taken, right = found
        return (
            f"the header has {name!r}: {DESCRIPTION} and the file are read in two encodings, "
            f"{missing[0]!r} is {right} taken for {taken}; save both as UTF-8"
        )
    if (
        layout.key
        and np.mean([not np.isnan(layout.number(name)) for name in header]) > 0.5
        and layout.header
    ):
        return (
            f"the first line holds numbers and no names: set {layout.key}.header: 0, and name the "
            "columns 1, 2, 3, …; or export the file with a header"
        )
    below = next(
        (
            each.number
            for each in islice(lines_of(path), _LINES_ABOVE)
            if set(missing) <= set(layout.names(each.text))
        ),
        None,
    )
    if layout.key and below is not None:
        return f"the names stand in line {below}: set {layout.key}.header: {below}"
    near = difflib.get_close_matches(missing[0], others, n=1, cutoff=0.5)
    if near:
        key = layout.keys.get(missing[0])
        return f"is it {near[0]!r}? {f'correct {key} in {DESCRIPTION}' if key else layout.missing}"
    return f"add it, or check the header{OWN_NAMES if layout == CONTRACT else ''}"


def _refuse_systematic_width(
    path: Path,
    widths: NDArray[np.int64],
    expected: int,
    line: NDArray[np.int64],
    layout: Layout,
) -> None:
    wrong = widths != expected
    if 2 * wrong.sum() <= len(widths):
        return
    first = int(np.argmax(wrong))
    commas = widths[first] > expected and layout.separator == ","
    raise _refusal(
        path,
        int(line[first]),
        f"{wrong.sum()} of {len(widths)} rows have another number of fields than the header "
        f"({widths[first]} for {expected})" + ("; decimal commas" if commas else ""),
        "one field for each column, decimal points",
        "export the file with decimal points" if commas else "export the file again",
    )


def _cut_last(decimals: NDArray[np.int64]) -> bool:
    """Return whether the last number of a file without a line end lacks digits others have."""
    usual = int(np.bincount(decimals).argmax())
    return bool(decimals[-1] < usual and np.mean(decimals[:-1] == usual) >= SAME_FORMAT)


def _refusal(path: Path, line: int, what: str, allowed: str, remedy: str) -> RawDataError:
    return RawDataError(what, where=f"{path}:{line}", allowed=allowed, remedy=remedy)


# How an unknown file is written: separator, decimal sign, line of the names, numbers.

#: So many lines are looked at.
LINES = 3000
LEAST_FIELDS = 3
_SEPARATORS = (";", "\t", ",", "|", None)


@dataclass(frozen=True)
class Sniffed:
    """A file, as far as it was looked at."""

    layout: Layout  # how it is written
    encoding: str  # of its text; empty of a workbook
    names: tuple[str, ...]  # of its columns
    units: tuple[str, ...]  # what a line of units below the names says of each; empty without one
    lines: tuple[int, ...]  # (N,) physical line of each row
    text: NDArray[np.str_]  # (N, k) fields of the rows
    numbers: Array  # (N, k) the same as numbers, nan where a field is none

    def column(self, name: str) -> Array:
        """Return a column of numbers."""
        return self.numbers[:, self.names.index(name)]

    def columns(self, names: Sequence[str]) -> Array:
        """Return columns of numbers (N, len(names))."""
        return np.column_stack([self.column(name) for name in names])

    def words(self, name: str) -> list[str]:
        """Return a column as it is written."""
        return [str(each) for each in self.text[:, self.names.index(name)]]

    def titled(self, name: str) -> str:
        """Return a name with the unit that a line below the names gives it."""
        unit = self.units[self.names.index(name)] if self.units else ""
        return f"{name} [{unit}]" if unit else name


def sniff(path: Path) -> Sniffed:
    """Find out how a file of rows of numbers is written; refuse one without such rows."""
    lines = [(line.number, line.text) for line in islice(lines_of(path), LINES)]
    if not lines:
        raise _refusal(path, 1, "the file is empty", "a header and rows", "export it again")
    workbook = is_workbook(path)
    ways = [
        _judged(lines, Layout(separator, decimal, own=True))
        for separator in (("\t",) if workbook else _SEPARATORS)
        for decimal in ("." if workbook else ".,")
        if separator != decimal and lines
    ]
    share, width, layout = max(
        ways or [(0.0, 0, Layout())], key=lambda way: (round(way[0], 3), way[1])
    )
    if share < 0.3 or width < LEAST_FIELDS:
        raise RawDataError(
            "no rows of numbers were found",
            where=str(path),
            allowed="a text file or a workbook with a row for each configuration: joint positions, "
            "and what was measured",
            remedy="export the rows as text; a binary log is not read",
        )
    rows = [(number, layout.row(text, width)) for number, text in lines]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    every = np.array([[layout.number(field) for field in fields] for _, fields in rows])
    starts = np.mean(~np.isnan(every), axis=1)
    usual = float(np.median(starts))
    body = next(k for k, share in enumerate(starts) if share >= 0.6 * usual)
    named = body > 0
    units: tuple[str, ...] = ()
    if named:
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
        names = tuple(str(k) for k in range(1, width + 1))
    text = np.array([fields for _, fields in rows[body:]], dtype=str)
    encoding = "" if workbook else encoding_of(path)
    of_rows = tuple(number for number, _ in rows[body:])
    return Sniffed(layout, encoding, names, units, of_rows, text.reshape(-1, width), every[body:])


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
