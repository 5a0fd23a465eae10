"""Cost of the tolerance terms: the L-curve, and the remaining error at each weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    VERMILLION,
    new_figure,
    panel,
    plain_log,
    power_of_ten,
    write_text_at,
)
from pa10cal.results.calibration import LCurvePoint

PICTURE = Picture(
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


def draw(results: Results) -> Figure:
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
