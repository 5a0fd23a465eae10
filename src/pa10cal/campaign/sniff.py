"""How an unknown text file is written: separator, decimal sign, line of the names, numbers."""

from __future__ import annotations

import gzip
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.csv_rows import Layout
from pa10cal.errors import RawDataError

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
    lines = _lines(path)
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


def _lines(path: Path) -> list[tuple[int, str]]:
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
