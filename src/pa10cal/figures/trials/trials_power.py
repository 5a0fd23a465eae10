"""How large an effect must be to be found: blind trials by size and by residual."""

from __future__ import annotations

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
_MARKERS = {"grid": "o", "wide": "s"}
_LOWEST, _HIGHEST = 0.03, 60.0
#: Where the residual is so many times the floor.
_RATIOS = {1.5: "right", 3.0: "left"}


def draw(scores: TrialScoresRecord) -> Figure:
    """Draw every trial by its effect and size, and the share found by what it does to poses."""
    trials = [trial for trial in scores.per_trial if trial.kind == "single"]
    if not trials:
        raise NothingToShowError("no trial hid one effect of the vocabulary")
    names = sorted({trial.hidden[0].id for trial in trials})
    height = _ROW_MM * len(names)
    figure = new_figure(height + 45.0, _TITLE)
    by_size = panel(figure, 37.0, 30.0, 60.0, height)
    _draw_sizes(by_size, trials, names)
    for k, name in enumerate(names):
        curve = scores.power.by_id.get(name)
        if curve is not None and curve.most is not None:
            by_size.plot(curve.most, k, color=BLACK, marker="|", markersize=9.0, linestyle="none")
    _draw_moved(panel(figure, 112.0, 30.0, 55.0, height), scores)
    _explain(figure)
    return figure


def _draw_sizes(axes: Axes, trials: list[JudgedTrial], names: list[str]) -> None:
    for trial in trials:
        hidden = trial.hidden[0]
        y = names.index(hidden.id) + (-0.17 if trial.layout == "grid" else 0.17)
        axes.plot(hidden.size, y, marker=_MARKERS[trial.layout], **_look(hidden))
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


def _explain(figure: Figure) -> None:
    write_text_at(
        figure,
        2.0,
        6.0,
        "Filled blue: named or in the alternatives; hollow red: neither; hollow grey: declared "
        "not testable.\nDots: grid; squares: wide layout. Upright dash: size found in 95 of 100. "
        "Right: effects that move poses, by how\nfar the residual of the calibrated baseline "
        "differs from that with nothing hidden (numbers: trials; bars: 95 %\nintervals; line: "
        "logistic; dotted: the residual is so many times the floor).",
    )
