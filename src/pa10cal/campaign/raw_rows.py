"""Rows of a raw file: columns of numbers and of text, their lines, and the rows not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.quarantine import Quarantined, quarantined

#: Columns of text; all others hold numbers.
TEXT = ("id", "kind", "pose", "ball")


@dataclass(frozen=True)
class NumberColumn:
    """A column of numbers, and the text of the fields that hold none."""

    values: Array  # (N,) numbers, nan where there is none
    odd: NDArray[np.intp]  # (m,) rows whose field is no finite number, ascending
    text: NDArray[np.object_]  # (m,) what stands there

    def take(self, keep: NDArray[np.bool_]) -> NumberColumn:
        """Return some of the rows."""
        stays = keep[self.odd]
        odd = np.cumsum(keep)[self.odd[stays]] - 1
        return NumberColumn(self.values[keep], odd, self.text[stays])

    def as_text(self, row: int) -> str:
        """Return what stands in a row."""
        at = int(np.searchsorted(self.odd, row))
        if at < len(self.odd) and self.odd[at] == row:
            return repr(str(self.text[at]))
        return f"{self.values[row]:.10g}"


@dataclass(frozen=True)
class OwnColumn:
    """What a column of the contract was read from, where the file has names of its own."""

    name: str  # the file's own name of it; of several columns all of them
    unit: str = ""  # the file's own unit
    # factor and offset: what the file's number is multiplied by, and what is added then
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class RawRows:
    """Rows of one CSV file: numbers where a column holds them, else text."""

    file: str  # name of the file
    # the columns requested, those of `TEXT` as (N,) text
    columns: dict[str, NumberColumn | NDArray[np.object_]]
    line: NDArray[np.int64]  # (N,) physical line of every row, the header being line 1
    total: int  # rows in the file, quarantined ones included
    unused: tuple[str, ...]  # columns that were not requested
    quarantined: tuple[Quarantined, ...]  # rows that are not used
    # the file's own columns, by the contract's names; empty where it has those
    own: dict[str, OwnColumn] = field(default_factory=dict)

    def name_of(self, name: str) -> str:
        """Return the file's own name of a column."""
        return self.own[name].name if name in self.own else name

    def shown(self, name: str, row: int) -> str:
        """Return a column's name and what stands in a row, as the file has both."""
        text = self.numbers_of(name).as_text(row)
        if name not in self.own:
            return f"{name} = {text}"
        own, value = self.own[name], float(self.numbers_of(name).values[row])
        if not np.isfinite(value) or (own.factor, own.offset) == (1.0, 0.0):
            return f"{own.name} = {text}"
        return f"{own.name} = {(value - own.offset) / own.factor:.10g} {own.unit} ({name} = {text})"

    def take(self, keep: NDArray[np.bool_], reason: str, values: Sequence[object]) -> RawRows:
        """Keep some rows; quarantine the others with a reason and (for each of them) a value."""
        if keep.all():
            return self
        return replace(
            self,
            columns={
                name: column.take(keep) if isinstance(column, NumberColumn) else column[keep]
                for name, column in self.columns.items()
            },
            line=self.line[keep],
            quarantined=(
                *self.quarantined,
                *quarantined(self.file, self.line[~keep], reason, values),
            ),
        )

    def numbers_of(self, name: str) -> NumberColumn:
        """Return a column of numbers."""
        column = self.columns[name]
        assert isinstance(column, NumberColumn)
        return column

    def text_of(self, name: str) -> NDArray[np.str_]:
        """Return a column of text."""
        column = self.columns[name]
        assert not isinstance(column, NumberColumn)
        return column.astype(str)

    def without_columns(self) -> RawRows:
        """Return what is to be known of the file once its columns were read."""
        return replace(self, columns={})


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
        parsed[:, k] = raw.numbers_of(name).values
    return raw, parsed


def finite(raw: RawRows, names: Sequence[str], *, may_be_blank: bool = False) -> RawRows:
    """Quarantine the rows in which a column holds no finite number; see `numbers`."""
    columns = [raw.numbers_of(name) for name in names]
    wrong: dict[int, str] = {}
    for name, column in zip(names, columns, strict=True):
        for row, text in zip(column.odd, column.text, strict=True):
            if text != "" or not may_be_blank:
                wrong.setdefault(int(row), f"{raw.name_of(name)} = {text!r}")
    keep = np.ones(len(raw.line), dtype=bool)
    keep[list(wrong)] = False
    return raw.take(keep, "not a finite number", [wrong[row] for row in sorted(wrong)])


def whole_numbers(raw: RawRows, name: str) -> tuple[RawRows, NDArray[np.int64]]:
    """Read a column as whole numbers; other rows are quarantined."""
    raw, found = numbers(raw, [name])
    column = found[:, 0]
    keep = column == np.round(column)
    values = [f"{raw.name_of(name)} = {value:g}" for value in column[~keep]]
    return raw.take(keep, "not a whole number", values), column[keep].astype(np.int64)


def choices(raw: RawRows, name: str, allowed: Sequence[str]) -> RawRows:
    """Keep the rows whose column holds one of the allowed words."""
    column = raw.text_of(name)
    keep = np.isin(column, list(allowed))
    values = [f"{raw.name_of(name)} = {str(value)!r}" for value in column[~keep]]
    return raw.take(keep, f"{name} is none of {', '.join(allowed)}", values)
