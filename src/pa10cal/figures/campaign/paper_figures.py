"""Figures 4, 5 and 6 of the paper: test path, errors by load and held out; its Monte Carlo."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from pa10cal.arrays import Array
from pa10cal.errors import RecordError
from pa10cal.figures import published, style
from pa10cal.figures.published import is_of_papers_arm
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.reports import theme
from pa10cal.reports.formatting import written_load
from pa10cal.reports.results_bundle import COMBINED, POSES, ResultsBundle
from pa10cal.results.calibration import BaseFrameRecord
from pa10cal.results.evaluation import Accuracy, HeldOutModel

#: How the places of each kind are drawn: in space, and what differs in a view of them.
_PATHS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "grid": (
        {"color": theme.BLUE, "marker": "o", "linewidth": 0.8},
        {"markersize": 2.5, "linewidth": 0.6},
    ),
    "holdout": ({"color": theme.VERMILLION, "marker": "^", "linestyle": "none"}, {}),
    "line_x": ({"color": theme.GREEN, "marker": ".", "linewidth": 1.4}, {"markersize": 2.0}),
    "line_y": ({"color": theme.ORANGE, "marker": ".", "linewidth": 1.4}, {"markersize": 2.0}),
}
_AXIS_LENGTH_MM = 150.0
_MARGIN_MM = 60.0
#: Columns of the table of poses that hold the measured position of the end-effector.
PLACE_MM = ("ee_x_mm", "ee_y_mm", "ee_z_mm")


def places(results: ResultsBundle) -> pd.DataFrame:
    """Return the table of poses in order of time, with the end-effector in `PLACE_MM`.

    Raises:
        RawDataError: when it cannot be used.
        RecordError: when it is missing, or the instrument measured no end-effector.
    """
    poses = results.poses
    absent = [] if poses is None else [name for name in PLACE_MM if name not in poses]
    if poses is None or absent:
        raise RecordError(
            "the table of poses has no column" if absent else "the table of poses is missing",
            where=str(results.folder / POSES),
            value=absent[0] if absent else None,
            allowed=f"a file that pa10cal ingest wrote, with {', '.join(PLACE_MM)}",
            remedy="run pa10cal ingest first",
        )
    return poses.sort_values("time_s")


def scatter_by_load(poses: pd.DataFrame) -> pd.DataFrame:
    """Return the paper's repeatability: how far repeats of one grid configuration scatter [mm].

    Standard deviations of the distance, the root of the variances along three axes together: the
    `largest` and the `mean` over the configurations, a row a load (`0N`, `22N`, …) with repeats.
    The `largest_per_axis` is nearest to the paper's scatter of a scalar error.
    """
    grid = poses[poses["kind"] == "grid"].groupby(["load_N", "pose"])
    variance = grid[list(PLACE_MM)].var(ddof=1).sum(axis=1, skipna=False)
    by_load = np.sqrt(variance).dropna().groupby(level="load_N")
    found = pd.DataFrame({"largest": by_load.max(), "mean": by_load.mean()})
    found["largest_per_axis"] = found["largest"] / np.sqrt(3.0)
    return found.rename(index=lambda load_N: f"{load_N:g}N")


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
def draw_fig4_test_path(results: ResultsBundle) -> Figure:
    """Draw the first pass over the grid, the held-out places and the straight-line moves."""
    poses, T_instr_base = places(results), results.read(BaseFrameRecord).T_instr_base
    first = poses.drop_duplicates(["kind", "pose"])
    p_base_mm = {
        kind: (
            first.loc[first["kind"] == kind, list(PLACE_MM)].to_numpy() - 1e3 * T_instr_base[:3, 3]
        )
        @ T_instr_base[:3, :3]
        for kind in _PATHS
    }
    every = np.vstack(list(p_base_mm.values()))
    low = np.minimum(every.min(axis=0), 0.0) - _MARGIN_MM
    high = np.maximum(every.max(axis=0), _AXIS_LENGTH_MM) + _MARGIN_MM
    figure = style.new_figure(
        128.0, "Experimental test path in the robot's base frame (compare Fig. 4 of the paper)"
    )
    space = style.panel(figure, 2.0, 29.0, 110.0, 94.0, projection="3d")
    _draw_space(space, p_base_mm, low, high)
    for box, seen, title in (
        ((119.0, 76.0, 48.0, 38.0), [0, 1], "From above"),
        ((119.0, 15.0, 48.0, 46.0), [0, 2], "From the side"),
    ):
        axes = style.panel(figure, *box)
        for kind, (look, in_a_view) in _PATHS.items():
            axes.plot(*p_base_mm[kind][:, seen].T, **look | in_a_view)
        axes.plot(0.0, 0.0, color=theme.BLACK, marker="s")
        axes.annotate("base", (0.0, 0.0), (4.0, 4.0), textcoords="offset points")
        (x_low, y_low), (x_high, y_high) = low[seen], high[seen]
        axes.set(xlim=(x_low, x_high), ylim=(y_low, y_high), title=title)
        axes.set_aspect("equal", adjustable="box", anchor="SW")
        axes.xaxis.set_major_locator(MultipleLocator(200.0))
        axes.yaxis.set_major_locator(MultipleLocator(200.0))
        axes.set(xlabel=f"{'xyz'[seen[0]]} [mm]", ylabel=f"{'xyz'[seen[1]]} [mm]")
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.055), ncols=2)
    return figure


def _draw_space(axes: Any, p_base_mm: dict[str, Array], low: Array, high: Array) -> None:
    grid = p_base_mm["grid"]
    names = {
        "grid": f"{len(grid)} calibration poses, as measured",
        "holdout": f"{len(p_base_mm['holdout'])} held-out poses",
        "line_x": "straight move along x",
        "line_y": "straight move along y",
    }
    for kind, path in p_base_mm.items():
        if len(path):
            axes.plot(*path.T, label=names[kind], **_PATHS[kind][0])
    axes.text(*grid[0], "first ", ha="right", va="center", color=theme.BLUE)
    axes.text(*grid[-1], " last", ha="left", va="center", color=theme.BLUE)
    for name, tip in zip("xyz", _AXIS_LENGTH_MM * np.eye(3), strict=True):
        axes.quiver(0, 0, 0, *tip, color=theme.BLACK, linewidth=1.2, arrow_length_ratio=0.15)
        axes.text(*(1.25 * tip), name, ha="center", va="center")
    base = {"color": theme.BLACK, "marker": "s", "linestyle": "none", "label": "robot base"}
    axes.plot([0.0], [0.0], [0.0], **base)
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


# Errors before and after calibration at each load, as Fig. 5 of the paper.

#: What stands at each load: its place about the load's middle, its colour, and its name.
_SLOTS = {
    "before": (-0.28, theme.BEFORE, "before: nominal rigid model"),
    "after": (-0.01, theme.AFTER, "after, calibrated at this load"),
    "combined": (0.10, theme.AFTER_COMBINED, "after, all loads together"),
    "repeats": (0.38, theme.BLACK, "repeats, one axis (largest)"),
}
_PAPER_ASIDE = -0.11
#: What the panel of orientations adds to the height.
_ORIENTATION_MM = 42.0


class _Column(NamedTuple):
    """What stands in one column: a mean, a peak where there is one, and whose figures they are."""

    load: int  # place of the load
    slot: str  # of `_SLOTS`
    mean: float
    peak: float | None
    is_paper: bool


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
def draw_fig5_before_after(results: ResultsBundle) -> Figure:
    """Draw mean and peak position error, and mean orientation error, on logarithmic axes."""
    cases, combined = results.load_cases(), results.paper_calibration()
    of_paper = is_of_papers_arm(results)
    stated = {"before": published.BEFORE, "after": published.AFTER} if of_paper else {}
    repeats: dict[bool, Any] = {False: scatter_by_load(places(results))["largest_per_axis"]}
    repeats |= {True: published.REPEATABILITY_MM} if of_paper else {}
    columns, angles = [], []
    for k, (load, together) in enumerate(combined.errors.items()):
        alone = cases[load].errors[load] if load in cases else None
        shown: list[tuple[str, Accuracy | published.PublishedError, bool]] = [
            ("before", together.before, False),
            *([] if alone is None else [("after", alone.after, False)]),
            ("combined", together.after, False),
            *((slot, of[load], True) for slot, of in stated.items() if load in of),
        ]
        for slot, errors, is_paper in shown:
            columns.append(_Column(k, slot, errors.mean_mm, errors.peak_mm, is_paper))
            if errors.orientation_deg is not None:
                angles.append(_Column(k, slot, errors.orientation_deg, None, is_paper))
        for is_paper, by_load in repeats.items():
            if load in by_load:
                columns.append(_Column(k, "repeats", by_load[load], None, is_paper))
    seen = any(not column.is_paper for column in angles)
    raised = _ORIENTATION_MM if seen else 0.0
    figure = style.new_figure(
        108.0 + raised,
        "Error before and after calibration, at each load (compare Fig. 5 of the paper)",
    )
    lowest = position = style.panel(figure, 23.0, 26.0 + raised, 145.0, 73.0)
    _draw_columns(position, columns, list(combined.errors), room=(3.0, 3.0))
    position.set_ylabel("position error [mm]")
    if seen:
        lowest = style.panel(figure, 23.0, 26.0, 145.0, 32.0)
        _draw_columns(lowest, angles, list(combined.errors), room=(2.5, 6.0))
        lowest.set_ylabel("orientation\nerror [deg]")
    lowest.set_xlabel("external load")
    handles = [
        style.mark(text, color=color, marker="o", markerfacecolor=color)
        for _, color, text in _SLOTS.values()
    ]
    if of_paper:
        text = "the paper's figures, same colours"
        handles.append(style.mark(text, color=theme.BLACK, marker="D", markerfacecolor="white"))
    text = "mean / peak, as written"
    handles.append(style.mark(text, color=theme.BLACK, marker="|", markersize=9.0))
    corner_mm = 0.012 * style.WIDTH_MM
    style.legend_at(figure, corner_mm, 6.75, handles, ncols=3, columnspacing=1.2)
    return figure


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
    for load, slot, mean, peak, is_paper in columns:
        aside, color, _ = _SLOTS[slot]
        x = load + aside + (_PAPER_ASIDE if is_paper else 0.0)
        if peak is not None:
            axes.plot([x, x], [mean, peak], color=color, linewidth=1.4)
            axes.plot(x, peak, color=color, marker="_", markersize=7.0)
        marker, face = ("D", "white") if is_paper else ("o", color)
        axes.plot(x, mean, color=color, marker=marker, markersize=5.0, markerfacecolor=face)
        digits = ".2f" if mean >= 0.1 else ".3f"
        if is_paper and peak is None:
            digits = "g"  # as it prints them
        below = slot == "before"
        axes.annotate(
            " / ".join(f"{value:{digits}}" for value in (mean, peak) if value is not None),
            (x, mean if below else peak or mean),
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
    style.name_columns(axes, [written_load(load) for load in loads])
    for k in range(1, len(loads)):
        axes.axvline(k - 0.5, color=theme.SEPARATOR, linewidth=0.6)


# Errors at held-out points and loads, as Fig. 6 of the paper.

#: Models: what they are called and their marker.
_MODELS = {
    "uncalibrated": ("uncalibrated", "^"),
    "linear": ("linear springs", "s"),
    "cubic": ("cubic springs", "o"),
    "calibrated": ("calibrated", "o"),
    "extended": ("extended model", "v"),
}
#: More configurations than this are not named one by one.
_MOST_NAMES = 45


@picture(
    title="Fig. 6: error at held-out points and loads",
    needs=("papers_calibration", "held_out"),
    section="accuracy",
    caption="""
Errors of ``{name}`` at poses and loads that no fit uses (Fig. 6 of the paper, whose poses lie
outside the calibrated volume, under loads up to about twice the calibrated ones). Above, every
configuration, by load; below, mean and peak over all of them, with the paper's values as hollow
markers. *Uncalibrated* is the nominal rigid model; *linear* and *cubic* are the calibrated
models without and with a cubic stiffness term, and the *extended model* has what the verdict
adds. An error that is larger here than in Fig. 5 is the cost of extrapolation. Where linear and
cubic springs do equally well, the data do not need the cubic term.
""",
)
def draw_fig6_holdout(results: ResultsBundle) -> Figure:
    """Draw every configuration by load, and mean and peak of each model beside the paper's."""
    held_out = results.sound_held_out()
    case = results.paper_calibration(held_out.calibration)  # refuses another model than the paper's
    models = dict(held_out.models)
    if not models:
        raise NothingToShowError("no held-out configuration was measured")
    said = "Linear and cubic springs: as calibrated"
    if not case.has_springs:  # one model: what has no springs has no linear or cubic ones
        models.pop("linear", None)
        models = {{"cubic": "calibrated"}.get(name, name): of for name, of in models.items()}
        said = "All joints were held rigid; calibrated"
    figure = style.new_figure(
        146.0, "Error at held-out points and loads, which no fit uses (compare Fig. 6 of the paper)"
    )
    single = style.panel(figure, 16.0, 81.0, 152.0, 53.0)
    _draw_configurations(single, models)
    load = held_out.calibration
    fitted = "all loads together" if load == COMBINED else f"{load} alone"
    style.note(figure, f"{said} with {fitted}.", 7.0)
    figure.legend(
        *single.get_legend_handles_labels(), loc="center", bbox_to_anchor=(0.5, 0.446), ncols=4
    )
    summary = style.panel(figure, 30.0, 22.0, 66.0, 32.0)
    _draw_summary(summary, models, published.HELD_OUT if is_of_papers_arm(results) else {})
    return figure


def _draw_configurations(axes: Axes, models: dict[str, HeldOutModel]) -> None:
    # Every model is judged on the same configurations, in the same order.
    first = next(iter(models.values())).rows
    order = np.lexsort((first.pose, first.load_N))
    loads, poses = first.load_N[order], first.pose[order]
    errors_mm = np.array(
        [np.linalg.norm(model.rows.position_mm[order], axis=1) for model in models.values()]
    )
    shifts = np.linspace(-0.2, 0.2, len(models))
    for shift, errors, (name, model) in zip(shifts, errors_mm, models.items(), strict=True):
        at = np.arange(len(errors)) + shift
        axes.plot(at, errors, label=_MODELS[name][0], **_dots(name))
        extrapolated = model.rows.extrapolated
        if extrapolated is not None and extrapolated.any():
            beyond = extrapolated[order]
            hollow = _dots(name) | {"markerfacecolor": "white"}
            axes.plot(at[beyond], errors[beyond], label="extrapolated", **hollow)
    style.plain_log(axes, "y", float(errors_mm.min()) / 1.5, float(errors_mm.max()) * 1.5)
    axes.set_xlim(-0.7, len(poses) - 0.3)
    axes.set_ylabel("position error [mm]")
    axes.set_xlabel("held-out configuration: pose, grouped by load")
    style.name_columns(axes, poses.tolist(), rotation=90.0)
    axes.tick_params(axis="x", labelbottom=len(poses) <= _MOST_NAMES)
    for load in np.unique(loads):
        at = np.flatnonzero(loads == load)
        axes.text(at.mean(), 1.02, f"{load:g} N", transform=axes.get_xaxis_transform(), ha="center")
        if at[0]:
            axes.axvline(at[0] - 0.5, color=theme.SEPARATOR, linewidth=0.6)


def _draw_summary(
    axes: Axes, models: dict[str, HeldOutModel], stated: dict[str, published.PublishedError]
) -> None:
    """Draw mean and peak of each model, ours above the paper's."""
    shown: list[HeldOutModel | published.PublishedError] = [*models.values(), *stated.values()]
    for k, (name, model) in enumerate(models.items()):
        digits = ".2f" if model.mean_mm > 0.1 else ".3f"
        rows: list[tuple[Any, ...]] = [(k - 0.17, model, digits, "", _dots(name), theme.BLACK)]
        if name in stated:
            look = _dots(name) | {"markerfacecolor": "white", "marker": "D"}
            rows.append((k + 0.2, stated[name], "g", "paper: ", look, theme.GREY))
        for y, errors, digits, whose, look, color in rows:
            axes.plot([errors.mean_mm, errors.peak_mm], [y, y], color=look["color"], linewidth=1.4)
            axes.plot(errors.peak_mm, y, color=look["color"], marker="|", markersize=7.0)
            axes.plot(errors.mean_mm, y, **look)
            text = f"{whose}{errors.mean_mm:{digits}} / {errors.peak_mm:{digits}} mm"
            if errors.orientation_deg is not None:
                text += f", orientation {errors.orientation_deg:{digits}}°"
            style.write_beside(axes, y, text, 1.03, color=color)
    lowest, highest = min(e.mean_mm for e in shown), max(e.peak_mm for e in shown)
    style.plain_log(axes, "x", lowest / 1.5, highest * 1.5)
    style.name_rows(axes, [_MODELS[name][0] for name in models], 0.6, lines=False)
    axes.set_title(
        "Mean and peak over all held-out configurations: ours filled, the paper's hollow"
    )
    axes.set_xlabel("position error [mm], mean to peak")


def _dots(name: str) -> dict[str, Any]:
    return {"color": theme.MODELS[name], "marker": _MODELS[name][1], "linestyle": "none"}


# The Monte Carlo by plane (Section III.A); the error over each plane stands on the page.

_ASIDE_MM = 18.0
#: The paper's figures are black diamonds wherever they stand beside ours.
_PAPER: dict[str, Any] = {
    "color": theme.BLACK,
    "marker": "D",
    "markersize": 4.5,
    "markerfacecolor": "white",
}


@picture(
    title="Monte Carlo: error by plane",
    needs=("planes",),
    section="trust",
    caption="""
Position error caused by the stated resolver uncertainty alone, in horizontal planes, for the
nominal arm. Left, the mean over all positions and draws with the standard deviation within a
position, beside the paper's value. Right, the means enlarged: bars are 95 % intervals for the
choice of positions, crosses the expectation from the Jacobian, which needs no draws. The paper
calls this the lower bound of calibration. However, a resolver repeats its error whenever a
joint returns to an angle, so a calibration can in principle remove it: it is a bound in the
paper's sense only. No measurement is used here.
""",
)
def draw_montecarlo_planes(results: ResultsBundle) -> Figure:
    """Draw the mean with the spread within a position, and the mean alone enlarged."""
    planes = results.planes_of_settings()
    figure = style.new_figure(
        103.0, "Position error that resolver uncertainty alone causes, by plane"
    )
    spread = style.panel(figure, 18.0, 42.0, 64.0, 50.0)
    enlarged = style.panel(figure, 104.0, 42.0, 63.0, 50.0)
    z_mm, mean_mm = [plane.plane_mm for plane in planes], [plane.mean_mm for plane in planes]
    look: dict[str, Any] = {"color": theme.BLUE, "marker": "o", "linestyle": "none", "capsize": 3.0}
    spread.errorbar(
        z_mm,
        mean_mm,
        yerr=[plane.std_mm for plane in planes],
        label="mean ± standard deviation within a position",
        **look,
    )
    enlarged.errorbar(
        z_mm,
        mean_mm,
        yerr=[plane.half_width95_positions_mm for plane in planes],
        ecolor=theme.SKY,
        label="mean, 95 % interval for the choice of positions",
        **look,
    )
    enlarged.plot(
        z_mm,
        [plane.closed_form_mean_mm for plane in planes],
        color=theme.GREEN,
        marker="x",
        markersize=6.0,
        linestyle="none",
        label="closed form from the Jacobian, same positions",
    )
    if is_of_papers_arm(results):
        at_mm = published.MONTE_CARLO_PLANE_MM + _ASIDE_MM
        paper_mm, apart_mm = published.MONTE_CARLO_MEAN_MM, published.MONTE_CARLO_PLANES_DIFFER_MM
        spread.errorbar(
            at_mm,
            paper_mm,
            yerr=published.MONTE_CARLO_STD_MM,
            linestyle="none",
            capsize=3.0,
            label="the paper, z = 500 mm",
            **_PAPER,
        )
        enlarged.fill_between(
            published.MONTE_CARLO_PARALLEL_PLANES_MM,
            paper_mm - apart_mm,
            paper_mm + apart_mm,
            color=theme.GREY,
            alpha=0.35,
            linewidth=0.0,
            label="the paper, z = 300 to 700 mm (± 0.001 mm)",
        )
        enlarged.plot(at_mm, paper_mm, **_PAPER)
    spread.set_ylim(bottom=0.0)
    spread.set_ylabel("position error [mm]")
    enlarged.set(title="the means, enlarged", ylabel="mean position error [mm]")
    for axes in (spread, enlarged):
        axes.set_xticks(z_mm)
        axes.set_xlim(z_mm[0] - 60.0, z_mm[-1] + 60.0)
        axes.set_xlabel("height z of the plane above the base [mm]")
    figure.legend(loc="lower left", bbox_to_anchor=(0.012, 0.155), ncols=2)
    first = planes[0]
    style.note(
        figure,
        f"Nominal arm; σ = {first.sigma_deg:g}° at every joint; {first.positions} positions, "
        f"{first.cycles} draws at each,\n"
        f"at {first.reach_m[0]:g} to {first.reach_m[1]:g} m from the base axis. "
        "No measurement enters.",
        6.5,
    )
    return figure
