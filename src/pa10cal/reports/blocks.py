"""What a page is made of: sections of blocks, which the template knows how to show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@dataclass(frozen=True)
class Block:
    """A part of a section; `kind` names the macro of the template that shows it."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph(Block):
    """A paragraph.

    Attributes:
        text: plain text.
        lead: whether it is the sentence of its section.
    """

    kind = "paragraph"
    text: str
    lead: bool = False


@dataclass(frozen=True)
class Callout(Block):
    """A sentence that stands out, with a word that says why.

    Attributes:
        word: `warning`, `missing` or `note`.
        text: plain text.
    """

    kind = "callout"
    word: Literal["warning", "missing", "note"]
    text: str


@dataclass(frozen=True)
class Facts(Block):
    """Names and what they are."""

    kind = "facts"
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Items(Block):
    """A list of sentences."""

    kind = "items"
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Grid(Block):
    """A table.

    Attributes:
        caption: what the rows are.
        header: one text a column; the first column names the row.
        rows: texts, each row as long as the header.
        numbers: columns of numbers, from 0: aligned to the right.
    """

    kind = "grid"
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Code(Block):
    """Something to type.

    Attributes:
        caption: what it does.
        text: as it is typed.
    """

    kind = "code"
    caption: str
    text: str


@dataclass(frozen=True)
class Drawing(Block):
    """A figure.

    Attributes:
        figure: of plotly.
        title: what it shows, in a few words.
        caption: what to see in it.
        id: of its element in the page.
        in_space: whether it is drawn in three dimensions and can be turned.
    """

    kind = "drawing"
    figure: Figure
    title: str
    caption: str
    id: str
    in_space: bool = False


@dataclass(frozen=True)
class Beside(Block):
    """Figures side by side where there is room."""

    kind = "beside"
    drawings: tuple[Drawing, ...]


@dataclass(frozen=True)
class Folded(Block):
    """What few readers need, unfolded by them.

    Attributes:
        summary: what is inside.
        blocks: it.
    """

    kind = "folded"
    summary: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes:
        id: of its element in the page.
        title: its heading.
        blocks: in the order of reading.
    """

    id: str
    title: str
    blocks: tuple[Block, ...]


def grid(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Iterable[int] = (),
) -> Grid:
    """Return a table of rows of texts."""
    return Grid(caption, tuple(header), tuple(tuple(row) for row in rows), frozenset(numbers))
