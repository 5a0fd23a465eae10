"""Rates of blind trials as they are drawn: shares with their intervals, of how many beside."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from pa10cal.figures.style import BLUE, GREY, SKY, write_beside
from pa10cal.results.trials import Rate


def draw_rates(axes: Axes, rates: Sequence[Rate]) -> None:
    """Draw a row a rate, its share in percent and of how many beside it."""
    for y, rate in enumerate(rates):
        share = 100.0 * (rate.share or 0.0)
        axes.errorbar(
            share,
            y,
            xerr=[[share - 100.0 * rate.low], [100.0 * rate.high - share]],
            color=BLUE,
            ecolor=SKY,
            marker="o",
            capsize=2.0,
        )
        write_beside(axes, y, f"{rate.count} of {rate.of}", color=GREY)
