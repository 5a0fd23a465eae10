"""Every figure that the paper states, beside the same quantity from this campaign."""

from __future__ import annotations

from operator import attrgetter

from pa10cal.figures.compared_campaign import Found
from pa10cal.figures.paper_comparison import compared
from pa10cal.figures.registry import Picture
from pa10cal.figures.repeats import incompleteness
from pa10cal.figures.results import Results
from pa10cal.figures.table import Shown, Table, frame_of

PICTURE = Picture(
    title="Paper against ours",
    needs=("papers_calibration", "evaluation", "planes", "poses"),
    caption="""
Every value that the paper states, with its place there, beside the same quantity from
``{name}``. Where the paper draws a conclusion from its own values, the column *recomputed*
holds what they give. *Remark* says how our value was obtained and what limits the comparison; a
quantity that the campaign does not state is called not measured. Loads that the paper does not
have stand below those it has. Agreement shows that the method is implemented as published; it
says nothing about the robot of the authors.
""",
)

_COLUMNS = ("quantity", "condition", "unit", "paper", "recomputed", "ours", "source", "remark")
_NOTES = (
    "recomputed: what the paper's own values give, where it draws a conclusion from them.",
    "ours: from this campaign alone; the arm of a synthetic campaign is not the one that the "
    "authors measured.",
)


def tabulate(results: Results) -> Table:
    """Return the paper's values with ours."""
    found = Found.of(results)
    data = frame_of(_COLUMNS, map(attrgetter(*_COLUMNS), compared(found)))
    lacking = incompleteness(found.combined, found.scatter)
    notes = _NOTES if lacking is None else (*_NOTES, lacking)
    return Table("The paper's values beside ours", data, (Shown(data),), notes)
