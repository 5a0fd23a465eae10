"""Rates of trials as they are drawn and listed: shares, their intervals, of how many."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from pa10cal.figures.style import BLUE, GREY, SKY, write_beside
from pa10cal.results.trials import Bar, Rate

BAR_HEADER = ("quantity", "to reach", "reached", "95 % interval", "trials", "met")


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


def bar_row(bar: Bar) -> tuple[object, ...]:
    """Return a figure to reach, and the one reached, as a row under `BAR_HEADER`."""
    return (
        bar.what,
        f"{'≥' if bar.at_least else '≤'} {_figure(bar.limit, bar)}",
        "" if bar.reached is None else _figure(bar.reached, bar),
        ""
        if bar.low is None or bar.high is None or not bar.trials
        else f"{_figure(bar.low, bar)} to {_figure(bar.high, bar)}",
        bar.trials,
        bar.verdict,
    )


def _figure(value: float, bar: Bar) -> str:
    return f"{100.0 * value:.1f} %" if bar.share else f"{value:.3g}"
