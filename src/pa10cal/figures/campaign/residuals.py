"""What calibration leaves at each pose, poses far outside, and an instrument that moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.table import read_base_motion
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import FILES, Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    evenly,
    height_of,
    legend_at,
    new_figure,
    panel,
    round_down,
    write_text_at,
)
from pa10cal.figures.table import Table, frame_of, shown
from pa10cal.observe.instrument import MotionFound
from pa10cal.results.analysis import GapRows
from pa10cal.results.evaluation import ResidualRows

_LONGEST_ARROW_MM = 140.0
_MARGIN_MM = 25.0
_GRID_LINES = 2.5


@dataclass(frozen=True)
class _View:
    """A projection along one of the base axes: which it shows, and which its colours show."""

    title: str
    shown: tuple[int, int]
    hidden: int


_VIEWS = (
    _View("From above; the brighter an arrow, the higher it lies", (0, 1), 2),
    _View("From the side; the brighter an arrow, the larger its y", (0, 2), 1),
)


@dataclass(frozen=True)
class _Frame:
    """The box (3,) to (3,) that all panels show [mm], and how much arrows are enlarged."""

    low_mm: Array
    high_mm: Array
    scale: float

    @property
    def grid_mm(self) -> float:
        return round_down(float(np.min(self.high_mm - self.low_mm)) / _GRID_LINES)


@dataclass(frozen=True)
class _Arrows:
    """Arrows at one load: from (N, 3) places, the predicted positions, by (N, 3) vectors [mm]."""

    load_N: float
    place_mm: Array
    vector_mm: Array

    @property
    def length_mm(self) -> Array:
        return np.asarray(np.linalg.norm(self.vector_mm, axis=1))


@picture(
    title="Residual vectors in space",
    needs=("papers_calibration",),
    caption="""
Remaining position error of ``{name}`` after calibration with all loads together. Each arrow
points from the predicted to the measured position of the end-effector, enlarged by the factor
stated in the picture, in space and seen from above and from the side. If the model describes
the arm completely, the arrows are short and have no common direction: noise. Long arrows that
repeat from load to load, or that turn steadily from pose to pose, show an effect that the model
lacks, even where the mean error looks small.
""",
)
def draw_residual_vectors(results: Results) -> Figure:
    """Draw arrows from predicted to measured positions of the combined calibration."""
    cases = _by_load(results.calibration().residuals)
    longest = max(float(case.length_mm.max()) for case in cases)
    frame = _frame(cases, round_down(_LONGEST_ARROW_MM / longest))
    figure = new_figure(
        190.0,
        "Remaining position error after calibration: from the predicted to the measured position",
    )
    width = 154.0 / len(cases)
    for k, case in enumerate(cases):
        left = 15.0 + k * width
        space = panel(figure, left - 12.0, 116.0, width + 6.0, 58.0, projection="3d")
        _draw_space(space, case, frame)
        write_text_at(
            figure,
            left,
            175.0,
            f"{case.load_N:g} N\nmean {case.length_mm.mean():.3f}, "
            f"peak {case.length_mm.max():.3f} mm",
            va="top",
        )
        for view, bottom in zip(_VIEWS, (70.0, 17.0), strict=True):
            axes = panel(figure, left, bottom, width - 7.0, 38.0)
            arrows = _draw_view(axes, case, view, frame)
            if k == 0:
                axes.set_title(view.title)
            else:
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
    key_mm = round_down(longest)
    axes.quiverkey(
        arrows,
        0.09,
        0.945,
        frame.scale * key_mm,
        f"this arrow: {key_mm:g} mm; all arrows are enlarged {frame.scale:g} times, "
        f"grid lines are {frame.grid_mm:g} mm apart",
        labelpos="E",
        coordinates="figure",
        color=BLACK,
    )
    return figure


def _by_load(residuals: ResidualRows) -> list[_Arrows]:
    """Return the arrows load by load; they are the opposite of the residuals."""
    load_N = residuals.load_N
    return [
        _Arrows(
            float(load), residuals.place_mm[load_N == load], -residuals.position_mm[load_N == load]
        )
        for load in np.unique(load_N)
    ]


def _frame(cases: list[_Arrows], scale: float) -> _Frame:
    """Return the box that holds every place and every tip."""
    places = np.vstack([case.place_mm for case in cases])
    tips = places + scale * np.vstack([case.vector_mm for case in cases])
    ends = np.vstack([places, tips])
    return _Frame(ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM, scale)


def _draw_space(axes: Any, case: _Arrows, frame: _Frame) -> None:
    axes.plot(*case.place_mm.T, color=ORANGE, marker="o", markersize=2.0, linestyle="none")
    axes.quiver(
        *case.place_mm.T,
        *(frame.scale * case.vector_mm).T,
        color=BLUE,
        linewidth=0.9,
        arrow_length_ratio=0.3,
    )
    low, high = frame.low_mm, frame.high_mm
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.0)
    axes.patch.set_visible(False)  # it would hide what its neighbour draws beyond its frame
    axes.view_init(elev=20.0, azim=-52.0)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MultipleLocator(frame.grid_mm))
        axis.set_ticklabels([])
        axis.labelpad = -14.0


def _draw_view(axes: Axes, case: _Arrows, view: _View, frame: _Frame) -> Quiver:
    columns = list(view.shown)
    place, vector = case.place_mm[:, columns].T, frame.scale * case.vector_mm[:, columns].T
    axes.plot(*place, color=ORANGE, marker="o", markersize=2.0, linestyle="none")
    arrows = axes.quiver(
        *place,
        *vector,
        case.place_mm[:, view.hidden],
        cmap="viridis",
        clim=(frame.low_mm[view.hidden], frame.high_mm[view.hidden]),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.008,
    )
    across, up = view.shown
    axes.set(
        xlim=(frame.low_mm[across], frame.high_mm[across]),
        ylim=(frame.low_mm[up], frame.high_mm[up]),
    )
    axes.set_aspect("equal", adjustable="box", anchor="SW")
    axes.xaxis.set_major_locator(MultipleLocator(frame.grid_mm))
    axes.yaxis.set_major_locator(MultipleLocator(frame.grid_mm))
    axes.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]")
    return arrows


# Residual vectors in space, before and after effects joined the model where there are any.

#: The longest arrow, at least, and as a part of what the places span.
_LONGEST_ARROW_MM_OF_FIELD, _LONGEST_PART = 220.0, 0.15
#: Of more poses only about so many are drawn, evenly over the record, and some of every set.
_MOST_ARROWS, _LEAST_ARROWS = 240, 40
_MARGIN_MM_OF_FIELD = 20.0
#: How wide a panel is and how far apart they begin; views side by side have an axis each.
_PANEL_MM, _APART_MM = 70.0, 78.0
_ALONE_MM, _ALONE_APART_MM = 63.0, 83.0
_BELOW_MM, _SAID_MM, _BETWEEN_MM, _ABOVE_MM = 22.5, 4.4, 10.0, 18.0
_SAME_SCALE = (
    "Arrows before and after have the same scale; an arrow shorter than its marker is hidden by it."
)
_VIEWS_OF_FIELD = (("seen from above", (0, 1)), ("seen from the side", (0, 2)))
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_BEYOND: dict[str, Any] = {"color": GREY, "marker": "s"}


@dataclass(frozen=True)
class _FieldArrows:
    """Arrows from (N, 3) places [mm]."""

    name: str  # what the poses are
    place_mm: Array  # where each begins
    vector_mm: dict[str, Array]  # (N, 3) arrows [mm] by what the model is: `before`, `after`
    look: dict[str, Any]

    def drawn(self, share: float) -> _FieldArrows:
        """Return a share of them."""
        most = max(round(share * len(self.place_mm)), _LEAST_ARROWS)
        rows = evenly(len(self.place_mm), most)
        vectors = {when: vector_mm[rows] for when, vector_mm in self.vector_mm.items()}
        return _FieldArrows(self.name, self.place_mm[rows], vectors, self.look)


@picture(
    title="Gap: residual vectors before and after",
    needs=("gap",),
    caption="""
Arrows from predicted to measured positions in ``{name}``, equally enlarged left, before, and
right, after the named effects were added; above seen from above, below from the side, along the
base axes of the robot. Without a search for effects, both views show the calibrated model. Blue:
fitted poses, each load by itself; orange: held-out poses; grey: held-out poses beyond the joint
angles of the fit, extrapolated. Of thousands of poses an even selection is drawn. Arrows that
agree from load to load, or turn steadily from place to place, show an effect that the model
lacks; the arrows on the right should be short and have no common direction.
""",
)
def draw_residual_field(results: Results) -> Figure:
    """Draw arrows from predicted to measured positions: before left, after right."""
    every = _sets(results)
    share = min(_MOST_ARROWS / sum(len(arrows.place_mm) for arrows in every), 1.0)
    sets = [arrows.drawn(share) for arrows in every]
    columns = list(sets[0].vector_mm)
    vectors = np.vstack([v for arrows in sets for v in arrows.vector_mm.values()])
    places = np.vstack([arrows.place_mm for arrows in sets for _ in columns])
    longest = float(np.linalg.norm(vectors, axis=1).max())
    reach_mm = max(_LONGEST_ARROW_MM_OF_FIELD, _LONGEST_PART * float(np.ptp(places, axis=0).max()))
    scale = round_down(reach_mm / longest)
    ends = np.vstack([places, places + scale * vectors])
    low, high = ends.min(axis=0) - _MARGIN_MM_OF_FIELD, ends.max(axis=0) + _MARGIN_MM_OF_FIELD
    alone = len(columns) == 1  # then the views stand side by side, else one below the other
    if alone:  # and as tall as each other
        middle, half = (low + high) / 2.0, (high - low)[1:].max() / 2.0
        low[1:], high[1:] = middle[1:] - half, middle[1:] + half
    wide_mm, apart_mm = (_ALONE_MM, _ALONE_APART_MM) if alone else (_PANEL_MM, _APART_MM)
    tall_mm = wide_mm / (high[0] - low[0]) * (high - low)
    below = _BELOW_MM + _SAID_MM * len(sets)
    top = below + (0.0 if alone else tall_mm[2] + _BETWEEN_MM)
    figure = new_figure(
        top + tall_mm[1] + _ABOVE_MM,
        "Position error in space: from the predicted to the measured position",
    )
    for k, when in enumerate(columns):
        for row, (title, view) in enumerate(_VIEWS_OF_FIELD):
            column, bottom = (row, top) if alone else (k, below if row else top)
            up = view[1]
            axes = panel(figure, 18.0 + apart_mm * column, bottom, wide_mm, tall_mm[up])
            arrows = _draw_view_of_field(axes, sets, when, view, scale)
            axes.set(xlim=(low[0], high[0]), ylim=(low[up], high[up]))
            axes.set_title(f"{when}, {title}")
            axes.set_ylabel(f"{'xyz'[up]} [mm]" if alone or not column else "")
            axes.tick_params(labelleft=alone or not column, labelbottom=bottom == below)
            if bottom == below:
                axes.set_xlabel("x [mm]")
    key_mm = round_down(longest)
    axes.quiverkey(
        arrows,
        0.64,
        1.0 - 7.5 / height_of(figure),
        scale * key_mm,
        f"{key_mm:g} mm, enlarged {scale:g} times",
        labelpos="E",
        coordinates="figure",
        color=BLACK,
    )
    _draw_legend(figure, every, sets)
    note = results.words.arrows if alone else _SAME_SCALE
    write_text_at(figure, 2.0, 6.0, note, color=GREY)
    return figure


def _sets(results: Results) -> list[_FieldArrows]:
    """Return the arrows of the poses fitted and held out; before alone where none is after."""
    if not results.has_gap:
        return [_calibrated(results.any_calibration().residuals)]
    found = results.analysis().gap
    every = np.ones(len(found.train), dtype=bool)
    sets = [_before_and_after("poses fitted", found.train, every, _TRAIN)]
    if found.holdout is not None:
        beyond = found.holdout.extrapolated
        if beyond is None:
            beyond = np.zeros(len(found.holdout), dtype=bool)
        sets += [
            _before_and_after(name, found.holdout, rows, look)
            for name, rows, look in (
                ("held-out poses", ~beyond, _HELD_OUT),
                ("held out, extrapolated", beyond, _BEYOND),
            )
            if rows.any()
        ]
    return sets


def _before_and_after(
    name: str, found: GapRows, rows: NDArray[np.bool_], look: dict[str, Any]
) -> _FieldArrows:
    """Return the arrows of configurations; they are the opposite of the residuals."""
    vectors = {"before": -found.before_mm[rows], "after": -found.after_mm[rows]}
    return _FieldArrows(name, found.place_mm[rows], vectors, look)


def _calibrated(rows: ResidualRows) -> _FieldArrows:
    return _FieldArrows("poses fitted", rows.place_mm, {"calibrated": -rows.position_mm}, _TRAIN)


def _draw_view_of_field(
    axes: Axes, sets: list[_FieldArrows], when: str, shown: tuple[int, int], scale: float
) -> Quiver:
    columns = list(shown)
    for arrows in sets:
        place = arrows.place_mm[:, columns].T
        axes.plot(*place, markersize=2.0, linestyle="none", **arrows.look)
        drawn = axes.quiver(
            *place,
            *(scale * arrows.vector_mm[when][:, columns].T),
            color=arrows.look["color"],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.005,
        )
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return drawn


def _draw_legend(figure: Figure, every: list[_FieldArrows], sets: list[_FieldArrows]) -> None:
    handles = [
        Line2D([], [], linestyle="none", label=_label(arrows, shown), **arrows.look)
        for arrows, shown in zip(every, sets, strict=True)
    ]
    legend_at(figure, 16.0, 10.5, handles)


def _label(arrows: _FieldArrows, shown: _FieldArrows) -> str:
    means = [
        f"{np.linalg.norm(vector_mm, axis=1).mean():.3f} mm {when}"
        for when, vector_mm in arrows.vector_mm.items()
    ]
    text = f"{arrows.name}, every load: mean length {', '.join(means)}"
    total, some = len(arrows.place_mm), len(shown.place_mm)
    return text if some == total else f"{text}; {some} of {total} drawn"


# Poses far outside the scatter of the others, each with why.

_HEADER = ("pose", "load_N", "distance", "weight", "why")
_SHOWN = ("pose", "load [N]", "distance", "weight", "why")


@picture(
    title="Suspected outliers",
    needs=("general",),
    caption="""
Poses of ``{name}`` that lie so far outside the scatter of the others that chance hardly
explains them, each with the quantity that is off and by how much. None was removed: each stayed
in the fit with a reduced weight, so that it cannot bias the other poses. A single such pose may
be a wrong reading. Several of them at neighbouring positions or joint angles are more likely an
effect that the model lacks.
""",
)
def tabulate_suspected_outliers(results: Results) -> Table:
    """Return every suspected outlier, the worst first."""
    case = results.general()
    rows = [
        (each.pose, each.load_N, round(each.distance, 2), round(each.weight, 3), each.why)
        for each in case.suspected_outliers
    ]
    cells = [
        (pose, f"{load_N:g}", f"{distance:.2f}", f"{weight:.3f}", why)
        for pose, load_N, distance, weight, why in rows
    ]
    return Table(
        title="Suspected outliers",
        data=frame_of(_HEADER, rows),
        shown=(shown(_SHOWN, cells),),
        notes=(
            f"{len(rows)} of {case.health.poses.measured} poses. None was removed: each stayed in "
            "the fit with the weight given, 1 being that of the others.",
            "Distance: residual over all readings of the pose, in standard deviations of the "
            "scatter. Without a wrong pose, one campaign in a hundred has a suspected outlier.",
            "A suspected outlier may be a wrong reading, or a place where the model lacks an "
            "effect.",
        ),
    )


# How the instrument moved against targets on the base while the campaign lasted.

_COLOURS = {"x": BLUE, "y": ORANGE, "z": GREEN}
_BELOW_MM_OF_MOTION, _PANEL_MM_OF_MOTION, _APART_MM_OF_MOTION, _ABOVE_MM_OF_MOTION = (
    26.0,
    42.0,
    8.0,
    10.0,
)
_FORMS = {
    "walk": "smoothed in time",
    "each": "each configuration by itself",
    "still": "no motion shows",
}


@picture(
    title="Motion of the instrument against targets on the base",
    needs=("base_motion",),
    caption="""
What targets on the base of ``{name}`` show of the instrument while the campaign lasted: their
common shift, and turn where three of them are not in line, about their mean, along the
instrument's axes, with bands of two standard uncertainties. All readings were turned back by it
before anything else was done with them. Dashed lines: a target moved against the others there,
and its readings of the shorter stretch are not used.
""",
)
def draw_base_motion(results: Results) -> Figure:
    """Draw shift and turn over time."""
    poses = results.poses()
    found = read_base_motion(results.folder / FILES["poses"])
    if found is None:
        raise NothingToShowError("the motion of the targets was not looked at")
    rows = [("shift", "mm", "{}_mm", 1.0, 0)]
    if found.turns:
        rows.append(("turn", "mrad", "r{}_rad", 1e3, 3))
    height = (
        _BELOW_MM_OF_MOTION
        + len(rows) * _PANEL_MM_OF_MOTION
        + (len(rows) - 1) * _APART_MM_OF_MOTION
        + _ABOVE_MM_OF_MOTION
    )
    figure = new_figure(height, "Motion of the instrument against targets on the base")
    hours = (poses["time_s"] - poses["time_s"].min()).to_numpy() / 3600.0
    for k, (word, unit, column, scale, first) in enumerate(rows):
        up = len(rows) - 1 - k
        axes = panel(
            figure,
            20.0,
            _BELOW_MM_OF_MOTION + up * (_PANEL_MM_OF_MOTION + _APART_MM_OF_MOTION),
            146.0,
            _PANEL_MM_OF_MOTION,
        )
        for i, axis in enumerate("xyz"):
            name = f"motion_{column.format(axis)}"
            value = scale * poses[name].to_numpy()
            at = first + i
            u = scale * np.sqrt(poses[f"motion_cov_{at}{at}"].to_numpy())
            axes.fill_between(hours, value - 2 * u, value + 2 * u, color=_COLOURS[axis], alpha=0.2)
            axes.plot(hours, value, color=_COLOURS[axis], linewidth=0.8)
        _mark(axes, found, poses)
        axes.set_ylabel(f"{word} [{unit}]")
        if up:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("time [h]")
    handles = [Line2D([], [], color=colour, label=axis) for axis, colour in _COLOURS.items()]
    legend_at(figure, 4.0, 11.0, handles, ncols=3)
    write_text_at(figure, 2.0, 8.0, _said(found, poses), color=GREY)
    return figure


def _mark(axes: Axes, found: MotionFound, poses: pd.DataFrame) -> None:
    for knock in found.knocked:
        at = (knock.time_s - poses["time_s"].min()) / 3600.0
        axes.axvline(at, color=VERMILLION, linestyle="--", linewidth=0.8)


def _said(found: MotionFound, poses: pd.DataFrame) -> str:
    shift = poses[[f"motion_{axis}_mm" for axis in "xyz"]].to_numpy()
    largest = float(np.linalg.norm(shift, axis=1).max())
    parts = [f"{_FORMS[found.form]}: up to {largest:.3f} mm"]
    if found.turns:
        turn = 1e3 * poses[[f"motion_r{axis}_rad" for axis in "xyz"]].to_numpy()
        parts[0] += f" and {float(np.linalg.norm(turn, axis=1).max()):.3f} mrad"
    parts.append(f"targets scatter by {found.noise:.2f} of the stated uncertainty")
    parts += [str(each) for each in found.knocked]
    return "; ".join(parts)
