"""Text tables, as data sets publish them: numbers by column, unusable rows listed.

A row with a field too many or too few, or with a field that is no number, is omitted and listed
with its line. Decimal commas throughout stop with one message. A table whose columns need no change
is read as it is, by `columns` of campaign.yaml.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.own_words import refuse_too_many
from pa10cal.campaign.raw_rows import Quarantined, quarantined
from pa10cal.errors import RawDataError

NOT_A_NUMBER = "not a finite number"


@dataclass(frozen=True)
class TextTable:
    """Rows of a text table as numbers."""

    file: str  # its path inside the data set's folder
    line: NDArray[np.int64]  # (N,) line of every row
    columns: dict[str, Array]  # (N,) numbers of every column by name
    total: int  # rows in the file
    left_out: tuple[Quarantined, ...]  # rows omitted

    def __len__(self) -> int:
        return len(self.line)

    def numbers(self, names: Sequence[str]) -> Array:
        """Return columns as (N, len(names))."""
        return np.column_stack([self.columns[name] for name in names])

    def take(self, rows: NDArray[np.intp]) -> TextTable:
        """Return rows in another order, or some of them, without listing the others."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return TextTable(self.file, self.line[rows], columns, self.total, self.left_out)

    def keep(self, good: NDArray[np.bool_], reason: str, values: Iterable[object]) -> TextTable:
        """Keep some rows and list the others with a reason and (for each of them) a value."""
        kept = self.take(np.flatnonzero(good))
        listed = quarantined(self.file, self.line[~good], reason, values)
        return TextTable(kept.file, kept.line, kept.columns, kept.total, (*self.left_out, *listed))

    def refuse_too_many(self, max_fraction: float) -> None:
        """Stop when more than a part of the rows, or all of them, are omitted (RawDataError)."""
        refuse_too_many(self.left_out, {self.file: self.total}, max_fraction)


def read_bare_table(
    folder: Path,
    file: str,
    names: Sequence[str],
    *,
    separator: str | None = None,
    header: bool = False,
) -> TextTable:
    """Read a table of numbers with decimal points.

    Every line is a row, a blank one too: tables of one campaign belong together line by line.

    Args:
        file: path of the table in it.
        names: what its columns are to be called.
        separator: what stands between fields; None for blanks.
        header: whether the first line holds names, which are not read.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    path, width = folder / file, len(names)
    lines = _numbered_lines(path)[int(header) :]
    rows = [(number, text.split(separator)) for number, text in lines]
    widths = np.array([len(words) for _, words in rows])
    line = np.array([number for number, _ in rows], dtype=np.int64)
    fits = widths == width
    words = np.array([each for _, each in rows if len(each) == width], dtype=object)
    words = words.reshape(-1, width)
    _refuse_decimal_commas(path, line[fits], words)
    good = np.ones(len(words), dtype=bool)
    values = np.full(len(words), "", dtype=object)
    columns: dict[str, Array] = {}
    for place, name in enumerate(names):
        columns[name], readable = _numbers(words[:, place])
        values[good & ~readable] = [f"{name} = {w!r}" for w in words[good & ~readable, place]]
        good &= readable
    wrong_width = f"the number of fields is not {width}"
    listed = quarantined(file, line[~fits], wrong_width, widths[~fits])
    whole = TextTable(file, line[fits], columns, len(rows), listed)
    return whole.keep(good, NOT_A_NUMBER, values[~good])


def _numbered_lines(path: Path) -> list[tuple[int, str]]:
    """Return lines with their numbers from 1, blank ones between them too."""
    text = path.read_bytes().decode("utf-8-sig", errors="replace").rstrip()
    lines = list(enumerate(text.splitlines(), start=1))
    if not lines:
        raise _refusal(path, 1, "the file is empty", None, "rows of numbers", "copy it again")
    return lines


def _numbers(words: NDArray[np.object_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return numbers, and whether each can be used."""
    found = np.array(pd.to_numeric(pd.Series(words, dtype=object), errors="coerce"), dtype=float)
    return found, np.isfinite(found)


def _refuse_decimal_commas(path: Path, line: NDArray[np.int64], words: NDArray[np.object_]) -> None:
    """Stop when most rows are written with decimal commas."""
    struck = np.array(["," in word for word in words.ravel()], dtype=bool).reshape(words.shape)
    rows = np.asarray(struck.any(axis=1), dtype=bool)
    if 2 * rows.sum() <= len(rows):
        return
    first = int(np.argmax(rows))
    raise _refusal(
        path,
        int(line[first]),
        "decimal commas where decimal points are expected",
        words[first][struck[first]][0],
        "numbers such as 1.5",
        "take the file as it was published, not as a spreadsheet rewrote it",
    )


def _refusal(
    path: Path, line: int, what: str, value: object, allowed: str, remedy: str
) -> RawDataError:
    return RawDataError(what, where=f"{path}:{line}", value=value, allowed=allowed, remedy=remedy)


def same_rows(tables: Sequence[TextTable], max_fraction: float) -> list[TextTable]:
    """Return the rows that can be used in every one of some tables, which belong together by line.

    Raises:
        RawDataError: when they have different numbers of rows, or too many of one cannot be used.
    """
    if len({table.total for table in tables}) > 1:
        raise RawDataError(
            "the tables have different numbers of rows",
            where=tables[0].file,
            value=", ".join(f"{table.file} {table.total}" for table in tables),
            allowed="one row a configuration in each table",
            remedy="fetch the data set again, or complete the shorter table",
        )
    for table in tables:
        table.refuse_too_many(max_fraction)
    line = reduce(np.intersect1d, [table.line for table in tables])
    return [table.take(np.flatnonzero(np.isin(table.line, line))) for table in tables]
