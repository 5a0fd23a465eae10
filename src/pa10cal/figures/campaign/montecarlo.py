"""The Monte Carlo in pictures: errors by plane, and over each plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator

from pa10cal.figures import published
from pa10cal.figures.registry import picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import PAPER, new_figure, note, panel
from pa10cal.reports.theme import BLACK, BLUE, GREEN, GREY, SKY
from pa10cal.results.studies import PlaneRecord

_ASIDE_MM = 18.0


@picture(
    title="Monte Carlo: error by plane",
    needs=("planes",),
    section="trust",
    caption="""
Position error caused by the stated resolver uncertainty alone, in horizontal planes, for the
nominal arm. Left, the mean over all positions and draws with the standard deviation within a
position, beside the paper's value. Right, the means enlarged: bars are 95 % intervals for the
choice of positions, crosses the expectation from the Jacobian, which needs no draws. The paper
calls this the lower bound of calibration. However, a resolver repeats its error whenever a
joint returns to an angle, so a calibration can in principle remove it: it is a bound in the
paper's sense only. No measurement is used here.
""",
)
def draw_montecarlo_planes(results: Results) -> Figure:
    """Draw the mean with the spread within a position, and the mean alone enlarged."""
    planes = results.planes()
    first = planes[0]
    figure = new_figure(103.0, "Position error that resolver uncertainty alone causes, by plane")
    spread = panel(figure, 18.0, 42.0, 64.0, 50.0)
    enlarged = panel(figure, 104.0, 42.0, 63.0, 50.0)
    _draw_spread(spread, planes, results.is_paper_arm)
    _draw_means(enlarged, planes, results.is_paper_arm)
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.155), ncols=2)
    note(
        figure,
        f"Nominal arm; σ = {first.sigma_deg:g}° at every joint; {first.positions} positions, "
        f"{first.cycles} draws at each,\n"
        f"at {first.reach_m[0]:g} to {first.reach_m[1]:g} m from the base axis. "
        "No measurement enters.",
        6.5,
    )
    return figure


def _draw_spread(axes: Axes, planes: list[PlaneRecord], with_paper: bool) -> None:
    _draw_mean(
        axes,
        planes,
        [plane.std_mm for plane in planes],
        label="mean ± standard deviation within a position",
    )
    if with_paper:
        axes.errorbar(
            published.MONTE_CARLO_PLANE_MM + _ASIDE_MM,
            published.MONTE_CARLO_MEAN_MM,
            yerr=published.MONTE_CARLO_STD_MM,
            linestyle="none",
            capsize=3.0,
            label="the paper, z = 500 mm",
            **PAPER,
        )
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("position error [mm]")
    _name_planes(axes, planes)


def _draw_means(axes: Axes, planes: list[PlaneRecord], with_paper: bool) -> None:
    _draw_mean(
        axes,
        planes,
        [plane.half_width95_positions_mm for plane in planes],
        ecolor=SKY,
        label="mean, 95 % interval for the choice of positions",
    )
    axes.plot(
        [plane.plane_mm for plane in planes],
        [plane.closed_form_mean_mm for plane in planes],
        color=GREEN,
        marker="x",
        markersize=6.0,
        linestyle="none",
        label="closed form from the Jacobian, same positions",
    )
    if with_paper:
        mean_mm, apart_mm = published.MONTE_CARLO_MEAN_MM, published.MONTE_CARLO_PLANES_DIFFER_MM
        axes.fill_between(
            published.MONTE_CARLO_PARALLEL_PLANES_MM,
            mean_mm - apart_mm,
            mean_mm + apart_mm,
            color=GREY,
            alpha=0.35,
            linewidth=0.0,
            label="the paper, z = 300 to 700 mm (± 0.001 mm)",
        )
        axes.plot(published.MONTE_CARLO_PLANE_MM + _ASIDE_MM, mean_mm, **PAPER)
    axes.set(title="the means, enlarged", ylabel="mean position error [mm]")
    _name_planes(axes, planes)


def _draw_mean(axes: Axes, planes: list[PlaneRecord], half_mm: list[float], **look: Any) -> None:
    look |= {"color": BLUE, "marker": "o", "linestyle": "none", "capsize": 3.0}
    z_mm, mean_mm = zip(*((plane.plane_mm, plane.mean_mm) for plane in planes), strict=True)
    axes.errorbar(z_mm, mean_mm, yerr=half_mm, **look)


def _name_planes(axes: Axes, planes: list[PlaneRecord]) -> None:
    axes.set_xticks([plane.plane_mm for plane in planes])
    axes.set_xlim(planes[0].plane_mm - 60.0, planes[-1].plane_mm + 60.0)
    axes.set_xlabel("height z of the plane above the base [mm]")


# The expected error from resolver uncertainty over each plane.

_COLUMNS = 3
_COLOURS = "cividis"
_SIZE_MM = 47.0
_APART_MM = 4.0
_TITLE_ROOM_MM = 8.0
_BELOW_MM = 36.0


@picture(
    title="Monte Carlo: map of the error over the plane",
    needs=("planes",),
    section="trust",
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
def draw_montecarlo_map(results: Results) -> Figure:
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
    note(
        figure,
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
