"""The gap between model and measurement as the named effects join the model one by one."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures import style
from pa10cal.figures.registry import picture
from pa10cal.reports.formatting import floor_is
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLACK, BLUE, ORANGE
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.discovery import VerdictRecord

#: Height of a step's row, and room of the figure below and above the rows [mm].
_ROW_MM, _BELOW_MM, _ABOVE_MM = 11.0, 30.0, 16.0
#: Distance of fitted and held-out errors from the middle of their row [rows].
_OFFSET = 0.19
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_FLOOR: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}


@picture(
    title="Gap: error as effects are named",
    needs=("analysis", "verdict"),
    section="accuracy",
    caption="""
Gap between model and measurement in ``{name}`` as the effects of the verdict are added to the
model, first those without which the model with all of them loses most, all parameters fitted
again each time: blue for fitted poses, orange for held-out poses and loads. A marker is the
mean, the bar on the line the root mean square, the end of the line the largest error; the axis
is logarithmic. Dashed: the mean error that noise alone leaves, as successive readings from one
direction of arrival scatter (unidirectional repeatability) or, without repeats, as stated; an
error common to all poses, such as a target position, adds to it. Effects that mask each other
may bring little one by one and much together. If orange falls with blue, the names are valid
beyond the fitted poses.
""",
)
def draw_gap_by_step(results: ResultsBundle) -> Figure:
    """Draw mean, root mean square and peak of every step, from the calibrated model downward."""
    steps = results.sound_record(AnalysisRecord).naming
    gap = results.sound_record(VerdictRecord).gap
    floor_mm, rows_mm = gap.noise_floor_mm, _ROW_MM * len(steps)
    figure = style.new_figure(
        _BELOW_MM + rows_mm + _ABOVE_MM, "Gap between model and measurement, effect by effect"
    )
    axes = style.panel(figure, 46.0, _BELOW_MM, 84.0, rows_mm)
    ends_mm, names = [floor_mm], []
    for k, step in enumerate(steps):
        for y, errors, look in (
            (k - _OFFSET, step.train, _TRAIN),
            (k + _OFFSET, step.holdout, _HELD_OUT),
        ):
            if errors is not None:
                mean, rms, peak = errors.mean_mm, errors.rms_mm, errors.peak_mm
                axes.plot([mean, peak], [y, y], color=look["color"], linewidth=1.4)
                axes.plot(rms, y, color=look["color"], marker="|", markersize=7.0)
                axes.plot(peak, y, color=look["color"], marker="|", markersize=4.0)
                axes.plot(mean, y, **look)
                style.write_beside(axes, y, f"{mean:.3f} / {rms:.3f} / {peak:.3f}", 1.035)
                ends_mm += [mean, peak]
        if step.effects:
            added = step.effects[-1]
            names.append(f"+ {added.id}\n   {added.of}".replace("_", " "))
        else:
            names.append("calibrated model")
    style.plain_log(axes, "x", min(ends_mm) / 1.5, max(ends_mm) * 1.4)
    axes.axvline(floor_mm, **_FLOOR)
    style.name_rows(axes, names, lines=False)
    axes.set_xlabel("position error [mm]: mean, rms (bar) and peak (end)")
    style.write_text_at(figure, 133.0, _BELOW_MM + rows_mm + 2.0, "mean / rms / peak [mm]")
    handles = [Line2D([], [], label="poses fitted", **_TRAIN)]
    if steps[0].holdout is not None:
        handles.append(Line2D([], [], label="held-out poses and loads", **_HELD_OUT))
    handles.append(Line2D([], [], label=f"{floor_is(gap)} alone: mean", **_FLOOR))
    style.legend_at(figure, 10.0, 11.0, handles, ncols=3)
    return figure
