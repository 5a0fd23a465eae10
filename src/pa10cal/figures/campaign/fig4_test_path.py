"""The experimental test path in the base frame, as Fig. 4 of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from pa10cal.arrays import Array
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import PLACE_MM, Results
from pa10cal.figures.style import BLACK, BLUE, GREEN, ORANGE, VERMILLION, new_figure, panel

PICTURE = Picture(
    title="Fig. 4: test path",
    needs=("papers_calibration", "poses", "base_frame"),
    caption="""
Where the arm was measured in ``{name}``, in the robot's base frame (Fig. 4 of the paper). Blue:
calibration poses, joined in the order measured. Red triangles: held-out poses, which no fit
uses; some lie outside the calibrated volume. Green and orange: the two straight moves along the
x and y axes of the robot, from which the base frame is first estimated. Every position was
measured in the instrument's frame and transformed with that estimate. The picture therefore
shows where the arm went, not how accurate it was.
""",
)


_GRID: dict[str, Any] = {"color": BLUE, "marker": "o", "linewidth": 0.8}
_HELD_OUT: dict[str, Any] = {"color": VERMILLION, "marker": "^", "linestyle": "none"}
_LINES: dict[str, dict[str, Any]] = {
    "line_x": {"color": GREEN, "marker": ".", "linewidth": 1.4},
    "line_y": {"color": ORANGE, "marker": ".", "linewidth": 1.4},
}
_AXIS_LENGTH_MM = 150.0
_MARGIN_MM = 60.0


@dataclass(frozen=True)
class _Path:
    """Places [mm] in the base frame: each (N, 3), in order of measurement."""

    grid: Array
    held_out: Array
    lines: dict[str, Array]

    @property
    def every(self) -> Array:
        return np.vstack([self.grid, self.held_out, *self.lines.values()])


def draw(results: Results) -> Figure:
    """Draw the first pass over the grid, the held-out places and the straight-line moves."""
    path = _path(results.places(), results.base_frame())
    figure = new_figure(
        128.0, "Experimental test path in the robot's base frame (compare Fig. 4 of the paper)"
    )
    space = panel(figure, 2.0, 29.0, 110.0, 94.0, projection="3d")
    _draw_space(space, path)
    _draw_view(panel(figure, 119.0, 76.0, 48.0, 38.0), path, (0, 1), "From above")
    _draw_view(panel(figure, 119.0, 15.0, 48.0, 46.0), path, (0, 2), "From the side")
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.055), ncols=2)
    return figure


def _path(poses: pd.DataFrame, T_instr_base: Array) -> _Path:
    """Carry the places to the base frame: the first visit of each pose, as the arm came by."""

    def first_visits(kind: str) -> Array:
        first = poses[poses["kind"] == kind].drop_duplicates("pose")
        p_instr_mm = first[list(PLACE_MM)].to_numpy()
        return np.asarray((p_instr_mm - 1e3 * T_instr_base[:3, 3]) @ T_instr_base[:3, :3])

    return _Path(
        grid=first_visits("grid"),
        held_out=first_visits("holdout"),
        lines={kind: first_visits(kind) for kind in _LINES},
    )


def _draw_space(axes: Any, path: _Path) -> None:
    axes.plot(*path.grid.T, label=f"{len(path.grid)} calibration poses, as measured", **_GRID)
    if len(path.held_out):
        axes.plot(*path.held_out.T, label=f"{len(path.held_out)} held-out poses", **_HELD_OUT)
    for kind, places in path.lines.items():
        if len(places):
            axes.plot(*places.T, label=f"straight move along {kind[-1]}", **_LINES[kind])
    axes.text(*path.grid[0], "first ", ha="right", va="center", color=BLUE)
    axes.text(*path.grid[-1], " last", ha="left", va="center", color=BLUE)
    for k, name in enumerate("xyz"):
        tip = np.zeros(3)
        tip[k] = _AXIS_LENGTH_MM
        axes.quiver(0, 0, 0, *tip, color=BLACK, linewidth=1.2, arrow_length_ratio=0.15)
        axes.text(*(1.25 * tip), name, ha="center", va="center")
    axes.plot([0.0], [0.0], [0.0], color=BLACK, marker="s", linestyle="none", label="robot base")
    low, high = _extent(path.every)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.05)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    # On the left, where no panel stands beside it.
    axes.zaxis.set_ticks_position("lower")
    axes.zaxis.set_label_position("lower")
    axes.zaxis.set_rotate_label(False)
    axes.zaxis.label.set_rotation(90.0)
    axes.view_init(elev=20.0, azim=-52.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MultipleLocator(200.0))


def _draw_view(axes: Axes, path: _Path, seen: tuple[int, int], title: str) -> None:
    """Draw a projection along one of the base axes."""
    columns = list(seen)
    axes.plot(*path.grid[:, columns].T, **_GRID | {"markersize": 2.5, "linewidth": 0.6})
    axes.plot(*path.held_out[:, columns].T, **_HELD_OUT)
    for kind, places in path.lines.items():
        axes.plot(*places[:, columns].T, **_LINES[kind] | {"markersize": 2.0})
    axes.plot(0.0, 0.0, color=BLACK, marker="s")
    axes.annotate("base", (0.0, 0.0), (4.0, 4.0), textcoords="offset points")
    low, high = _extent(path.every)
    axes.set(xlim=(low[seen[0]], high[seen[0]]), ylim=(low[seen[1]], high[seen[1]]))
    axes.set_aspect("equal", adjustable="box", anchor="SW")
    axes.xaxis.set_major_locator(MultipleLocator(200.0))
    axes.yaxis.set_major_locator(MultipleLocator(200.0))
    axes.set_title(title)
    axes.set(xlabel=f"{'xyz'[seen[0]]} [mm]", ylabel=f"{'xyz'[seen[1]]} [mm]")


def _extent(places: Array) -> tuple[Array, Array]:
    """Return the corners of the box that holds all places and the base with its axes."""
    low = np.minimum(places.min(axis=0), 0.0) - _MARGIN_MM
    return low, np.maximum(places.max(axis=0), _AXIS_LENGTH_MM) + _MARGIN_MM
