"""Files of rows as instruments write them: their layout, and their columns read.

A row that cannot be used is quarantined. A file that cannot be used (another separator, decimal
commas throughout, a missing column, no row) is refused with one message.
"""

from __future__ import annotations

import csv
import difflib
import re
import sys
from collections import ChainMap, Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, StringConstraints

from pa10cal.arrays import Array, Mask
from pa10cal.campaign.column_map import CONTRACT_COLUMNS, ColumnMap
from pa10cal.campaign.column_names import mistaken_encoding
from pa10cal.campaign.formats import BY_NAME, table_lines
from pa10cal.campaign.raw_rows import TEXT, InFile, RawRows, quarantined
from pa10cal.campaign.text_lines import TextLine
from pa10cal.errors import RawDataError
from pa10cal.files.table_cells import from_csv_cell
from pa10cal.options import Section

#: Rows, or letters, that are read at a time; columns of a file, at most.
ROWS_A_PART, LETTERS_A_PART, MOST_COLUMNS = 20_000, 1 << 23, 2000
#: Unreadable rows and fields at most; letters of a column of labels at most, if each label is as
#: long as the longest.
MOST_UNREADABLE, MOST_LABEL_LETTERS = 500_000, 100_000_000
#: Part of the stamps that different rows share, at least, where stamps are rounded.
SHARED_STAMPS = 0.05
#: Part of the rows with one number of last digits for a last row with fewer to count as cut.
SAME_FORMAT = 0.99
OWN_NAMES = "; for a campaign's file pa10cal columns proposes how to read other names"
DESCRIPTION = "campaign.yaml"
#: Lines in which names of columns are sought.
_LINES_ABOVE = 50
CUT = "the last line is cut short"
REPEATED = "repeats an earlier row"
FIELDS = "the number of fields differs from the header"
#: Separators that campaign.yaml has words for.
_SIGNS: dict[str, str | None] = {"tab": "\t", "blanks": None}


def _known_format(name: str) -> str:
    if name not in BY_NAME:
        raise ValueError(", ".join(BY_NAME))
    return name


class Layout(Section):
    """How a file is written."""

    format: Annotated[str, AfterValidator(_known_format)] | None = Field(
        default=None,
        description="of a file whose table is made by the program, such as kuka or motive; its "
        "columns then have the names that pa10cal columns prints",
    )
    separator: Annotated[str, StringConstraints(pattern=r"^(.|tab|blanks)$")] = Field(
        default=",", description="one character, tab, or blanks for any number of them"
    )
    decimal: Literal[".", ","] = "."
    header: int = Field(
        default=1,
        ge=0,
        le=1000,
        description="line of the column names; 0 where there is none, columns then being 1, 2, …",
    )
    first_row: int = Field(
        default=0, ge=0, description="line of the first row; 0 where it follows the names"
    )

    @property
    def sign(self) -> str | None:
        """Return the separator of fields; None for any number of blanks."""
        word = "tab" if self.format else self.separator
        return _SIGNS.get(word, word)

    @property
    def own(self) -> bool:
        """Return whether it is a user's own, in which names of columns may occur twice."""
        return self is not CONTRACT

    @property
    def text(self) -> tuple[str, ...]:
        """Return the columns of text."""
        return TEXT

    def fields(self, text: str) -> list[str]:
        """Return the fields of a line."""
        sign = self.sign
        if '"' in text and sign is not None:
            try:
                (split,) = csv.reader([text], delimiter=sign, skipinitialspace=True)
            except csv.Error:  # a field of more than 131072 characters: no number, quoted or not
                pass
            else:
                return [self._bare(field.strip()) for field in split]
        fields = text.split(sign)
        # A shortcut for most lines, in which there is nothing to strip.
        if not any(letter in text for letter in " \t\"'"):
            return fields
        return [self._bare(field.strip(' \t"')) for field in fields]

    def _bare(self, field: str) -> str:
        """Return a field without the apostrophe by which workbooks mark one as text."""
        return field[1:] if self.own and field[:1] == "'" else field

    def names(self, text: str) -> list[str]:
        """Return the names of the columns in the line of names; 1, 2, … of a first row."""
        fields = self.fields(text)
        if not self.header:
            return [str(k) for k in range(1, len(fields) + 1)]
        return numbered_apart(fields) if self.own else fields

    def row(self, text: str, width: int) -> list[str]:
        """Return the fields of a row, without an empty one behind a separator at the end."""
        row = self.fields(text)
        return row[:-1] if self.own and len(row) == width + 1 and row[-1] == "" else row

    def plain(self, field: str) -> str:
        """Return a number with a decimal point; `?` for a point where commas are decimal."""
        if self.decimal == ".":
            return field
        return "?" if "." in field else field.replace(self.decimal, ".")

    def number(self, field: str) -> float:
        """Return a number, also one with separated thousands; nan for none."""
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
        """Return fields as numbers, nan where one is no finite number."""
        plain = fields if self.decimal == "." else [self.plain(field) for field in fields]
        values = np.array(pd.to_numeric(np.array(plain, object), errors="coerce"), dtype=float)
        for k in np.flatnonzero(~np.isfinite(values)).tolist():
            value = self.number(fields[k]) if fields[k] != "" else np.nan
            values[k] = value if np.isfinite(value) else np.nan
        return values


#: Non-breaking blanks, and apostrophes, between the thousands of a number.
_BETWEEN_THOUSANDS = re.compile(r"(?<=\d)[\u00a0\u202f\u2009'’](?=\d{3})")
#: Numbers with points, or commas, between thousands and the other sign before decimals.
_IN_THOUSANDS = {
    ".": re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d+"),
    ",": re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d+"),
}
#: What `same_name` returns of the second column of a name, and of later ones.
_REPEATED = re.compile(r"(?P<name>.*) \(\d+\)")
CONTRACT = Layout()


def numbered_apart(names: Sequence[str]) -> list[str]:
    """Return unique names of columns: repeated ones with a number, blank ones as `column k`."""
    seen: Counter[str] = Counter()
    unique = []
    for k, name in enumerate(names, start=1):
        seen[name] += 1
        unique.append(same_name(name, seen[name]) if name else f"column {k}")
    return unique


def same_name(name: str, k: int) -> str:
    """Return the unique name of the k-th column, from 1, with a name."""
    return name if k == 1 else f"{name} ({k})"


def is_repeated(name: str, names: Sequence[str]) -> bool:
    """Return whether a name is that of another column with a number, see `numbered_apart`."""
    found = _REPEATED.fullmatch(name)
    return found is not None and found["name"] in names


def column_names(path: Path, layout: Layout = CONTRACT, within: Path | None = None) -> list[str]:
    """Return the names of the columns of a file, none where it is empty; see `lines_of`."""
    first = _first(table_lines(path, layout.format, within), layout)
    return [] if first is None else layout.names(first.text)


def _first(lines: Iterator[TextLine], layout: Layout) -> TextLine | None:
    """Return the line of the names, or the first row of a file without; None for no such line."""
    start = layout.header or layout.first_row
    return next((line for line in lines if line.number >= start), None)


def read_rows(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    together: Sequence[str] = (),
    layout: Layout = CONTRACT,
    *,
    words: ColumnMap = CONTRACT_COLUMNS,
    repeats: bool = False,
    stamps: Sequence[str] = (),
    within: Path | None = None,
    label: str = "pose",
) -> RawRows:
    """Read columns of a file of rows, in parts.

    Rows with another number of fields than the header, a last line that was cut short and exact
    repeats of an earlier row are quarantined.

    Args:
        path: the file.
        required: columns that must be there.
        optional: columns that are read if they are there.
        together: columns that are required if one of them is there.
        layout: how the file is written.
        words: the column map, for messages.
        repeats: whether exact repeats are kept.
        stamps: columns of times; where they are rounded so that rows share them, repeats are kept.
        within: folder that the file must lie in, see `lines_of`.
        label: the column of labels by which rows are counted, if it is read.

    Raises:
        RawDataError: when the file is empty or too large, is no text, uses another separator or
            decimal commas throughout, or lacks a required column.
    """
    lines = table_lines(path, layout.format, within)
    first = _first(lines, layout)
    if first is None:
        raise empty_file(path)
    header = layout.names(first.text)
    needed = [*required, *(together if set(together) & set(header) else ())]
    _check_header(path, first, header, needed, layout, words)
    used = [name for name in header if name in needed or name in optional]
    below = lines if layout.header else chain([first], lines)
    below = (line for line in below if line.number >= layout.first_row)
    part, last = _read_parts(path, below, header, used, layout, repeats=repeats)
    if last is None:
        raise RawDataError(
            "there is no row under the header",
            where=f"{path}:{first.number}",
            allowed="rows",
            remedy="export it",
        )
    width, wrong = len(header), part.widths != len(header)
    _refuse_other_widths(part, width, path, layout)
    _refuse_long_labels(part, set(used) & set(layout.text), f"{path}:{first.number}")
    right = part.line[~wrong]
    cut = not last.ended and part.widths[-1] < width
    wrong[-1] &= not cut
    listed = quarantined(path.name, part.line[wrong], f"{FIELDS} {width}", part.widths[wrong])
    if cut:
        listed += quarantined(path.name, part.line[-1:], CUT, [last.text])
    unused = tuple(name for name in header if name not in used)
    totals = {path.name: len(part.line)}
    once = ~pd.Series(part.hashes).duplicated().to_numpy()
    raw = RawRows(
        path.name,
        part.columns,
        right,
        totals,
        unused,
        listed,
        part.non_numeric,
        in_file=_in_file(part, once, width, label),
    )
    if _rounded_stamps(part, [name for name in stamps if name in used]):
        repeats = True
    if not last.ended and part.widths[-1] == width:
        # The last number of a file without a line end may lack digits that all others have.
        decimals = part.decimals
        usual = int(np.bincount(decimals).argmax())
        if decimals[-1] < usual and np.mean(decimals[:-1] == usual) >= SAME_FORMAT:
            keep = np.arange(len(once)) < len(once) - 1
            raw, once = raw.take(keep, CUT, [layout.row(last.text, width)[-1]]), once[keep]
    return raw if repeats else raw.take(once, REPEATED)


def _in_file(part: _Part, once: Mask, width: int, label: str) -> InFile:
    """Return where the rows that are as wide as the header stand in the file, all L rows counted.

    `once` says which of them repeat no earlier one.
    """
    unread = part.widths != width
    number = np.flatnonzero(~unread)
    repeats = np.zeros(len(unread), dtype=bool)
    repeats[number] = ~once
    labels = np.full(len(unread), "", dtype=object)
    labels[number] = part.columns.get(label, "")
    return InFile(number, repeats, unread, labels)


def _read_parts(
    path: Path,
    lines: Iterator[TextLine],
    header: Sequence[str],
    used: Sequence[str],
    layout: Layout,
    *,
    repeats: bool,
) -> tuple[_Part, TextLine | None]:
    """Read lines part by part; return all of them, and the last line, None without any.

    A file with too many unreadable rows and numbers, and repeats unless they are allowed, is
    refused as soon as they are read, since each of them takes memory.
    """
    parts: list[_Part] = []
    last, unreadable_count, row_count = None, 0, 0
    while lines_of_part := part_of(lines):
        part = _read_part(lines_of_part, header, used, layout)
        parts.append(part)
        last, row_count = lines_of_part[-1], row_count + len(lines_of_part)
        unreadable_count += part.unreadable_count(len(header), repeats=repeats)
        if unreadable_count > MOST_UNREADABLE:
            raise RawDataError(
                f"{unreadable_count} rows or numbers of the first {row_count} rows cannot be read "
                "or stand there twice",
                where=str(path),
                allowed=f"{len(header)} fields a row, numbers under the names of numbers, every "
                "row once",
                remedy="export the file again; pa10cal columns shows how it is written",
            )
    return _Part.joined(parts or [_read_part([], header, used, layout)]), last


def _rounded_stamps(part: _Part, stamps: Sequence[str]) -> bool:
    """Return whether columns of times are rounded to more than the time from row to row.

    Different rows then share a stamp, so that equal ones are samples of an arm at rest.
    """
    if not stamps:
        return False
    rows = pd.DataFrame({name: part.columns[name] for name in stamps}).assign(row=part.hashes)
    of_stamps = rows.groupby(list(stamps), sort=False)["row"].agg(["size", "nunique"])
    shared = float((of_stamps["nunique"] > 1).mean())
    return len(rows) >= 2 * len(of_stamps) and shared >= SHARED_STAMPS


def _refuse_other_widths(part: _Part, width: int, path: Path, layout: Layout) -> None:
    """Refuse a file of which most rows have another number of fields than the header."""
    wrong = part.widths != width
    if 2 * wrong.sum() <= len(wrong):
        return
    row = int(np.argmax(wrong))
    commas = part.widths[row] > width and layout.sign == ","
    why, how = ("; decimal commas", "with decimal points") if commas else ("", "again")
    raise RawDataError(
        f"{wrong.sum()} of {len(wrong)} rows have another number of fields than the header "
        f"({part.widths[row]} for {width}){why}",
        where=f"{path}:{part.line[row]}",
        allowed="one field for each column, decimal points",
        remedy=f"export the file {how}",
    )


def _refuse_long_labels(part: _Part, names: Collection[str], where: str) -> None:
    """Refuse columns of labels that take too much memory once all are as long as the longest."""
    for name in sorted(names):
        longest = max(map(len, part.columns[name].tolist()), default=0)
        if longest * len(part.columns[name]) > MOST_LABEL_LETTERS:
            raise RawDataError(
                f"a label under {name} has {longest} letters",
                where=where,
                allowed="short labels, such as P012",
                remedy="check the columns of labels",
            )


@dataclass(frozen=True)
class _Part:
    """Some lines of a file as they were read; R of L rows are as wide as the header."""

    line: NDArray[np.int64]  # (L,) numbers of the lines
    widths: NDArray[np.int64]  # (L,) number of fields
    hashes: NDArray[np.int64]  # (R,) hash of all fields
    decimals: NDArray[np.int64]  # (R,) digits behind the decimal sign of the last field
    columns: dict[str, NDArray[Any]]  # (R,) text, or numbers with nan where a field is none
    non_numeric: dict[str, dict[int, str]]  # fields that are no numbers, by line, without blanks

    @classmethod
    def joined(cls, parts: Sequence[_Part]) -> _Part:
        """Return parts of one file as one; columns of the parts are freed one after the other."""

        def stacked(key: str) -> NDArray[np.int64]:
            return np.concatenate([getattr(part, key) for part in parts])

        names = list(parts[0].columns)
        texts = {name: ChainMap(*(part.non_numeric[name] for part in parts)) for name in names}
        return cls(
            stacked("line"),
            stacked("widths"),
            stacked("hashes"),
            stacked("decimals"),
            {name: np.concatenate([part.columns.pop(name) for part in parts]) for name in names},
            {name: dict(of_parts) for name, of_parts in texts.items()},
        )

    def unreadable_count(self, width: int, *, repeats: bool) -> int:
        """Return the number of rows of another width, of fields, and of repeats unless allowed."""
        count = int(np.count_nonzero(self.widths != width))
        count += sum(map(len, self.non_numeric.values()))
        return count if repeats else count + len(self.hashes) - len(set(self.hashes.tolist()))


def part_of(
    lines: Iterator[TextLine], most: int = ROWS_A_PART, most_letters: int = LETTERS_A_PART
) -> list[TextLine]:
    """Return the lines that follow, as many as are read at a time."""
    part, letters = [], 0
    for line in lines:
        part.append(line)
        letters += len(line.text)
        if len(part) == most or letters > most_letters:
            break
    return part


def _read_part(
    lines: Sequence[TextLine], header: Sequence[str], used: Sequence[str], layout: Layout
) -> _Part:
    """Read some lines of a file."""
    all_rows = [layout.row(line.text, len(header)) for line in lines]
    rows = [row for row in all_rows if len(row) == len(header)]
    numbers = [
        line.number for line, row in zip(lines, all_rows, strict=True) if len(row) == len(header)
    ]
    columns: dict[str, NDArray[Any]] = {}
    non_numeric: dict[str, dict[int, str]] = {name: {} for name in used}
    for name in used:
        at = header.index(name)
        fields = [row[at] for row in rows]
        if name in layout.text:
            columns[name] = np.array([sys.intern(from_csv_cell(field)) for field in fields], object)
            continue
        columns[name] = layout.numbers(fields)
        unread = np.flatnonzero(np.isnan(columns[name])).tolist()
        non_numeric[name] = {numbers[k]: fields[k] for k in unread if fields[k] != ""}
    decimals = [len(row[-1].partition(layout.decimal)[2]) for row in rows]
    return _Part(
        np.array([line.number for line in lines], dtype=np.int64),
        np.array(list(map(len, all_rows)), dtype=np.int64),
        np.array([hash(tuple(row)) for row in rows], dtype=np.int64),
        np.array(decimals, dtype=np.int64),
        columns,
        non_numeric,
    )


def _check_header(
    path: Path,
    first: TextLine,
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
    words: ColumnMap,
) -> None:
    where, here, section = f"{path}:{first.number}", layout.sign, words.section
    if len(header) > MOST_COLUMNS:
        raise too_many_columns(where, len(header))
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        if here and here != separator and first.text.count(separator) > first.text.count(here):
            allowed = "commas between fields, decimal points"
            if here != ",":
                allowed = f"the separator {here!r}, as {DESCRIPTION} states it"
            remedy = (
                f"set {section}.separator: {'tab' if separator == chr(9) else repr(separator)}"
                if section
                else "export the file with commas and decimal points; that of a campaign may stay "
                f"as it is: pa10cal columns {path.name} proposes how {DESCRIPTION} describes it"
            )
            raise RawDataError(
                f"the fields are separated by {name}", where=where, allowed=allowed, remedy=remedy
            )
    twice = [name for name, times in Counter(header).items() if times > 1]
    if twice:
        raise RawDataError(
            f"column {twice[0]} occurs twice", where=where, allowed="once", remedy="remove one"
        )
    if missing := [name for name in required if name not in header]:
        remedy = _remedy_for_missing(path, missing, header, required, layout, words)
        columns = "column" if len(missing) == 1 else "columns"
        raise RawDataError(
            f"missing {columns} {', '.join(missing)}",
            where=where,
            value=", ".join(header),
            allowed=", ".join(required),
            remedy=remedy,
        )


def _remedy_for_missing(
    path: Path,
    missing: Sequence[str],
    header: Sequence[str],
    required: Sequence[str],
    layout: Layout,
    words: ColumnMap,
) -> str:
    """Return the remedy for missing columns, by the names that are there."""
    others, section = [name for name in header if name not in required], words.section
    if (mistaken := mistaken_encoding(missing[0], others)) is not None:
        name, taken, right = mistaken
        return (
            f"the header has {name!r}: {DESCRIPTION} and the file are read in two encodings, "
            f"{missing[0]!r} is {right} taken for {taken}; save both as UTF-8"
        )
    numbers = np.mean([not np.isnan(layout.number(name)) for name in header])
    if section and layout.header and numbers > 0.5:
        return (
            f"the first line holds numbers and no names: set {section}.header: 0, and name the "
            "columns 1, 2, 3, …; or export the file with a header"
        )
    if section:
        for line in islice(table_lines(path, layout.format, path.parent), _LINES_ABOVE):
            if set(missing) <= set(layout.names(line.text)):
                return f"the names stand in line {line.number}: set {section}.header: {line.number}"
    near = difflib.get_close_matches(missing[0], others, n=1, cutoff=0.5)
    if not near:
        return f"add it, or check the header{OWN_NAMES if not layout.own else ''}"
    key = words.key_called(missing[0]) or section
    return f"is it {near[0]!r}? {f'correct {key} in {DESCRIPTION}' if key else 'rename it'}"


def empty_file(path: Path) -> RawDataError:
    """Return the refusal of an empty file."""
    return RawDataError(
        "the file is empty",
        where=f"{path}:1",
        allowed="a header and rows",
        remedy="export it again",
    )


def too_many_columns(where: str, columns: int) -> RawDataError:
    """Return the refusal of a line with more columns than are read."""
    return RawDataError(
        f"there are too many columns: {columns}",
        where=where,
        allowed=f"at most {MOST_COLUMNS}",
        remedy="check the separator, or leave out what is not needed",
    )
