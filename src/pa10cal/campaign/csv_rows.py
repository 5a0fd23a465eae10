"""Files of rows as they come from instruments: their lines, how they are written, their columns.

A file is text in any usual encoding, plain or gzipped, or a sheet of a workbook. What makes a
single row unusable quarantines it; what makes the file unusable (another separator, decimal commas
throughout, a missing column, nothing in it) stops with one message.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import gzip
import io
import os
import re
import sys
import zlib
from collections import ChainMap, Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.raw_rows import TEXT, RawRows, quarantined
from pa10cal.campaign.recognise import canonical_unit, mistaken_encoding, unit_alone
from pa10cal.campaign.workbook import rows_of_workbook
from pa10cal.errors import RawDataError, refusals_beside
from pa10cal.files.output import from_csv_cell
from pa10cal.input_files import open_file, reason

#: Files of more text than this, unpacked, or of more lines, are refused, before any is read.
LARGEST_BYTES, MOST_LINES = 310_000_000, 5_000_000
#: So many bytes are looked at at a time; a line that fills them is none of a table.
BLOCK_BYTES = 1 << 20
#: So many rows, or letters, are read at a time.
ROWS_A_PART, LETTERS_A_PART, MOST_COLUMNS = 20_000, 1 << 23, 2000
#: Rows and fields that cannot be read are listed, up to so many; letters of a column of labels,
#: each as long as the longest.
MOST_UNREADABLE, MOST_LABEL_LETTERS = 500_000, 100_000_000
#: Byte-order marks, the longest first: that of UTF-32 begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
#: Encodings of one byte a letter, the commonest first: Windows, DOS, old Macintosh.
_ONE_BYTE = ("cp1252", "cp850", "mac_roman")
#: What such files hold besides ASCII: units, letters of German, French and Spanish.
_USUAL = frozenset("°µ²³±ΔäöüÄÖÜßàâçèéêëîïôùûÀÇÈÉÊáíóúñÁÍÓÚÑ")
_ASCII = bytes(range(128))
#: Beginnings of workbooks: of archives (.xlsx, .ods), and of the older kind (.xls).
_ARCHIVE, _OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"

_refusal = refusals_beside(__file__, RawDataError)


class TextLine(NamedTuple):
    """A line that is not blank."""

    number: int  # from 1
    text: str
    ended: bool  # whether a line end follows


def lines_of(path: Path, within: Path | None = None) -> Iterator[TextLine]:
    """Yield the lines that are not blank; rows of a workbook with tabs between the cells.

    Args:
        path: the file.
        within: folder that it must lie in; None for anywhere.

    Raises:
        RawDataError: when the file is not there, damaged, larger than is read, or no text.
    """
    if is_workbook(path, within):
        yield from _rows_of_workbook(path, within)
        return
    encoding = encoding_of(path, within)
    with _unpacked(path, within) as content:
        text = io.TextIOWrapper(content, encoding=encoding, errors="replace")
        for number, line in enumerate(text, start=1):
            if "\x00" in line:
                raise _refusal("no text", f"{path}:{number}")
            if line.strip():
                yield TextLine(number, line.removesuffix("\n"), line.endswith("\n"))


def encoding_of(path: Path, within: Path | None = None) -> str:
    """Return the encoding of a file of text, told from its bytes; see `lines_of`.

    A byte-order mark says it; text that is valid UTF-8 is UTF-8; of one byte a letter it is the
    encoding whose letters are such as units, German, French and Spanish have.
    """
    decoder = codecs.getincrementaldecoder("utf-8")()
    valid, size, lines, odd, head = True, 0, 1, bytearray(), b""
    with _unpacked(path, within) as content:
        while block := content.read(BLOCK_BYTES):
            head = head or block[:4096]
            size += len(block)
            if size > LARGEST_BYTES:
                raise _too_large(path)
            ends = max(block.count(b"\n"), block.count(b"\r"))
            if not ends and len(block) == BLOCK_BYTES:
                raise _refusal("long line", f"{path}:{lines}", None, BLOCK_BYTES)
            lines += ends
            if lines > MOST_LINES:
                raise _refusal("many lines", path, None, MOST_LINES)
            if valid:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:
                    valid = False
            odd += block.translate(None, _ASCII)[: BLOCK_BYTES - len(odd)]
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    if b"\x00" in head:
        even, uneven = head[::2].count(0), head[1::2].count(0)
        if max(even, uneven) > 0.4 * len(head) / 2 and min(even, uneven) == 0:
            return "utf-16-le" if uneven > even else "utf-16-be"
        raise _refusal("no text", f"{path}:1")

    def usual(encoding: str) -> int:
        return sum(letter in _USUAL for letter in odd.decode(encoding, errors="replace"))

    return "utf-8" if valid else max(_ONE_BYTE, key=usual)


def is_workbook(path: Path, within: Path | None = None) -> bool:
    """Return whether a file is a workbook, such as .xlsx, .ods or .xls."""
    with _opened(path, within) as content:
        head = content.read(4)
    return head == _OLE or (head == _ARCHIVE and path.suffix.lower() != ".zip")


def _opened(path: Path, within: Path | None) -> io.BufferedReader:
    try:
        return open_file(path, within)
    except FileNotFoundError:
        raise _refusal("absent", path) from None
    except OSError as error:
        raise _refusal("unreadable", path, None, reason(error)) from None


@contextmanager
def _unpacked(path: Path, within: Path | None) -> Iterator[IO[bytes]]:
    """Open a file, plain or gzipped."""
    with _opened(path, within) as content:
        packed = content.read(2) == b"\x1f\x8b"
        content.seek(0)
        try:
            yield cast("IO[bytes]", gzip.GzipFile(fileobj=content)) if packed else content
        except (EOFError, gzip.BadGzipFile, zlib.error):
            raise _refusal("damaged", path) from None


def _rows_of_workbook(path: Path, within: Path | None) -> Iterator[TextLine]:
    """Yield the rows of the sheet with the most cells; numbers in full, times as ISO 8601."""
    letters = 0
    with _opened(path, within) as file:
        if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
            raise _too_large(path)
        for number, text in rows_of_workbook(path, file):
            letters += len(text)
            if letters > LARGEST_BYTES:
                raise _too_large(path)
            yield TextLine(number, text, ended=True)


def _too_large(path: Path) -> RawDataError:
    return _refusal("too large", path, f"more than {(mb := LARGEST_BYTES / 1e6):.0f} MB", mb)


# How the rows of a file are written, and what stands in its columns.

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

    def numbers(self, fields: Sequence[str]) -> Array:
        """Return fields as numbers, nan where one is none, or none that is finite."""
        plain = fields if self.decimal == "." else [self.plain(field) for field in fields]
        values = np.array(pd.to_numeric(np.array(plain, object), errors="coerce"), dtype=float)
        for k in np.flatnonzero(~np.isfinite(values)).tolist():
            value = self.number(fields[k]) if fields[k] != "" else np.nan
            values[k] = value if np.isfinite(value) else np.nan
        return values


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


def column_names(path: Path, layout: Layout = CONTRACT, within: Path | None = None) -> list[str]:
    """Return the names of the columns of a file, none where it is empty; see `lines_of`."""
    first = _first(lines_of(path, within), layout)
    return [] if first is None else layout.names(first.text)


def _first(lines: Iterator[TextLine], layout: Layout) -> TextLine | None:
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
    within: Path | None = None,
) -> RawRows:
    """Read a file of rows, in parts; it must lie `within` a folder, see `lines_of`.

    Rows with another number of fields than the header, a last line that was cut short and, unless
    `repeats` are kept, exact repeats of an earlier row are quarantined. Columns that belong
    `together` are all there or all absent.

    Raises:
        RawDataError: when the file is empty or too large, is no text, uses another separator or
            decimal commas throughout, or lacks a required column.
    """
    lines = lines_of(path, within)
    first = _first(lines, layout)
    if first is None:
        raise _refusal("empty", f"{path}:1")
    header = layout.names(first.text)
    width = len(header)
    needed = [*required, *(together if set(together) & set(header) else ())]
    _check_header(path, first, header, needed, layout, within)
    used = [name for name in header if name in needed or name in optional]
    below = lines if layout.header else chain([first], lines)
    below = (line for line in below if line.number >= layout.first)
    parts, last, unreadable, rows_read = [], first, 0, 0
    while part := _part_of(below):
        parts.append(read := _read_part(part, header, used, layout))
        last, rows_read = part[-1], rows_read + len(part)
        unreadable += int(np.count_nonzero(read[0][1] != width)) + sum(map(len, read[2].values()))
        unreadable += 0 if repeats else len(read[0][2]) - len(set(read[0][2].tolist()))
        if unreadable > MOST_UNREADABLE:
            raise _refusal("unreadable rows", path, None, unreadable, rows_read, width)
    if not parts:
        raise _refusal("no rows", f"{path}:{first.number}")
    known = zip(*(numbers for numbers, _, _ in parts), strict=True)
    line, widths, hashes, decimals = map(np.concatenate, known)
    wrong = widths != width
    if 2 * wrong.sum() > len(widths):
        at = int(np.argmax(wrong))
        counts = (wrong.sum(), len(widths), widths[at], width)
        commas = widths[at] > width and layout.separator == ","
        rest = ("; decimal commas", "with decimal points") if commas else ("", "again")
        raise _refusal("width", f"{path}:{line[at]}", None, *counts, *rest)
    right = line[~wrong]
    cut = not last.ended and widths[-1] < width
    wrong[-1] &= not cut
    listed = (
        *quarantined(path.name, line[wrong], f"{FIELDS} {width}", widths[wrong]),
        *quarantined(path.name, line[-1:] if cut else [], CUT, [last.text] if cut else []),
    )
    unused = tuple(name for name in header if name not in used)
    columns = {name: np.concatenate([read.pop(name) for _, read, _ in parts]) for name in used}
    for name in set(used) & set(layout.text):
        longest = max(map(len, columns[name].tolist()), default=0)
        if longest * len(columns[name]) > MOST_LABEL_LETTERS:
            raise _refusal("long label", f"{path}:{first.number}", None, name, longest)
    non_numeric = {name: dict(ChainMap(*(part[2][name] for part in parts))) for name in used}
    raw = RawRows(path.name, columns, right, {path.name: len(line)}, unused, listed, non_numeric)
    if not last.ended and widths[-1] == width:
        # The last number of a file without a line end may lack digits that all others have.
        usual = int(np.bincount(decimals).argmax())
        if decimals[-1] < usual and np.mean(decimals[:-1] == usual) >= SAME_FORMAT:
            keep = np.arange(len(hashes)) < len(hashes) - 1
            raw, hashes = raw.take(keep, CUT, [layout.row(last.text, width)[-1]]), hashes[keep]
    return raw if repeats else raw.take(~pd.Series(hashes).duplicated().to_numpy(), REPEATED)


def _part_of(
    lines: Iterator[TextLine], most: int = ROWS_A_PART, most_letters: int = LETTERS_A_PART
) -> list[TextLine]:
    """Return some of the lines that follow."""
    part, letters = [], 0
    for line in lines:
        part.append(line)
        letters += len(line.text)
        if len(part) == most or letters > most_letters:
            break
    return part


def _read_part(
    lines: Sequence[TextLine], header: Sequence[str], used: Sequence[str], layout: Layout
) -> tuple[list[NDArray[np.int64]], dict[str, NDArray[Any]], dict[str, dict[int, str]]]:
    """Read some lines of a file.

    Returns:
        The numbers of the lines, how many fields each has, and of the rows as wide as the header a
        hash of all fields and the digits of the last; the columns, text as it is and numbers, nan
        where there is none; and what stands there, by line, but for blanks.
    """
    every = [layout.row(line.text, len(header)) for line in lines]
    rows = [row for row in every if len(row) == len(header)]
    right = [line.number for line, row in zip(lines, every, strict=True) if len(row) == len(header)]
    columns: dict[str, NDArray[Any]] = {}
    non_numeric: dict[str, dict[int, str]] = {name: {} for name in used}
    for name in used:
        at = header.index(name)
        fields = [row[at] for row in rows]
        if name in layout.text:
            columns[name] = np.array([sys.intern(from_csv_cell(each)) for each in fields], object)
            continue
        columns[name] = layout.numbers(fields)
        unread = np.flatnonzero(np.isnan(columns[name])).tolist()
        non_numeric[name] = {right[k]: fields[k] for k in unread if fields[k] != ""}
    known = (
        [line.number for line in lines],
        [len(row) for row in every],
        [hash(tuple(row)) for row in rows],
        [len(row[-1].partition(layout.decimal)[2]) for row in rows],
    )
    return [np.array(numbers, dtype=np.int64) for numbers in known], columns, non_numeric


def _check_header(
    path: Path,
    first: TextLine,
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
    within: Path | None,
) -> None:
    where, here = f"{path}:{first.number}", layout.separator
    if len(header) > MOST_COLUMNS:
        raise _refusal("many columns", where, None, len(header), MOST_COLUMNS)
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        if here and here != separator and first.text.count(separator) > first.text.count(here):
            allowed = "commas between fields, decimal points"
            if here != ",":
                allowed = f"the separator {here!r}, as {DESCRIPTION} states it"
            remedy = (
                f"set {layout.key}.separator: {'tab' if separator == chr(9) else repr(separator)}"
                if layout.key
                else "export the file with commas and decimal points; that of a campaign may stay "
                f"as it is: pa10cal columns {path.name} proposes how {DESCRIPTION} describes it"
            )
            raise _refusal("separator", where, None, name, allowed, remedy)
    twice = [name for name, times in Counter(header).items() if times > 1]
    if twice:
        raise _refusal("twice", where, None, twice[0])
    if missing := [name for name in required if name not in header]:
        remedy = _remedy_for_missing(path, missing, header, required, layout, within)
        words = ("s" * (len(missing) > 1), ", ".join(missing), ", ".join(required), remedy)
        raise _refusal("missing", where, ", ".join(header), *words)


def _remedy_for_missing(
    path: Path,
    missing: Sequence[str],
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
    within: Path | None,
) -> str:
    """Return what to do where columns are missing: what stands in their place, and which key."""
    others = [name for name in header if name not in required]
    if (other := mistaken_encoding(missing[0], others)) is not None:
        name, taken, right = other
        return (
            f"the header has {name!r}: {DESCRIPTION} and the file are read in two encodings, "
            f"{missing[0]!r} is {right} taken for {taken}; save both as UTF-8"
        )
    numbers = np.mean([not np.isnan(layout.number(name)) for name in header])
    if layout.key and layout.header and numbers > 0.5:
        return (
            f"the first line holds numbers and no names: set {layout.key}.header: 0, and name the "
            "columns 1, 2, 3, …; or export the file with a header"
        )
    if layout.key:
        for line in islice(lines_of(path, within), _LINES_ABOVE):
            if set(missing) <= set(layout.names(line.text)):
                return (
                    f"the names stand in line {line.number}: set {layout.key}.header: {line.number}"
                )
    near = difflib.get_close_matches(missing[0], others, n=1, cutoff=0.5)
    if not near:
        return f"add it, or check the header{OWN_NAMES if layout == CONTRACT else ''}"
    key = layout.keys.get(missing[0]) or layout.key
    return f"is it {near[0]!r}? {f'correct {key} in {DESCRIPTION}' if key else 'rename it'}"


# How an unknown file is written: separator, decimal sign, line of the names, numbers.

#: So many lines, or letters, are looked at.
LINES, LETTERS = 3000, 1 << 21
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
    text: NDArray[np.object_]  # (N, k) fields of the rows
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
    lines = [(line.number, line.text) for line in _part_of(lines_of(path), LINES, LETTERS)]
    if not lines:
        raise _refusal("empty", f"{path}:1")
    for number, line in lines:
        if (most := max(len(line.split()), *map(line.count, ";\t,|"))) > MOST_COLUMNS:
            raise _refusal("many columns", f"{path}:{number}", None, most, MOST_COLUMNS)
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
        raise _refusal("no numbers", path)
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
    text = np.array([fields for _, fields in rows[body:]], dtype=object)
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
