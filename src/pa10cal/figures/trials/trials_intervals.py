"""Coverage of the intervals of named effects."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from pa10cal.figures.rates import draw_rates
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import BLACK, BLUE, GREY, name_rows, new_figure, panel, write_text_at
from pa10cal.results.trials import TrialScoresRecord

PICTURE = Picture(
    title="Coverage of the intervals of effects",
    needs=(),
    caption="""
Coverage of the intervals that a verdict gives for the parameters of an effect ({name}). Left,
the share of true values inside the interval at the usual level, by parameter. Right, the share
inside at every level, over all parameters: on the line the stated uncertainties are right,
below it they are too small. Only effects named at their place count, so the smallest of them
are those that chance made larger.
""",
)

_TITLE = "Coverage of the intervals of named effects: blind trials"
_ROW_MM = 4.6


def draw(scores: TrialScoresRecord) -> Figure:
    """Draw the share inside the 95 % interval by parameter, and by level over all of them."""
    found = scores.intervals
    if not found.scores:
        raise NothingToShowError("no hidden effect with parameters was named")
    height = max(50.0, _ROW_MM * len(found.by_parameter))
    figure = new_figure(height + 44.0, _TITLE)
    _draw_parameters(panel(figure, 50.0, 30.0, 42.0, height), scores)
    _draw_levels(panel(figure, 123.0, 30.0 + height - 44.0, 44.0, 44.0), scores)
    inside = found.inside
    write_text_at(
        figure,
        2.0,
        6.0,
        f"{inside.count} of {inside.of} parameters lie inside their 95 % interval "
        f"({100 * inside.low:.1f} to {100 * inside.high:.1f} %);\nroot mean square of "
        f"(value − truth) / std: {found.rms:.2f}. Of trials in which the hidden effect is named "
        "at its place;\nmaps are omitted. Bars: 95 % intervals (Clopper and Pearson).",
    )
    return figure


def _draw_parameters(axes: Axes, scores: TrialScoresRecord) -> None:
    rows = scores.intervals.by_parameter
    draw_rates(axes, rows)
    axes.axvline(95.0, color=BLACK, linewidth=0.8)
    axes.set_xlim(0.0, 102.0)
    name_rows(axes, [f"{row.id} {row.parameter}" for row in rows])
    axes.set_xlabel("inside, 95 % interval [%]")


def _draw_levels(axes: Axes, scores: TrialScoresRecord) -> None:
    size = np.abs([score.score for score in scores.intervals.scores])
    level = np.linspace(0.0, 0.995, 200)
    half_width = ndtri(0.5 + level / 2.0)
    share = (size[:, None] <= half_width).mean(axis=0)
    band = 1.96 * np.sqrt(level * (1.0 - level) / len(size))
    axes.fill_between(
        100.0 * level, 100.0 * (level - band), 100.0 * (level + band), color=GREY, alpha=0.25, lw=0
    )
    axes.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, linewidth=0.8)
    axes.plot(100.0 * level, 100.0 * share, color=BLUE)
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel("level of the interval [%]")
    axes.set_ylabel("parameters inside [%]")
    axes.set_title("every level (grey: chance)")
