"""Figures with two axes: errors of every model, parameters in tolerances, poses needed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from plotly import graph_objects as go
from plotly.offline import get_plotlyjs

from pa10cal.figures.table import written
from pa10cal.reports.blocks import HALF_WIDTH_95, Drawing
from pa10cal.reports.gathered import Gathered
from pa10cal.results.calibration import CalibrationRecord, GeneralErrors
from pa10cal.results.evaluation import Accuracy, Parameter
from pa10cal.results.health import PosesNeeded

# How figures of the page look: readable on light and dark ground, told by more than colour.

#: A grey with the same contrast to a light and to a dark ground.
GREY = "#7d7d7d"
_GRID = "rgba(128,128,128,0.35)"
_CLEAR = "rgba(0,0,0,0)"
#: Told apart without colour vision and on either ground.
BLUE, ORANGE, GREEN, PURPLE = "#2b83d0", "#d9720b", "#129a74", "#a96fc4"
_FONT = {"family": "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif", "size": 13}
_AXIS = {"gridcolor": _GRID, "zerolinecolor": GREY, "linecolor": GREY, "tickcolor": GREY}
#: No button that leads elsewhere; only figures that can be turned have some.
_CONFIG = {"responsive": True, "displaylogo": False, "scrollZoom": False, "displayModeBar": False}
_CONFIG_IN_SPACE = {
    **_CONFIG,
    "displayModeBar": True,
    "modeBarButtons": [
        ["orbitRotation", "pan3d", "zoom3d", "resetCameraDefault3d"],
        ["toImage"],
    ],
}


def new_figure(height: int, x: dict[str, Any], y: dict[str, Any], **layout: Any) -> Any:
    """Return an empty figure with two axes.

    Args:
        height: in pixels; the width is that of the page.
        x, y: what the axes are given besides their looks.
        layout: anything else of plotly's layout.
    """
    return go.Figure(
        layout={
            **_ground(height),
            "margin": {"l": 10, "r": 10, "t": 30, "b": 10},
            "dragmode": False,
            "xaxis": {**_AXIS, "automargin": True, "showline": True, "ticks": "outside", **x},
            "yaxis": {**_AXIS, "automargin": True, **y},
            **layout,
        }
    )


def new_space(height: int, ranges_mm: NDArray[np.float64]) -> Any:
    """Return an empty figure in three dimensions, that can be turned.

    Args:
        height: in pixels; the width is that of the page.
        ranges_mm: (3, 2) ends of the axes.
    """
    axis = {
        "gridcolor": GREY,
        "zerolinecolor": GREY,
        "showbackground": False,
        "showspikes": False,
        "color": GREY,
        "nticks": 6,
    }
    scene = {
        f"{name}axis": {**axis, "title": {"text": f"{name} [mm]"}, "range": ends.tolist()}
        for name, ends in zip("xyz", ranges_mm, strict=True)
    }
    camera = {"eye": {"x": 1.4, "y": -1.4, "z": 0.85}, "center": {"x": 0, "y": 0, "z": -0.12}}
    return go.Figure(
        layout={
            **_ground(height),
            "margin": {"l": 0, "r": 0, "t": 30, "b": 0},
            "modebar": {"bgcolor": _CLEAR, "color": GREY, "activecolor": BLUE},
            "scene": {**scene, "aspectmode": "data", "camera": camera, "dragmode": "turntable"},
        }
    )


def _ground(height: int) -> dict[str, Any]:
    return {
        "template": "none",
        "height": height,
        "autosize": True,
        "paper_bgcolor": _CLEAR,
        "plot_bgcolor": _CLEAR,
        "font": {**_FONT, "color": GREY},
        "legend": {
            "orientation": "h",
            "y": 1.0,
            "yanchor": "bottom",
            "x": 0,
            "bgcolor": _CLEAR,
            "itemsizing": "constant",
        },
        "hoverlabel": {"font": {"size": 13}},
    }


def drawn(drawing: Drawing) -> Markup:
    """Return a figure as it stands in the page, without the library."""
    return Markup(
        drawing.figure.to_html(
            include_plotlyjs=False,
            full_html=False,
            div_id=drawing.id,
            config=_CONFIG_IN_SPACE if drawing.in_space else _CONFIG,
            default_width="100%",
            default_height=f"{drawing.figure.layout.height}px",
        )
    )


def library() -> Markup:
    """Return plotly's own code, which stands in the page once."""
    return Markup(get_plotlyjs())


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


# Errors of every model over fitted and held-out poses.

UNCALIBRATED, CALIBRATED, EXTENDED = "not calibrated", "calibrated", "with the effects found"
FITTED, HELD_OUT = "fitted", "held out"
_SPRINGS = {
    "geometry": "calibrated, geometry alone",
    "linear": "calibrated, linear springs",
    "cubic": "calibrated, cubic springs",
}


@dataclass(frozen=True)
class Errors:
    """Errors of one model over some configurations."""

    poses: str  # `fitted` or `held out`
    load: str  # `all`, or a load such as `22N`
    model: str  # as readers see it
    # rms_mm, peak_mm and mean_mm: position error
    rms_mm: float
    peak_mm: float
    mean_mm: float
    orientation_deg: float | None  # mean orientation error; None where no attitude is measured
    configurations: int  # how many

    @property
    def kind(self) -> str:
        """Return which poses they are of, as it stands before a noun."""
        return self.poses.replace(" ", "-")


def errors_of(found: Gathered) -> list[Errors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(found), *_held_out(found)]
    return [each for each in every if each.load == "all"] + [
        each for each in every if each.load != "all"
    ]


def headline(found: Gathered) -> tuple[Errors, Errors] | None:
    """Return the errors before and after that count: held out where there are such poses."""
    every = [each for each in errors_of(found) if each.load == "all"]
    for poses in (HELD_OUT, FITTED):
        of = [each for each in every if each.poses == poses]
        if of:
            return of[0], of[-1]
    return None


def model_title(name: str, found: Gathered, beside: Iterable[str]) -> str | None:
    """Return what readers call a model; None of one that is the calibrated one once more.

    Args:
        name: in the records.
        found: what was gathered.
        beside: names of the models that it is compared with.
    """
    if name == "extended":
        return EXTENDED if found.verdict is None or found.verdict.effects else None
    if name == "uncalibrated":
        return UNCALIBRATED
    return _SPRINGS.get(name, name) if {"geometry", "cubic"} & set(beside) else CALIBRATED


def _fitted(found: Gathered) -> Iterator[Errors]:
    if (record := found.calibration) is None:
        return
    yield from _over(FITTED, UNCALIBRATED, {k: e.before for k, e in record.errors.items()})
    geometry = {k: e.geometry for k, e in record.errors.items() if isinstance(e, GeneralErrors)}
    if geometry and _has_springs(record):
        yield from _over(FITTED, _SPRINGS["geometry"], geometry)
    yield from _over(FITTED, _last_title(record), {k: e.after for k, e in record.errors.items()})
    if found.verdict is not None and found.verdict.effects:
        gap = found.verdict.gap.train
        yield _errors(FITTED, "all", EXTENDED, gap.after)
        for load, part in gap.per_load.items():
            yield _errors(FITTED, load, EXTENDED, part.after)


def _held_out(found: Gathered) -> Iterator[Errors]:
    if found.held_out is None:
        return
    for name, model in found.held_out.models.items():
        title = model_title(name, found, found.held_out.models)
        if title is None:
            continue
        yield _errors(HELD_OUT, "all", title, model)
        for load, part in model.per_load.items():
            yield _errors(HELD_OUT, load, title, part)


def _has_springs(record: CalibrationRecord) -> bool:
    return bool(getattr(record, "springs", True))


def _last_title(record: CalibrationRecord) -> str:
    if record.model == "paper":
        return _SPRINGS["cubic"]
    return _SPRINGS["linear"] if _has_springs(record) else CALIBRATED


def _errors(poses: str, load: str, model: str, of: Accuracy) -> Errors:
    return Errors(
        poses,
        load,
        model,
        of.rms_mm,
        of.peak_mm,
        of.mean_mm,
        of.orientation_deg,
        of.configurations,
    )


def _over(poses: str, model: str, by_load: Mapping[str, Accuracy]) -> Iterator[Errors]:
    """Yield errors over all loads together, then at each."""
    parts = list(by_load.values())
    count_of = sum(part.configurations for part in parts)

    def mean(values: Iterable[float]) -> float:
        pairs = zip(values, parts, strict=True)
        return sum(value * part.configurations for value, part in pairs) / count_of

    if count_of:
        angles = [part.orientation_deg for part in parts if part.orientation_deg is not None]
        yield Errors(
            poses,
            "all",
            model,
            mean(part.rms_mm**2 for part in parts) ** 0.5,
            max(part.peak_mm for part in parts),
            mean(part.mean_mm for part in parts),
            mean(angles) if len(angles) == len(parts) else None,
            count_of,
        )
    for load, part in by_load.items():
        yield _errors(poses, load, model, part)
