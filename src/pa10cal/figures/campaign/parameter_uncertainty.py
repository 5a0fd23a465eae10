"""Every parameter with its uncertainty, beside Table I of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.arrays import Array
from pa10cal.figures.parameter_names import K_CUB, K_LIN, LINKS, Kind, joints_of, std_of
from pa10cal.figures.registry import Picture
from pa10cal.figures.repeats import incompleteness, scatter_by_load
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PAPER,
    VERMILLION,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.results.calibration import PaperCalibrationRecord

PICTURE = Picture(
    title="Parameters and their uncertainty",
    needs=("papers_calibration", "poses"),
    caption="""
Parameters of ``{name}`` from all loads together, beside Table I of the paper (diamonds). Above
left, departures of the links from nominal in units of their manufacturing tolerance. Above
right, half the 95 % interval (blue), and how much the estimate changes with the choice of the
poses that determine the base frame (orange). Where orange is much larger than blue, the model
lacks an effect and the interval is too small. Parameters in red are not identifiable: they
cannot be separated from the base frame, and their tolerance alone determines them. Below,
stiffness and base frame. The paper's values belong to the arm that its authors measured. The
arm of the shipped campaign lightcap2008 is simulated with Table I, so a difference there is an
estimation error.
""",
)


_HALF_WIDTH_95 = 1.96
_OPEN = VERMILLION
_FOUND: dict[str, Any] = {"color": BLUE, "marker": "o"}
_UNIDENTIFIABLE: dict[str, Any] = {"color": _OPEN, "marker": "s", "markerfacecolor": "white"}
_ROW_MM = 3.8
#: Room for what is said of the model below the legend.
_NOTE_MM = 8.0
_BELOW_MM = 72.0 + _NOTE_MM
_ABOVE_MM = 10.0
_TITLE = "Parameters from all loads together, with 95 % intervals, beside Table I of the paper"


@dataclass(frozen=True)
class _Row:
    """Where a link parameter is drawn, counted downward."""

    y: int
    kind: Kind
    joint: int

    @property
    def name(self) -> str:
        return self.kind.name(self.joint)


def draw(results: Results) -> Figure:
    """Draw departures in units of their tolerance, stiffness, and the base frame."""
    case = results.calibration()
    headings, rows = _lay_out(list(case.parameters))
    height = _ROW_MM * (len(headings) + len(rows) + 0.5)
    total = _BELOW_MM + height + _ABOVE_MM
    figure = new_figure(total, _TITLE)
    values = panel(figure, 14.0, _BELOW_MM, 82.0, height)
    widths = panel(figure, 106.0, _BELOW_MM, 61.0, height)
    _draw_values(values, headings, rows, case, results)
    _draw_widths(widths, rows, case)
    for axes in (values, widths):
        axes.set_ylim(len(headings) + len(rows) - 0.5, -0.7)
        axes.set_yticks([row.y for row in rows], [row.kind.written(row.joint) for row in rows])
        axes.tick_params(axis="y", length=0.0)
    widths.tick_params(labelleft=False)
    for label, row in zip(values.yaxis.get_ticklabels(), rows, strict=True):
        label.set_color(BLACK if case.parameters[row.name].identifiable else _OPEN)
    bottom, tall = 29.0 + _NOTE_MM, 25.0
    _draw_stiffness(panel(figure, 22.0, bottom, 40.0, tall), K_LIN, case, results)
    _draw_stiffness(panel(figure, 76.0, bottom, 40.0, tall), K_CUB, case, results)
    _draw_base(panel(figure, 137.0, bottom, 30.0, tall), case)
    figure.legend(
        handles=_legend(case, results),
        loc="lower left",
        bbox_to_anchor=(0.012, (6.0 + _NOTE_MM) / total),
        ncols=2,
    )
    lacking = incompleteness(case, scatter_by_load(results.places()))
    if lacking is not None:
        write_text_at(figure, 2.0, 6.0, lacking.replace(": ", ":\n"))
    return figure


def _lay_out(names: list[str]) -> tuple[dict[int, Kind], list[_Row]]:
    """Return the places of the headings, one a kind of link parameter, and of the parameters."""
    headings: dict[int, Kind] = {}
    rows: list[_Row] = []
    for kind in LINKS:
        joints = joints_of(kind, names)
        top = len(headings) + len(rows)
        if joints:
            headings[top] = kind
        rows += [_Row(top + k, kind, joint) for k, joint in enumerate(joints, start=1)]
    return headings, rows


def _draw_values(
    axes: Axes,
    headings: dict[int, Kind],
    rows: list[_Row],
    case: PaperCalibrationRecord,
    results: Results,
) -> None:
    _draw_parameters(
        axes,
        [row.name for row in rows],
        np.array([row.y for row in rows]),
        np.array([_tolerance(case, row) for row in rows]),
        case,
        results,
    )
    for y, kind in headings.items():
        first = next(row for row in rows if row.kind is kind)
        tolerance = kind.scale * _tolerance(case, first)
        said = f"{kind.title} {kind.symbol}, tolerance {tolerance:g} {kind.unit}"
        bare = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        write_beside(axes, y + 0.1, said, 0.01, color=GREY, bbox=bare)
    axes.axvline(0.0, color=GREY, linewidth=0.6)
    axes.set_xlabel("departure from nominal / tolerance")


def _draw_widths(axes: Axes, rows: list[_Row], case: PaperCalibrationRecord) -> None:
    known = [row for row in rows if case.parameters[row.name].identifiable]
    y = [row.y for row in known]
    per_tolerance = _HALF_WIDTH_95 / np.array([_tolerance(case, row) for row in known])
    half = per_tolerance * [std_of(case.parameters[row.name]) for row in known]
    spread = per_tolerance * [case.inner_dependence.std[row.name] for row in known]
    axes.plot(spread, y, color=ORANGE, marker="^", linestyle="none")
    axes.plot(half, y, color=BLUE, marker="o", linestyle="none")
    for row in rows:
        if row not in known:
            write_beside(axes, row.y, "not identifiable: set by the tolerance", 0.03, color=_OPEN)
    shown = np.concatenate([half, spread])
    shown = shown[shown > 0.0]
    if len(shown):
        plain_log(axes, "x", shown.min() / 1.5, shown.max() * 1.5)
    axes.set_xlabel("half width of the 95 % interval / tolerance")


def _tolerance(case: PaperCalibrationRecord, row: _Row) -> float:
    """Return the tolerance of a link parameter; every one has one."""
    return case.parameters[row.name].tolerance or 1.0


def _draw_parameters(
    axes: Axes,
    names: list[str],
    y: Array,
    unit: Array,
    case: PaperCalibrationRecord,
    results: Results,
) -> None:
    """Draw values with their intervals, and the paper's values behind them.

    Args:
        axes: to draw into.
        names: of n parameters.
        y: (n,) where each is drawn.
        unit: (n,) what each is measured in.
        case: the calibration.
        results: gives the paper's values.
    """
    parameters = [case.parameters[name] for name in names]
    value = np.array([parameter.value for parameter in parameters]) / unit
    half = _HALF_WIDTH_95 * np.array([std_of(parameter) for parameter in parameters]) / unit
    is_open = np.array([not parameter.identifiable for parameter in parameters], dtype=bool)
    at_bound = np.array([parameter.at_bound for parameter in parameters], dtype=bool) & ~is_open
    for rows, look in (
        (~is_open & ~at_bound, _FOUND),
        (at_bound, _FOUND | {"markerfacecolor": "white"}),
        (is_open, _UNIDENTIFIABLE),
    ):
        if rows.any():
            axes.errorbar(
                value[rows], y[rows], xerr=half[rows], linestyle="none", capsize=2.0, **look
            )
    stated = np.array([results.published(name) for name in names], dtype=float)
    axes.plot(stated / unit, y, linestyle="none", zorder=1.9, **PAPER)


def _draw_stiffness(axes: Axes, kind: Kind, case: PaperCalibrationRecord, results: Results) -> None:
    joints = joints_of(kind, list(case.parameters))
    axes.set_title(kind.title)
    if not joints:
        axes.text(0.5, 0.5, "all joints held rigid", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    names = [kind.name(joint) for joint in joints]
    y = np.arange(len(joints), dtype=float)
    _draw_parameters(axes, names, y, np.full(len(joints), 1.0 / kind.scale), case, results)
    for name, at in zip(names, y, strict=True):
        spread = _HALF_WIDTH_95 * case.inner_dependence.std[name]
        # A stiffness is not negative, whatever its spread.
        ends = np.maximum(case.parameters[name].value + np.array([-spread, spread]), 0.0)
        axes.plot(kind.scale * ends, [at + 0.3, at + 0.3], color=ORANGE, linewidth=2.0)
    labels = [
        f"joint {joint}" + ("\nat bound" if case.parameters[kind.name(joint)].at_bound else "")
        for joint in joints
    ]
    name_rows(axes, labels, 0.6)
    axes.set_xlabel(f"{kind.symbol} [{kind.unit}]")


def _draw_base(axes: Axes, case: PaperCalibrationRecord) -> None:
    """Draw the half widths of the base frame's intervals; the paper states no values."""
    shown = {
        "x [µm]": "base_p_cmm_x",
        "y [µm]": "base_p_cmm_y",
        "z [µm]": "base_p_cmm_z",
        "γx [µrad]": "gamma_x",
        "γy [µrad]": "gamma_y",
        "γz [µrad]": "gamma_z",
    }
    half = [1e6 * _HALF_WIDTH_95 * std_of(case.parameters[name]) for name in shown.values()]
    axes.plot(half, range(len(shown)), color=BLUE, marker="o", linestyle="none")
    name_rows(axes, list(shown))
    axes.set_xlim(0.0, 1.15 * max(half))
    axes.set_title("base frame")
    axes.set_xlabel("half width of interval")


def _legend(case: PaperCalibrationRecord, results: Results) -> list[Line2D]:
    choices = case.inner_dependence.choices
    entries: list[tuple[str, dict[str, Any]]] = [
        ("found, with 95 % interval", _FOUND | {"linestyle": "-"}),
        ("not identifiable from the poses", _UNIDENTIFIABLE | {"linestyle": "-"}),
        (
            f"1.96 × spread over {choices} choices of inner poses",
            {"color": ORANGE, "marker": "^", "linestyle": "-"},
        ),
    ]
    if results.is_paper_arm:
        entries.append(("the paper's arm (Table I)", PAPER | {"linestyle": "none"}))
    return [Line2D([], [], label=label, **look) for label, look in entries]
