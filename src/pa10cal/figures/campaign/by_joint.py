"""Remaining error joint by joint: against angles, and as torque."""

from __future__ import annotations

from bisect import bisect_left
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.style import draw_points, legend_at, mark, new_figure, panel, write_text_at
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import AFTER, BEFORE, BLUE, GREY, ORANGE, SEPARATOR
from pa10cal.results.analysis import AnalysisRecord, LackOfFit, Periodogram

#: Left and right end of a row of panels, and the space between two of them.
_LEFT_MM, _RIGHT_MM, _GAP_MM = 18.0, 168.0, 2.5
#: Part of a panel at either side that has no number, so that those of neighbours stay apart.
_BARE = 0.18
#: The least range that is shown [deg, mm], of a joint that stood still.
_LEAST = 1.0
#: Beneath panels whose titles say where the unit is another one.
_POSITION = "joint angle [deg], of a joint that slides its position [mm]"
#: Fits before and after: colour, marker, and how broadly they are drawn. Before is broader, so that
#: it is seen beneath after where nothing changed.
_LOOKS = ((BEFORE, "s", 1.7), (AFTER, "o", 1.0))


def _position(q: Array, *, slides: bool) -> Array:
    """Return positions [rad, or m of a joint that slides] as they are shown [deg or mm]."""
    return 1e3 * q if slides else np.degrees(q)


def _joint_panels(
    figure: Figure, count: int, bottom_mm: float, height_mm: float, label: str
) -> list[Axes]:
    """Return panels side by side, the label and the numbers of their common axis at the first."""
    width = (_RIGHT_MM - _LEFT_MM) / count
    panels = [
        panel(figure, _LEFT_MM + k * width, bottom_mm, width - _GAP_MM, height_mm)
        for k in range(count)
    ]
    panels[0].set_ylabel(label)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    return panels


def _label_below(figure: Figure, y_mm: float, text: str) -> None:
    """Write a common label below a row of panels."""
    write_text_at(figure, (_LEFT_MM + _RIGHT_MM) / 2, y_mm, text, ha="center")


def _span_positions(axes: Axes, position: Array) -> None:
    """Let an axis span the positions [deg or mm] of a joint, with two round numbers."""
    middle = (float(position.min()) + float(position.max())) / 2.0
    half = 0.56 * max(float(np.ptp(position)), _LEAST)
    axes.set_xlim(middle - half, middle + half)
    ends = middle + (1.0 - 2.0 * _BARE) * half * np.array([-1.0, 1.0])
    step = 5.0 * 10.0 ** np.floor(np.log10(half / 10.0))  # two at least lie between these ends
    axes.set_xticks(np.array([np.ceil(ends[0] / step), np.floor(ends[1] / step)]) * step)


# Up to which order of a joint's angle the measured angles separate sines.

#: Angles closer than this part of a cycle count as one.
_SAME_PHASE = 0.1


def highest_separable(orders: Array, q_rad: Array) -> float:
    """Return the highest order (cycles a turn) up to which the angles separate all orders.

    Two orders differ over the arc that the joint moved where they are one cycle of it apart, and
    the sine of each has two unknowns. With the mean, k orders need 1 + 2 k different angles; with
    fewer, any error is a sum of such sines.

    Args:
        orders: (F,) ascending cycles a turn, of which one is returned; the first where not even
            that can be separated.
        q_rad: (C,) angles measured.
    """
    angles = np.sort(q_rad / (2.0 * np.pi)).tolist()
    turns, highest = angles[-1] - angles[0], float(orders[0])
    for order in orders.tolist():
        different, at = 0, 0
        while at < len(angles):
            different, at = different + 1, bisect_left(angles, angles[at] + _SAME_PHASE / order)
        if different < 1 + 2 * int(turns * order):
            break
        highest = order
    return highest


# Angle error of every joint against its angle, and which orders of the angle it goes with.

#: Cells with so many times the usual uncertainty of a joint's angle do not set the scale.
_POOR = 3.0
#: Where the gear ratio is not known, orders of the motor are not looked for.
_MOST_UNGEARED = 30.0
#: Orders of a turn of the joint.
_OF_JOINT = (1.0, 2.0)
#: Of many orders the highest of each band is drawn.
_BANDS_A_DECADE = 24.0


@picture(
    title="Where: error of each joint against its angle",
    needs=("analysis",),
    section="verdict",
    caption="""
One column a joint of ``{name}``. Above, the joint angle error, measured minus modelled, against
the joint angle, in every cell of readings: red before, blue after the named effects were added.
Below, how much of it a sine of the angle explains, order by order (Lomb-Scargle periodogram; of
many orders the highest in each band). Upright lines with markers: the orders at which joints are
known to err, once and twice a turn of the joint and, where the gear ratio is known, once and
twice a turn of the motor. A red marker far above its neighbours that is low in blue is an error
of that joint that was found. Grey: orders that so few different angles cannot separate; an
error at one of them appears at many, so only the known orders are drawn there. An error elsewhere
in the arm appears in several joints.
""",
)
def draw_where_joints(results: ResultsBundle) -> Figure:
    """Draw points above and the periodogram below, a column a joint, before and after."""
    found = results.sound_record(AnalysisRecord)
    fits = (found.before, found.after)
    joints = found.before.by_joint
    known = [joint.periodogram for joint in joints if joint.periodogram is not None]
    motor = (
        "; N: gear ratio, one cycle a turn of the motor"
        if any(_gear_ratio(each) for each in known)
        else ""
    )
    figure = new_figure(131.0, "Error of each joint angle, and its orders in the angle")
    upper = _joint_panels(figure, len(joints), 76.0, 43.0, "angle error [µrad]")
    orders = _joint_panels(figure, len(joints), 29.0, 30.0, "explained, rms [µrad]")
    _label_below(figure, 65.0, _POSITION if results.sliding_joints else "joint angle [deg]")
    _label_below(figure, 15.5, f"order: cycles a turn of the joint{motor}")
    limit = max(
        1.1e6
        * float(np.abs(cells.error_rad)[cells.std_rad <= _POOR * np.median(cells.std_rad)].max())
        for fit in fits
        for cells in fit.by_joint
    )
    for k, joint in enumerate(joints):
        slides = joint.joint in results.sliding_joints
        upper[k].set_title(f"joint {joint.joint}{' [µm]' if slides else ''}")
        upper[k].axhline(0.0, color=GREY, linewidth=0.6)
        for fit, (color, marker, broad) in zip(fits, _LOOKS, strict=True):
            cells = fit.by_joint[k]
            position = _position(cells.q_rad, slides=slides)
            look = {"color": color, "marker": marker, "markersize": 1.1 * broad}
            draw_points(upper[k], position, 1e6 * cells.error_rad, **look)
            _span_positions(upper[k], position)
        upper[k].set_ylim(-limit, limit)
        _draw_orders(orders[k], fits, k, without="slides" if slides else "hardly\nturned")
    drawn = [np.asarray(line.get_ydata(), dtype=float) for axes in orders for line in axes.lines]
    highest = max((float(y.max()) for y in drawn if len(y)), default=0.0)
    for axes in orders:
        axes.set_ylim(0.0, 1.1 * highest or 1.0)
    handles = [
        Line2D([], [], color=BEFORE, marker="s", label="before: without the effects"),
        Patch(color=SEPARATOR, alpha=0.35, label="orders that these poses cannot separate"),
        Line2D([], [], color=AFTER, marker="o", label="after: with the named effects"),
    ]
    legend_at(figure, _LEFT_MM, 6.0, handles, ncols=2)
    return figure


def _draw_orders(axes: Axes, fits: tuple[LackOfFit, LackOfFit], k: int, *, without: str) -> None:
    """Draw the periodogram of a joint: up to the highest separable order, and at known orders.

    Args:
        axes: to draw in.
        fits: before and after.
        k: the joint, from 0.
        without: why there is no periodogram, if there is none.
    """
    axes.grid(visible=False, axis="x")
    found = fits[0].by_joint[k].periodogram
    if found is None:
        axes.text(0.5, 0.5, without, transform=axes.transAxes, ha="center")
        axes.set_xticks([])
        return
    axes.set_xscale("log")
    separable = highest_separable(found.orders, fits[0].by_joint[k].q_rad)
    last = found.orders[-1]
    if _gear_ratio(found) is None:
        last = min(_MOST_UNGEARED, max(separable, found.marked[-1]))
    axes.axvspan(separable, last, color=SEPARATOR, alpha=0.35, linewidth=0.0)
    for fit, (color, marker, broad) in zip(fits, _LOOKS, strict=True):
        found = fit.by_joint[k].periodogram or found
        shown = found.orders <= min(separable, last)
        order, explained = found.orders[shown], 1e6 * found.explained_rad[shown]
        if len(order):  # the highest in each of a few bands of orders, where there are many
            band = np.floor(_BANDS_A_DECADE * np.log10(order / order[0])).astype(int)
            first = np.flatnonzero(np.diff(band, prepend=-1))
            parts = np.split(explained, first[1:])
            highest = first + [int(np.argmax(part)) for part in parts]
            order, explained = order[highest], explained[highest]
        axes.plot(order, explained, color=color, linewidth=0.7 * broad)
        marked = 1e6 * found.marked_rad
        axes.vlines(found.marked, 0.0, marked, color=color, linewidth=0.8 * broad)
        look: dict[str, Any] = {"color": color, "marker": marker, "linestyle": "none"}
        axes.plot(found.marked, marked, markersize=2.0 + broad, **look)
    axes.set_xlim(found.orders[0], last)
    axes.xaxis.set_major_locator(FixedLocator(list(found.marked)))
    axes.xaxis.set_major_formatter(FixedFormatter(names_of_orders(found)))
    axes.xaxis.set_minor_locator(NullLocator())


def names_of_orders(found: Periodogram) -> list[str]:
    """Return the names of the marked orders: 1 and 2, and N and 2N of a gear ratio N."""
    ratio = _gear_ratio(found)
    names = []
    for order in found.marked:
        called = [f"{order:g}"] if order in _OF_JOINT else []
        if ratio is not None and np.isclose(order, ratio):
            called.append("N")
        elif ratio is not None and np.isclose(order, 2.0 * ratio):
            called.append("2N" if called else "\n2N")  # a line below, since 2N is close to N
        names.append(", ".join(called))
    return names


def _gear_ratio(found: Periodogram) -> float | None:
    """Return the gear ratio of the joint; None where it is not known, or 1."""
    of_motor = sorted(set(found.marked) - set(_OF_JOINT))
    if not of_motor:
        return None
    # Of a ratio of 2 or 1/2 one of N and 2N is an order of the joint, too.
    only_twice = len(of_motor) == 1 and of_motor[0] > max(_OF_JOINT)
    return float(of_motor[0] / 2.0 if only_twice else of_motor[0])


# Residual torque of every joint, by direction of arrival and joint angle.

#: Half the noise band, in standard deviations.
_NOISES = 2.0
#: Torques below this are those of a log that was calculated [N m].
_LEAST_NM = 1e-6
#: Directions of arrival: sign, marker and colour, and what they are called.
_SIDES: tuple[tuple[int, dict[str, Any], str], ...] = (
    (1, {"color": BLUE, "marker": "^"}, "arrived in + direction"),
    (-1, {"color": ORANGE, "marker": "v"}, "in − direction"),
    (0, {"color": GREY, "marker": "o"}, "had not moved"),
)


@picture(
    title="Where: remaining torque at each joint",
    needs=("analysis",),
    section="residuals",
    caption="""
Torque of each joint of ``{name}`` as logged, minus the torque of the known weights, against the
joint angle; above before, below after the named effects were added. Triangles point in the
direction in which the joint arrived. Two separate bands, one for each direction, are friction
that held part of the load. A slope or a curve is a wrong weight or scale. Points inside the
grey band are noise. Errors of masses, loads and zeros, as large as their stated uncertainty,
are removed first. Each row has its own axis. Poses always reached from one side show one band
only.
""",
)
def draw_where_torque(results: ResultsBundle) -> Figure:
    """Draw residual torques before above those after, a column a joint."""
    found = results.sound_record(AnalysisRecord)
    joints = found.before.by_joint
    if any(joint.torque_residual_Nm is None for joint in joints):
        raise NothingToShowError(
            "residual torques need logged torques, known weights and repeated poses"
        )
    limits = [  # how far the torques of any joint reach, and at least their noise
        1.1
        * max(
            *(float(np.abs(np.asarray(of.torque_residual_Nm)).max()) for of in fit.by_joint),
            *(_NOISES * (of.torque_noise_Nm or 0.0) for of in fit.by_joint),
        )
        for fit in (found.before, found.after)
    ]
    if max(limits) < _LEAST_NM:
        raise NothingToShowError("the torques logged are those of the weights: none remain")
    figure = new_figure(128.0, "Residual torque, logged minus static, joint by joint")
    _label_below(figure, 13.5, _POSITION if results.sliding_joints else "joint angle [deg]")
    for fit, limit, bottom_mm, when in (
        (found.before, limits[0], 76.0, "before"),
        (found.after, limits[1], 24.0, "after"),
    ):
        label = f"{when}: residual [N m]"
        panels = _joint_panels(figure, len(joints), bottom_mm, 38.0, label)
        for axes, joint in zip(panels, fit.by_joint, strict=True):
            slides = joint.joint in results.sliding_joints
            position = _position(joint.q_rad, slides=slides)
            residual_Nm = np.asarray(joint.torque_residual_Nm)
            for sign, look, _ in _SIDES:
                rows = np.sign(joint.arrival) == sign
                if rows.any():
                    draw_points(axes, position[rows], residual_Nm[rows], markersize=2.5, **look)
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            _span_positions(axes, position)
            noise = _NOISES * (joint.torque_noise_Nm or 0.0)
            axes.axhspan(-noise, noise, color=SEPARATOR, alpha=0.5, linewidth=0.0)
            title = f"joint {joint.joint}{' [N]' if slides else ''}" if when == "before" else ""
            axes.set(ylim=(-limit, limit), title=title)
    sides = {int(side) for joint in joints for side in np.sign(joint.arrival)}
    shown = [mark(label, **look) for sign, look, label in _SIDES if sign in sides]
    band = Line2D([], [], color=SEPARATOR, linewidth=5.0, label="noise, ± 2 std")
    legend_at(figure, _LEFT_MM, 6.0, [*shown, band], ncols=4)
    return figure
