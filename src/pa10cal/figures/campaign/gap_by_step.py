"""Remaining error as the named effects are added one by one, fitted and held out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    legend_at,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.analysis import AnalysisRecord, NamingStep

PICTURE = Picture(
    title="Gap: error as effects are named",
    needs=("analysis", "verdict"),
    caption="""
Gap between model and measurement in ``{name}`` as the effects of the verdict are added to the
model, first those without which the model with all of them loses most, all parameters fitted
again each time: blue for fitted poses, orange for held-out poses and loads. A marker is the
mean, the bar on the line the root mean square, the end of the line the largest error; the axis
is logarithmic. Dashed: the mean error that noise alone leaves, as successive readings from one
direction of arrival scatter (unidirectional repeatability) or, without repeats, as stated; an
error common to all poses, such as a target position, adds to it. Effects that mask each other
may bring little one by one and much together. Where orange falls with blue, the names hold
beyond the fitted poses.
""",
)

_ROW_MM = 11.0
_BELOW_MM, _ABOVE_MM = 30.0, 16.0
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_ASIDE = 0.19
_FLOOR_LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}


def draw(results: Results) -> Figure:
    """Draw mean, root mean square and peak of every step, from the calibrated model downward."""
    found = results.analysis()
    steps = found.naming
    rows = _ROW_MM * len(steps)
    figure = new_figure(
        _BELOW_MM + rows + _ABOVE_MM, "Gap between model and measurement, effect by effect"
    )
    axes = panel(figure, 46.0, _BELOW_MM, 84.0, rows)
    for k, step in enumerate(steps):
        _draw_errors(axes, k - _ASIDE, step.train, _TRAIN)
        if step.holdout is not None:
            _draw_errors(axes, k + _ASIDE, step.holdout, _HELD_OUT)
    everything = [errors for step in steps for errors in (step.train, step.holdout) if errors]
    floor = found.noise_floor_mm
    lowest = min(floor, *(errors.mean_mm for errors in everything))
    plain_log(axes, "x", lowest / 1.5, max(errors.peak_mm for errors in everything) * 1.4)
    axes.axvline(floor, **_FLOOR_LINE)
    name_rows(axes, [_name(step) for step in steps], lines=False)
    axes.set_xlabel("position error [mm]: mean, rms (bar) and peak (end)")
    write_text_at(figure, 133.0, _BELOW_MM + rows + 2.0, "mean / rms / peak [mm]")
    _draw_legend(figure, steps, f"{results.verdict().gap.floor_is} alone: mean")
    write_text_at(figure, 10.0, 6.5, _beyond(found), color=GREY)
    return figure


def _beyond(found: AnalysisRecord) -> str:
    """State the errors of held-out poses inside the joint angles of the fit and beyond."""
    if len(found.naming) == 1:
        return "No effect was named: there is one step."
    held_out = found.gap.holdout
    beyond = None if held_out is None else held_out.extrapolated
    if held_out is None or beyond is None or not beyond.any():
        return ""
    error_mm = np.linalg.norm(held_out.after_mm, axis=1)
    outside_mm = np.sqrt(np.mean(error_mm[beyond] ** 2))
    if beyond.all():
        return f"Held out, last step: rms {outside_mm:.3f} mm; all poses are extrapolated."
    inside_mm = np.sqrt(np.mean(error_mm[~beyond] ** 2))
    return (
        f"Held out, last step: rms {inside_mm:.3f} mm inside the angles of the fit, "
        f"{outside_mm:.3f} mm in {beyond.sum()} of {len(beyond)} (extrapolated)."
    )


def _name(step: NamingStep) -> str:
    """Return what joined the model at a step."""
    if not step.effects:
        return "calibrated model"
    name, _, place = step.effects[-1].words.partition(", ")
    return f"+ {name}\n   {place}"


def _draw_errors(axes: Axes, y: float, errors: Accuracy, look: dict[str, Any]) -> None:
    axes.plot([errors.mean_mm, errors.peak_mm], [y, y], color=look["color"], linewidth=1.4)
    for value, size in ((errors.rms_mm, 7.0), (errors.peak_mm, 4.0)):
        axes.plot(value, y, color=look["color"], marker="|", markersize=size)
    axes.plot(errors.mean_mm, y, **look)
    said = f"{errors.mean_mm:.3f} / {errors.rms_mm:.3f} / {errors.peak_mm:.3f}"
    write_beside(axes, y, said, 1.035)


def _draw_legend(figure: Figure, steps: tuple[NamingStep, ...], floor_is: str) -> None:
    handles = [Line2D([], [], label="poses fitted", **_TRAIN)]
    if steps[0].holdout is not None:
        handles.append(Line2D([], [], label="held-out poses and loads", **_HELD_OUT))
    handles.append(Line2D([], [], label=floor_is, **_FLOOR_LINE))
    legend_at(figure, 10.0, 11.0, handles, ncols=3)
