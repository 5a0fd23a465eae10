"""Angle error of every joint against its angle, and which orders of the angle it goes with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.figures.joint_columns import LEFT_MM, joint_panels, label_below, over_angle
from pa10cal.figures.orders_told import highest_told
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import AFTER, BEFORE, GREY, SEPARATOR, legend_at, new_figure, points
from pa10cal.results.analysis import CellJoint, LackOfFit, Periodogram

PICTURE = Picture(
    title="Where: error of each joint against its angle",
    needs=("analysis",),
    caption="""
One column a joint of ``{name}``. Above, the joint angle error, measured minus modelled, against
the joint angle, in every cell of readings: red before, blue after the named effects were added.
Below, how much of it a sine of the angle explains, order by order (Lomb-Scargle periodogram; of
many orders the highest in each band). Upright lines with markers: the orders at which joints are
known to err, once and twice a turn of the joint and, where the gear ratio is known, once and
twice a turn of the motor. A red marker far above its neighbours that is low in blue is an error
of that joint that was found. Grey: orders that so few different angles cannot tell apart; an
error at one of them appears at many, so only the known orders are drawn there. An error elsewhere
in the arm appears in several joints.
""",
)


_HEIGHT_MM = 131.0
#: Cells with so many times the usual uncertainty of a joint's angle do not set the scale.
_POOR = 3.0
#: Before is drawn broader, so that it is seen beneath after where nothing changed.
_BROAD = 1.7
#: Orders of a turn of the joint, and of the motor where the gear ratio is known.
_KNOWN_WITH_RATIO = 4
#: Where it is not, orders of the motor are not looked for.
_MOST_UNGEARED = 30.0
_BANDS_A_DECADE = 24.0
_MARKERS = {BEFORE: "s", AFTER: "o"}
_Fits = tuple[tuple[LackOfFit, str, float], ...]


def draw(results: Results) -> Figure:
    """Draw points above and the periodogram below, a column a joint, before and after."""
    found = results.analysis()
    joints = found.before.cells.joints
    figure = new_figure(_HEIGHT_MM, "Error of each joint angle, and its orders in the angle")
    fits = ((found.before, BEFORE, _BROAD), (found.after, AFTER, 1.0))
    limit = max(_limit(joint) for fit, _, _ in fits for joint in fit.cells.joints)
    points = joint_panels(figure, len(joints), 76.0, 43.0, "angle error [µrad]")
    orders = joint_panels(figure, len(joints), 29.0, 30.0, "explained, rms [µrad]")
    for k, joint in enumerate(joints):
        points[k].set_title(f"joint {joint.joint}")
        points[k].axhline(0.0, color=GREY, linewidth=0.6)
        _draw_points(points[k], fits, k)
        points[k].set_ylim(-limit, limit)
        _draw_orders(orders[k], fits, k)
    drawn = [np.asarray(line.get_ydata(), dtype=float) for axes in orders for line in axes.lines]
    highest = max((float(y.max()) for y in drawn if len(y)), default=0.0)
    for axes in orders:
        axes.set_ylim(0.0, 1.1 * highest or 1.0)
    label_below(figure, 65.0, "joint angle [deg]")
    known = [part.periodogram for part in found.before.by_joint if part.periodogram is not None]
    motor = "; N: gear ratio, one cycle a turn of the motor" if any(map(_geared, known)) else ""
    label_below(figure, 15.5, f"order: cycles a turn of the joint{motor}")
    handles = [
        Line2D([], [], color=BEFORE, marker="s", label="before: without the effects"),
        Patch(color=SEPARATOR, alpha=0.35, label="orders that these poses cannot tell apart"),
        Line2D([], [], color=AFTER, marker="o", label="after: with the named effects"),
    ]
    legend_at(figure, LEFT_MM, 6.0, handles, ncols=2)
    return figure


def _limit(joint: CellJoint) -> float:
    """Return how far points reach [µrad], without uncertain ones."""
    error, std = np.abs(joint.error_rad), joint.std_rad
    return float(1.1e6 * error[std <= _POOR * np.median(std)].max())


def _draw_points(axes: Axes, fits: _Fits, k: int) -> None:
    for fit, colour, broad in fits:
        joint = fit.cells.joints[k]
        points(
            axes,
            np.degrees(joint.q_rad),
            1e6 * joint.error_rad,
            color=colour,
            marker=_MARKERS[colour],
            markersize=1.1 * broad,
        )
    over_angle(axes, np.degrees(joint.q_rad))


def _draw_orders(axes: Axes, fits: _Fits, k: int) -> None:
    """Draw what sines explain, order by order as far as the angles tell, and at known orders."""
    axes.set_xscale("log")
    axes.grid(visible=False, axis="x")
    found = fits[0][0].by_joint[k].periodogram
    if found is None:
        axes.text(0.5, 0.5, "hardly\nturned", transform=axes.transAxes, ha="center")
        axes.set_xticks([])
        return
    told = highest_told(found.orders, fits[0][0].cells.joints[k].q_rad)
    last = found.orders[-1] if _geared(found) else min(_MOST_UNGEARED, max(told, found.marked[-1]))
    axes.axvspan(told, last, color=SEPARATOR, alpha=0.35, linewidth=0.0)
    for fit, colour, broad in fits:
        found = fit.by_joint[k].periodogram or found
        shown = found.orders <= min(told, last)
        order, highest = _highest_by_band(found.orders[shown], 1e6 * found.explained_rad[shown])
        axes.plot(order, highest, color=colour, linewidth=0.7 * broad)
        axes.vlines(found.marked, 0.0, 1e6 * found.marked_rad, color=colour, linewidth=0.8 * broad)
        axes.plot(
            found.marked,
            1e6 * found.marked_rad,
            color=colour,
            marker=_MARKERS[colour],
            markersize=2.0 + broad,
            linestyle="none",
        )
    axes.set_xlim(found.orders[0], last)
    axes.xaxis.set_major_locator(FixedLocator(list(found.marked)))
    axes.xaxis.set_major_formatter(FixedFormatter(_names(found)))
    axes.xaxis.set_minor_locator(NullLocator())


def _highest_by_band(orders: Array, explained: Array) -> tuple[Array, Array]:
    """Return the highest peak in each of a few bands of orders, where there are many."""
    if not len(orders):
        return orders, explained
    band = np.floor(_BANDS_A_DECADE * np.log10(orders / orders[0])).astype(int)
    first = np.flatnonzero(np.diff(band, prepend=-1))
    highest = np.maximum.reduceat(explained, first)
    at = [start + int(np.argmax(part)) for start, part in _parts(explained, first)]
    return orders[at], highest


def _parts(values: Array, first: NDArray[np.intp]) -> Iterator[tuple[int, Array]]:
    """Yield the parts of a column that begin at some rows, each with its first row."""
    for start, part in zip(first, np.split(values, first[1:]), strict=True):
        yield int(start), part


def _geared(found: Periodogram) -> bool:
    """Return whether the gear ratio of the joint is known."""
    return len(found.marked) == _KNOWN_WITH_RATIO


def _names(found: Periodogram) -> list[str]:
    """Return the marked orders as they are written: once and twice a turn, N and 2N."""
    if not _geared(found):
        return [f"{order:g}" for order in found.marked]
    return ["1", "2", "N", "\n2N"]
