"""One shape of a chain along a curve: in space, and its joint angles."""

from __future__ import annotations

from matplotlib.figure import Figure

from pa10cal.figures.curve_drawing import draw_angles, space
from pa10cal.figures.curve_results import CurveResults
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.style import new_figure, panel

PICTURE = Picture(
    title="A chain along a curve",
    needs=(),
    caption="""
A continuous curve as straight links ({name}). Left, the curve, the links, whose ends lie on it,
and the z axis of every link. The end of each link is the first point of the curve at the length
of a link from its beginning, so chords equal the length to rounding. Right, the angles of the
joints between the links, two rotations each. The roll of the first link about itself is free;
it was chosen so that the largest joint angle is smallest.
""",
)


def draw(results: CurveResults) -> Figure:
    """Draw the chain left, the angles of its joints right."""
    if results.moves:
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
