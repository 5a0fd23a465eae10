"""A chain that moves: some of its shapes, its joint angles over time, and the moves between."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pa10cal.figures.curve_drawing import space
from pa10cal.figures.curve_results import ONE_SHAPE, CurveResults
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import BLACK, evenly, new_figure, panel

PICTURE = Picture(
    title="A chain that moves",
    needs=(),
    caption="""
A chain of links that moves ({name}): some of its shapes above; joint angles over time, and the
largest move between two shapes, below. The helix stays in place while every link turns about
itself, so every joint bends to all sides in turn. The film shows the same, shape after shape.
Nothing of it was measured: the angles follow from the shapes alone, moment by moment.
""",
)

_SHAPES = 3
_HEIGHT_MM = 128.0
_COLOURS = "RdBu_r"


def draw(results: CurveResults) -> Figure:
    """Draw shapes above, the angles of all joints over time and the largest moves below."""
    if not results.moves:
        raise NothingToShowError(ONE_SHAPE)
    figure = new_figure(_HEIGHT_MM, f"{results.record.links} links along a curve that moves")
    for column, shape in enumerate(evenly(len(results.time_s) - 1, _SHAPES)):
        place_mm = (10.0 + 54.0 * column, 68.0, 50.0, 48.0)
        axes = space(figure, results, int(shape), place_mm, numbers=False)
        axes.set_title(f"{results.time_s[shape]:.2f} s", loc="center")
        if column == 0:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.22, 1.0), handlelength=1.2)
    joints = results.a_deg.shape[1]
    most = float(np.abs([results.a_deg, results.b_deg]).max(initial=1e-3))
    named = (("a, about z", results.a_deg), ("b, about y", results.b_deg))
    for column, (name, angle_deg) in enumerate(named):
        axes = panel(figure, 14.0 + 48.0 * column, 18.0, 42.0, 40.0)
        image = axes.imshow(
            angle_deg.T,
            aspect="auto",
            origin="lower",
            extent=(results.time_s[0], results.time_s[-1], 0.5, joints + 0.5),
            cmap=_COLOURS,
            vmin=-most,
            vmax=most,
            interpolation="nearest",
        )
        axes.grid(visible=False)
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.set_title(name)
        axes.set_xlabel("time [s]")
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
