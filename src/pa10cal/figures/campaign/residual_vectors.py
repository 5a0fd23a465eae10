"""Remaining position error after calibration, as arrows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from matplotlib.ticker import MultipleLocator

from pa10cal.arrays import Array
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLACK, BLUE, ORANGE, new_figure, panel, round_down, write_text_at
from pa10cal.results.accuracy import ResidualRows

PICTURE = Picture(
    title="Residual vectors in space",
    needs=("papers_calibration",),
    caption="""
Remaining position error of ``{name}`` after calibration with all loads together. Each arrow
points from the predicted to the measured position of the end-effector, enlarged by the factor
stated in the picture, in space and seen from above and from the side. If the model describes
the arm completely, the arrows are short and have no common direction: noise. Long arrows that
repeat from load to load, or that turn steadily from pose to pose, show an effect that the model
lacks, even where the mean error looks small.
""",
)


_LONGEST_ARROW_MM = 140.0
_MARGIN_MM = 25.0
_GRID_LINES = 2.5


@dataclass(frozen=True)
class _View:
    """A projection along one of the base axes: which it shows, and which its colours show."""

    title: str
    shown: tuple[int, int]
    hidden: int


_VIEWS = (
    _View("From above; the brighter an arrow, the higher it lies", (0, 1), 2),
    _View("From the side; the brighter an arrow, the larger its y", (0, 2), 1),
)


@dataclass(frozen=True)
class _Frame:
    """The box (3,) to (3,) that all panels show [mm], and how much arrows are enlarged."""

    low_mm: Array
    high_mm: Array
    scale: float

    @property
    def grid_mm(self) -> float:
        return round_down(float(np.min(self.high_mm - self.low_mm)) / _GRID_LINES)


@dataclass(frozen=True)
class _Arrows:
    """Arrows at one load: from (N, 3) places, the predicted positions, by (N, 3) vectors [mm]."""

    load_N: float
    place_mm: Array
    vector_mm: Array

    @property
    def length_mm(self) -> Array:
        return np.asarray(np.linalg.norm(self.vector_mm, axis=1))


def draw(results: Results) -> Figure:
    """Draw arrows from predicted to measured positions of the combined calibration."""
    cases = _by_load(results.calibration().residuals)
    longest = max(float(case.length_mm.max()) for case in cases)
    frame = _frame(cases, round_down(_LONGEST_ARROW_MM / longest))
    figure = new_figure(
        190.0,
        "Remaining position error after calibration: from the predicted to the measured position",
    )
    width = 154.0 / len(cases)
    for k, case in enumerate(cases):
        left = 15.0 + k * width
        space = panel(figure, left - 12.0, 116.0, width + 6.0, 58.0, projection="3d")
        _draw_space(space, case, frame)
        write_text_at(
            figure,
            left,
            175.0,
            f"{case.load_N:g} N\nmean {case.length_mm.mean():.3f}, "
            f"peak {case.length_mm.max():.3f} mm",
            va="top",
        )
        for view, bottom in zip(_VIEWS, (70.0, 17.0), strict=True):
            axes = panel(figure, left, bottom, width - 7.0, 38.0)
            arrows = _draw_view(axes, case, view, frame)
            if k == 0:
                axes.set_title(view.title)
            else:
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
    key_mm = round_down(longest)
    axes.quiverkey(
        arrows,
        0.09,
        0.945,
        frame.scale * key_mm,
        f"this arrow: {key_mm:g} mm; all arrows are enlarged {frame.scale:g} times, "
        f"grid lines are {frame.grid_mm:g} mm apart",
        labelpos="E",
        coordinates="figure",
        color=BLACK,
    )
    return figure


def _by_load(residuals: ResidualRows) -> list[_Arrows]:
    """Return the arrows load by load; they are the opposite of the residuals."""
    load_N = residuals.load_N
    return [
        _Arrows(
            float(load), residuals.place_mm[load_N == load], -residuals.position_mm[load_N == load]
        )
        for load in np.unique(load_N)
    ]


def _frame(cases: list[_Arrows], scale: float) -> _Frame:
    """Return the box that holds every place and every tip."""
    places = np.vstack([case.place_mm for case in cases])
    tips = places + scale * np.vstack([case.vector_mm for case in cases])
    ends = np.vstack([places, tips])
    return _Frame(ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM, scale)


def _draw_space(axes: Any, case: _Arrows, frame: _Frame) -> None:
    axes.plot(*case.place_mm.T, color=ORANGE, marker="o", markersize=2.0, linestyle="none")
    axes.quiver(
        *case.place_mm.T,
        *(frame.scale * case.vector_mm).T,
        color=BLUE,
        linewidth=0.9,
        arrow_length_ratio=0.3,
    )
    low, high = frame.low_mm, frame.high_mm
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.0)
    axes.patch.set_visible(False)  # it would hide what its neighbour draws beyond its frame
    axes.view_init(elev=20.0, azim=-52.0)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MultipleLocator(frame.grid_mm))
        axis.set_ticklabels([])
        axis.labelpad = -14.0


def _draw_view(axes: Axes, case: _Arrows, view: _View, frame: _Frame) -> Quiver:
    columns = list(view.shown)
    place, vector = case.place_mm[:, columns].T, frame.scale * case.vector_mm[:, columns].T
    axes.plot(*place, color=ORANGE, marker="o", markersize=2.0, linestyle="none")
    arrows = axes.quiver(
        *place,
        *vector,
        case.place_mm[:, view.hidden],
        cmap="viridis",
        clim=(frame.low_mm[view.hidden], frame.high_mm[view.hidden]),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.008,
    )
    across, up = view.shown
    axes.set(
        xlim=(frame.low_mm[across], frame.high_mm[across]),
        ylim=(frame.low_mm[up], frame.high_mm[up]),
    )
    axes.set_aspect("equal", adjustable="box", anchor="SW")
    axes.xaxis.set_major_locator(MultipleLocator(frame.grid_mm))
    axes.yaxis.set_major_locator(MultipleLocator(frame.grid_mm))
    axes.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]")
    return arrows
