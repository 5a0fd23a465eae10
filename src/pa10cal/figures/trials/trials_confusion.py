"""What was hidden in blind trials, and what was named: the confusion matrix."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    SEPARATOR,
    VERMILLION,
    new_figure,
    panel,
    write_text_at,
)
from pa10cal.results.trials import TrialScoresRecord

PICTURE = Picture(
    title="What was hidden, and what was named",
    needs=(),
    caption="""
Simulated campaigns in which one effect was hidden, judged without knowledge of it ({name}). A
row is the effect that was hidden, a column the effect that was named. Blue: right name at the
right place. *In the alternatives*: the data cannot distinguish the truth from the name given,
and the verdict lists both. *No name, right place* is the correct answer for effects outside the
vocabulary (below the line). Red: wrong name. The hidden effects go down to a tenth of their
usual size, so *nothing found* is no fault by itself. Errors of real robots that the simulation
does not have are not tested.
""",
)

_TITLE = "Blind trials with one hidden effect: what was hidden, and what was named"
_CELL_MM = 4.6
_LEFT_MM, _TOP_MM, _BOTTOM_MM = 37.0, 44.0, 16.0
#: Outcomes that are no id, in the order of the columns, and those that are no fault.
_WORDS = (
    "in the alternatives",
    "no name, right place",
    "said to be not testable",
    "nothing found",
    "right id elsewhere",
    "no name, other place",
    "failed",
)
_HONEST = _WORDS[:4]
_RIGHT_WITHOUT_NAME = _WORDS[1]


def draw(scores: TrialScoresRecord) -> Figure:
    """Draw a row an effect, a column a name that was given, and columns for what is no name."""
    inside, outside = scores.confusion.single, scores.confusion.outside
    rows = [*((name, inside[name]) for name in sorted(inside))]
    rows += [(name, outside[name]) for name in sorted(outside)]
    if not rows:
        raise NothingToShowError("no trial hid one effect")
    given = {outcome for _, counts in rows for outcome in counts}
    ids = sorted({*inside, *(given - set(_WORDS))})
    columns = [*ids, *(word for word in _WORDS if word in given)]
    width, height = _CELL_MM * (len(columns) + 1), _CELL_MM * len(rows)
    figure = new_figure(_TOP_MM + height + _BOTTOM_MM, _TITLE)
    axes = panel(figure, _LEFT_MM, _BOTTOM_MM, width, height)
    _draw_cells(axes, rows, columns, set(outside))
    _name(axes, rows, columns, len(ids), len(inside))
    write_text_at(
        figure,
        2.0,
        6.0,
        "Blue: right id at the right place, or rightly without a name. Orange: not named alone, "
        "but no wrong name\neither. Red: wrong. Shade: share of the row. Last column: trials.",
    )
    return figure


def _draw_cells(
    axes: Axes,
    rows: list[tuple[str, Mapping[str, int]]],
    columns: list[str],
    without_name: set[str],
) -> None:
    shades = {
        color: LinearSegmentedColormap.from_list("shade", ["white", color])
        for color in (BLUE, ORANGE, VERMILLION)
    }
    for y, (name, counts) in enumerate(rows):
        total = sum(counts.values())
        best = _RIGHT_WITHOUT_NAME if name in without_name else name
        for x, column in enumerate(columns):
            count = counts.get(column, 0)
            if not count:
                continue
            right = BLUE if column == best else ORANGE if column in _HONEST else VERMILLION
            share = 0.15 + 0.6 * count / total
            box = (x - 0.5, y - 0.5)
            axes.add_patch(Rectangle(box, 1.0, 1.0, facecolor=shades[right](share), linewidth=0.0))
            axes.text(x, y, str(count), ha="center", va="center")
        axes.text(len(columns), y, str(total), ha="center", va="center", color=GREY)


def _name(
    axes: Axes, rows: list[tuple[str, Mapping[str, int]]], columns: list[str], ids: int, inside: int
) -> None:
    axes.set_xlim(-0.5, len(columns) + 0.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xticks(range(len(columns)), columns, rotation=90.0)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.tick_params(
        axis="both", length=0.0, top=False, labeltop=True, bottom=False, labelbottom=False
    )
    axes.grid(visible=False)
    axes.set_ylabel("hidden")
    axes.axvline(ids - 0.5, color=SEPARATOR, linewidth=0.8)
    axes.axvline(len(columns) - 0.5, color=SEPARATOR, linewidth=0.8)
    if 0 < inside < len(rows):
        axes.axhline(inside - 0.5, color=SEPARATOR, linewidth=0.8)
