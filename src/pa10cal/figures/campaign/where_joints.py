"""Angle error of every joint against its angle, and which orders of the angle it goes with."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from pa10cal.figures.joint_columns import LEFT_MM, joint_panels, label_below, over_angle
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    GREY,
    legend_at,
    new_figure,
    points,
)
from pa10cal.results.analysis import CellJoint, LackOfFit, Periodogram

PICTURE = Picture(
    title="Where: error of each joint against its angle",
    needs=("analysis",),
    caption="""
One column a joint of ``{name}``. Above, the joint angle error, measured minus modelled, against
the joint angle, in every cell of readings: red before, blue after the named effects were added.
Below, how much of it a sine of the angle explains, order by order (generalised Lomb-Scargle
periodogram). Dotted lines: orders at which joints are known to have errors, once and twice a
turn of the joint, once and twice a turn of the motor. A red peak at a dotted line that is
absent in blue is an error of that joint that was found. With few poses the orders cannot all be
separated, so peaks have neighbours of equal height, and an error elsewhere in the arm appears
in several joints.
""",
)

_HEIGHT_MM = 128.0
#: Cells with so many times the usual uncertainty of a joint's angle do not set the scale.
_POOR = 3.0
#: Before is drawn broader, so that it is seen beneath after where nothing changed.
_BROAD = 1.7
_Fits = tuple[tuple[LackOfFit, str, float], ...]


def draw(results: Results) -> Figure:
    """Draw points above and the periodogram below, a column a joint, before and after."""
    found = results.analysis()
    joints = found.before.cells.joints
    figure = new_figure(_HEIGHT_MM, "Error of each joint angle, and its orders in the angle")
    fits = ((found.before, BEFORE, _BROAD), (found.after, AFTER, 1.0))
    limit = max(_limit(joint) for fit, _, _ in fits for joint in fit.cells.joints)
    highest = max(
        (
            max((*part.periodogram.explained_rad, *part.periodogram.marked_rad)) * 1e6
            for fit, _, _ in fits
            for part in fit.by_joint
            if part.periodogram is not None
        ),
        default=1.0,
    )
    points = joint_panels(figure, len(joints), 73.0, 43.0, "angle error [µrad]")
    orders = joint_panels(figure, len(joints), 26.0, 30.0, "explained, rms [µrad]")
    for k, joint in enumerate(joints):
        points[k].set_title(f"joint {joint.joint}")
        points[k].axhline(0.0, color=GREY, linewidth=0.6)
        _draw_points(points[k], fits, k)
        points[k].set_ylim(-limit, limit)
        _draw_orders(orders[k], fits, k)
        orders[k].set_ylim(0.0, 1.1 * highest)
    label_below(figure, 62.0, "joint angle [deg]")
    label_below(
        figure,
        12.5,
        "order: cycles a turn of the joint (N: gear ratio, cycles a turn of the motor)",
    )
    handles = [
        Line2D([], [], color=BEFORE, marker="o", label="before: without the effects"),
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
            marker=".",
            markersize=2.2 * broad,
        )
    over_angle(axes, np.degrees(joint.q_rad))


def _draw_orders(axes: Axes, fits: _Fits, k: int) -> None:
    """Draw periodograms over the logarithm of the order, known orders marked."""
    axes.set_xscale("log")
    axes.grid(visible=False, axis="x")
    found = fits[0][0].by_joint[k].periodogram
    if found is None:
        axes.text(0.5, 0.5, "hardly\nturned", transform=axes.transAxes, ha="center")
        axes.set_xticks([])
        return
    for order in found.marked:
        axes.axvline(order, color=GREY, linewidth=0.5, linestyle=":")
    for fit, colour, broad in fits:
        found = fit.by_joint[k].periodogram or found
        axes.plot(found.orders, 1e6 * found.explained_rad, color=colour, linewidth=0.7 * broad)
        axes.plot(
            found.marked,
            1e6 * found.marked_rad,
            color=colour,
            marker="o",
            markersize=2.0 + broad,
            markeredgecolor=BLACK,
            markeredgewidth=0.3,
            linestyle="none",
        )
    axes.set_xlim(found.orders[0], found.orders[-1])
    axes.xaxis.set_major_locator(FixedLocator(list(found.marked)))
    axes.xaxis.set_major_formatter(FixedFormatter(_names(found)))
    axes.xaxis.set_minor_locator(NullLocator())


def _names(found: Periodogram) -> list[str]:
    """Return the marked orders as they are written: once and twice a turn, N and 2N."""
    if len(found.marked) != 4:
        return [f"{order:g}" for order in found.marked]
    return ["1", "2", "N", "\n2N"]
