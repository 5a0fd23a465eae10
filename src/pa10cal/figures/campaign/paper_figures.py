"""Figures 4, 5 and 6 of the paper: test path, errors at each load, and of held-out poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from pa10cal.arrays import Array
from pa10cal.figures import published, style
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import COMBINED, PLACE_MM, Results
from pa10cal.reports import theme
from pa10cal.reports.formatting import written_load
from pa10cal.results.evaluation import Accuracy, HeldOutModel, HoldoutRecord

#: How the places of each kind are drawn, in space, and what is smaller in a view of them.
_LOOKS: dict[str, dict[str, Any]] = {
    "grid": {"color": theme.BLUE, "marker": "o", "linewidth": 0.8},
    "holdout": {"color": theme.VERMILLION, "marker": "^", "linestyle": "none"},
    "line_x": {"color": theme.GREEN, "marker": ".", "linewidth": 1.4},
    "line_y": {"color": theme.ORANGE, "marker": ".", "linewidth": 1.4},
}
_IN_A_VIEW: dict[str, dict[str, Any]] = {
    "grid": {"markersize": 2.5, "linewidth": 0.6},
    "holdout": {},
    "line_x": {"markersize": 2.0},
    "line_y": {"markersize": 2.0},
}
_AXIS_LENGTH_MM = 150.0
_MARGIN_MM = 60.0


@picture(
    title="Fig. 4: test path",
    needs=("papers_calibration", "poses", "base_frame"),
    section="measured",
    caption="""
Where the arm was measured in ``{name}``, in the robot's base frame (Fig. 4 of the paper). Blue:
calibration poses, joined in the order measured. Red triangles: held-out poses, which no fit
uses; some lie outside the calibrated volume. Green and orange: the two straight moves along the
x and y axes of the robot, from which the base frame is first estimated. Every position was
measured in the instrument's frame and transformed with that estimate. The picture therefore
shows where the arm went, not how accurate it was.
""",
)
def draw_fig4_test_path(results: Results) -> Figure:
    """Draw the first pass over the grid, the held-out places and the straight-line moves."""
    p_base_mm = _first_visits(results.places(), results.base_frame())
    figure = style.new_figure(
        128.0, "Experimental test path in the robot's base frame (compare Fig. 4 of the paper)"
    )
    _draw_space(style.panel(figure, 2.0, 29.0, 110.0, 94.0, projection="3d"), p_base_mm)
    _draw_view(style.panel(figure, 119.0, 76.0, 48.0, 38.0), p_base_mm, [0, 1], "From above")
    _draw_view(style.panel(figure, 119.0, 15.0, 48.0, 46.0), p_base_mm, [0, 2], "From the side")
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.055), ncols=2)
    return figure


def _first_visits(poses: pd.DataFrame, T_instr_base: Array) -> dict[str, Array]:
    """Return where each pose was first measured [mm] in the base frame, (N, 3) by kind."""

    def of_kind(kind: str) -> Array:
        first = poses[poses["kind"] == kind].drop_duplicates("pose")
        p_instr_mm = first[list(PLACE_MM)].to_numpy()
        return np.asarray((p_instr_mm - 1e3 * T_instr_base[:3, 3]) @ T_instr_base[:3, :3])

    return {kind: of_kind(kind) for kind in _LOOKS}


def _draw_space(axes: Any, p_base_mm: dict[str, Array]) -> None:
    grid = p_base_mm["grid"]
    names = {
        "grid": f"{len(grid)} calibration poses, as measured",
        "holdout": f"{len(p_base_mm['holdout'])} held-out poses",
        "line_x": "straight move along x",
        "line_y": "straight move along y",
    }
    for kind, places in p_base_mm.items():
        if len(places):
            axes.plot(*places.T, label=names[kind], **_LOOKS[kind])
    axes.text(*grid[0], "first ", ha="right", va="center", color=theme.BLUE)
    axes.text(*grid[-1], " last", ha="left", va="center", color=theme.BLUE)
    for name, tip in zip("xyz", _AXIS_LENGTH_MM * np.eye(3), strict=True):
        axes.quiver(0, 0, 0, *tip, color=theme.BLACK, linewidth=1.2, arrow_length_ratio=0.15)
        axes.text(*(1.25 * tip), name, ha="center", va="center")
    axes.plot(
        [0.0], [0.0], [0.0], color=theme.BLACK, marker="s", linestyle="none", label="robot base"
    )
    low, high = _extent(p_base_mm)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.05)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    # On the left, where no panel stands beside it.
    axes.zaxis.set_ticks_position("lower")
    axes.zaxis.set_label_position("lower")
    axes.zaxis.set_rotate_label(False)
    axes.zaxis.label.set_rotation(90.0)
    axes.view_init(elev=20.0, azim=-52.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MultipleLocator(200.0))


def _draw_view(axes: Axes, p_base_mm: dict[str, Array], seen: list[int], title: str) -> None:
    """Draw a projection along one of the base axes."""
    for kind, places in p_base_mm.items():
        axes.plot(*places[:, seen].T, **_LOOKS[kind] | _IN_A_VIEW[kind])
    axes.plot(0.0, 0.0, color=theme.BLACK, marker="s")
    axes.annotate("base", (0.0, 0.0), (4.0, 4.0), textcoords="offset points")
    (x_low, y_low), (x_high, y_high) = (corner[seen] for corner in _extent(p_base_mm))
    axes.set(xlim=(x_low, x_high), ylim=(y_low, y_high), title=title)
    axes.set_aspect("equal", adjustable="box", anchor="SW")
    axes.xaxis.set_major_locator(MultipleLocator(200.0))
    axes.yaxis.set_major_locator(MultipleLocator(200.0))
    axes.set(xlabel=f"{'xyz'[seen[0]]} [mm]", ylabel=f"{'xyz'[seen[1]]} [mm]")


def _extent(p_base_mm: dict[str, Array]) -> tuple[Array, Array]:
    """Return the corners of the box that holds all places and the base with its axes."""
    every = np.vstack(list(p_base_mm.values()))
    low = np.minimum(every.min(axis=0), 0.0) - _MARGIN_MM
    return low, np.maximum(every.max(axis=0), _AXIS_LENGTH_MM) + _MARGIN_MM


# Errors before and after calibration at each load, as Fig. 5 of the paper.

_TITLE = "Error before and after calibration, at each load (compare Fig. 5 of the paper)"
#: Where a load's columns stand about its middle.
_SLOTS = {"before": -0.28, "after": -0.01, "combined": 0.10, "repeats": 0.38}
_PAPER_ASIDE = -0.11
#: What the panel of orientations adds to the height.
_ORIENTATION_MM = 42.0
_COLOURS = {
    "before": theme.BEFORE,
    "after": theme.AFTER,
    "combined": theme.AFTER_COMBINED,
    "repeats": theme.BLACK,
}


@dataclass(frozen=True)
class _Column:
    """What stands in one column: a mean, a peak where there is one, and whose figures they are."""

    load: int
    slot: str
    mean: float
    peak: float | None
    is_paper: bool

    @property
    def x(self) -> float:
        return self.load + _SLOTS[self.slot] + (_PAPER_ASIDE if self.is_paper else 0.0)


@picture(
    title="Fig. 5: error before and after calibration",
    needs=("papers_calibration", "poses"),
    section="accuracy",
    caption="""
Position error (above) and orientation error (below) at each external load in ``{name}`` (Fig. 5
of the paper). A marker is the mean over the calibration poses, and the bar above it ends at the
largest error; both values are written beside it. Filled markers: this campaign; hollow markers:
values stated in the paper. *Before*: nominal rigid model, its base frame fitted once to the
positions at the smallest load. *After*: calibrated model, for each load alone and for all loads
together. No model can fall below the scatter of repeated measurements. The axes are
logarithmic. Agreement of a synthetic campaign with the paper says nothing about the robot that
the authors measured.
""",
)
def draw_fig5_before_after(results: Results) -> Figure:
    """Draw mean and peak position error, and mean orientation error, on logarithmic axes."""
    loads = list(results.load_cases())
    angles = _columns(results, lambda errors: (errors.orientation_deg, None))
    seen = any(not column.is_paper for column in angles)
    raised = _ORIENTATION_MM if seen else 0.0
    figure = style.new_figure(108.0 + raised, _TITLE)
    lowest = position = style.panel(figure, 23.0, 26.0 + raised, 145.0, 73.0)
    columns = _columns(results, lambda errors: (errors.mean_mm, errors.peak_mm))
    columns += _scatter_columns(results, loads)
    _draw_columns(position, columns, loads, room=(3.0, 3.0))
    position.set_ylabel("position error [mm]")
    if seen:
        lowest = style.panel(figure, 23.0, 26.0, 145.0, 32.0)
        _draw_columns(lowest, angles, loads, room=(2.5, 6.0))
        lowest.set_ylabel("orientation\nerror [deg]")
    lowest.set_xlabel("external load")
    style.legend_at(
        figure, 0.012 * style.WIDTH_MM, 6.75, _legend(results), ncols=3, columnspacing=1.2
    )
    return figure


def _columns(
    results: Results,
    shown: Callable[[Accuracy | published.PublishedError], tuple[float | None, float | None]],
) -> list[_Column]:
    """Return a column a load and model, without those whose figure was not measured."""
    combined = results.calibration()
    columns = []
    for k, (load, case) in enumerate(results.load_cases().items()):
        entries: list[tuple[str, Accuracy | published.PublishedError, bool]] = [
            ("before", case.errors[load].before, False),
            ("after", case.errors[load].after, False),
            ("combined", combined.errors[load].after, False),
        ]
        for slot, stated in (("before", published.BEFORE), ("after", published.AFTER)):
            if results.is_paper_arm and load in stated:
                entries.append((slot, stated[load], True))
        for slot, errors, is_paper in entries:
            mean, peak = shown(errors)
            if mean is not None:
                columns.append(_Column(k, slot, mean, peak, is_paper))
    return columns


def _scatter_columns(results: Results, loads: list[str]) -> list[_Column]:
    ours = {load: found.largest_per_axis_mm for load, found in results.scatter.items()}
    stated = published.REPEATABILITY_MM if results.is_paper_arm else {}
    return [
        _Column(k, "repeats", by_load[load], None, is_paper)
        for by_load, is_paper in ((ours, False), (stated, True))
        for k, load in enumerate(loads)
        if load in by_load
    ]


def _draw_columns(
    axes: Axes, columns: list[_Column], loads: list[str], room: tuple[float, float]
) -> None:
    """Draw columns with their figures above them, those before calibration below.

    Args:
        axes: logarithmic in height.
        columns: to draw.
        loads: names of the places along the axis.
        room: factors by which the axis reaches beyond the figures, below and above.
    """
    for column in columns:
        colour = _COLOURS[column.slot]
        face = "white" if column.is_paper else colour
        if column.peak is not None:
            axes.plot([column.x, column.x], [column.mean, column.peak], color=colour, linewidth=1.4)
            axes.plot(column.x, column.peak, color=colour, marker="_", markersize=7.0)
        axes.plot(
            column.x,
            column.mean,
            color=colour,
            marker="D" if column.is_paper else "o",
            markersize=5.0,
            markerfacecolor=face,
        )
        below = column.slot == "before"
        axes.annotate(
            _text(column),
            (column.x, column.mean if below else column.peak or column.mean),
            (0.0, -5.0 if below else 5.0),
            textcoords="offset points",
            rotation=90.0,
            ha="center",
            va="top" if below else "bottom",
        )
    low = min(column.mean for column in columns)
    high = max(column.peak or column.mean for column in columns)
    style.plain_log(axes, "y", low / room[0], high * room[1])
    axes.set_xlim(-0.5, len(loads) - 0.5)
    axes.set_xticks(range(len(loads)), [written_load(load) for load in loads])
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    for k in range(1, len(loads)):
        axes.axvline(k - 0.5, color=theme.SEPARATOR, linewidth=0.6)


def _text(column: _Column) -> str:
    values = [column.mean] + ([column.peak] if column.peak is not None else [])
    digits = ".2f" if column.mean >= 0.1 else ".3f"
    if column.is_paper and column.peak is None:
        digits = "g"  # as it prints them
    return " / ".join(f"{value:{digits}}" for value in values)


def _legend(results: Results) -> list[Line2D]:
    entries = [
        ("o", theme.BEFORE, theme.BEFORE, "before: nominal rigid model"),
        ("o", theme.AFTER, theme.AFTER, "after, calibrated at this load"),
        ("o", theme.AFTER_COMBINED, theme.AFTER_COMBINED, "after, all loads together"),
        ("o", theme.BLACK, theme.BLACK, "repeats, one axis (largest)"),
    ]
    if results.is_paper_arm:
        entries.append(("D", theme.BLACK, "white", "the paper's figures, same colours"))
    handles = [
        style.mark(text, color=edge, marker=marker, markerfacecolor=face)
        for marker, edge, face, text in entries
    ]
    return [
        *handles,
        style.mark("mean / peak, as written", color=theme.BLACK, marker="|", markersize=9.0),
    ]


# Errors at held-out points and loads, as Fig. 6 of the paper.

_TITLE_OF_FIG6 = (
    "Error at held-out points and loads, which no fit uses (compare Fig. 6 of the paper)"
)
_NAMES_OF_FIG6 = {
    "uncalibrated": "uncalibrated",
    "linear": "linear springs",
    "cubic": "cubic springs",
    "calibrated": "calibrated",
    "extended": "with named effects",
}
_MARKERS = {
    "uncalibrated": "^",
    "geometry": "D",
    "linear": "s",
    "cubic": "o",
    "calibrated": "o",
    "extended": "v",
}
#: More configurations than this are not named one by one.
_MOST_NAMES = 45


@picture(
    title="Fig. 6: error at held-out points and loads",
    needs=("papers_calibration", "held_out"),
    section="accuracy",
    caption="""
Errors of ``{name}`` at poses and loads that no fit uses (Fig. 6 of the paper): poses outside
the calibrated volume, and loads up to about twice the calibrated ones. Above, every
configuration, by load; below, mean and peak over all of them, with the paper's values as hollow
markers. *Uncalibrated* is the nominal rigid model; *linear* and *cubic* are the calibrated
models without and with a cubic stiffness term. An error that is larger here than in Fig. 5 is
the cost of extrapolation. Where linear and cubic springs do equally well, the data do not need
the cubic term.
""",
)
def draw_fig6_holdout(results: Results) -> Figure:
    """Draw every configuration by load, and mean and peak of each model beside the paper's."""
    held_out = results.held_out()
    case = results.calibration(held_out.calibration)  # refuses another model than the paper's
    if not held_out.models:
        raise NothingToShowError("no held-out configuration was measured")
    said = "Linear and cubic springs: as calibrated"
    if not case.has_springs:  # one model: what has no springs has no linear or cubic ones
        held_out = _of_rigid_joints(held_out)
        said = "All joints were held rigid; calibrated"
    figure = style.new_figure(146.0, _TITLE_OF_FIG6)
    single = style.panel(figure, 16.0, 81.0, 152.0, 53.0)
    _draw_configurations(single, held_out)
    load = held_out.calibration
    fitted = "all loads together" if load == COMBINED else f"{load} alone"
    style.note(figure, f"{said} with {fitted}.", 7.0)
    figure.legend(
        *single.get_legend_handles_labels(), loc="center", bbox_to_anchor=(0.5, 0.446), ncols=4
    )
    summary = style.panel(figure, 30.0, 22.0, 66.0, 32.0)
    _draw_summary(summary, held_out, results.is_paper_arm)
    return figure


def _of_rigid_joints(held_out: HoldoutRecord) -> HoldoutRecord:
    """Return the models of an arm whose joints were held rigid: one is calibrated."""
    names = {"linear": "", "cubic": "calibrated"}
    models = {names.get(name, name): model for name, model in held_out.models.items()}
    models.pop("", None)
    return held_out.model_copy(update={"models": models})


def _draw_configurations(axes: Axes, held_out: HoldoutRecord) -> None:
    # Every model is judged on the same configurations, in the same order.
    first = next(iter(held_out.models.values())).rows
    order = np.lexsort((first.pose, first.load_N))
    loads, poses = first.load_N[order], first.pose[order]
    aside = np.linspace(-0.2, 0.2, len(held_out.models))
    errors_mm = {
        name: np.linalg.norm(model.rows.position_mm[order], axis=1)
        for name, model in held_out.models.items()
    }
    for shift, (name, errors) in zip(aside, errors_mm.items(), strict=True):
        at = np.arange(len(errors)) + shift
        axes.plot(at, errors, label=_NAMES_OF_FIG6[name], **_dots(name))
        extrapolated = held_out.models[name].rows.extrapolated
        if extrapolated is not None and extrapolated.any():
            beyond = extrapolated[order]
            hollow = _dots(name) | {"markerfacecolor": "white"}
            axes.plot(at[beyond], errors[beyond], label="extrapolated", **hollow)
    lowest = min(errors.min() for errors in errors_mm.values())
    highest = max(errors.max() for errors in errors_mm.values())
    style.plain_log(axes, "y", lowest / 1.5, highest * 1.5)
    axes.set_xlim(-0.7, len(poses) - 0.3)
    axes.set_ylabel("position error [mm]")
    axes.set_xlabel("held-out configuration: pose, grouped by load")
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(poses)), poses.tolist(), rotation=90.0)
    axes.tick_params(axis="x", length=0.0, labelbottom=len(poses) <= _MOST_NAMES)
    for load in np.unique(loads):
        at = np.flatnonzero(loads == load)
        axes.text(at.mean(), 1.02, f"{load:g} N", transform=axes.get_xaxis_transform(), ha="center")
        if at[0]:
            axes.axvline(at[0] - 0.5, color=theme.SEPARATOR, linewidth=0.6)


def _draw_summary(axes: Axes, held_out: HoldoutRecord, with_paper: bool) -> None:
    """Draw mean and peak of each model, ours above the paper's."""
    paper = published.HELD_OUT if with_paper else {}
    for k, (name, model) in enumerate(held_out.models.items()):
        digits = ".2f" if model.mean_mm > 0.1 else ".3f"
        _draw_range(axes, k - 0.17, model, _text_of_model(model, digits), _dots(name))
        if name in paper:
            text = "paper: " + _text_of_model(paper[name], "g")
            look = _dots(name) | {"markerfacecolor": "white", "marker": "D"}
            _draw_range(axes, k + 0.2, paper[name], text, look, theme.GREY)
    shown: list[HeldOutModel | published.PublishedError] = [*held_out.models.values()]
    shown += paper.values()
    lowest, highest = min(e.mean_mm for e in shown), max(e.peak_mm for e in shown)
    style.plain_log(axes, "x", lowest / 1.5, highest * 1.5)
    style.name_rows(axes, [_NAMES_OF_FIG6[name] for name in held_out.models], 0.6, lines=False)
    axes.set_title(
        "Mean and peak over all held-out configurations: ours filled, the paper's hollow"
    )
    axes.set_xlabel("position error [mm], mean to peak")


def _draw_range(
    axes: Axes,
    y: float,
    errors: HeldOutModel | published.PublishedError,
    text: str,
    look: dict[str, Any],
    color: str = theme.BLACK,
) -> None:
    axes.plot([errors.mean_mm, errors.peak_mm], [y, y], color=look["color"], linewidth=1.4)
    axes.plot(errors.peak_mm, y, color=look["color"], marker="|", markersize=7.0)
    axes.plot(errors.mean_mm, y, **look)
    style.write_beside(axes, y, text, 1.03, color=color)


def _dots(name: str) -> dict[str, Any]:
    return {"color": theme.MODELS[name], "marker": _MARKERS[name], "linestyle": "none"}


def _text_of_model(errors: HeldOutModel | published.PublishedError, digits: str) -> str:
    position = f"{errors.mean_mm:{digits}} / {errors.peak_mm:{digits}} mm"
    if errors.orientation_deg is None:
        return position
    return f"{position}, orientation {errors.orientation_deg:{digits}}°"
