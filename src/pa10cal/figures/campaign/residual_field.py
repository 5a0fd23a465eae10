"""Residual vectors in space, before and after effects joined the model where there are any."""

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

from pa10cal.arrays import Array
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    evenly,
    height_of,
    legend_at,
    new_figure,
    panel,
    round_down,
    write_text_at,
)
from pa10cal.results.accuracy import ResidualRows
from pa10cal.results.analysis import GapRows

PICTURE = Picture(
    title="Gap: residual vectors before and after",
    needs=("gap",),
    caption="""
Arrows from predicted to measured positions in ``{name}``, equally enlarged left, before, and
right, after the named effects were added; above seen from above, below from the side, along the
base axes of the robot. Without a search for effects, both views show the calibrated model. Blue:
fitted poses, each load by itself; orange: held-out poses; grey: held-out poses beyond the joint
angles of the fit, extrapolated. Of thousands of poses an even selection is drawn. Arrows that
agree from load to load, or turn steadily from place to place, show an effect that the model
lacks; the arrows on the right should be short and have no common direction.
""",
)


#: The longest arrow, at least, and as a part of what the places span.
_LONGEST_ARROW_MM, _LONGEST_PART = 220.0, 0.15
#: Of more poses only about so many are drawn, evenly over the record, and some of every set.
_MOST_ARROWS, _LEAST_ARROWS = 240, 40
_MARGIN_MM = 20.0
#: How wide a panel is and how far apart they begin; views side by side have an axis each.
_PANEL_MM, _APART_MM = 70.0, 78.0
_ALONE_MM, _ALONE_APART_MM = 63.0, 83.0
_BELOW_MM, _SAID_MM, _BETWEEN_MM, _ABOVE_MM = 22.5, 4.4, 10.0, 18.0
_SAME_SCALE = (
    "Arrows before and after have the same scale; an arrow shorter than its marker is hidden by it."
)
_VIEWS = (("seen from above", (0, 1)), ("seen from the side", (0, 2)))
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_BEYOND: dict[str, Any] = {"color": GREY, "marker": "s"}


@dataclass(frozen=True)
class _Arrows:
    """Arrows from (N, 3) places [mm]."""

    name: str  # what the poses are
    place_mm: Array  # where each begins
    vector_mm: dict[str, Array]  # (N, 3) arrows [mm] by what the model is: `before`, `after`
    look: dict[str, Any]

    def drawn(self, share: float) -> _Arrows:
        """Return a share of them."""
        most = max(round(share * len(self.place_mm)), _LEAST_ARROWS)
        rows = evenly(len(self.place_mm), most)
        vectors = {when: vector_mm[rows] for when, vector_mm in self.vector_mm.items()}
        return _Arrows(self.name, self.place_mm[rows], vectors, self.look)


def draw(results: Results) -> Figure:
    """Draw arrows from predicted to measured positions: before left, after right."""
    every = _sets(results)
    share = min(_MOST_ARROWS / sum(len(arrows.place_mm) for arrows in every), 1.0)
    sets = [arrows.drawn(share) for arrows in every]
    columns = list(sets[0].vector_mm)
    vectors = np.vstack([v for arrows in sets for v in arrows.vector_mm.values()])
    places = np.vstack([arrows.place_mm for arrows in sets for _ in columns])
    longest = float(np.linalg.norm(vectors, axis=1).max())
    reach_mm = max(_LONGEST_ARROW_MM, _LONGEST_PART * float(np.ptp(places, axis=0).max()))
    scale = round_down(reach_mm / longest)
    ends = np.vstack([places, places + scale * vectors])
    low, high = ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM
    alone = len(columns) == 1  # then the views stand side by side, else one below the other
    if alone:  # and as tall as each other
        middle, half = (low + high) / 2.0, (high - low)[1:].max() / 2.0
        low[1:], high[1:] = middle[1:] - half, middle[1:] + half
    wide_mm, apart_mm = (_ALONE_MM, _ALONE_APART_MM) if alone else (_PANEL_MM, _APART_MM)
    tall_mm = wide_mm / (high[0] - low[0]) * (high - low)
    below = _BELOW_MM + _SAID_MM * len(sets)
    top = below + (0.0 if alone else tall_mm[2] + _BETWEEN_MM)
    figure = new_figure(
        top + tall_mm[1] + _ABOVE_MM,
        "Position error in space: from the predicted to the measured position",
    )
    for k, when in enumerate(columns):
        for row, (title, shown) in enumerate(_VIEWS):
            column, bottom = (row, top) if alone else (k, below if row else top)
            up = shown[1]
            axes = panel(figure, 18.0 + apart_mm * column, bottom, wide_mm, tall_mm[up])
            arrows = _draw_view(axes, sets, when, shown, scale)
            axes.set(xlim=(low[0], high[0]), ylim=(low[up], high[up]))
            axes.set_title(f"{when}, {title}")
            axes.set_ylabel(f"{'xyz'[up]} [mm]" if alone or not column else "")
            axes.tick_params(labelleft=alone or not column, labelbottom=bottom == below)
            if bottom == below:
                axes.set_xlabel("x [mm]")
    key_mm = round_down(longest)
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
    _draw_legend(figure, every, sets)
    note = results.words.arrows if alone else _SAME_SCALE
    write_text_at(figure, 2.0, 6.0, note, color=GREY)
    return figure


def _sets(results: Results) -> list[_Arrows]:
    """Return the arrows of the poses fitted and held out; before alone where none is after."""
    if not results.has_gap:
        return [_calibrated(results.any_calibration().residuals)]
    found = results.analysis().gap
    every = np.ones(len(found.train), dtype=bool)
    sets = [_before_and_after("poses fitted", found.train, every, _TRAIN)]
    if found.holdout is not None:
        beyond = found.holdout.extrapolated
        if beyond is None:
            beyond = np.zeros(len(found.holdout), dtype=bool)
        sets += [
            _before_and_after(name, found.holdout, rows, look)
            for name, rows, look in (
                ("held-out poses", ~beyond, _HELD_OUT),
                ("held out, extrapolated", beyond, _BEYOND),
            )
            if rows.any()
        ]
    return sets


def _before_and_after(
    name: str, found: GapRows, rows: NDArray[np.bool_], look: dict[str, Any]
) -> _Arrows:
    """Return the arrows of configurations; they are the opposite of the residuals."""
    vectors = {"before": -found.before_mm[rows], "after": -found.after_mm[rows]}
    return _Arrows(name, found.place_mm[rows], vectors, look)


def _calibrated(rows: ResidualRows) -> _Arrows:
    return _Arrows("poses fitted", rows.place_mm, {"calibrated": -rows.position_mm}, _TRAIN)


def _draw_view(
    axes: Axes, sets: list[_Arrows], when: str, shown: tuple[int, int], scale: float
) -> Quiver:
    columns = list(shown)
    for arrows in sets:
        place = arrows.place_mm[:, columns].T
        axes.plot(*place, markersize=2.0, linestyle="none", **arrows.look)
        drawn = axes.quiver(
            *place,
            *(scale * arrows.vector_mm[when][:, columns].T),
            color=arrows.look["color"],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.005,
        )
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return drawn


def _draw_legend(figure: Figure, every: list[_Arrows], sets: list[_Arrows]) -> None:
    handles = [
        Line2D([], [], linestyle="none", label=_label(arrows, shown), **arrows.look)
        for arrows, shown in zip(every, sets, strict=True)
    ]
    legend_at(figure, 16.0, 10.5, handles)


def _label(arrows: _Arrows, shown: _Arrows) -> str:
    means = [
        f"{np.linalg.norm(vector_mm, axis=1).mean():.3f} mm {when}"
        for when, vector_mm in arrows.vector_mm.items()
    ]
    text = f"{arrows.name}, every load: mean length {', '.join(means)}"
    total, some = len(arrows.place_mm), len(shown.place_mm)
    return text if some == total else f"{text}; {some} of {total} drawn"
