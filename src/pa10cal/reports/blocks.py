"""What a page is made of: sections of blocks, which the template knows how to show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from pa10cal.figures.table import written
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.record import EffectName

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@dataclass(frozen=True)
class Block:
    """A part of a section; `kind` names the macro of the template that shows it."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph(Block):
    """A paragraph."""

    kind = "paragraph"
    text: str  # plain text
    lead: bool = False  # whether it is the sentence of its section


@dataclass(frozen=True)
class Callout(Block):
    """A sentence that stands out, with a word that says why."""

    kind = "callout"
    word: Literal["warning", "missing", "note"]  # `warning`, `missing` or `note`
    text: str  # plain text


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
    """A table."""

    kind = "grid"
    caption: str  # what the rows are
    header: tuple[str, ...]  # one text a column; the first column names the row
    rows: tuple[tuple[str, ...], ...]  # texts, each row as long as the header
    numbers: frozenset[int] = frozenset()  # columns of numbers, from 0: aligned to the right


@dataclass(frozen=True)
class Code(Block):
    """Something to type."""

    kind = "code"
    caption: str  # what it does
    text: str  # as it is typed


@dataclass(frozen=True)
class Drawing(Block):
    """A figure."""

    kind = "drawing"
    figure: Figure  # of plotly
    title: str  # what it shows, in a few words
    caption: str  # what to see in it
    id: str  # of its element in the page
    in_space: bool = False  # whether it is drawn in three dimensions and can be turned


@dataclass(frozen=True)
class Beside(Block):
    """Figures side by side where there is room."""

    kind = "beside"
    drawings: tuple[Drawing, ...]


@dataclass(frozen=True)
class Folded(Block):
    """What few readers need, unfolded by them."""

    kind = "folded"
    summary: str  # what is inside
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """A section of the page."""

    id: str  # of its element in the page
    title: str  # its heading
    blocks: tuple[Block, ...]  # in the order of reading


def grid(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Iterable[int] = (),
) -> Grid:
    """Return a table of rows of texts."""
    return Grid(caption, tuple(header), tuple(tuple(row) for row in rows), frozenset(numbers))


# How numbers and names are written on the page.

#: From a standard uncertainty to half of a 95 % interval.
HALF_WIDTH_95 = 1.96
NOT_KNOWN = "–"
#: Units to show, and by how much a value is multiplied.
_SHOWN = {
    "m": ("mm", 1e3),
    "rad": ("mrad", 1e3),
    "N m/rad": ("kN m/rad", 1e-3),
    "N m/rad^3": ("MN m/rad³", 1e-6),
}
#: A larger angle is shown in radians: it is a phase.
_PHASE_RAD = 0.1


def shown_in(unit: str, value: float = 0.0) -> tuple[str, float]:
    """Return the unit that a value is shown in, and by how much it is multiplied."""
    if unit == "rad" and abs(value) > _PHASE_RAD:
        return unit, 1.0
    return _SHOWN.get(unit, (unit, 1.0))


def mm(value: float | None) -> str:
    """Return a length in millimetres, three decimals."""
    return NOT_KNOWN if value is None else f"{value:.3f}"


def deg(value: float | None) -> str:
    """Return an angle in degrees, four decimals."""
    return NOT_KNOWN if value is None else f"{value:.4f}"


def with_interval(value: float, std: float | None) -> str:
    """Return a value and half of its 95 % interval, to two figures of the latter."""
    if std is None or not std > 0.0:
        return f"{value:.4g}"
    half = HALF_WIDTH_95 * std
    decimals = max(0, 1 - _exponent(half))
    return f"{value:.{decimals}f} ± {half:.{decimals}f}"


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])


def sized(parameter: EffectParameter) -> str:
    """Return a parameter of an effect with its 95 % interval and unit."""
    unit, scale = shown_in(parameter.unit, parameter.value)
    text = with_interval(scale * parameter.value, scale * parameter.std)
    return unbroken(f"({text}) {unit}" if unit != "1" else text)


def unbroken(text: str) -> str:
    """Return a text that stays on one line."""
    return text.replace(" ", "\u00a0")


def named(effect: EffectName) -> str:
    """Return an effect as readers see it: `friction torque at joint 2`."""
    of = effect.of.replace("_", " ")
    place = f"at {of}" if of.startswith("joint") else f"of the {of}"
    return f"{effect.id.replace('_', ' ')} {place}"


def listed(names: Iterable[str], nothing: str = "none") -> str:
    """Return texts as a list within a sentence: `a, b and c`."""
    *first, last = list(names) or [nothing]
    return f"{', '.join(first)} and {last}" if first else last


def parameters(names: Iterable[str]) -> str:
    """Return parameters' names as readers see them, as a list within a sentence."""
    return listed(map(written, names))


def sentence(text: str) -> str:
    """Return a text that begins with a capital and ends with a full stop."""
    text = text.strip().removesuffix(".")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def count(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def nonzero(rows: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return names and texts without those that say nothing."""
    return tuple((name, text) for name, text in rows if text)
