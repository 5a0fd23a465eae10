"""Figures with two axes: parameters in tolerances, shares of errors, motion, poses needed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pa10cal.reports import theme
from pa10cal.reports.blocks import Drawing
from pa10cal.reports.formatting import written
from pa10cal.results.evaluation import HoldoutRecord, Parameter
from pa10cal.results.health import PosesNeeded
from pa10cal.results.record import HALF_WIDTH_95

if TYPE_CHECKING:
    import pandas as pd

_ROOM_PX = 110
#: Marks of a logarithmic axis, each written out: digits without their decade are not read.
_TICKS = [digit * 10.0**decade for decade in range(-4, 5) for digit in (1, 2, 5)]


def tolerances_drawing(
    parameters: Mapping[str, Parameter], before: Mapping[str, float]
) -> Drawing | None:
    """Return departures of the links in units of their tolerances, with 95 % intervals.

    Args:
        parameters: of the final model.
        before: values before effects joined the model, where some did.
    """
    shown = {
        name: (each, each.tolerance)
        for name, each in parameters.items()
        if name.startswith("delta_") and each.tolerance and each.identifiable and each.std
    }
    if not shown:
        return None
    figure = theme.new_figure(
        _ROOM_PX + 18 * len(shown),
        {"title": {"text": "departure from nominal / tolerance"}, "zeroline": True},
        {"autorange": "reversed", "type": "category", "dtick": 1},
    )
    figure.add_vrect(x0=-1, x1=1, fillcolor=theme.GREY, opacity=0.18, line_width=0)
    half = [HALF_WIDTH_95 * (each.std or 0.0) / tolerance for each, tolerance in shown.values()]
    series = [("final model", [e.value / t for e, t in shown.values()], theme.BLUE, "circle", half)]
    if moved := [name for name in shown if name in before]:
        values = [before[name] / shown[name][1] for name in moved]
        series.insert(0, ("without the effects", values, theme.VERMILLION, "square-open", []))
    for name, values, color, symbol, bars in series:
        figure.add_scatter(
            x=values,
            y=[written(key) for key in (shown if bars else moved)],
            error_x={"array": bars, "color": color, "thickness": 2, "width": 4} if bars else None,
            mode="markers",
            marker={"color": color, "size": 7, "symbol": symbol},
            name=name,
            showlegend=len(series) > 1,
            hovertemplate=f"%{{y}}: %{{x:.2f}} tolerances<extra>{name}</extra>",
        )
    squares = "Squares: the model without the effects, which absorbed part of them. "
    return Drawing(
        figure,
        "Departures of the links, in tolerances",
        "Bars are 95 % intervals, often shorter than the mark; the grey band is within the "
        f"tolerance. {squares if moved else ''}The tables below have the numbers.",
        "tolerances",
    )


#: Of more poses only so many steps of a distribution are drawn.
_MOST_STEPS = 100
_DASHES = {"uncalibrated": "solid", "geometry": "dash", "linear": "dashdot"}


def shares_drawing(held_out: HoldoutRecord, titles: Mapping[str, str], unit: str) -> Drawing | None:
    """Return which share of the held-out poses errs by less than so much, under each model.

    Args:
        held_out: errors of the models.
        titles: models to draw, as readers see them.
        unit: `mm` of positions, `deg` of orientations.
    """
    what = {"mm": "position", "deg": "orientation"}[unit]
    figure = theme.new_figure(
        360,
        {"type": "log", "title": {"text": f"{what} error [{unit}]"}, "dtick": 1},
        {"title": {"text": "share of the poses [%]"}, "range": [0, 102]},
    )
    for name, title in titles.items():
        rows = held_out.models[name].rows
        errors = rows.error_mm
        if unit == "deg":
            if rows.rotation_deg is None:
                return None
            errors = np.linalg.norm(rows.rotation_deg, axis=1)
        beyond = rows.extrapolated
        if beyond is None or not beyond.any() or beyond.all():
            beyond = np.zeros(len(rows), dtype=bool)
        for apart in (False, True) if beyond.any() else (False,):
            ordered = np.sort(errors[beyond == apart])
            count = len(ordered)
            rank = np.unique(np.linspace(1, count, min(count, _MOST_STEPS)).round().astype(int))
            figure.add_scatter(
                x=_short(ordered[rank - 1]),
                y=(100.0 * rank / count).round(2).tolist(),
                mode="lines",
                line={
                    "color": theme.MODELS[name],
                    "dash": "dot" if apart else _DASHES.get(name, "solid"),
                    "shape": "hv",
                },
                name=f"{title}{', extrapolated' if apart else ''} ({count})",
                hovertemplate=f"%{{y:.0f}} % below %{{x:.4g}} {unit}<extra></extra>",
            )
    return Drawing(
        figure,
        f"Distribution of the {what} errors of held-out poses",
        "For each model, the share of the held-out poses with a smaller error; in brackets how "
        "many poses. Dotted: poses beyond the joint angles of the fit.",
        f"shares-{what}",
    )


#: Motion of the base: unit shown, columns of the table of poses, their scale and first covariance.
_MOTIONS = {
    "shift": ("mm", "motion_{}_mm", 1.0, 0),
    "turn": ("mrad", "motion_r{}_rad", 1e3, 3),
}


def motion_drawing(poses: pd.DataFrame, word: str, knocks_s: Sequence[float]) -> Drawing:
    """Return the motion that targets on the base show, over time, with two standard uncertainties.

    Args:
        poses: the table of poses, with columns `motion_…`.
        word: `shift` or `turn`.
        knocks_s: when a target moved against the others.
    """
    unit, column, scale, at = _MOTIONS[word]
    first = poses["time_s"].min()
    hours = ((poses["time_s"] - first) / 3600.0).round(4).tolist()
    figure = theme.new_figure(
        320, {"title": {"text": "time [h]"}}, {"title": {"text": f"{word} [{unit}]"}}
    )
    looks = (("x", theme.BLUE, "solid"), ("y", theme.VERMILLION, "dash"), ("z", theme.GREEN, "dot"))
    for k, (name, color, dash) in enumerate(looks):
        value = scale * poses[column.format(name)].to_numpy()
        u = scale * np.sqrt(poses[f"motion_cov_{at + k}{at + k}"].to_numpy())
        figure.add_scatter(
            x=[*hours, *reversed(hours)],
            y=_short((*(value - 2 * u), *(value + 2 * u)[::-1])),
            fill="toself",
            opacity=0.2,
            line={"width": 0},
            fillcolor=color,
            mode="lines",
            hoverinfo="skip",
            showlegend=False,
        )
        figure.add_scatter(
            x=hours,
            y=_short(value),
            mode="lines",
            line={"color": color, "dash": dash, "width": 1.5},
            name=name,
            hovertemplate=f"{word} {name} %{{y:.4g}} {unit}<extra></extra>",
        )
    for knock_s in knocks_s:
        figure.add_vline(
            (knock_s - first) / 3600.0, line={"color": theme.PURPLE, "dash": "longdash"}
        )
    return Drawing(
        figure,
        f"Motion of the instrument against targets on the base: {word}",
        "About its mean, along the instrument's axes; bands of two standard uncertainties. All "
        "readings were turned back by it. Upright dashes: a target moved against the others.",
        f"base-motion-{word}",
    )


def _short(values: Iterable[float]) -> list[float]:
    """Return values with four figures, which keep a page small."""
    return [float(f"{value:.4g}") for value in values]


def poses_drawing(poses: PosesNeeded) -> Drawing | None:
    """Return the uncertainty to be expected by number of poses, and the one that is enough."""
    if len(poses.expected) < 2:
        return None
    counts = [each.poses for each in poses.expected]
    ticks: dict[str, Any] = {"type": "log", "tickmode": "array"}
    ticks |= {"tickvals": _TICKS, "ticktext": [f"{tick:g}" for tick in _TICKS]}
    figure = theme.new_figure(
        340,
        {"title": {"text": "poses"}, **ticks},
        {"title": {"text": "expected uncertainty [mm]"}, **ticks},
    )
    for name, key, color, symbol, dash in (
        ("best poses first", "u_optimal_mm", theme.BLUE, "circle", "solid"),
        ("in the order measured", "u_measured_mm", theme.VERMILLION, "x", "dash"),
    ):
        figure.add_scatter(
            x=counts,
            y=[getattr(each, key) for each in poses.expected],
            mode="lines+markers",
            name=name,
            line={"color": color, "dash": dash},
            marker={"symbol": symbol, "size": 7},
            hovertemplate="%{x} poses: %{y:.4f} mm<extra></extra>",
        )
    figure.add_hline(y=poses.u_needed_mm, line={"color": theme.GREY, "width": 2, "dash": "dot"})
    return Drawing(
        figure,
        "Uncertainty of a prediction by number of poses",
        f"Solid with circles: the most informative poses first; dashed with crosses: as measured. "
        f"The dotted line, {poses.u_needed_mm:.3f} mm, "
        + (
            "adds hardly anything to the remaining error."
            if poses.wanted_mm is None
            else "is wanted."
        ),
        "poses-needed",
    )
