"""How every picture looks, and how it is written: the same bytes for the same results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike, NDArray

from pa10cal.files.output import whole_file
from pa10cal.reports.theme import GREY

WIDTH_MM = 170.0
_MM_PER_INCH = 25.4
_FOOTER_MM = 1.5
_TITLE_MM = 1.5
_FOOTER_LETTERS = 108
_TITLE_LETTERS = 98
_LINE_MM = 3.5
_TWO_DECADES = 100.0
#: More points than this are drawn as an image inside SVG and PDF, which stay small.
_MOST_POINTS = 300

_TEXTS = ("font", "axes.title", "axes.label", "xtick.label", "ytick.label", "legend.font")
_LOOKS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    **{f"{of}{'.size' if of == 'font' else 'size'}": 8.0 for of in _TEXTS},
    "figure.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # where it stands anyway; to look for room takes a tenth of the drawing
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#d9d9d9",
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6),
    **dict.fromkeys(("grid.linewidth", "xtick.minor.width", "ytick.minor.width"), 0.4),
    "lines.linewidth": 1.0,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "legend.borderaxespad": 0.0,
    "svg.hashsalt": "pa10cal",
    "svg.fonttype": "path",
}
#: Without dates and versions a picture changes only when what it shows does.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}


@contextmanager
def theme() -> Iterator[None]:
    """Draw and write with the project's looks, whatever the user's own settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_LOOKS)
        yield


def new_figure(height_mm: float, title: str) -> Figure:
    """Return an empty figure of the common width with its title."""
    figure = Figure(figsize=(WIDTH_MM / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    figure.suptitle(title, x=2.0 / WIDTH_MM, y=1.0 - _TITLE_MM / height_mm, ha="left", va="top")
    return figure


def name_in_title(figure: Figure, name: str) -> None:
    """Let a figure's title begin with what it is of; further lines stand above the figure."""
    lines = wrap(f"{name}: {figure.get_suptitle()}", _TITLE_LETTERS)
    above_mm = _LINE_MM * (len(lines) - 1)
    y = 1.0 + (above_mm - _TITLE_MM) / height_of(figure)
    figure.suptitle("\n".join(lines), x=2.0 / WIDTH_MM, y=y, ha="left", va="top")


def height_of(figure: Figure) -> float:
    """Return the height of a figure [mm]."""
    return float(figure.get_figheight() * _MM_PER_INCH)


def panel(
    figure: Figure, x_mm: float, y_mm: float, width_mm: float, height_mm: float, **options: Any
) -> Axes:
    """Add axes whose frame has its lower left corner at (x, y), measured from the lower left."""
    height = height_of(figure)
    box = (x_mm / WIDTH_MM, y_mm / height, width_mm / WIDTH_MM, height_mm / height)
    return figure.add_axes(box, **options)


def label_space(axes: Axes, low_m: ArrayLike, high_m: ArrayLike, *, numbers: bool = True) -> None:
    """Give axes in space their limits, (3,) each, and names and a few numbers, or neither."""
    solid: Any = axes  # matplotlib's axes in space are not typed
    for name, low, high in zip("xyz", np.asarray(low_m), np.asarray(high_m), strict=True):
        getattr(solid, f"set_{name}lim")(low, high)
        if numbers:
            getattr(solid, f"set_{name}label")(f"{name} [m]")
            getattr(solid, f"{name}axis").get_major_locator().set_params(nbins=3)
        else:
            getattr(solid, f"{name}axis").set_ticklabels([])
    solid.set_box_aspect(np.subtract(high_m, low_m))


def plain_log(axes: Axes, along: Literal["x", "y"], low: float, high: float) -> None:
    """Make an axis logarithmic from low to high, with plain numbers and always some of them.

    Args:
        axes: to change.
        along: which axis.
        low, high: its ends.
    """
    (axes.set_xscale if along == "x" else axes.set_yscale)("log")
    (axes.set_xlim if along == "x" else axes.set_ylim)(low, high)
    axis = axes.xaxis if along == "x" else axes.yaxis
    subs = (1.0,) if high / low > _TWO_DECADES else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_points(axes: Axes, x: ArrayLike, y: ArrayLike, **look: Any) -> None:
    """Draw points, as an image where there are more than 300, so that files stay light."""
    drawn: dict[str, Any] = {"linestyle": "none", "rasterized": np.size(x) > _MOST_POINTS}
    axes.plot(x, y, **(drawn | look))


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return so many rows of a count, at most, spread evenly over it."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def write_text_at(figure: Figure, x_mm: float, y_mm: float, text: str, **options: Any) -> None:
    """Write text into the figure, placed in millimetres from the lower left."""
    figure.text(x_mm / WIDTH_MM, y_mm / height_of(figure), text, **options)


def note(figure: Figure, text: str, y_mm: float = 6.0, **options: Any) -> None:
    """Write a note at the lower left of a figure, above its footer."""
    write_text_at(figure, 2.0, y_mm, text, **options)


def mark(label: str, **look: Any) -> Line2D:
    """Return an entry of a legend that shows a marker."""
    return Line2D([], [], label=label, **{"linestyle": "none", **look})


def legend_at(
    figure: Figure, x_mm: float, y_mm: float, handles: Sequence[Artist], **options: Any
) -> None:
    """Put a legend into the figure, its lower left corner in millimetres from the lower left."""
    corner = (x_mm / WIDTH_MM, y_mm / height_of(figure))
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=corner, **options)


def name_columns(
    axes: Axes, names: Sequence[str], at: Sequence[float] | None = None, **options: Any
) -> None:
    """Name columns in place of an axis of numbers; they stand at 0, 1, 2, … unless told."""
    axes.set_xticks(range(len(names)) if at is None else at, names, **options)
    axes.tick_params(axis="x", length=0.0, which="both")
    axes.grid(visible=False, axis="x")


def name_rows(axes: Axes, names: Sequence[str], room: float = 0.5, *, lines: bool = True) -> None:
    """Let rows run downward from 0, each with its name.

    Args:
        axes: to change.
        names: of the rows.
        room: above the first and below the last.
        lines: whether the grid has a line a row.
    """
    axes.set_ylim(len(names) - 1.0 + room, -room)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0.0)
    if not lines:
        axes.grid(visible=False, axis="y")


def write_beside(axes: Axes, y: float, text: str, x: float = 1.02, **options: Any) -> None:
    """Write text level with a row, at a part of the width of the axes: right of them above 1."""
    axes.text(x, y, text, transform=axes.get_yaxis_transform(), va="center", **options)


def write_figure(figure: Figure, footer: str, folder: Path, name: str, png_dpi: int) -> None:
    """Write a figure as SVG, PDF and PNG with a footer: all three or none.

    A footer of several lines hangs below the figure and a title of several stands above it: the
    figure grows by them.
    """
    lines = wrap(footer, _FOOTER_LETTERS)
    below_mm = _LINE_MM * (len(lines) - 1)
    above_mm = _LINE_MM * figure.get_suptitle().count("\n")
    for k, line in enumerate(lines):
        y_mm = _FOOTER_MM - k * _LINE_MM
        write_text_at(figure, 2.0, y_mm, line, ha="left", va="bottom", color=GREY)
    width, height = figure.get_size_inches()
    area = None
    if below_mm or above_mm:
        area = Bbox([[0.0, -below_mm / _MM_PER_INCH], [width, height + above_mm / _MM_PER_INCH]])
    with ExitStack() as stack:
        for ending, metadata in _METADATA.items():
            path = stack.enter_context(whole_file(folder / f"{name}.{ending}"))
            figure.savefig(path, format=ending, metadata=metadata, dpi=png_dpi, bbox_inches=area)
