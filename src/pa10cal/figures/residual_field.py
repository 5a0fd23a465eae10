"""Residual vectors in space before and after the effects joined the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pa10cal.figures.discovery_records import Configuration
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLACK, BLUE, ORANGE, WIDTH_MM, height_of, new_figure, panel

Array = NDArray[np.float64]

_LONGEST_ARROW_MM = 220.0
_MARGIN_MM = 20.0
_PANEL_MM = 70.0
_BELOW_MM, _BETWEEN_MM, _ABOVE_MM = 26.0, 10.0, 18.0
_VIEWS = (("seen from above", (0, 1)), ("seen from the side", (0, 2)))
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}


@dataclass(frozen=True)
class _Arrows:
    """Arrows from (N, 3) places [mm] by (N, 3) vectors [mm], and how they look."""

    place_mm: Array
    before_mm: Array
    after_mm: Array
    look: dict[str, Any]


def draw(results: Results) -> Figure:
    """Draw arrows from predicted to measured positions: before left, after right."""
    found = results.analysis().gap
    sets = [_arrows(found.train, _TRAIN)]
    if found.holdout:
        sets.append(_arrows(found.holdout, _HELD_OUT))
    vectors = np.vstack([v for arrows in sets for v in (arrows.before_mm, arrows.after_mm)])
    longest = float(np.linalg.norm(vectors, axis=1).max())
    scale = _round_down(_LONGEST_ARROW_MM / longest)
    places = np.vstack([arrows.place_mm for arrows in sets for _ in range(2)])
    ends = np.vstack([places, places + scale * vectors])
    low, high = ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM
    tall_mm = _PANEL_MM / (high[0] - low[0]) * (high - low)
    top = _BELOW_MM + tall_mm[2] + _BETWEEN_MM
    figure = new_figure(
        top + tall_mm[1] + _ABOVE_MM,
        "Position error in space: from the predicted to the measured place",
    )
    for column, when in enumerate(("before", "after")):
        for (title, shown), bottom in zip(_VIEWS, (top, _BELOW_MM), strict=True):
            up = shown[1]
            axes = panel(figure, 16.0 + 78.0 * column, bottom, _PANEL_MM, tall_mm[up])
            arrows = _draw_view(axes, sets, when, shown, scale)
            axes.set(xlim=(low[0], high[0]), ylim=(low[up], high[up]))
            axes.set_title(f"{when}, {title}")
            axes.set_ylabel("" if column else f"{'xyz'[up]} [mm]")
            axes.tick_params(labelleft=not column, labelbottom=bottom == _BELOW_MM)
        axes.set_xlabel("x [mm]")
    key_mm = _round_down(longest)
    axes.quiverkey(
        arrows,
        0.64,
        1.0 - 7.5 / height_of(figure),
        scale * key_mm,
        f"{key_mm:g} mm, enlarged {scale:g} times",
        labelpos="E",
        coordinates="figure",
        color=BLACK,
    )
    _draw_legend(figure, sets)
    return figure


def _arrows(rows: tuple[Configuration, ...], look: dict[str, Any]) -> _Arrows:
    """Return the arrows of configurations; they are the opposite of the residuals."""
    return _Arrows(
        np.array([row.place_mm for row in rows]),
        -np.array([row.before_mm for row in rows]),
        -np.array([row.after_mm for row in rows]),
        look,
    )


def _draw_view(
    axes: Axes, sets: list[_Arrows], when: str, shown: tuple[int, int], scale: float
) -> Quiver:
    columns = list(shown)
    for arrows in sets:
        vector_mm = arrows.before_mm if when == "before" else arrows.after_mm
        place = arrows.place_mm[:, columns].T
        axes.plot(*place, markersize=2.0, linestyle="none", **arrows.look)
        drawn = axes.quiver(
            *place,
            *(scale * vector_mm[:, columns].T),
            color=arrows.look["color"],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.005,
        )
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return drawn


def _draw_legend(figure: Figure, sets: list[_Arrows]) -> None:
    names = ("poses fitted, every load", "held-out poses, every load")
    handles = [
        Line2D([], [], linestyle="none", label=_label(name, arrows), **arrows.look)
        for name, arrows in zip(names, sets, strict=False)
    ]
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(16.0 / WIDTH_MM, 6.0 / height_of(figure))
    )


def _label(name: str, arrows: _Arrows) -> str:
    mean = [np.linalg.norm(v, axis=1).mean() for v in (arrows.before_mm, arrows.after_mm)]
    return f"{name}: mean {mean[0]:.3f} mm before, {mean[1]:.3f} mm after"


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 3 and 5 times a power of ten that is not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    steps = (1.0, 2.0, 3.0, 5.0)
    return float(power * max(step for step in steps if step * power <= value * 1.000001))
