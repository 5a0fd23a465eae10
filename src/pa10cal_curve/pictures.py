"""A chain of links along a curve, still and moving: pictures and films."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pa10cal.errors import OutputError
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.style import evenly, label_space, new_figure, panel
from pa10cal.reports.theme import BLACK, BLUE, GREY, ORANGE, SKY, VERMILLION
from pa10cal_curve.tables import CurveResults, read_curve

#: Why a chain that does not move has no gait to show.
ONE_SHAPE = "one shape does not move"
#: The file of a results folder that these are drawn of.
FROM = "curve.json"


def read_content(folder: Path) -> tuple[str, CurveResults]:
    """Return the footer of the pictures of a folder that the command `curve` wrote, and the chain.

    Raises:
        RecordError: as `read_curve`.
    """
    results = read_curve(folder)
    links = f"{results.record.links} links of {results.record.link_m:.4g} m on a continuous curve"
    return f"{links}: {results.record.shapes[0].ending_is}. Synthetic data.", results


# What pictures and films of a chain are made of: it in space beside its curve, and its angles.

#: Links of longer chains are drawn without a mark at every joint, and without their axes.
_MOST_MARKS = 120
#: Length of a link's z axis as drawn, as a part of the link.
_AXIS = 0.45
_MARGIN = 0.05


def space(
    figure: Figure,
    results: CurveResults,
    shape: int,
    place_mm: tuple[float, float, float, float],
    *,
    numbers: bool,
) -> Axes:
    """Add axes in space with one shape of the chain, equal scales and room for all shapes.

    Args:
        place_mm: x, y, width and height in the figure.
        numbers: whether the axes have numbers and names.
    """
    axes = panel(figure, *place_mm, projection="3d")
    draw_chain(axes, results, shape)
    every = np.concatenate([results.curve_m.reshape(-1, 3), results.p_m.reshape(-1, 3)])
    low, high = every.min(axis=0), every.max(axis=0)
    reach = float((high - low).max())
    middle, half = (low + high) / 2.0, np.maximum(high - low, 0.25 * reach) / 2.0
    half = half + _MARGIN * reach
    label_space(axes, middle - half, middle + half, numbers=numbers)
    return axes


def draw_chain(axes: Axes, results: CurveResults, shape: int) -> None:
    """Draw one shape of the chain, the curve under it and the z axes of its links."""
    curve_m, p_m = results.curve_m[shape], results.p_m[shape]
    axes.plot(*curve_m.T, color=SKY, linewidth=2.5, alpha=0.7, label="curve")
    few = len(p_m) <= _MOST_MARKS
    mark = "o" if few else None
    axes.plot(*p_m.T, color=BLUE, marker=mark, markersize=2.5, linewidth=1.2, label="links")
    if few:
        begin = (p_m[:-1] + p_m[1:]) / 2.0
        end = begin + _AXIS * results.record.link_m * results.z_axis[shape]
        gap = np.full_like(begin, np.nan)  # lifts the pen
        ticks = np.stack([begin, end, gap], axis=1).reshape(-1, 3)
        axes.plot(*ticks.T, color=VERMILLION, linewidth=0.9, label="their z")
    axes.plot(*p_m[:1].T, color=BLACK, marker="s", markersize=4.0, linestyle="none", label="begin")


def draw_angles(axes: Axes, results: CurveResults, shape: int) -> None:
    """Draw the angles of all joints of one shape, scaled for all shapes."""
    joint = np.arange(1, results.a_deg.shape[1] + 1)
    mark = "." if len(joint) <= _MOST_MARKS else ""
    axes.plot(joint, results.a_deg[shape], color=BLUE, marker=mark, label="a, about z")
    axes.plot(joint, results.b_deg[shape], color=ORANGE, marker=mark, label="b, about y")
    most = 1.1 * float(np.abs([results.a_deg, results.b_deg]).max(initial=1e-3))
    for limit in {each for each in results.limits_deg if abs(each) < 2.0 * most}:
        axes.axhline(limit, color=GREY, linestyle="--", linewidth=0.8)
        most = max(most, 1.05 * abs(limit))
    axes.set(ylim=(-most, most), xlabel="joint", ylabel="angle [°]")


# One shape of a chain along a curve: in space, and its joint angles.


@picture(
    title="A chain along a curve",
    needs=(),
    caption="""
A continuous curve as straight links ({name}). Left, the curve, the links, whose ends lie on it,
and the z axis of every link. The end of each link is the first point of the curve at the length
of a link from its beginning, so chords equal the length to rounding. Right, the angles of the
joints between the links, two rotations each. The roll of the first link about itself is free:
the settings choose it, by default for the smallest largest joint angle.
""",
)
def draw_curve_shape(results: CurveResults) -> Figure:
    """Draw the chain left, the angles of its joints right."""
    if len(results.time_s) > 1:
        raise NothingToShowError("the chain moves")
    figure = new_figure(100.0, f"{results.record.links} links along a continuous curve")
    chain = space(figure, results, 0, (2.0, 16.0, 76.0, 76.0), numbers=True)
    chain.legend(loc="upper left", bbox_to_anchor=(-0.02, 1.02))
    angles = panel(figure, 112.0, 30.0, 54.0, 56.0)
    draw_angles(angles, results, 0)
    shape = results.record.shapes[0]
    angles.set_title(f"roll {shape.roll_deg:.1f}°, largest angle {shape.largest_angle_deg:.1f}°")
    angles.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    return figure


# A chain that moves: some of its shapes, its joint angles over time, and the moves between.

_SHAPES = 3
_HEIGHT_MM = 128.0
_COLOURS = "RdBu_r"


@picture(
    title="A chain that moves",
    needs=(),
    caption="""
A chain of links that moves ({name}): some of its shapes above; joint angles over time, and the
largest move between two shapes, below. A wave travels along the chain; a chain that rolls keeps
its shape while every link turns about itself, so every joint bends to all sides in turn. The
film shows the same, shape after shape. Nothing of it was measured: the angles follow from the
shapes alone, moment by moment.
""",
)
def draw_curve_gait(results: CurveResults) -> Figure:
    """Draw shapes above, the angles of all joints over time and the largest moves below."""
    if len(results.time_s) == 1:
        raise NothingToShowError(ONE_SHAPE)
    figure = new_figure(_HEIGHT_MM, f"{results.record.links} links that move along a curve")
    for column, shape in enumerate(evenly(len(results.time_s) - 1, _SHAPES)):
        place_mm = (10.0 + 54.0 * column, 68.0, 50.0, 48.0)
        axes = space(figure, results, int(shape), place_mm, numbers=False)
        axes.set_title(f"{results.time_s[shape]:.2f} s", loc="center")
        if column == 0:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.22, 1.0), handlelength=1.2)
    joints = results.a_deg.shape[1]
    most = float(np.abs([results.a_deg, results.b_deg]).max(initial=1e-3))
    named = (("a, about z", results.a_deg), ("b, about y", results.b_deg))
    over = (results.time_s[0], results.time_s[-1], 0.5, joints + 0.5)
    looks: dict[str, Any] = {"cmap": _COLOURS, "vmin": -most, "vmax": most}
    looks |= {"aspect": "auto", "origin": "lower", "interpolation": "nearest"}
    for column, (name, angle_deg) in enumerate(named):
        axes = panel(figure, 14.0 + 48.0 * column, 18.0, 42.0, 40.0)
        image = axes.imshow(angle_deg.T, extent=over, **looks)
        axes.grid(visible=False)
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.set(title=name, xlabel="time [s]")
        if column == 0:
            axes.set_ylabel("joint")
        else:
            axes.set_yticklabels([])
    bar = panel(figure, 106.0, 18.0, 2.5, 40.0)
    figure.colorbar(image, cax=bar)
    bar.set_title("[°]")
    turns = np.concatenate([results.a_deg, results.b_deg], axis=1)
    moved = np.abs(np.diff(turns, axis=0)).max(axis=1, initial=0.0)
    moves = panel(figure, 128.0, 18.0, 38.0, 40.0)
    moves.plot(results.time_s[1:], moved, color=BLACK)
    moves.set_ylim(0.0, 1.15 * moved.max() if moved.any() else 1.0)
    moves.set_title("largest move of a joint\nbetween shapes [°]")
    moves.set_xlabel("time [s]")
    return figure


# A chain that moves, as a film: GIF, or MP4 where ffmpeg is installed.

_HEIGHT_MM_OF_FILM = 92.0
_LEAST_RATE_HZ, _MOST_RATE_HZ = 1, 50


@picture(
    title="A chain that moves, as a film",
    needs=(),
    caption="""
A chain of links that moves ({name}), shape after shape, with the angles of its joints. The
film has one frame a shape, at the speed of the gait where that needs between one and fifty
frames a second. A wave travels along the chain; a chain that rolls keeps its shape while every
link turns about itself. Nothing of it was measured: the angles follow from the shapes alone.
""",
)
def film_curve_film(results: CurveResults, path: Path, dpi: int) -> None:
    """Write the shapes one after the other, as fast as they follow.

    Args:
        path: ends in `.gif` or `.mp4`.

    Raises:
        NothingToShowError: when there is one shape.
        OutputError: when there is no writer of that kind.
    """
    if len(results.time_s) == 1:
        raise NothingToShowError(ONE_SHAPE)
    rate = (len(results.time_s) - 1) / float(results.time_s[-1] - results.time_s[0])
    writer = _writer(path, int(np.clip(rate, _LEAST_RATE_HZ, _MOST_RATE_HZ)))
    title = f"{results.record.links} links that move along a curve (synthetic)"
    figure = new_figure(_HEIGHT_MM_OF_FILM, title)
    with writer.saving(figure, str(path), dpi):
        for shape, time_s in enumerate(results.time_s):
            for axes in figure.axes:
                axes.remove()
            chain = space(figure, results, shape, (4.0, 4.0, 100.0, 78.0), numbers=False)
            chain.set_title(f"{time_s:.2f} s", loc="center")
            angles = panel(figure, 120.0, 24.0, 46.0, 50.0)
            draw_angles(angles, results, shape)
            angles.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1)
            writer.grab_frame()


def _writer(path: Path, rate_hz: int) -> AbstractMovieWriter:
    if path.suffix == ".gif":
        return PillowWriter(fps=rate_hz)
    if path.suffix == ".mp4" and FFMpegWriter.isAvailable():
        return FFMpegWriter(fps=rate_hz)
    raise OutputError(
        "no writer for this kind of film",
        where=str(path),
        value=path.suffix,
        allowed=".gif; .mp4 where ffmpeg is installed",
        remedy="write a GIF, or install ffmpeg",
    )
