"""Distribution of the errors of held-out poses."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.arrays import Array
from pa10cal.figures.held_out_models import Judged, judged
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import COMBINED, Results
from pa10cal.figures.style import (
    GREY,
    evenly,
    legend_at,
    new_figure,
    panel,
    plain_log,
    write_text_at,
)
from pa10cal.results.evaluation import HoldoutRecord

PICTURE = Picture(
    title="Error of held-out poses",
    needs=("general_calibration", "held_out"),
    caption="""
Errors of ``{name}`` at poses that no fit uses: the share of poses with a smaller error, for
each model; left the error of the measured target or distance, right the orientation error where
the instrument measures orientation. *Nominal* is the described arm with base and tool or
targets fitted; *geometry* has calibrated links; *geometry and springs* also has calibrated
joint stiffness (an arm without springs has one model, *calibrated*); the last model includes the
discovered effects. An error learnt as a function
of a joint angle is known only at the angles of the fitted poses: poses beyond them are
extrapolated and drawn apart, dotted.
""",
)


_TITLE = "Error of held-out poses, which no fit uses: share of poses with a smaller error"
#: Of more poses only so many are drawn: more would not be seen.
_MOST_STEPS = 400
#: Wide lines lie under the others, and marks on all of them.
_UNDER, _OVER, _MARK = 2.0, 2.1, 2.2
_BELOW_MM, _PANEL_MM, _ABOVE_MM, _ROW_MM = 25.0, 62.0, 12.0, 4.6


def draw(results: Results) -> Figure:
    """Draw the distribution of each model's errors, of position and of orientation."""
    held_out = results.held_out()
    if not held_out.models:
        raise NothingToShowError("no held-out configuration was measured")
    models = judged(held_out)
    legend_mm = _ROW_MM * len(models)
    bottom = _BELOW_MM + legend_mm
    figure = new_figure(bottom + _PANEL_MM + _ABOVE_MM, _TITLE)
    angles = [(model, model.angle_deg) for model in models if model.angle_deg is not None]
    wide = 72.0 if angles else 152.0
    position = panel(figure, 15.0, bottom, wide, _PANEL_MM)
    _draw_shares(position, [(model, model.error_mm) for model in models])
    words = results.words
    position.set(xlabel=f"{words.error} [mm]", ylabel="share of the poses [%]")
    if angles:
        orientation = panel(figure, 96.0, bottom, wide, _PANEL_MM)
        _draw_shares(orientation, angles)
        orientation.set_xlabel("orientation error [deg]")
        orientation.tick_params(labelleft=False)
    handles = [Line2D([], [], label=_said(model), **model.look) for model in models]
    legend_at(figure, 4.0, 14.0, handles, handlelength=4.0)
    for k, line in enumerate((words.of, _fitted(held_out))):
        write_text_at(figure, 2.0, 10.0 - 4.0 * k, line, color=GREY)
    return figure


def _draw_shares(axes: Axes, drawn: list[tuple[Judged, Array]]) -> None:
    for model, errors in drawn:
        at, count = np.sort(errors), len(errors)
        rms = float(np.sqrt(np.mean(errors**2)))
        below = max(int(np.searchsorted(at, rms, side="right")), 1)
        rank = np.union1d(evenly(count, _MOST_STEPS) + 1, below)  # the step that holds the mark
        line = {key: model.look[key] for key in ("color", "linestyle", "linewidth")}
        axes.plot(
            at[rank - 1],
            100.0 * rank / count,
            drawstyle="steps-post",
            zorder=_UNDER if line["linewidth"] > 1.0 else _OVER,
            **line,
        )
        axes.plot(rms, 100.0 * below / count, zorder=_MARK, **model.look)
    every = np.concatenate([errors for _, errors in drawn])
    low = float(np.quantile(every, 0.002))
    plain_log(axes, "x", max(low, 1e-3 * every.max()) / 1.2, float(every.max()) * 1.2)
    axes.set_ylim(0.0, 102.0)


def _said(model: Judged) -> str:
    text = f"{model.title}: rms {model.rms_mm:.3f}, peak {model.error_mm.max():.3f} mm"
    if model.angle_deg is not None:
        text += f"; {np.sqrt(np.mean(model.angle_deg**2)):.4f}°"
    return f"{text} ({len(model.error_mm)} poses)"


def _fitted(held_out: HoldoutRecord) -> str:
    load = held_out.calibration
    fitted = "all loads together" if load == COMBINED else f"{load} alone"
    return f"Marks on the lines: rms. Calibrated with {fitted}."
