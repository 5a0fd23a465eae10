"""What a page is made of: sections of blocks, which the template knows how to show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@dataclass(frozen=True)
class PageBlock:
    """A part of a section."""

    @property
    def kind(self) -> str:
        """The macro of the template that shows it."""
        return type(self).__name__.lower()


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
    """Names and what they are."""

    rows: tuple[tuple[str, str], ...]


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
    numbers: frozenset[int] = frozenset()  # columns of numbers, from 0: aligned to the right


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
class Beside(PageBlock):
    """Figures side by side where there is room."""

    drawings: tuple[Drawing, ...]


@dataclass(frozen=True)
class Folded(PageBlock):
    """What few readers need, unfolded by them."""

    summary: str  # what is inside
    blocks: tuple[PageBlock, ...]


@dataclass(frozen=True)
class PageSection:
    """A section of the page."""

    id: str  # of its element in the page
    title: str  # its heading
    blocks: tuple[PageBlock, ...]  # in the order of reading


def grid(
    caption: str, header: Sequence[str], rows: Iterable[Sequence[str]], numbers: Iterable[int] = ()
) -> Grid:
    """Return a table of rows of texts."""
    return Grid(caption, tuple(header), tuple(tuple(row) for row in rows), frozenset(numbers))


def folded(table: Grid, title: str = "") -> Folded:
    """Return a table that is unfolded by its caption, or by a title of its own."""
    return Folded(title or table.caption, (table,))
