"""Whether a calibration is good: expected uncertainty, remaining error, and the verdict."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.parameter_names import listed, written
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import MODELS, Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
    legend_at,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.health import Health, PosesNeeded

PICTURE = Picture(
    title="Health of the calibration",
    needs=("calibration",),
    caption="""
Whether the calibration of ``{name}`` with all loads together is good. Left, the standard
uncertainty to expect of a predicted position against the number of poses: with poses in D-optimal
order (blue), in the order measured (orange), and with all of them (star). Dashed: the uncertainty
that adds hardly anything to the remaining error, and how many chosen poses reach it. Right, the
remaining error beside the error that noise explains, root mean squares: *scatter of all repeats*
is over every direction of arrival and with drift; *stated uncertainty* is what the campaign
states. The noise in the verdict is smaller: a mean, from successive readings that arrived from
one direction, since what depends on direction or time is sought there as an effect. Below, the
grade with its reason, then rank, condition number, termination of the fit, parameters that are
not identifiable, at a bound, or strongly correlated. The expected uncertainties do not cover
effects that the model lacks.
""",
)

_OPTIMAL: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 3.0}
_MEASURED: dict[str, Any] = {"color": ORANGE, "marker": "^", "markersize": 3.0}
_ALL: dict[str, Any] = {"color": ORANGE, "marker": "*", "markersize": 9.0, "linestyle": "none"}
_WANTED: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}
_LEFT: dict[str, Any] = {"color": VERMILLION, "linewidth": 0.9, "linestyle": ":"}
#: Room for the panels and their legend, and what a line of text takes.
_PANELS_MM, _ABOVE_MM, _BELOW_MM, _LINE_MM = 78.0, 12.0, 8.0, 4.0
_WIDE_LETTERS, _HALF_LETTERS = 102, 52
_MOST_PAIRS = 8


def draw(results: Results) -> Figure:
    """Draw the expected uncertainty by number of poses, the errors, and say what else counts."""
    case = results.any_calibration()
    health = case.health
    grade = health.grade.replace("_", " ").capitalize()
    verdict = wrap(f"{grade}: {health.line}.", _WIDE_LETTERS)
    facts, pairs = _facts(health), _pairs(health)
    lines = len(verdict) + max(len(facts), len(pairs)) + 1
    text_mm = _LINE_MM * lines
    figure = new_figure(
        _BELOW_MM + text_mm + _PANELS_MM + _ABOVE_MM,
        f"Health of the calibration with the {MODELS[case.model]}, all loads together",
    )
    bottom = _BELOW_MM + text_mm
    curve = panel(figure, 22.0, bottom + 28.0, 75.0, _PANELS_MM - 30.0)
    error = results.words.error
    _draw_poses(curve, health)
    legend_at(figure, 4.0, bottom + 3.0, curve.get_legend_handles_labels()[0], ncols=2)
    errors = panel(figure, 134.0, bottom + 28.0, 22.0, _PANELS_MM - 30.0)
    _draw_errors(errors, case)
    errors.set_xlabel(f"{error} [mm]")
    top = bottom - _LINE_MM
    for k, line in enumerate(verdict):
        write_text_at(figure, 4.0, top - k * _LINE_MM, line)
    for x_mm, column in ((4.0, facts), (90.0, pairs)):
        for k, line in enumerate(column, start=len(verdict)):
            write_text_at(figure, x_mm, top - 1.5 - k * _LINE_MM, line, color=GREY)
    return figure


def _draw_poses(axes: Axes, health: Health) -> None:
    poses = health.poses
    numbers = [point.poses for point in poses.expected]
    optimal = [point.u_optimal_mm for point in poses.expected]
    measured = [(p.poses, p.u_measured_mm) for p in poses.expected if p.u_measured_mm is not None]
    axes.plot(numbers, optimal, label="poses in D-optimal order", **_OPTIMAL)
    axes.plot(*zip(*measured, strict=True), label="poses in the order measured", **_MEASURED)
    if poses.u_model_mm is not None:
        label = f"all {poses.measured} poses: {poses.u_model_mm:.3g} mm"
        axes.plot(poses.measured, poses.u_model_mm, label=label, **_ALL)
    axes.axhline(poses.u_needed_mm, label=_wanted(poses), **_WANTED)
    left = f"remaining error, rms: {health.train_rms_mm:.3g} mm"
    axes.axhline(health.train_rms_mm, label=left, **_LEFT)
    if poses.needed is not None:
        axes.plot([poses.needed] * 2, [1e-9, poses.u_needed_mm], **_WANTED)
    shown = [*optimal, *(u for _, u in measured), poses.u_needed_mm, health.train_rms_mm]
    shown += [] if poses.u_model_mm is None else [poses.u_model_mm]
    plain_log(axes, "x", min(numbers) / 1.2, max(*numbers, poses.measured) * 1.3)
    plain_log(axes, "y", min(shown) / 1.5, max(shown) * 1.5)
    axes.set_xlabel("number of poses")
    axes.set_ylabel("expected standard uncertainty\nof a prediction [mm]")


def _wanted(poses: PosesNeeded) -> str:
    needed = f"needed: {poses.u_needed_mm:.3g} mm"
    if poses.needed is None:
        return f"{needed}, not reached with {len(poses.d_optimal_order)} chosen poses"
    return f"{needed}, reached with {poses.needed} chosen poses"


def _draw_errors(axes: Axes, case: CalibrationRecord) -> None:
    """Draw the remaining error and the errors to compare it with, one below the other."""
    health = case.health
    rows = [
        ("expected uncertainty", health.poses.u_model_mm, ORANGE, "*"),
        (case.noise_is, health.noise_mm, GREEN, "s"),
        ("fitted poses", health.train_rms_mm, VERMILLION, "o"),
        ("held-out poses", health.held_out_rms_mm, PURPLE, "v"),
    ]
    known = [value for _, value, _, _ in rows if value]
    plain_log(axes, "x", min(known) / 2.5, max(known) * 2.5, few=True)
    for y, (_, value, colour, marker) in enumerate(rows):
        if value:
            axes.plot(value, y, color=colour, marker=marker, linestyle="none")
        text = "not known" if value is None else f"{value:.3f}"
        write_beside(axes, y, text, 1.08)
    name_rows(axes, [name for name, _, _, _ in rows])
    axes.set_title("rms [mm]", loc="right")


def _facts(health: Health) -> list[str]:
    ending = health.ending
    lines = [
        f"Rank {health.rank} of {health.unknowns}; condition number {health.condition:.0f}.",
        f"{ending[0].upper()}{ending[1:]}.",
        f"At a bound: {listed(health.at_bounds)}.",
        f"Not identifiable: {listed(health.not_identifiable)}.",
    ]
    return [line for text in lines for line in wrap(text, _HALF_LETTERS)]


def _pairs(health: Health) -> list[str]:
    pairs = health.correlated_pairs
    if not pairs:
        return ["No two parameters are strongly correlated."]
    lines = ["Strongly correlated parameters, with correlation:"]
    for pair in pairs[:_MOST_PAIRS]:
        first, second = map(written, pair.parameters)
        lines.append(f"{first} and {second}: {pair.correlation:+.3f}")
    if len(pairs) > _MOST_PAIRS:
        lines.append(f"and {len(pairs) - _MOST_PAIRS} more, see the table")
    return lines
