"""Position error from resolver uncertainty alone, plane by plane."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures import published
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLUE, GREEN, GREY, PAPER, SKY, new_figure, panel, write_text_at
from pa10cal.results.montecarlo import PlaneRecord

PICTURE = Picture(
    title="Monte Carlo: error by plane",
    needs=("planes",),
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

_ASIDE_MM = 18.0


def draw(results: Results) -> Figure:
    """Draw the mean with the spread within a position, and the mean alone enlarged."""
    planes = results.planes()
    first = planes[0]
    figure = new_figure(103.0, "Position error that resolver uncertainty alone causes, by plane")
    spread = panel(figure, 18.0, 42.0, 64.0, 50.0)
    enlarged = panel(figure, 104.0, 42.0, 63.0, 50.0)
    _draw_spread(spread, planes, results.is_paper_arm)
    _draw_means(enlarged, planes, results.is_paper_arm)
    handles = dict(zip(*reversed(spread.get_legend_handles_labels()), strict=True))
    handles |= dict(zip(*reversed(enlarged.get_legend_handles_labels()), strict=True))
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="lower left",
        bbox_to_anchor=(0.012, 0.155),
        ncols=2,
    )
    write_text_at(
        figure,
        2.0,
        6.5,
        f"Nominal arm; σ = {first.sigma_deg:g}° at every joint; {first.positions} positions, "
        f"{first.cycles} draws at each,\n"
        f"at {first.reach_m[0]:g} to {first.reach_m[1]:g} m from the base axis. "
        "No measurement enters.",
    )
    return figure


def _draw_spread(axes: Axes, planes: list[PlaneRecord], with_paper: bool) -> None:
    axes.errorbar(
        [plane.plane_mm for plane in planes],
        [plane.mean_mm for plane in planes],
        yerr=[plane.std_mm for plane in planes],
        color=BLUE,
        marker="o",
        linestyle="none",
        capsize=3.0,
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
    z_mm = [plane.plane_mm for plane in planes]
    axes.errorbar(
        z_mm,
        [plane.mean_mm for plane in planes],
        yerr=[plane.half_width95_positions_mm for plane in planes],
        color=BLUE,
        marker="o",
        linestyle="none",
        capsize=3.0,
        ecolor=SKY,
        label="mean, 95 % interval for the choice of positions",
    )
    axes.plot(
        z_mm,
        [plane.closed_form_mean_mm for plane in planes],
        color=GREEN,
        marker="x",
        markersize=6.0,
        linestyle="none",
        label="closed form from the Jacobian, same positions",
    )
    if with_paper:
        across = published.MONTE_CARLO_PARALLEL_PLANES_MM
        axes.fill_between(
            across,
            published.MONTE_CARLO_MEAN_MM - published.MONTE_CARLO_PLANES_DIFFER_MM,
            published.MONTE_CARLO_MEAN_MM + published.MONTE_CARLO_PLANES_DIFFER_MM,
            color=GREY,
            alpha=0.35,
            linewidth=0.0,
            label="the paper, z = 300 to 700 mm (± 0.001 mm)",
        )
        axes.plot(
            published.MONTE_CARLO_PLANE_MM + _ASIDE_MM, published.MONTE_CARLO_MEAN_MM, **PAPER
        )
    axes.set_title("the means, enlarged")
    axes.set_ylabel("mean position error [mm]")
    _name_planes(axes, planes)


def _name_planes(axes: Axes, planes: list[PlaneRecord]) -> None:
    axes.set_xticks([plane.plane_mm for plane in planes])
    axes.set_xlim(planes[0].plane_mm - 60.0, planes[-1].plane_mm + 60.0)
    axes.set_xlabel("height z of the plane above the base [mm]")
