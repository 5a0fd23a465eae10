"""Whether the campaigns of a group agree on the errors by joint angles, joint by joint."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import AFTER, GREY, name_rows, new_figure, panel, write_text_at
from pa10cal.results.group import CampaignsAgree

PICTURE = Picture(
    title="Where: campaigns that agree",
    needs=("verdict",),
    caption="""
The errors by joint angles that discovery found in ``{name}``, fitted to each campaign alone and
compared over the angles that two campaigns both visited, each less its mean there. Left: their
correlation; right: the slope of the second by the first, both uncertain alike; with 95 %
intervals. Written beside: root mean square of both and of what they differ by, and the part of
the turn that both visited. A correlation and a slope near one show that the error belongs to the
robot, and not to one set-up.
""",
)

Compared = tuple[str, CampaignsAgree]

_ROW_MM, _BELOW_MM, _ABOVE_MM = 7.0, 21.0, 12.0


def draw(results: Results) -> Figure:
    """Draw correlation and slope, a row a joint and pair of campaigns."""
    found = [
        (each.of, pair)
        for each in results.verdict().by_campaign or ()
        for pair in each.agreement
        if pair.correlation is not None
    ]
    if not found:
        raise NothingToShowError("no joint's error was seen by two campaigns at the same angles")
    found.sort(key=lambda each: each[0])
    height = _ROW_MM * max(len(found), 2)
    figure = new_figure(
        _BELOW_MM + height + _ABOVE_MM, "Errors by joint angles, campaign against campaign"
    )
    left = panel(figure, 36.0, _BELOW_MM, 36.0, height)
    right = panel(figure, 78.0, _BELOW_MM, 36.0, height)
    _draw(left, [p.correlation for _, p in found], [p.correlation95 for _, p in found])
    _draw(right, [p.slope for _, p in found], [p.slope95 for _, p in found])
    left.set_xlabel("correlation")
    right.set_xlabel("slope")
    name_rows(left, [f"{of}: {p.first}, {p.second}" for of, p in found], 0.6)
    name_rows(right, ["" for _ in found], 0.6)
    for row, (_, pair) in enumerate(found):
        right.annotate(
            _beside(pair), (1.03, row), xycoords=("axes fraction", "data"), va="center", fontsize=6
        )
    write_text_at(
        figure, 2.0, 6.5, "Beside: rms of both / of the difference [mrad]; turn both visited.",
        color=GREY,
    )  # fmt: skip
    return figure


def _draw(
    axes: Axes,
    values: list[float | None],
    intervals: list[tuple[float, float] | None],
) -> None:
    """Draw values with their intervals, row by row."""
    at = np.array(values, dtype=float)
    ends = np.array(intervals, dtype=float).reshape(-1, 2)
    off = np.abs(ends - at[:, None]).T
    axes.errorbar(at, np.arange(len(at)), xerr=off, fmt="o", ms=3.0, color=AFTER, capsize=2.0)
    axes.axvline(1.0, color=GREY, linewidth=0.6)
    low = min(0.8, float(ends.min()) - 0.02)
    axes.set_xlim(low, max(1.02, float(ends.max()) + 0.02))


def _beside(pair: CampaignsAgree) -> str:
    return (
        f"{pair.first_rms_mrad:.3f}, {pair.second_rms_mrad:.3f} / "
        f"{pair.difference_rms_mrad:.3f}; {100.0 * pair.share_of_turn:.0f} %"
    )
