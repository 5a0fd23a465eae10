"""Whether a calibration is good: expected uncertainty, remaining error, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.registry import NothingToShowError, picture
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
    power_of_ten,
    write_beside,
    write_text_at,
)
from pa10cal.figures.table import Row, Shown, Table, frame_of, listed, shown, written
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord, LCurvePoint
from pa10cal.results.health import Health, PosesNeeded

_OPTIMAL: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 3.0}
_MEASURED: dict[str, Any] = {"color": ORANGE, "marker": "^", "markersize": 3.0}
_ALL: dict[str, Any] = {"color": ORANGE, "marker": "*", "markersize": 9.0, "linestyle": "none"}
_WANTED: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}
_LEFT: dict[str, Any] = {"color": VERMILLION, "linewidth": 0.9, "linestyle": ":"}
#: Room for the panels and their legend, and what a line of text takes.
_PANELS_MM, _ABOVE_MM, _BELOW_MM, _LINE_MM = 78.0, 12.0, 8.0, 4.0
_WIDE_LETTERS, _HALF_LETTERS = 102, 52
_MOST_PAIRS = 8


@picture(
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
def draw_health(results: Results) -> Figure:
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


# The health of the calibrations of all loads: what to look at before one is trusted.

_HEADER = ("model", "quantity", "of", "value", "unit")
_UNKNOWN = "–"
#: So many poses in D-optimal order are shown; the CSV has all that were ordered.
_MOST_SHOWN = 30


@picture(
    title="Health of the calibration",
    needs=("calibration", "general"),
    caption="""
Whether the calibration of ``{name}`` is good, in one line and in the quantities behind it:
termination of the fit, rank and condition number, parameters at a bound, not identifiable or
strongly correlated, the error of fitted against held-out poses, and the uncertainty to expect
with so many poses. Where the paper's model is used, the general model stands beside it. The
poses at the head of the D-optimal order carry the most information: measured again, they are a
good check.
""",
)
def tabulate_health_summary(results: Results) -> Table:
    """Return termination, rank, errors and expected uncertainty, and how many poses are needed."""
    cases = results.calibrations()
    models = [MODELS[case.model] for case in cases]
    columns = [_said(case) for case in cases]
    rows = [
        (quantity, *(column.get(quantity, _UNKNOWN) for column in columns))
        for quantity in dict.fromkeys(name for column in columns for name in column)
    ]
    return Table(
        title="Health of the calibration",
        data=frame_of(_HEADER, [row for case in cases for row in _data_rows(case)]),
        shown=(
            shown(("all loads together", *models), rows),
            _pairs_of_summary([case.health for case in cases], models),
            *(_order(case.health, model) for case, model in zip(cases, models, strict=True)),
        ),
        notes=(
            "Expected uncertainty: standard uncertainty of a predicted position, root mean square "
            "over the poses; with the paper's model from the scatter of repeats, with the "
            "general model from the scatter of the poses about it. Neither covers an effect that "
            "the model lacks.",
            "Scatter of all repeats: of the averaged repeats of a pose and load, from every "
            "direction of arrival and with the drift between them. Stated uncertainty: what the "
            "campaign states of its averaged readings. The grade compares with what successive "
            "readings scatter by, where they are repeated, and with the places of the targets; the "
            "verdict with the mean, not the root mean square, of the former "
            "(unidirectional repeatability).",
            "Needed: the uncertainty that adds hardly anything to the remaining error. D-optimal "
            "order: each pose increases the determinant of the information matrix most.",
        ),
    )


def _said(case: CalibrationRecord) -> dict[str, str]:
    """Return quantities and how they are written."""
    health = case.health
    poses = health.poses
    needed = f"more than {len(poses.d_optimal_order)}" if poses.needed is None else poses.needed
    found = {
        "grade": f"{health.grade}: {health.line}",
        "termination": health.ending,
        "rank": f"{health.rank} of {health.unknowns} unknowns",
        "condition number": f"{health.condition:.4g}",
        "at a bound": listed(health.at_bounds),
        "not identifiable from these poses": listed(health.not_identifiable),
        "error of the fitted poses, rms [mm]": _number(health.train_rms_mm),
        "error of the held-out poses, rms [mm]": _number(health.held_out_rms_mm),
        f"error that the {case.noise_is} explains, rms [mm]": _number(health.noise_mm),
        "expected uncertainty of a prediction [mm]": _number(poses.u_model_mm),
        "needed uncertainty [mm]": _number(poses.u_needed_mm),
        "poses measured": str(poses.measured),
        "well-chosen poses that suffice": str(needed),
    }
    if isinstance(case, GeneralCalibrationRecord):
        for of, scatter in case.scatter.items():
            unit = "mrad" if of.startswith("attitude") else "mm"
            found[f"scatter beyond the stated uncertainty, {of} [{unit}]"] = _number(1e3 * scatter)
    return found


def _pairs_of_summary(healths: list[Health], models: list[str]) -> Shown:
    rows = [
        (model, *map(written, pair.parameters), f"{pair.correlation:+.4f}")
        for health, model in zip(healths, models, strict=True)
        for pair in health.correlated_pairs
    ]
    header = ("model", "parameter", "and", "correlation")
    return shown(header, rows, "Strongly correlated parameters")


def _order(health: Health, model: str) -> Shown:
    """Return the uncertainty by number of poses, and which pose comes next."""
    poses = health.poses
    rows = [
        (
            str(expected.poses),
            _number(expected.u_optimal_mm),
            _number(expected.u_measured_mm),
            poses.d_optimal_order[expected.poses - 1],
        )
        for expected in poses.expected[:_MOST_SHOWN]
    ]
    header = ("poses", "D-optimal order [mm]", "order measured [mm]", "last pose of the former")
    return shown(header, rows, f"Expected uncertainty by number of poses, {model}")


def _data_rows(case: CalibrationRecord) -> Iterator[Row]:
    health, model = case.health, case.model
    poses = health.poses
    for quantity in ("grade", "line", "reason", "rank", "unknowns", "condition"):
        yield (model, quantity, "", str(getattr(health, quantity)), "")
    for quantity in ("at_bounds", "not_identifiable"):
        yield (model, quantity, "", " ".join(getattr(health, quantity)), "")
    for quantity in ("train_rms_mm", "held_out_rms_mm", "noise_mm"):
        yield (model, quantity, "", _plain(getattr(health, quantity)), "mm")
    for quantity in ("u_model_mm", "u_needed_mm"):
        yield (model, quantity, "", _plain(getattr(poses, quantity)), "mm")
    for quantity in ("measured", "needed"):
        value = getattr(poses, quantity)
        yield (model, f"poses_{quantity}", "", "" if value is None else str(value), "")
    for pair in health.correlated_pairs:
        yield (model, "correlation", " and ".join(pair.parameters), f"{pair.correlation:.6g}", "")
    for expected in poses.expected:
        for quantity in ("u_optimal_mm", "u_measured_mm"):
            value = _plain(getattr(expected, quantity))
            yield (model, quantity, f"{expected.poses} poses", value, "mm")
    for k, pose in enumerate(poses.d_optimal_order, start=1):
        yield (model, "d_optimal_order", str(k), pose, "")


def _number(value: float | None) -> str:
    return _UNKNOWN if value is None else f"{value:.4f}"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


# Cost of the tolerance terms: the L-curve, and the remaining error at each weight.

_TITLE = "L-curve of the tolerance terms, if they acted on every departure as printed"


#: Weights are written beside points this far apart, as a part of the curve's extent.
_LABELS_APART = 0.17
#: A label needs more room along the misfit than along the departure.
_LABEL_SHAPE = (2.0, 1.0)


@dataclass(frozen=True)
class _Reading:
    """One reading of epsilon: what it multiplies, and the weight on the residuals that makes."""

    title: str
    weight: float
    colour: str
    marker: str


@picture(
    title="L-curve of the tolerance terms",
    needs=("papers_calibration",),
    caption="""
Cost of the tolerance terms in equation (2) of the paper for ``{name}``, if they acted on every
departure, as printed. Left, each point is a weight: to the right the fit gets worse, downward
the departures from nominal get smaller. Right, the mean position error that remains at each
weight. The paper's ε can be read as a factor on the residuals or on the cost; both readings are
marked. A reading whose error lies far above the flat part of the curve cannot have given the
paper's accuracy. By default the terms act only on directions that the poses do not determine,
at no cost in accuracy.
""",
)
def draw_l_curve(results: Results) -> Figure:
    """Draw departure over misfit, and mean position error over weight, with both readings."""
    case = results.calibration()
    if not case.l_curve:
        raise NothingToShowError("no weights were tried")
    epsilon = float(str(case.settings["epsilon"]))
    readings = (
        _Reading("ε on the residuals", epsilon, ORANGE, "s"),
        _Reading("ε on the cost: √ε on the residuals", float(np.sqrt(epsilon)), VERMILLION, "^"),
    )
    figure = new_figure(98.0, _TITLE)
    curve = panel(figure, 20.0, 34.0, 62.0, 52.0)
    error = panel(figure, 102.0, 34.0, 64.0, 52.0)
    _draw_curve(curve, case.l_curve, readings)
    _draw_error(error, case.l_curve, readings)
    figure.legend(
        *error.get_legend_handles_labels(), loc="lower left", bbox_to_anchor=(0.012, 0.115)
    )
    chosen = {"residual": readings[0], "cost": readings[1]}[
        str(case.settings["epsilon_acts_on"])
    ].title
    acts = (
        "only on directions that the poses do not identify, at no cost in fit"
        if case.settings["tolerance_terms"] == "null_space"
        else f"on every departure, with {chosen}"
    )
    write_text_at(figure, 2.0, 6.5, f"In the calibration itself the terms act {acts}.")
    return figure


def _draw_curve(
    axes: Axes, points: tuple[LCurvePoint, ...], readings: tuple[_Reading, ...]
) -> None:
    misfit = np.array([point.misfit for point in points])
    departure = np.array([point.departure for point in points])
    axes.plot(misfit, departure, color=BLUE, marker="o")
    for point in _apart(points):
        axes.annotate(
            _written(point.weight),
            (point.misfit, point.departure),
            (-6.0, -4.0),
            textcoords="offset points",
            ha="right",
            va="top",
            color=GREY,
        )
    for reading in readings:
        at = _between(points, reading.weight)
        if at is not None:
            axes.plot(at.misfit, at.departure, **_mark(reading))
    plain_log(axes, "x", misfit.min() / 3.0, misfit.max() * 2.0)
    plain_log(axes, "y", departure.min() / 2.0, departure.max() * 2.0)
    axes.set_xlabel("misfit: norm of the residuals")
    axes.set_ylabel("norm of departures\nover tolerances")
    axes.set_title("misfit against departure; weights beside points")


def _draw_error(
    axes: Axes, points: tuple[LCurvePoint, ...], readings: tuple[_Reading, ...]
) -> None:
    weight = np.array([point.weight for point in points])
    mean_mm = np.array([point.mean_mm for point in points])
    axes.plot(weight, mean_mm, color=BLUE, marker="o")
    ends = [*weight, *(reading.weight for reading in readings)]
    plain_log(axes, "x", min(ends) / 1.5, max(ends) * 1.5)
    plain_log(axes, "y", mean_mm.min() / 1.5, mean_mm.max() * 2.0)
    axes.xaxis.set_major_formatter(lambda value, _: power_of_ten(round(np.log10(value))))
    for reading in readings:
        at = _between(points, reading.weight)
        left = "beyond the weights tried" if at is None else f"remaining error {at.mean_mm:.3f} mm"
        label = f"{reading.title}, weight {reading.weight:.2g}: {left}"
        axes.axvline(reading.weight, color=reading.colour, linewidth=0.8, linestyle="--")
        axes.plot(
            [] if at is None else [reading.weight],
            [] if at is None else [at.mean_mm],
            label=label,
            **_mark(reading),
        )
    axes.set_xlabel("weight of the terms on the residuals")
    axes.set_ylabel("mean position error [mm]")
    axes.set_title("remaining error at each weight, all loads")


def _apart(points: tuple[LCurvePoint, ...]) -> list[LCurvePoint]:
    """Return points from the first on that are far enough apart to be written on."""
    places = np.log([[point.misfit, point.departure] for point in points])
    places /= np.ptp(places, axis=0) * _LABEL_SHAPE
    chosen = [0]
    for k, place in enumerate(places):
        if np.linalg.norm(place - places[chosen[-1]]) > _LABELS_APART:
            chosen.append(k)
    return [points[k] for k in chosen]


def _written(weight: float) -> str:
    """Return a weight with one figure and its power of ten."""
    power = int(np.floor(np.log10(weight)))
    mantissa = f"{weight / 10.0**power:.0f}"
    return power_of_ten(power) if mantissa == "1" else f"{mantissa}·{power_of_ten(power)}"


def _between(points: tuple[LCurvePoint, ...], weight: float) -> LCurvePoint | None:
    """Return the curve at a weight, interpolated by logarithms; None beyond its ends."""
    weights = np.array([point.weight for point in points])
    slack = 1.0 + 1e-9
    if not weights.min() / slack <= weight <= weights.max() * slack:
        return None

    def at(values: list[float]) -> float:
        return float(np.exp(np.interp(np.log(weight), np.log(weights), np.log(values))))

    return LCurvePoint(
        weight=weight,
        misfit=at([point.misfit for point in points]),
        departure=at([point.departure for point in points]),
        mean_mm=at([point.mean_mm for point in points]),
    )


def _mark(reading: _Reading) -> dict[str, Any]:
    return {
        "color": reading.colour,
        "marker": reading.marker,
        "markersize": 7.0,
        "linestyle": "none",
        "zorder": 3.0,
    }
