"""How the Monte Carlo mean settles as draws are added."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLACK, GREY, SERIES, new_figure, panel, plain_log, power_of_ten

PICTURE = Picture(
    title="Monte Carlo: convergence",
    needs=("planes",),
    caption="""
Number of draws that the Monte Carlo results need. Left, the mean over all positions against the
number of draws, as a difference from the closed form of the Jacobian in percent, with its 95 %
interval. Right, the size of this difference: it should fall with the dashed line, the half
width of the interval, and end well below the dotted line, the required agreement of draws and
closed form. A curve that levelled off above the dashed line would show that draws and closed
form disagree. No measurement is used here.
""",
)

#: The closed form holds to first order in the joint errors; so far should the draws agree.
_AGREEMENT_PERCENT = 0.3
#: Planes differ by more than their colours.
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def draw(results: Results) -> Figure:
    """Draw the running mean over the closed form, and how far off it is, against the draws."""
    planes = results.planes()
    figure = new_figure(94.0, "Monte Carlo mean as draws are added, against the closed form")
    running = panel(figure, 18.0, 33.0, 64.0, 52.0)
    distance = panel(figure, 104.0, 33.0, 63.0, 52.0)
    halves = []
    for plane, colour, marker in zip(planes, cycle(SERIES), cycle(_MARKERS), strict=False):
        trace = plane.convergence
        cycles = trace.cycles
        percent = 100.0 * (trace.mean_mm / plane.closed_form_mean_mm - 1.0)
        halves.append(100.0 * trace.half_width95_mm / plane.closed_form_mean_mm)
        look: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "markersize": 3.0,
            "linewidth": 0.7,
        }
        running.plot(cycles, percent, label=f"z = {plane.plane_mm} mm", **look)
        distance.plot(cycles, np.abs(percent), **look)
    # The planes' intervals hardly differ; the first one's stands for all.
    cycles, half = planes[0].convergence.cycles, halves[0]
    running.fill_between(
        cycles, -half, half, color="#d9d9d9", linewidth=0.0, zorder=0.5, label="95 % interval"
    )
    distance.plot(
        cycles, half, color=BLACK, linestyle="--", label="half width of the 95 % interval"
    )
    for axes in (running, distance):
        axes.set_xscale("log")
        axes.set_xlim(cycles.min() / 1.2, cycles.max() * 1.2)
        axes.xaxis.set_major_formatter(lambda value, _: power_of_ten(round(np.log10(value))))
        axes.set_xlabel("draws at each position")
    running.axhline(0.0, color=BLACK, linewidth=0.6)
    limit = 1.15 * float(np.max(halves))
    running.set_ylim(-limit, limit)
    running.set_ylabel("mean of draws / closed form − 1 [%]")
    plain_log(distance, "y", float(np.min(halves)) / 30.0, 2.0 * float(np.max(halves)))
    distance.axhline(
        _AGREEMENT_PERCENT,
        color=GREY,
        linewidth=1.2,
        linestyle=":",
        label=f"{_AGREEMENT_PERCENT:g} %, required agreement",
    )
    distance.set_ylabel("distance from the closed form [%]")
    handles, labels = running.get_legend_handles_labels()
    more, names = distance.get_legend_handles_labels()
    figure.legend(
        [*handles, *more],
        [*labels, *names],
        loc="lower left",
        bbox_to_anchor=(0.012, 0.065),
        ncols=3,
        columnspacing=1.0,
    )
    return figure
