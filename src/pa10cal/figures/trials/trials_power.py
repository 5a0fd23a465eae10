"""How large an effect must be to be found: blind trials by size and by residual."""

from __future__ import annotations

from itertools import cycle
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    SKY,
    VERMILLION,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_text_at,
)
from pa10cal.results.trials import JudgedEffect, JudgedTrial, TrialScoresRecord

PICTURE = Picture(
    title="How large an effect must be to be found",
    needs=(),
    caption="""
Size at which an effect is named or among the alternatives ({name}). Left, every trial by the
size of its hidden effect, in units of the usual size in robots of this kind; hollow markers
were missed. Right, the same trials by the effect on the poses: the difference between the
residual of the calibrated model and that of the same campaign without the effect, relative to
the residual that noise alone leaves. Effects that only the logged torque shows are omitted
there.
""",
)

_TITLE = "How large an effect must be: blind trials with one hidden effect"
_ROW_MM = 4.8
#: Markers of layouts, in order of their names, and what they are called.
_MARKERS = {
    "o": "dots",
    "s": "squares",
    "^": "triangles up",
    "v": "triangles down",
    "D": "diamonds",
    "P": "crosses",
}
#: How far the rows of the first and of the last layout are apart.
_SPREAD = {1: 0.0, 2: 0.34}
_WIDEST_SPREAD = 0.6
#: Characters of a line below the panels.
_LINE = 96
_LOWEST, _HIGHEST = 0.03, 60.0
#: Where the residual is so many times the floor.
_RATIOS = {1.5: "right", 3.0: "left"}


def draw(scores: TrialScoresRecord) -> Figure:
    """Draw every trial by its effect and size, and the share found by what it does to poses."""
    trials = [trial for trial in scores.per_trial if trial.kind == "single"]
    if not trials:
        raise NothingToShowError("no trial hid one effect of the vocabulary")
    names = sorted({trial.hidden[0].id for trial in trials})
    markers = dict(zip(sorted({trial.layout for trial in trials}), cycle(_MARKERS), strict=False))
    height, below = _ROW_MM * len(names), 32.0 + 3.5 * ((len(markers) + 2) // 3)
    figure = new_figure(height + below + 15.0, _TITLE)
    by_size = panel(figure, 37.0, below, 60.0, height)
    _draw_sizes(by_size, trials, names, markers)
    for k, name in enumerate(names):
        curve = scores.power.by_id.get(name)
        if curve is not None and curve.most is not None:
            by_size.plot(curve.most, k, color=BLACK, marker="|", markersize=9.0, linestyle="none")
    _draw_moved(panel(figure, 112.0, below, 55.0, height), scores)
    _explain(figure, markers)
    return figure


def _draw_sizes(
    axes: Axes, trials: list[JudgedTrial], names: list[str], markers: dict[str, str]
) -> None:
    half = 0.5 * _SPREAD.get(len(markers), _WIDEST_SPREAD)
    offsets = dict(zip(markers, np.linspace(-half, half, len(markers)), strict=True))
    for trial in trials:
        hidden = trial.hidden[0]
        y = names.index(hidden.id) + offsets[trial.layout]
        axes.plot(hidden.size, y, marker=markers[trial.layout], **_look(hidden))
    plain_log(axes, "x", 0.085, 3.5)
    name_rows(axes, names)
    axes.set_xlabel("size, in the reference size of the effect")
    axes.set_title("every trial")


def _look(hidden: JudgedEffect) -> dict[str, Any]:
    color = BLUE if hidden.listed else VERMILLION if hidden.testable else GREY
    face = color if hidden.listed else "white"
    return {"color": color, "markerfacecolor": face, "markersize": 2.8, "markeredgewidth": 0.7}


def _draw_moved(axes: Axes, scores: TrialScoresRecord) -> None:
    for entry in scores.power.bins:
        found = entry.listed
        if found.share is None:
            continue
        x = np.sqrt(max(entry.low, _LOWEST) * (entry.high or _HIGHEST))
        axes.errorbar(
            x,
            found.share,
            yerr=[[found.share - found.low], [found.high - found.share]],
            color=BLUE,
            ecolor=SKY,
            marker="o",
            capsize=2.0,
        )
        axes.text(x, -0.06, str(found.of), ha="center", color=GREY)
    curve = scores.power.by_moved
    if curve is not None:
        moved = np.geomspace(_LOWEST, _HIGHEST, 200)
        odds = curve.intercept + curve.slope * np.log(moved)
        axes.plot(moved, 1.0 / (1.0 + np.exp(-odds)), color=BLACK, linewidth=0.8)
    for ratio, side in _RATIOS.items():
        x = np.sqrt(ratio**2 - 1.0)
        axes.axvline(x, color=GREY, linewidth=0.8, linestyle=":")
        axes.text(x, 1.06, f" {ratio:g} × ", ha=side, color=GREY)
    plain_log(axes, "x", _LOWEST, _HIGHEST)
    axes.set_ylim(-0.1, 1.12)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("residual moved, over the noise floor")
    axes.set_title("share named or in the alternatives")


def _explain(figure: Figure, markers: dict[str, str]) -> None:
    layouts = "; ".join(f"{_MARKERS[marker]}: {layout}" for layout, marker in markers.items())
    layouts = fill(f"{layouts[0].upper()}{layouts[1:]}.", _LINE)
    write_text_at(
        figure,
        2.0,
        6.0,
        "Filled blue: named or in the alternatives; hollow red: neither; hollow grey: declared "
        f"not testable.\n{layouts}\n"
        "Upright dash: size found in 95 of 100. Right: effects that move poses, by how far the "
        "residual of the\ncalibrated baseline differs from that with nothing hidden (numbers: "
        "trials; bars: 95 % intervals; line: logistic;\ndotted: the residual is so many times "
        "the floor).",
    )
