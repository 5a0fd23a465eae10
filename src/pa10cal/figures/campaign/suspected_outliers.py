"""Poses far outside the scatter of the others, each with why."""

from __future__ import annotations

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Table, frame_of, shown

PICTURE = Picture(
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

_HEADER = ("pose", "load_N", "distance", "weight", "why")
_SHOWN = ("pose", "load [N]", "distance", "weight", "why")


def tabulate(results: Results) -> Table:
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
