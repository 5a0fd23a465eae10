"""Where model and data disagree, before and after effects joined the model; what absorbed them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.arrays import Array
from pa10cal.figures.registry import picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    GREY,
    SEPARATOR,
    legend_at,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_text_at,
)
from pa10cal.figures.table import K_CUB, K_LIN, KINDS, LINKS, Kind, joints_of
from pa10cal.results.analysis import AnalysisRecord, LackOfFit, ParameterShift
from pa10cal.results.evaluation import Estimate

_HALF_WIDTH_95 = 1.96
_S_PER_H = 3600.0
_BEFORE: dict[str, Any] = {"color": BEFORE, "marker": "s", "linestyle": "none"}
_AFTER: dict[str, Any] = {"color": AFTER, "marker": "o", "linestyle": "none"}
_FLOOR: dict[str, Any] = {
    "color": BLACK,
    "marker": "_",
    "markersize": 9.0,
    "markeredgewidth": 1.4,
    "linestyle": "none",
}
_ASIDE = 0.16
#: Room above and below, and least ratio of an axis's ends: else it has hardly a number.
_ROOM, _LEAST_RATIO = 1.5, 12.0
_HEIGHT_MM = 148.0


@picture(
    title="Where: remaining error by load, axis, joint and direction",
    needs=("analysis", "verdict"),
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
def draw_where_breakdown(results: Results) -> Figure:
    """Draw errors by load, axis, joint and direction, and drifts, beside the floor."""
    found = results.analysis()
    figure = new_figure(
        _HEIGHT_MM, "Where model and measurement disagree, without and with the named effects"
    )
    before, after = found.before, found.after
    _draw_parts(
        panel(figure, 18.0, 95.0, 36.0, 38.0),
        [part.of.removesuffix(" N") for part in before.by_load],
        [[part.rms_mm for part in fit.by_load] for fit in (before, after)],
        [part.floor_mm for part in before.by_load],
    ).set(title="by load", xlabel="load [N]", ylabel="position error, rms [mm]")
    _draw_parts(
        panel(figure, 71.0, 95.0, 32.0, 38.0),
        [part.of for part in before.by_axis],
        [[part.rms_mm for part in fit.by_axis] for fit in (before, after)],
        [part.floor_mm for part in before.by_axis],
    ).set(title="by axis of the instrument", xlabel="axis", ylabel="rms [mm]")
    joints = [str(part.joint) for part in before.by_joint]
    _draw_parts(
        panel(figure, 121.0, 95.0, 46.0, 38.0),
        joints,
        [[1e6 * part.rms_rad for part in fit.by_joint] for fit in (before, after)],
        [1e6 * part.floor_rad for part in before.by_joint],
    ).set(title="by joint, as an error of its angle", xlabel="joint", ylabel="rms [µrad]")
    direction = panel(figure, 18.0, 39.0, 85.0, 38.0)
    _draw_directions(direction, found)
    direction.set_title("by direction of arrival: mean angle error, with 95 % intervals")
    drift = panel(figure, 121.0, 39.0, 46.0, 38.0)
    _draw_drifts(drift, found)
    drift.set_title("drift over the whole campaign")
    noise_from = results.verdict().gap.noise_floor_from
    write_text_at(figure, 18.0, 8.0, _against_pure_error(found, noise_from))
    handles = [
        Line2D([], [], label="before: without the effects", **_BEFORE),
        Line2D([], [], label="after: with the named effects", **_AFTER),
        Line2D([], [], label=results.verdict().gap.floor_is, **_FLOOR),
    ]
    legend_at(figure, 4.0, 18.5, handles, ncols=3, columnspacing=1.2)
    return figure


def _draw_parts(axes: Axes, names: list[str], rms: list[list[float]], floor: list[float]) -> Axes:
    """Draw root mean squares of named parts, before and after, and their floor."""
    at = np.arange(len(names))
    axes.plot(at, floor, **_FLOOR)
    for values, aside, look in zip(rms, (-_ASIDE, _ASIDE), (_BEFORE, _AFTER), strict=True):
        axes.plot(at + aside, values, **look)
    everything = [each for each in (*floor, *rms[0], *rms[1]) if each > 0.0]  # 0: not measured
    low, high = min(everything) / _ROOM, max(everything) * _ROOM
    aside = max(np.sqrt(_LEAST_RATIO * low / high), 1.0)
    plain_log(axes, "y", low / aside, high * aside)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.set_xticks(at, names)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    return axes


def _draw_directions(axes: Axes, found: AnalysisRecord) -> None:
    """Draw, for each joint, the mean error at cells where it came from either side."""
    ticks, labels = [], []
    if not any(part.arrivals for part in found.before.by_joint):
        axes.text(0.5, 0.55, "no direction was logged", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    for fit, look, aside in (
        (found.before, _BEFORE, -_ASIDE / 1.6),
        (found.after, _AFTER, _ASIDE / 1.6),
    ):
        shown = [(part.joint, arrival) for part in fit.by_joint for arrival in part.arrivals]
        at = np.array([joint + 0.22 * arrival.direction for joint, arrival in shown])
        mean = np.array([1e6 * arrival.mean_rad for _, arrival in shown])
        half = _HALF_WIDTH_95 * np.array([1e6 * (arrival.std_rad or 0.0) for _, arrival in shown])
        axes.errorbar(at + aside, mean, yerr=half, elinewidth=0.8, **look)
        ticks = at.tolist()
        labels = ["+" if arrival.direction > 0 else "−" for _, arrival in shown]
    joints = [part.joint for part in found.before.by_joint]
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.set_xticks(ticks, labels, minor=True)
    axes.set_xticks(joints, [f"\n{joint}" for joint in joints])
    axes.tick_params(axis="x", length=0.0, which="both")
    axes.grid(visible=False, axis="x")
    axes.set_xlim(joints[0] - 0.6, joints[-1] + 0.6)
    axes.set(xlabel="joint, arriving in − or + direction", ylabel="mean [µrad]")


def _draw_drifts(axes: Axes, found: AnalysisRecord) -> None:
    """Draw slopes of the position error with time and temperature, over the range of each."""
    kelvin = found.before.cells.temperature_C
    spans = (
        float(np.ptp(found.before.cells.time_s)) / _S_PER_H,
        float(np.ptp(kelvin)) if np.isfinite(kelvin).all() else 0.0,
    )
    for fit, look, aside in ((found.before, _BEFORE, -_ASIDE), (found.after, _AFTER, _ASIDE)):
        for first, slopes, span in zip((0, 4), _slopes(fit), spans, strict=True):
            known = [(k, slope) for k, slope in enumerate(slopes) if slope is not None]
            if not known:
                continue
            axes.errorbar(
                [first + k + aside for k, _ in known],
                [1e3 * span * slope.value for _, slope in known],
                yerr=[1e3 * span * _HALF_WIDTH_95 * (slope.std or 0.0) for _, slope in known],
                elinewidth=0.8,
                **look,
            )
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    names = [drift.axis for drift in found.before.drifts]
    warmed = any(slope is not None for slope in _slopes(found.before)[1])
    axes.set_xticks([0, 1, 2, 4, 5, 6][: 6 if warmed else 3], names * (2 if warmed else 1))
    axes.set_xlim(-0.6, 6.6 if warmed else 2.6)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("with time        with temperature" if warmed else "with time")
    axes.set_ylabel("slope × range [µm]")


def _slopes(fit: LackOfFit) -> tuple[list[Estimate | None], list[Estimate | None]]:
    """Return the slopes along the axes with time and with temperature."""
    return (
        [drift.by_time_mm_per_h for drift in fit.drifts],
        [drift.by_temperature_mm_per_K for drift in fit.drifts],
    )


def _against_pure_error(found: AnalysisRecord, noise_from: str | None) -> str:
    """Return how what poses share compares with pure error, before and after."""
    tests = [("before", found.before.pose.shared), ("after", found.after.pose.shared)]
    if not any(test for _, test in tests):
        origin, _, _ = (noise_from or "nearly equal poses").partition(":")
        return f"No pose was repeated: the noise is that of {origin}."
    said = ", ".join(
        f"{_number(test.F)} {when} (p {_probability(test.p_value)})" for when, test in tests if test
    )
    return (
        "F, variance shared by the readings of a pose over the variance of repeats, is 1 for a "
        f"complete\nmodel: {said}; p: probability of a larger F by chance"
    )


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _probability(p_value: float) -> str:
    return "< 0.001" if p_value < 1e-3 else f"= {p_value:.2g}"


# Parameters of the model that had absorbed part of the missing effects.

_ROW_MM = 4.0
_BELOW_MM, _ABOVE_MM = 24.0, 17.0
_FOUND: dict[str, Any] = {"color": AFTER, "marker": "o", "linestyle": "none"}


@picture(
    title="Gap: parameters that had absorbed the effects",
    needs=("analysis",),
    caption="""
Change of the parameters of ``{name}`` when the named effects were added: a model that lacks an
effect absorbs part of it in the parameters it has. Left, link parameters in units of their
manufacturing tolerance; right, stiffness in percent of the larger of the two values. Lines are
95 % intervals of the value after. A bar much longer than its line is a parameter that was
biased; a bar longer than a tolerance would have suggested a defective part. Where no effect was
named, nothing moved.
""",
)
def draw_parameter_shifts(results: Results) -> Figure:
    """Draw the change of each parameter when the effects were added: links left, springs right."""
    found = results.analysis()
    shifts = {
        shift.name: shift
        for shift in found.parameter_shifts
        if shift.identifiable and (shift.before or shift.after or shift.std)
    }  # a linear spring's cubic stiffness is nothing, before and after
    links = [(kind, joint) for kind in LINKS for joint in joints_of(kind, list(shifts))]
    springs = [(kind, joint) for kind in (K_LIN, K_CUB) for joint in joints_of(kind, list(shifts))]
    rows = _ROW_MM * max(len(links), 8)
    figure = new_figure(
        _BELOW_MM + rows + _ABOVE_MM, "Change of the parameters when the named effects were added"
    )
    left = panel(figure, 16.0, _BELOW_MM, 76.0, rows)
    _draw_links(left, links, shifts)
    tall = _ROW_MM * 1.6 * max(len(springs), 2)
    right = panel(figure, 118.0, _BELOW_MM + rows - tall, 48.0, tall)
    _draw_springs(right, springs, shifts)
    write_text_at(figure, 2.0, 7.5, _said(found))
    return figure


def _draw_links(
    axes: Axes, links: list[tuple[Kind, int]], shifts: dict[str, ParameterShift]
) -> None:
    found = [shifts[kind.name(joint)] for kind, joint in links]
    unit = np.array([shift.tolerance or 1.0 for shift in found])
    _draw_shifts(axes, found, unit, [kind.written(joint) for kind, joint in links])
    axes.axvspan(-1.0, 1.0, color=SEPARATOR, alpha=0.35, linewidth=0.0)
    axes.set_title("lengths and angles of the links")
    axes.set_xlabel("after − before, in manufacturing tolerances (grey: within one)")


def _draw_springs(
    axes: Axes, springs: list[tuple[Kind, int]], shifts: dict[str, ParameterShift]
) -> None:
    axes.set_title("stiffness of the joints")
    if not springs:
        axes.text(0.5, 0.5, "all joints held rigid", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    found = [shifts[kind.name(joint)] for kind, joint in springs]
    # The larger of the two: a cubic stiffness may have been, or become, zero.
    unit = np.array([max(abs(s.before), abs(s.after)) or 1.0 for s in found]) / 100.0
    names = [kind.written(joint) for kind, joint in springs]
    _draw_shifts(axes, found, unit, names)
    axes.set_xlabel("after − before [%] of the larger")


def _draw_shifts(axes: Axes, found: list[ParameterShift], unit: Array, names: list[str]) -> None:
    """Draw shifts of n parameters, each in its unit (n,), with their 95 % intervals."""
    y = np.arange(len(found))
    moved = np.array([shift.after - shift.before for shift in found]) / unit
    half = _HALF_WIDTH_95 * np.array([shift.std for shift in found]) / unit
    axes.barh(y, moved, height=0.55, color=AFTER, alpha=0.35)
    axes.errorbar(moved, y, xerr=half, capsize=2.0, **_FOUND)
    axes.axvline(0.0, color=GREY, linewidth=0.6)
    name_rows(axes, names, 0.6, lines=False)
    reach = 1.15 * max(float(np.abs(moved).max() + half.max()), 0.01)
    axes.set_xlim(-reach, reach)


def _said(found: AnalysisRecord) -> str:
    if not found.effects:
        return "No effect was named: any change comes from the weights of the fit."
    names = [shift.name for shift in found.parameter_shifts if not shift.identifiable]
    hidden = [kind.written(joint) for kind in KINDS for joint in joints_of(kind, names)]
    others = f"; not identifiable: {', '.join(hidden)}" if hidden else ""
    return (
        "Bars: change of the value. Lines: 95 % intervals of the value after.\n"
        f"Not shown: base frame, tool and weights{others}."
    )
