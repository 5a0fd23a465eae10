"""CSV as it comes from instruments: rows with their physical lines, bad rows listed.

What makes a single row unusable quarantines it; what makes the file unusable (another
separator, decimal commas throughout, a missing column, nothing in it) stops with one message.
"""

from __future__ import annotations

import difflib
import gzip
import io
import sys
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.raw_rows import TEXT, NumberColumn, RawRows, quarantined
from pa10cal.errors import RawDataError

#: Files of more text than this, unpacked, are refused; so many bytes and rows are read at a time.
LARGEST_BYTES = 310_000_000
BLOCK_BYTES = 1 << 22
ROWS_A_PART = 20_000
#: Share of rows that must write their last field in one format for a shorter one to count as cut.
SAME_FORMAT = 0.99

OWN_NAMES = "; for a campaign's file pa10cal columns proposes how to read other names"
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
    text: tuple[str, ...] = TEXT  # columns of text
    missing: str = "rename it"  # what to do where a column is missing

    def fields(self, text: str) -> list[str]:
        """Return the fields of a line."""
        return [field.strip(' \t"') for field in text.split(self.separator)]

    def names(self, text: str) -> list[str]:
        """Return the names of the columns, of the line that has them or else of the first."""
        fields = self.fields(text)
        return fields if self.header else [str(k) for k in range(1, len(fields) + 1)]

    def row(self, text: str, width: int) -> list[str]:
        """Return the fields of a row; a separator at the end of each makes no further field."""
        row = self.fields(text)
        own = self.separator != "," or self.header != 1
        return row[:-1] if own and len(row) == width + 1 and row[-1] == "" else row

    def plain(self, field: str) -> str:
        """Return a number with a decimal point; no number for one with another sign."""
        if self.decimal == ".":
            return field
        return "?" if "." in field else field.replace(self.decimal, ".")


CONTRACT = Layout()
#: Number from 1, text, and whether a line end follows.
_Line = tuple[int, str, bool]


def column_names(path: Path, layout: Layout = CONTRACT) -> list[str]:
    """Return the names of the columns of a file, none where it is empty."""
    first = _first(_lines(path), layout)
    return [] if first is None else layout.names(first[1])


def _first(lines: Iterator[_Line], layout: Layout) -> _Line | None:
    """Return the line with the names, or without names the first; None where there is none."""
    return next((line for line in lines if line[0] >= layout.header), None)


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
        path: the file; a byte-order mark and Windows line ends are accepted.
        required: columns that must be there.
        optional: columns that may be there.
        together: columns that are all there or all absent.
        layout: how the file is written.
        repeats: whether exact repeats are kept.

    Raises:
        RawDataError: when the file is empty or too large, is no UTF-8 text, uses another separator
            or decimal commas throughout, or lacks a required column.
    """
    lines = _lines(path)
    first = _first(lines, layout)
    if first is None:
        raise _refusal(path, 1, "the file is empty", "a header and rows", "export it again")
    header_line, header_text, _ = first
    header = layout.names(header_text)
    needed = [*required, *(together if set(together) & set(header) else ())]
    _check_header(path, header_line, header_text, header, needed, layout)
    used = [name for name in header if name in needed or name in optional]
    parts = _Parts(header, used, layout)
    for number, text, ended in lines if layout.header else chain([first], lines):
        parts.add(number, text, ended=ended)
    if not parts.lines:
        raise _refusal(path, header_line, "there is no row under the header", "rows", "export it")
    line, widths = np.array(parts.lines, dtype=np.int64), np.array(parts.widths)
    _refuse_systematic_width(path, widths, len(header), line, layout)
    right = widths == len(header)
    cut = not parts.ended and widths[-1] < len(header)
    wrong = ~right
    wrong[-1] &= not cut
    listed = (
        *quarantined(path.name, line[wrong], f"{FIELDS} {len(header)}", widths[wrong]),
        *quarantined(path.name, line[-1:] if cut else [], CUT, [parts.last] if cut else []),
    )
    unused = tuple(name for name in header if name not in used)
    raw = RawRows(path.name, parts.joined(), line[right], len(line), unused, listed)
    kept = np.ones(len(raw.line), dtype=bool)
    if not parts.ended and right[-1]:
        kept[-1] = not _cut_last(np.array(parts.decimals))
        raw = raw.take(kept, CUT, [layout.row(parts.last, len(header))[-1]] * int(not kept[-1]))
    if repeats:
        return raw
    once = ~pd.Series(np.array(parts.hashes, dtype=np.int64)[kept]).duplicated().to_numpy()
    return raw.take(once, REPEATED, [""] * int((~once).sum()))


class _Parts:
    """Rows of a file as they are read: columns in parts, and what is known of every line.

    Attributes:
        lines, widths: physical line of every row, and its number of fields.
        hashes, decimals: of the rows as wide as the header: of all fields, and digits of the last.
        ended, last: whether the last line has a line end, and its text.
    """

    def __init__(self, header: Sequence[str], used: Sequence[str], layout: Layout) -> None:
        self._layout = layout
        self.lines = array("q")
        self.widths = array("q")
        self.hashes = array("q")
        self.decimals = array("q")
        self.ended = True
        self.last = ""
        self._width = len(header)
        self._at = {name: header.index(name) for name in used}
        self._rows: list[list[str]] = []
        # Buffers that grow in place: parts that are joined in the end would need twice the room.
        self._numbers = {name: array("d") for name in used if name not in layout.text}
        self._odd: dict[str, tuple[list[int], list[str]]] = {n: ([], []) for n in self._numbers}
        self._text: dict[str, list[str]] = {name: [] for name in used if name in layout.text}

    def add(self, number: int, text: str, *, ended: bool) -> None:
        """Take up a line."""
        row = self._layout.row(text, self._width)
        self.lines.append(number)
        self.widths.append(len(row))
        self.ended, self.last = ended, text
        if len(row) != self._width:
            return
        self.hashes.append(hash(tuple(row)))
        self.decimals.append(len(row[-1].partition(self._layout.decimal)[2]))
        self._rows.append(row)
        if len(self._rows) >= ROWS_A_PART:
            self._finish_part()

    def joined(self) -> dict[str, NumberColumn | NDArray[np.object_]]:
        """Return the columns."""
        self._finish_part()
        columns: dict[str, NumberColumn | NDArray[np.object_]] = {}
        for name in self._at:
            if name in self._layout.text:
                columns[name] = np.array(self._text.pop(name), dtype=object)
            else:
                rows, text = self._odd[name]
                columns[name] = NumberColumn(
                    np.frombuffer(self._numbers.pop(name), dtype=np.float64),
                    np.array(rows, dtype=np.intp),
                    np.array(text, dtype=object),
                )
        return columns

    def _finish_part(self) -> None:
        for name, at in self._at.items():
            fields = [row[at] for row in self._rows]
            if name in self._layout.text:
                self._text[name] += map(sys.intern, fields)
            else:
                self._add_numbers(name, fields)
        self._rows = []

    def _add_numbers(self, name: str, fields: list[str]) -> None:
        text = np.array([self._layout.plain(field) for field in fields], dtype=object)
        values = np.asarray(pd.to_numeric(text, errors="coerce"), dtype=np.float64)
        odd = np.flatnonzero(~np.isfinite(values))
        values = np.where(np.isfinite(values), values, np.nan)
        rows, found = self._odd[name]
        rows += (odd + len(self._numbers[name])).tolist()
        found += [fields[k] for k in odd]
        self._numbers[name].frombytes(values.tobytes())


def _lines(path: Path) -> Iterator[_Line]:
    """Yield the lines that are not blank: number from 1, text, and whether a line end follows.

    Raises:
        RawDataError: when the file is damaged, larger than is read, or no text.
    """
    with path.open("rb") as content:
        packed = content.read(2) == b"\x1f\x8b"
        content.seek(0)
        try:
            plain = gzip.GzipFile(fileobj=content) if packed else content
            _refuse_large(cast(IO[bytes], plain), path)
            content.seek(0)
            plain = gzip.GzipFile(fileobj=content) if packed else content
            text = io.TextIOWrapper(plain, encoding="utf-8-sig", errors="replace")
            for number, line in enumerate(text, start=1):
                if "\x00" in line:
                    raise _refusal(
                        path, number, "the file is not UTF-8 text", "UTF-8", "export it as UTF-8"
                    )
                if line.strip():
                    yield number, line.removesuffix("\n"), line.endswith("\n")
        except (EOFError, gzip.BadGzipFile, zlib.error):
            raise RawDataError(
                "the compressed file is damaged or cut short",
                where=str(path),
                allowed="a whole gzip file",
                remedy="copy or export it again",
            ) from None


def _refuse_large(content: IO[bytes], path: Path) -> None:
    """Stop at a file, or what an archive unpacks to, that would not fit into memory."""
    size = 0
    while block := content.read(BLOCK_BYTES):
        size += len(block)
        if size > LARGEST_BYTES:
            raise RawDataError(
                "the file, unpacked, is larger than is read",
                where=str(path),
                value=f"more than {LARGEST_BYTES / 1e6:.0f} MB",
                allowed=f"at most {LARGEST_BYTES / 1e6:.0f} MB of text",
                remedy="leave out what is not needed, such as samples between the dwells, or "
                "split the campaign",
            )


def _check_header(
    path: Path,
    line: int,
    text: str,
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
) -> None:
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
                "export the file with commas and decimal points; that of a campaign may stay as it "
                f"is: pa10cal columns {path.name} proposes how campaign.yaml describes it",
            )
    twice = [name for name, times in Counter(header).items() if times > 1]
    if twice:
        raise _refusal(path, line, f"column {twice[0]} occurs twice", "once", "remove one")
    missing = [name for name in required if name not in header]
    if missing:
        others = [name for name in header if name not in required]
        near = difflib.get_close_matches(missing[0], others, n=1, cutoff=0.5)
        raise RawDataError(
            f"missing column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            where=f"{path}:{line}",
            value=", ".join(header),
            allowed=", ".join(required),
            remedy=f"is it {near[0]!r}? {layout.missing}"
            if near
            else f"add it, or check the header{OWN_NAMES if layout == CONTRACT else ''}",
        )


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


# How an unknown text file is written: separator, decimal sign, line of the names, numbers.

#: So many lines are looked at.
LINES = 3000
LEAST_FIELDS = 4
_SEPARATORS = (";", "\t", ",", None)


@dataclass(frozen=True)
class Sniffed:
    """A file, as far as it was looked at."""

    layout: Layout  # how it is written
    names: tuple[str, ...]  # of its columns
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


def sniff(path: Path) -> Sniffed:
    """Find out how a file of rows of numbers is written.

    Raises:
        RawDataError: when it cannot be read, or holds no rows of numbers.
    """
    lines = _first_lines(path)
    ways = [
        _judged(lines, Layout(separator, decimal))
        for separator in _SEPARATORS
        for decimal in (".", ",")
        if separator != decimal and lines
    ]
    none = (0.0, 0, Layout())
    share, width, layout = max(ways or [none], key=lambda way: (round(way[0], 3), way[1]))
    if share < 0.3 or width < LEAST_FIELDS:
        raise RawDataError(
            "no rows of numbers were found",
            where=str(path),
            allowed="a text file with a row for each configuration: joint positions, and what was "
            "measured",
            remedy="export the file as text; a workbook or a binary log is not read",
        )
    rows = [(number, layout.row(text, width)) for number, text in lines]
    rows = [(number, fields) for number, fields in rows if len(fields) == width]
    number, first = rows[0]
    named = _numeric(first, layout) < 0.3
    layout = Layout(layout.separator, layout.decimal, number if named else 0)
    names = tuple(first) if named else tuple(str(k) for k in range(1, width + 1))
    text = np.array([fields for _, fields in rows[int(named) :]], dtype=str)
    numbers = np.array([[_number(field, layout) for field in row] for row in text])
    return Sniffed(layout, names, text.reshape(-1, width), numbers.reshape(-1, width))


def _first_lines(path: Path) -> list[tuple[int, str]]:
    try:
        content = path.read_bytes()[: 1 << 24]
        if content[:2] == b"\x1f\x8b":
            content = gzip.decompress(path.read_bytes())[: 1 << 24]
    except (OSError, EOFError) as error:
        raise RawDataError(
            "the file cannot be read",
            where=str(path),
            value=str(error),
            allowed="a text file, plain or gzipped",
            remedy="check the path",
        ) from None
    text = content.decode("utf-8-sig", errors="replace").splitlines()
    return [(k, line) for k, line in enumerate(text, start=1) if line.strip()][:LINES]


def _judged(lines: Sequence[tuple[int, str]], layout: Layout) -> tuple[float, int, Layout]:
    """Return the share of fields that are numbers in rows of the usual width, and that width."""
    rows = [layout.fields(text) for _, text in lines]
    # A separator at the end of each line makes an empty field, which is none.
    rows = [row[:-1] if row[-1] == "" else row for row in rows]
    width, times = Counter(map(len, rows)).most_common(1)[0]
    usual = [row for row in rows if len(row) == width]
    share = float(np.mean([_numeric(row, layout) for row in usual[-200:]]))
    return share * times / len(rows), width, layout


def _numeric(row: Sequence[str], layout: Layout) -> float:
    """Return the share of the fields of a row that are numbers."""
    return float(np.mean([not np.isnan(_number(field, layout)) for field in row]))


def _number(field: str, layout: Layout) -> float:
    try:
        return float(layout.plain(field))
    except ValueError:
        return float("nan")
