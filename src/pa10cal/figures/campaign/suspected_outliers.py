"""The poses that a calibration doubts, each with why."""

from __future__ import annotations

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Grid, Row, Table

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

_HEADER: Row = ("pose", "load_N", "distance", "weight", "why")
_SHOWN: Row = ("pose", "load [N]", "distance", "weight", "why")


def tabulate(results: Results) -> Table:
    """Return every suspected outlier, the worst first."""
    case = results.general()
    rows = tuple(
        (
            outlier.pose,
            f"{outlier.load_N:g}",
            f"{outlier.distance:.2f}",
            f"{outlier.weight:.3f}",
            outlier.why,
        )
        for outlier in case.suspected_outliers
    )
    return Table(
        title="Suspected outliers",
        data=Grid(_HEADER, rows),
        shown=(Grid(_SHOWN, rows or (("none", "–", "–", "–", "–"),)),),
        notes=(
            f"{len(rows)} of {case.health.poses.measured} poses. None was dropped: each stayed in "
            "the fit with the weight given, 1 being that of the others.",
            "Distance: of what is left, in standard deviations of the scatter, over all that was "
            "read in the pose. In a campaign without a wrong pose, one is suspected once in a "
            "hundred campaigns.",
            "A suspected outlier may be a wrong reading, or the place where the model lacks an "
            "effect.",
        ),
    )
