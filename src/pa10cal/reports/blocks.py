"""What a page is made of: sections of blocks, which the template knows how to show."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal

from pa10cal.reports.formatting import NOT_KNOWN

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@dataclass(frozen=True)
class PageBlock:
    """A part of a section; a page does not show one that is empty."""

    @property
    def kind(self) -> str:
        """The macro of the template that shows it."""
        return type(self).__name__.lower()

    @property
    def empty(self) -> bool:
        """Whether nothing is in it: a table without rows, a list without entries."""
        return any(getattr(self, field.name) == () for field in fields(self))


@dataclass(frozen=True)
class Paragraph(PageBlock):
    """A paragraph."""

    text: str
    lead: bool = False  # whether it is the sentence of its section


@dataclass(frozen=True)
class Callout(PageBlock):
    """A sentence that stands out, with a word that says why."""

    word: Literal["warning", "missing", "note"]
    text: str


@dataclass(frozen=True)
class Facts(PageBlock):
    """Names and what they are; a name of nothing is not shown."""

    rows: tuple[tuple[str, str], ...]

    @property
    def empty(self) -> bool:
        """Whether no name is of anything."""
        return not any(text for _, text in self.rows)


@dataclass(frozen=True)
class Items(PageBlock):
    """A list of sentences."""

    texts: tuple[str, ...]


@dataclass(frozen=True)
class Links(PageBlock):
    """Other pages: path from this page, and what is there."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Grid(PageBlock):
    """A table."""

    caption: str  # what the rows are
    header: tuple[str, ...]  # one text a column; the first column names the row
    rows: tuple[tuple[str, ...], ...]  # texts, each row as long as the header

    @property
    def numbers(self) -> frozenset[int]:
        """Columns of numbers, from 0: aligned to the right."""
        columns = enumerate(zip(*self.rows, strict=True))
        return frozenset(k for k, cells in columns if any(map(_NUMBER.fullmatch, cells)))


@dataclass(frozen=True)
class Code(PageBlock):
    """Something to type."""

    caption: str  # what it does
    text: str


@dataclass(frozen=True)
class Drawing(PageBlock):
    """A figure of plotly."""

    figure: Figure
    title: str  # what it shows, in a few words
    caption: str  # what to see in it
    id: str  # of its element in the page
    in_space: bool = False  # whether it is drawn in three dimensions and can be turned


@dataclass(frozen=True)
class Image(PageBlock):
    """A picture that lies among the results as a file."""

    source: str  # the file as a data URI
    title: str  # what it shows, in a few words
    caption: str  # what to see in it
    id: str  # of its element in the page
    saved_as: tuple[str, ...]  # what it can be saved as


@dataclass(frozen=True)
class SideBySide(PageBlock):
    """Figures side by side where there is room."""

    drawings: tuple[Drawing, ...]


@dataclass(frozen=True)
class Folded(PageBlock):
    """What few readers need, unfolded by them."""

    summary: str  # what is inside
    blocks: tuple[PageBlock, ...]

    @property
    def empty(self) -> bool:
        """Whether nothing is in any of its blocks."""
        return all(block.empty for block in self.blocks)


#: Format of a number in a column, by the unit in the name of the column.
_FORMATS = {"mm": ".3f", "deg": ".4f", "N": "g"}
_UNIT = re.compile(r"\[(mm|deg|N)\b")
#: Text of a cell that is a number, with an interval or unit: `0.549 ± 0.049`, `97 %`.
_NUMBER = re.compile(r"[-+(]?\d([^A-Za-z]|e[-+]?\d|to)*")


def grid(
    caption: str, head: str | Sequence[str], rows: Iterable[Sequence[str | float | None]]
) -> Grid:
    """Return a table; a number is formatted by the unit of its column.

    Args:
        caption: what the rows are.
        head: names of the columns, `pose | load [N] | error [mm]`; the first names the row.
        rows: one cell a column; None, and cells that are missing at the end, are not known.
    """
    names = tuple(head.split(" | ") if isinstance(head, str) else head)
    units = [match[1] if (match := _UNIT.search(name)) else "" for name in names]
    texts = (map(_text, [*row, *[None] * (len(names) - len(row))], units) for row in rows)
    return Grid(caption, names, tuple(map(tuple, texts)))


def _text(cell: str | float | None, unit: str) -> str:
    """Return a cell as text: numbers by their unit, truth values in words."""
    if cell is None or isinstance(cell, bool):
        return {None: NOT_KNOWN, True: "yes", False: "no"}[cell]
    return cell if isinstance(cell, str) else f"{cell:{_FORMATS.get(unit, '')}}"


def folded(table: Grid, title: str = "") -> Folded:
    """Return a table that is folded under its caption, or under another title."""
    return Folded(title or table.caption, () if table.empty else (table,))
