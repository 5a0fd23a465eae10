"""Residuals in parts, and as effects join the model; suspected outliers.

Parts are those by load, axis, joint and direction of arrival, and drifts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures import style
from pa10cal.figures.registry import picture
from pa10cal.figures.table import ResultTable, frame_of
from pa10cal.reports.formatting import floor_is
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import AFTER, BEFORE, BLACK, BLUE, GREY, ORANGE
from pa10cal.reports.trust import outliers_grid
from pa10cal.results.analysis import AnalysisRecord, LackOfFit
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.number_text import HALF_WIDTH_95

_BEFORE: dict[str, Any] = {"color": BEFORE, "marker": "s", "linestyle": "none"}
_AFTER: dict[str, Any] = {"color": AFTER, "marker": "o", "linestyle": "none"}
_FLOOR: dict[str, Any] = {
    "color": BLACK,
    "marker": "_",
    "markersize": 9.0,
    "markeredgewidth": 1.4,
    "linestyle": "none",
}
#: Distance of the markers before and after from the middle of their column [columns].
_OFFSET = 0.16
#: Factor by which a logarithmic axis reaches beyond the errors, at either end.
_MARGIN = 1.5
#: Least ratio of the ends of a logarithmic axis: a narrower one hardly has a number on it.
_LEAST_RATIO = 12.0
#: Layout of the figure [mm]: its height; bottoms of the two rows of panels and height of each.
_HEIGHT_MM = 148.0
_UPPER_MM, _LOWER_MM, _PANEL_MM = 95.0, 39.0, 38.0
#: Left edges of the panels that stand above each other [mm].
_LEFT_MM, _RIGHT_MM = 18.0, 121.0


@picture(
    title="Where: remaining error by load, axis, joint and direction",
    needs=("analysis", "verdict"),
    section="residuals",
    caption="""
Remaining error of ``{name}`` fitted without effects (red) and with the effects of the verdict
(blue), part by part. The black bar is the error that noise alone leaves in a cell of a few
readings, which is more than in averaged poses: the scatter of successive readings from one
direction of arrival (unidirectional repeatability) or, without repeats, what is stated. Above:
position error by load and by axis of the instrument, and the same expressed as joint angle
errors, on logarithmic axes. Below: the mean error of each joint by direction of arrival, and the
drift with time and, where it was logged, temperature. Blue at the bars and at zero means that
nothing remains; red and blue together, far from the bars, mean that an error was not found.
Errors common to all poses are removed first.
""",
)
def draw_where_breakdown(results: ResultsBundle) -> Figure:
    """Draw errors by load, axis, joint and direction, and drifts, beside the noise floor."""
    analysis, gap = results.sound_record(AnalysisRecord), results.sound_record(VerdictRecord).gap
    before, after = analysis.before, analysis.after
    figure = style.new_figure(
        _HEIGHT_MM, "Where model and measurement disagree, without and with the named effects"
    )
    _draw_parts(
        style.panel(figure, _LEFT_MM, _UPPER_MM, 36.0, _PANEL_MM),
        [part.of.removesuffix(" N") for part in before.by_load],
        [[part.rms_mm for part in fit.by_load] for fit in (before, after)],
        [part.floor_mm for part in before.by_load],
    ).set(title="by load", xlabel="load [N]", ylabel="position error, rms [mm]")
    _draw_parts(
        style.panel(figure, 71.0, _UPPER_MM, 32.0, _PANEL_MM),
        [part.of for part in before.by_axis],
        [[part.rms_mm for part in fit.by_axis] for fit in (before, after)],
        [part.floor_mm for part in before.by_axis],
    ).set(title="by axis of the instrument", xlabel="axis", ylabel="rms [mm]")
    _draw_parts(
        style.panel(figure, _RIGHT_MM, _UPPER_MM, 46.0, _PANEL_MM),
        _joint_names(results, before),
        [[1e6 * part.rms_rad for part in fit.by_joint] for fit in (before, after)],
        [1e6 * part.floor_rad for part in before.by_joint],
    ).set(title="by joint, as an error of its angle", xlabel="joint", ylabel="rms [µrad]")
    direction = style.panel(figure, _LEFT_MM, _LOWER_MM, 85.0, _PANEL_MM)
    direction.set_title("by direction of arrival: mean angle error, with 95 % intervals")
    _draw_directions(direction, analysis, _joint_names(results, before))
    drift = style.panel(figure, _RIGHT_MM, _LOWER_MM, 46.0, _PANEL_MM)
    drift.set_title("drift over the whole campaign")
    _draw_drifts(drift, analysis)
    style.write_text_at(figure, _LEFT_MM, 8.0, _f_test(analysis, gap.noise_floor_from))
    handles = [
        style.mark("before: without the effects", **_BEFORE),
        style.mark("after: with the named effects", **_AFTER),
        style.mark(floor_is(gap), **_FLOOR),
    ]
    style.legend_at(figure, 4.0, 18.5, handles, ncols=3, columnspacing=1.2)
    return figure


def _draw_parts(axes: Axes, names: list[str], rms: list[list[float]], floor: list[float]) -> Axes:
    """Draw a column for each part: its rms error before and after, and its noise floor."""
    columns = np.arange(len(names))
    axes.plot(columns, floor, **_FLOOR)
    axes.plot(columns - _OFFSET, rms[0], **_BEFORE)
    axes.plot(columns + _OFFSET, rms[1], **_AFTER)
    shown = [value for value in (*floor, *rms[0], *rms[1]) if value > 0.0]  # 0: not measured
    low, high = min(shown) / _MARGIN, max(shown) * _MARGIN
    widen = max(np.sqrt(_LEAST_RATIO * low / high), 1.0)
    style.plain_log(axes, "y", low / widen, high * widen)
    axes.set_xlim(-0.6, len(names) - 0.4)
    style.name_columns(axes, names)
    return axes


def _joint_names(results: ResultsBundle, fit: LackOfFit) -> list[str]:
    """Return the numbers of the joints, with the unit of the errors of those that slide."""
    slide = results.sliding_joints
    return [f"{part.joint}{' [µm]' if part.joint in slide else ''}" for part in fit.by_joint]


def _draw_directions(axes: Axes, analysis: AnalysisRecord, names: list[str]) -> None:
    """Draw the mean angle error of each joint, by its name, by the direction of arrival."""
    if not any(part.arrivals for part in analysis.before.by_joint):
        axes.text(0.5, 0.55, "no direction was logged", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    for fit, look, offset in (
        (analysis.before, _BEFORE, -_OFFSET / 1.6),
        (analysis.after, _AFTER, _OFFSET / 1.6),
    ):
        shown = [(part.joint, arrival) for part in fit.by_joint for arrival in part.arrivals]
        ticks = [joint + 0.22 * arrival.direction for joint, arrival in shown]
        mean = np.array([1e6 * arrival.mean_rad for _, arrival in shown])
        half = HALF_WIDTH_95 * np.array([1e6 * (arrival.std_rad or 0.0) for _, arrival in shown])
        axes.errorbar(np.array(ticks) + offset, mean, yerr=half, elinewidth=0.8, **look)
        signs = ["+" if arrival.direction > 0 else "−" for _, arrival in shown]
        axes.set_xticks(ticks, signs, minor=True)
    joints = [part.joint for part in analysis.before.by_joint]
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    style.name_columns(axes, [f"\n{name}" for name in names], joints)
    axes.set_xlim(joints[0] - 0.6, joints[-1] + 0.6)
    axes.set(xlabel="joint, arriving in − or + direction", ylabel="mean [µrad]")


def _draw_drifts(axes: Axes, analysis: AnalysisRecord) -> None:
    """Draw the drift of the position error with time and temperature, over the range of each.

    The three axes of the instrument stand at 0 to 2 for time, and at 4 to 6 for temperature.
    """
    for fit, look, offset in (
        (analysis.before, _BEFORE, -_OFFSET),
        (analysis.after, _AFTER, _OFFSET),
    ):
        with_time = [drift.with_time_mm for drift in fit.drifts]
        with_temperature = [drift.with_temperature_mm for drift in fit.drifts]
        for first, drifts in ((0, with_time), (4, with_temperature)):
            shown = [(x + offset, drift) for x, drift in enumerate(drifts, start=first) if drift]
            if shown:
                half = [1e3 * HALF_WIDTH_95 * (drift.std or 0.0) for _, drift in shown]
                value = [1e3 * drift.value for _, drift in shown]
                axes.errorbar([x for x, _ in shown], value, yerr=half, elinewidth=0.8, **look)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    names = [drift.axis for drift in analysis.before.drifts]
    warmed = any(drift.with_temperature_mm is not None for drift in analysis.before.drifts)
    if warmed:
        style.name_columns(axes, names * 2, [0, 1, 2, 4, 5, 6])
    else:
        style.name_columns(axes, names, [0, 1, 2])
    axes.set_xlim(-0.6, 6.6 if warmed else 2.6)
    axes.set_xlabel("with time        with temperature" if warmed else "with time")
    axes.set_ylabel("slope × range [µm]")


def _f_test(analysis: AnalysisRecord, noise_from: str | None) -> str:
    """Return the lack-of-fit F tests against pure error (repeats), before and after, in words."""
    results = []
    for when, fit in (("before", analysis.before), ("after", analysis.after)):
        if (test := fit.pure_error) is not None:
            ratio = f"{test.F:.0f}" if test.F >= 100.0 else f"{test.F:.3g}"
            p_value = "< 0.001" if test.p_value < 1e-3 else f"= {test.p_value:.2g}"
            results.append(f"{ratio} {when} (p {p_value})")
    if not results:
        origin = (noise_from or "nearly equal poses").partition(":")[0]
        return f"No pose was repeated: the noise is that of {origin}."
    return (
        "F, variance shared by the readings of a pose over the variance of repeats, is 1 for a "
        f"complete\nmodel: {', '.join(results)}; p: probability of a larger F by chance"
    )


# The gap between model and measurement as the named effects join the model one by one.

#: Height of a step's row, and room of the figure below and above the rows [mm].
_ROW_MM, _BELOW_MM, _ABOVE_MM = 11.0, 30.0, 16.0
#: Distance of fitted and held-out errors from the middle of their row [rows].
_STEP_OFFSET = 0.19
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_FLOOR_LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}


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
            (k - _STEP_OFFSET, step.train, _TRAIN),
            (k + _STEP_OFFSET, step.holdout, _HELD_OUT),
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
    axes.axvline(floor_mm, **_FLOOR_LINE)
    style.name_rows(axes, names, lines=False)
    axes.set_xlabel("position error [mm]: mean, rms (bar) and peak (end)")
    style.write_text_at(figure, 133.0, _BELOW_MM + rows_mm + 2.0, "mean / rms / peak [mm]")
    handles = [Line2D([], [], label="poses fitted", **_TRAIN)]
    if steps[0].holdout is not None:
        handles.append(Line2D([], [], label="held-out poses and loads", **_HELD_OUT))
    handles.append(Line2D([], [], label=f"{floor_is(gap)} alone: mean", **_FLOOR_LINE))
    style.legend_at(figure, 10.0, 11.0, handles, ncols=3)
    return figure


# Suspected outliers.


@picture(
    title="Suspected outliers",
    needs=("general",),
    caption="""
Poses of ``{name}`` that lie so far outside the scatter of the others that chance hardly
explains them, each with the quantity that is off and by how much. None was removed: each stayed
in the fit with a reduced weight, so that it cannot bias the other poses. A single such pose may
be a wrong reading. Several of them at neighbouring positions or joint angles are more likely an
effect that the model lacks.
""",
)
def tabulate_suspected_outliers(results: ResultsBundle) -> ResultTable:
    """Return every suspected outlier, in the order of the record."""
    case = results.general_calibration()
    rows = [
        (pose.pose, pose.load_N, round(pose.distance, 2), round(pose.weight, 3), pose.why)
        for pose in case.suspected_outliers
    ]
    return ResultTable(
        title="Suspected outliers",
        data=frame_of(("pose", "load_N", "distance", "weight", "why"), rows),
        shown=(outliers_grid(case),),
        notes=(
            f"{len(rows)} of {case.health.poses.measured} poses. None was removed: each stayed in "
            "the fit with the weight given, 1 being that of the others.",
            "Distance: residual over all readings of the pose, in standard deviations of the "
            "scatter. Without a wrong pose, one campaign in a hundred has a suspected outlier.",
            "A suspected outlier may be a wrong reading, or a place where the model lacks an "
            "effect.",
        ),
    )
