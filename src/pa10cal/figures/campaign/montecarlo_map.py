"""The expected error from resolver uncertainty over each plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLACK, new_figure, panel, write_text_at
from pa10cal.results.montecarlo import PlaneRecord

PICTURE = Picture(
    title="Monte Carlo: map of the error over the plane",
    needs=("planes",),
    caption="""
Expected position error caused by resolver uncertainty over each plane, from the closed form, in
one colour scale for all planes. The circles bound the requested reach. Where the ring is white,
no posture within the joint limits reaches the point with the flange pointing down. The error
grows with the distance from the base, because the first joints act over a longer arm. The mean
is over the grid of the map; other Monte Carlo pictures use positions drawn at random in the
same plane, so the two differ a little. Only the nominal arm is used: the maps of all campaigns
of one arm are the same.
""",
)

_COLUMNS = 3
_COLOURS = "cividis"
_SIZE_MM = 47.0
_APART_MM = 4.0
_TITLE_ROOM_MM = 8.0
_BELOW_MM = 36.0


def draw(results: Results) -> Figure:
    """Draw the closed-form mean on the grid of every plane, in common colours."""
    planes = results.planes()
    rows = -(-len(planes) // _COLUMNS)
    height = _BELOW_MM + rows * (_SIZE_MM + _TITLE_ROOM_MM) + 8.0
    figure = new_figure(height, "Expected position error from resolver uncertainty alone")
    values = np.concatenate([plane.map.rows[:, 2] for plane in planes])
    limits = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    for k, plane in enumerate(planes):
        row, column = divmod(k, _COLUMNS)
        left = 18.0 + column * (_SIZE_MM + _APART_MM)
        bottom = height - 8.0 - (row + 1) * (_SIZE_MM + _TITLE_ROOM_MM)
        axes = panel(figure, left, bottom, _SIZE_MM, _SIZE_MM)
        _draw_ring(axes, plane)
        if len(plane.map.rows):
            _draw_map(axes, plane, limits)
        else:
            axes.set_title(f"z = {plane.plane_mm} mm")
            axes.text(0.5, 0.6, "no grid point in reach", transform=axes.transAxes, ha="center")
        axes.tick_params(labelleft=column == 0, labelbottom=k + _COLUMNS >= len(planes))
        if column == 0:
            axes.set_ylabel("y [mm]")
        if k + _COLUMNS >= len(planes):
            axes.set_xlabel("x [mm]")
    bar = panel(figure, 30.0, 17.0, 110.0, 3.0)
    figure.colorbar(ScalarMappable(Normalize(*limits), _COLOURS), cax=bar, orientation="horizontal")
    bar.set_title("mean position error [mm]")
    bar.grid(visible=False)
    write_text_at(
        figure,
        2.0,
        6.0,
        "Circles: requested reach. White between them: no posture within the joint limits.",
    )
    return figure


def _draw_ring(axes: Axes, plane: PlaneRecord) -> None:
    """Draw the circles of the requested reach, and the base."""
    for reach_m in plane.reach_m:
        axes.add_patch(Circle((0.0, 0.0), 1e3 * reach_m, fill=False, linewidth=0.6))
    axes.plot(0.0, 0.0, color=BLACK, marker="s")
    limit = 1.08e3 * plane.reach_m[1]
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.xaxis.set_major_locator(MultipleLocator(500.0))
    axes.yaxis.set_major_locator(MultipleLocator(500.0))


def _draw_map(axes: Axes, plane: PlaneRecord, limits: tuple[float, float]) -> None:
    """Draw the map of one plane, its colours between limits, within what the axes show."""
    spacing = plane.map.spacing_mm
    points = plane.map.rows
    index = np.round(points[:, :2] / spacing).astype(int)
    low = index.min(axis=0)
    shape = index.max(axis=0) - low + 1
    grid = np.full(shape[::-1], np.nan)
    grid[index[:, 1] - low[1], index[:, 0] - low[0]] = points[:, 2]
    left, bottom = spacing * (low - 0.5)
    right, top = spacing * (low + shape - 0.5)
    window = axes.axis()
    axes.imshow(
        np.ma.masked_invalid(grid),
        extent=(left, right, bottom, top),
        origin="lower",
        interpolation="nearest",
        cmap=_COLOURS,
        vmin=limits[0],
        vmax=limits[1],
    )
    axes.axis(window)
    axes.set_title(f"z = {plane.plane_mm} mm: mean {points[:, 2].mean():.3f} mm")
