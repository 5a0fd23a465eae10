"""Figures with two axes: errors of every model, parameters in tolerances, poses needed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pa10cal.figures.parameter_names import written
from pa10cal.reports.blocks import Drawing
from pa10cal.reports.looks import BLUE, GREY, ORANGE, new_figure
from pa10cal.reports.model_errors import Errors
from pa10cal.reports.written import HALF_WIDTH_95
from pa10cal.results.accuracy import Parameter
from pa10cal.results.health import PosesNeeded

_ROW_PX, _ROOM_PX = 44, 110
#: Marks of a logarithmic axis, each written out: digits without their decade are not read.
_TICKS = [digit * 10.0**decade for decade in range(-4, 5) for digit in (1, 2, 5)]


def errors_drawing(every: Sequence[Errors], noise_mm: Mapping[str, float]) -> Drawing:
    """Return root mean square and largest errors of every model, fitted and held out.

    Args:
        every: errors, in the order of the rows.
        noise_mm: mean error that noise alone leaves, by which poses it is of.
    """
    smallest = min(*(each.rms_mm for each in every), *noise_mm.values(), 1e9)
    largest = max(each.peak_mm for each in every)
    ends = [math.log10(max(smallest, 1e-6)) - 0.75, math.log10(max(largest, 1e-6)) + 0.65]
    rows = len(every)
    figure = new_figure(
        _ROOM_PX + _ROW_PX * rows,
        {"type": "log", "title": {"text": "position error [mm]"}, "dtick": 1, "range": ends},
        {"range": [rows - 0.4, -0.75], "visible": False},
    )
    for row, each in enumerate(every):
        figure.add_annotation(
            text=f"{each.poses}, {each.model}",
            xref="paper",
            x=0,
            xanchor="left",
            y=row,
            yshift=19,
            showarrow=False,
        )
        figure.add_scatter(
            x=[each.rms_mm, each.peak_mm],
            y=[row, row],
            mode="lines",
            line={"color": GREY, "width": 1},
            hoverinfo="skip",
            showlegend=False,
        )
    looks = (
        ("root mean square", "circle", BLUE, "rms_mm", "middle left"),
        ("largest", "triangle-right", ORANGE, "peak_mm", "middle right"),
    )
    for name, symbol, color, key, side in looks:
        values = [getattr(each, key) for each in every]
        figure.add_scatter(
            x=values,
            y=list(range(rows)),
            mode="markers+text",
            marker={"color": color, "size": 10, "symbol": symbol},
            text=[f" {value:.3f} " for value in values],
            textposition=side,
            name=name,
            hovertemplate=f"{name} %{{x:.4f}} mm<extra></extra>",
        )
    noisy = [
        (row, noise_mm[each.poses]) for row, each in enumerate(every) if each.poses in noise_mm
    ]
    if noisy:
        figure.add_scatter(
            x=[mm for _, mm in noisy],
            y=[row for row, _ in noisy],
            mode="markers",
            marker={"color": GREY, "size": 12, "symbol": "line-ns", "line": {"width": 2}},
            name="noise alone, mean",
            hovertemplate="noise alone, mean %{x:.4f} mm<extra></extra>",
        )
    return Drawing(
        figure,
        "Position error of every model",
        "Circles: root mean square; triangles: largest; upright strokes: mean error that noise "
        "alone leaves. The scale is logarithmic. The table below has the numbers.",
        "errors",
    )


def tolerances_drawing(parameters: Mapping[str, Parameter]) -> Drawing | None:
    """Return departures of the links in units of their tolerances, with 95 % intervals."""
    shown = {
        name: each
        for name, each in parameters.items()
        if name.startswith("delta_") and each.tolerance and each.identifiable and each.std
    }
    if not shown:
        return None
    figure = new_figure(
        _ROOM_PX + 18 * len(shown),
        {"title": {"text": "departure / tolerance"}, "zeroline": True},
        {"autorange": "reversed", "type": "category", "dtick": 1},
    )
    figure.add_vrect(x0=-1, x1=1, fillcolor=GREY, opacity=0.18, line_width=0)
    figure.add_scatter(
        x=[each.value / (each.tolerance or 1.0) for each in shown.values()],
        y=[written(name) for name in shown],
        error_x={
            "array": [
                HALF_WIDTH_95 * (each.std or 0.0) / (each.tolerance or 1.0)
                for each in shown.values()
            ],
            "color": BLUE,
            "thickness": 2,
            "width": 4,
        },
        mode="markers",
        marker={"color": BLUE, "size": 7},
        showlegend=False,
        hovertemplate="%{y}: %{x:.2f} tolerances<extra></extra>",
    )
    return Drawing(
        figure,
        "Departures of the links, in tolerances",
        "Bars are 95 % intervals, often shorter than the mark; the grey band is within the "
        "tolerance. The table below has the numbers.",
        "tolerances",
    )


def poses_drawing(poses: PosesNeeded) -> Drawing | None:
    """Return the uncertainty to be expected by number of poses, and the one that is enough."""
    if len(poses.expected) < 2:
        return None
    counts = [each.poses for each in poses.expected]
    ticks = {"type": "log", "tickmode": "array"}
    shown = {"tickvals": _TICKS, "ticktext": [f"{tick:g}" for tick in _TICKS]}
    figure = new_figure(
        340,
        {"title": {"text": "poses"}, **ticks, **shown},
        {"title": {"text": "expected uncertainty [mm]"}, **ticks, **shown},
    )
    series = (
        ("best poses first", [e.u_optimal_mm for e in poses.expected], BLUE, "circle", "solid"),
        ("in the order measured", [e.u_measured_mm for e in poses.expected], ORANGE, "x", "dash"),
    )
    for name, values, color, symbol, dash in series:
        figure.add_scatter(
            x=counts,
            y=values,
            mode="lines+markers",
            name=name,
            line={"color": color, "dash": dash},
            marker={"symbol": symbol, "size": 7},
            hovertemplate="%{x} poses: %{y:.4f} mm<extra></extra>",
        )
    figure.add_hline(y=poses.u_needed_mm, line={"color": GREY, "width": 2, "dash": "dot"})
    return Drawing(
        figure,
        "Uncertainty of a prediction by number of poses",
        f"Solid with circles: the most informative poses first; dashed with crosses: as measured. "
        f"The dotted line, {poses.u_needed_mm:.3f} mm, is enough.",
        "poses-needed",
    )
