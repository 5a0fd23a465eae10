"""The Monte Carlo by plane; the error over each plane stands on the page."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures import published
from pa10cal.figures.registry import picture
from pa10cal.figures.style import PAPER, new_figure, note, panel
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLUE, GREEN, GREY, SKY

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
def draw_montecarlo_planes(results: ResultsBundle) -> Figure:
    """Draw the mean with the spread within a position, and the mean alone enlarged."""
    planes, with_paper = results.planes_set(), published.is_of_papers_arm(results)
    figure = new_figure(103.0, "Position error that resolver uncertainty alone causes, by plane")
    spread = panel(figure, 18.0, 42.0, 64.0, 50.0)
    enlarged = panel(figure, 104.0, 42.0, 63.0, 50.0)
    z_mm, mean_mm = [plane.plane_mm for plane in planes], [plane.mean_mm for plane in planes]
    look: dict[str, Any] = {"color": BLUE, "marker": "o", "linestyle": "none", "capsize": 3.0}
    spread.errorbar(
        z_mm,
        mean_mm,
        yerr=[plane.std_mm for plane in planes],
        label="mean ± standard deviation within a position",
        **look,
    )
    enlarged.errorbar(
        z_mm,
        mean_mm,
        yerr=[plane.half_width95_positions_mm for plane in planes],
        ecolor=SKY,
        label="mean, 95 % interval for the choice of positions",
        **look,
    )
    enlarged.plot(
        z_mm,
        [plane.closed_form_mean_mm for plane in planes],
        color=GREEN,
        marker="x",
        markersize=6.0,
        linestyle="none",
        label="closed form from the Jacobian, same positions",
    )
    if with_paper:
        _draw_papers(spread, enlarged)
    spread.set_ylim(bottom=0.0)
    spread.set_ylabel("position error [mm]")
    enlarged.set(title="the means, enlarged", ylabel="mean position error [mm]")
    for axes in (spread, enlarged):
        axes.set_xticks(z_mm)
        axes.set_xlim(z_mm[0] - 60.0, z_mm[-1] + 60.0)
        axes.set_xlabel("height z of the plane above the base [mm]")
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.155), ncols=2)
    first = planes[0]
    note(
        figure,
        f"Nominal arm; σ = {first.sigma_deg:g}° at every joint; {first.positions} positions, "
        f"{first.cycles} draws at each,\n"
        f"at {first.reach_m[0]:g} to {first.reach_m[1]:g} m from the base axis. "
        "No measurement enters.",
        6.5,
    )
    return figure


def _draw_papers(spread: Axes, enlarged: Axes) -> None:
    """Draw the paper's mean and spread, and how little it says that parallel planes differ."""
    at_mm = published.MONTE_CARLO_PLANE_MM + _ASIDE_MM
    mean_mm, apart_mm = published.MONTE_CARLO_MEAN_MM, published.MONTE_CARLO_PLANES_DIFFER_MM
    spread.errorbar(
        at_mm,
        mean_mm,
        yerr=published.MONTE_CARLO_STD_MM,
        linestyle="none",
        capsize=3.0,
        label="the paper, z = 500 mm",
        **PAPER,
    )
    enlarged.fill_between(
        published.MONTE_CARLO_PARALLEL_PLANES_MM,
        mean_mm - apart_mm,
        mean_mm + apart_mm,
        color=GREY,
        alpha=0.35,
        linewidth=0.0,
        label="the paper, z = 300 to 700 mm (± 0.001 mm)",
    )
    enlarged.plot(at_mm, mean_mm, **PAPER)
