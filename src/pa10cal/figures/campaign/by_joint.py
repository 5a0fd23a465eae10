"""What is left, joint by joint: against angles, as errors of positions, as torque."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SEPARATOR,
    legend_at,
    new_figure,
    panel,
    points,
    write_text_at,
)
from pa10cal.results.analysis import CellJoint, LackOfFit, Periodogram
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.evaluation import HeldOutRows, ResidualRows

LEFT_MM = 18.0
_RIGHT_MM, _GAP_MM = 168.0, 2.5
#: Part of a panel at either side that has no tick: labels of neighbours stay apart.
_BARE = 0.14
_BEYOND = 0.06
#: Part of the angles that two numbers are apart at least, and more steps until two are.
_APART = 0.5
_STEPS = (5, 10, 20)
#: The least that is shown [deg, mm], of a joint that stood still.
_LEAST = 1.0


def joint_panels(
    figure: Figure, count: int, bottom_mm: float, height_mm: float, label: str
) -> list[Axes]:
    """Return panels side by side, the label and the numbers of their common axis at the first."""
    width = (_RIGHT_MM - LEFT_MM) / count
    panels = [
        panel(figure, LEFT_MM + k * width, bottom_mm, width - _GAP_MM, height_mm)
        for k in range(count)
    ]
    panels[0].set_ylabel(label)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    return panels


def over_angle(axes: Axes, q_deg: NDArray[np.float64]) -> None:
    """Let an axis span the angles of a joint, with two numbers."""
    middle = (float(q_deg.min()) + float(q_deg.max())) / 2.0
    span = max(float(np.ptp(q_deg)), _LEAST)
    low, high = middle - span / 2.0, middle + span / 2.0
    axes.set_xlim(low - _BEYOND * span, high + _BEYOND * span)
    for steps in _STEPS:
        ticks = np.asarray(MaxNLocator(steps, steps=[1, 2, 3, 5, 10]).tick_values(low, high))
        inside = ticks[(ticks > low + _BARE * span) & (ticks < high - _BARE * span)]
        if np.ptp(inside) > _APART * span:
            break
    axes.set_xticks(inside[[0, -1]])


def label_below(figure: Figure, y_mm: float, text: str) -> None:
    """Write a common label below a row of panels."""
    write_text_at(figure, (LEFT_MM + _RIGHT_MM) / 2, y_mm, text, ha="center")


# Up to which order of a joint's angle the measured angles tell sines apart.

#: Angles closer than this part of a cycle count as one.
_SAME_PHASE = 0.1


def highest_told(orders: Array, q_rad: Array) -> float:
    """Return the highest order (cycles a turn) up to which the angles tell all orders apart.

    A sine has two unknowns, and two orders differ over the arc that the joint moved where they are
    one cycle of it apart. So many orders up to a highest one can be told apart only where there are
    twice as many different angles, the mean being one unknown more; beyond that any error is a sum
    of such sines.

    Args:
        orders: (F,) ascending cycles a turn, of which one is returned; the first where not even
            that can be told.
        q_rad: (C,) angles measured.
    """
    angles = np.sort(q_rad / (2.0 * np.pi)).tolist()
    turns, highest = angles[-1] - angles[0], float(orders[0])
    for order in orders.tolist():
        if _different(angles, _SAME_PHASE / order) < 1 + 2 * int(turns * order):
            break
        highest = order
    return highest


def _different(angles: list[float], apart: float) -> int:
    """Return how many of ascending angles [turns] are so far apart."""
    count, at = 0, 0
    while at < len(angles):
        count, at = count + 1, bisect_left(angles, angles[at] + apart)
    return count


# Angle error of every joint against its angle, and which orders of the angle it goes with.

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


@picture(
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
def draw_where_joints(results: Results) -> Figure:
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


# Remaining error expressed as errors of the joint positions, against each position.
#
# A picture of where to look, not a test: a joint that does not err takes part of what another
# does, wherever a pose has fewer or hardly more readings than joints.

_ROW_MM, _BETWEEN_MM, _BELOW_MM, _ABOVE_MM = 38.0, 4.0, 33.0, 14.0
#: Most bins of the running mean over what a joint turned, and share of the errors in sight.
_BINS = 90
_IN_SIGHT = 0.998
#: Joint error thought possible, a standard deviation [rad or m]: decides what poses leave open.
_POSSIBLE = 1e-3
#: Part of the residuals that joints need not explain; small, or their errors would come out short.
_NOISE_SHARE = 0.1
#: Fewer points than this have no mean worth drawing.
_LEAST_IN_BIN = 5
#: Joints whose errors are all below this part of the largest move nothing that was measured.
_NOTHING = 1e-2


@dataclass(frozen=True)
class PoseResiduals:
    """Residuals of P poses about a model."""

    q: Array  # (P, n) joint positions [rad, m]
    position_mm: Array  # (P, 3) predicted less measured, along the axes of the base
    # (P, 3) axis times angle, along the axes of the base; None where no attitude was seen
    rotation_deg: Array | None


@dataclass(frozen=True)
class _Row:
    """A row of panels."""

    title: str  # what its poses are
    colour: str  # of its points
    q: Array  # (P, n) joint positions [deg, mm]
    error: Array  # (P, n) errors of the joints [mrad, mm]
    # (P,) poses with a joint at an angle that the model has not learnt from
    beyond: NDArray[np.bool_]


@picture(
    title="Error of each joint against its position",
    needs=("general_calibration", "evaluation", "poses", "positions"),
    caption="""
Remaining error at every pose of ``{name}``, expressed as errors of the joint positions, against
the position of each joint; one column a joint, black the running mean. Rows: poses fitted and
poses held out before discovery, and held-out poses after it; without discovery, those of the
calibrated model. A pattern that is the same in fitted and held-out poses is an error that
depends on the joint angle; the picture does not show whether encoder, gear or controller causes
it. A flat last row shows that the error was found; grey points there are extrapolated. The
errors of all joints are estimated together, so a joint without error may take part of another
joint's error, more so where the instrument does not measure orientation.
""",
)
def draw_error_by_joint(results: Results) -> Figure:
    """Draw errors of poses fitted and held out, and of those held out after discovery."""
    case, joints = results.general(), results.joints()
    chain, p_ee_target_m = results.chain(), _target(case)
    to_shown = np.where(joints.slides, 1e3, np.degrees(1.0))
    rows = []
    for title, colour, found in _sets(results, case):
        q = joints.of(found.pose.tolist(), found.load_N.tolist())
        left = PoseResiduals(q, found.position_mm, found.rotation_deg)
        error = 1e3 * joint_errors(chain, left, p_ee_target_m)
        rows.append(_Row(title, colour, left.q * to_shown, error, _beyond(found)))
    figure = new_figure(
        _BELOW_MM + len(rows) * (_ROW_MM + _BETWEEN_MM) - _BETWEEN_MM + _ABOVE_MM,
        "Remaining error expressed as joint errors, against the position of each joint",
    )
    everywhere = np.vstack([row.q for row in rows])
    limit = 1.05 * max(float(np.quantile(np.abs(row.error), _IN_SIGHT)) for row in rows)
    averaged = False
    for k, row in enumerate(rows):
        bottom = _BELOW_MM + (len(rows) - 1 - k) * (_ROW_MM + _BETWEEN_MM)
        label = f"{row.title}\n{_unit(joints.slides)}"
        panels = joint_panels(figure, len(joints.slides), bottom, _ROW_MM, label)
        panels[0].yaxis.labelpad = 1.0
        averaged |= _draw_row(panels, row, everywhere, limit)
        for joint, axes in enumerate(panels):
            axes.set_title(f"joint {joint + 1}" if k == 0 else "")
            axes.tick_params(labelbottom=k == len(rows) - 1)
    sliding = [str(joint + 1) for joint in np.flatnonzero(joints.slides)]
    angle = (
        f"joint angle [deg]; of joint {', '.join(sliding)} mm" if sliding else "joint angle [deg]"
    )
    label_below(figure, _BELOW_MM - 9.5, angle)
    for k, line in enumerate(_notes(rows, limit, averaged, case)):
        write_text_at(figure, 2.0, 13.5 - 4.0 * k, line, color=GREY)
    return figure


def _sets(
    results: Results, case: GeneralCalibrationRecord
) -> Iterator[tuple[str, str, ResidualRows | HeldOutRows]]:
    """Yield the poses of each row: what they are, their colour, their residuals."""
    models = results.held_out().models
    label = "{}, before" if "extended" in models else "calibrated model, {}"
    yield label.format("fitted"), ORANGE, case.residuals
    if "linear" in models:
        yield label.format("held out"), BEFORE, models["linear"].rows
    if "extended" in models:
        yield "held out, after", AFTER, models["extended"].rows


def _beyond(found: ResidualRows | HeldOutRows) -> NDArray[np.bool_]:
    extrapolated = found.extrapolated if isinstance(found, HeldOutRows) else None
    return np.zeros(len(found), dtype=bool) if extrapolated is None else extrapolated


def _target(case: GeneralCalibrationRecord) -> Array:
    """Return the place (3,) of what was measured, the middle of several, in the end-effector."""
    if case.solved.places_m.size:
        return np.asarray(np.reshape(case.solved.places_m, (-1, 3)).mean(axis=0))
    tool = [case.parameters.get(f"tool_{axis}") for axis in "xyz"]
    return np.array([0.0 if parameter is None else parameter.value for parameter in tool])


def _draw_row(panels: list[Axes], row: _Row, everywhere: Array, limit: float) -> bool:
    """Draw a row and return whether poses are dense enough anywhere for a mean."""
    averaged = False
    for axes, q, error, every in zip(panels, row.q.T, row.error.T, everywhere.T, strict=True):
        for poses, colour in ((~row.beyond, row.colour), (row.beyond, GREY)):
            points(axes, q[poses], error[poses], color=colour, marker=".", markersize=1.5)
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        span = float(np.ptp(every))
        if span > 0.0:
            bins = np.clip(len(q) // (2 * _LEAST_IN_BIN), 1, _BINS)
            middle, mean = running_mean(q, error, span / float(bins))
            axes.plot(middle, mean, color=BLACK, linewidth=0.9)
            known = np.isfinite(mean)
            averaged |= bool((known[1:] & known[:-1]).any())  # else no line is seen
        axes.set_ylim(-limit, limit)
        over_angle(axes, every)
    return averaged


def _unit(slides: NDArray[np.bool_]) -> str:
    return "error [mrad; mm]" if slides.any() else "error [mrad]"


def _notes(
    rows: list[_Row], limit: float, averaged: bool, case: GeneralCalibrationRecord
) -> Iterator[str]:
    beyond = sum(int((np.abs(row.error) > limit).sum()) for row in rows)
    model = "before and after discovery" if rows[-1].colour == AFTER else "calibrated model"
    points_lie = "point lies" if beyond == 1 else "points lie"
    outside = f"; {beyond} {points_lie} outside the panels" if beyond else ""
    yield (
        f"Rows of {', '.join(str(len(row.q)) for row in rows)} poses, {model}{outside}."
        f"{' Black: running mean.' if averaged else ''}"
    )
    extrapolated = int(rows[-1].beyond.sum())
    if extrapolated:
        yield f"Grey: {extrapolated} extrapolated poses, beyond the angles of the fit."
    if case.residuals.rotation_deg is None:
        yield "Positions alone were measured: an error of one joint appears in several." + _hidden(
            rows
        )
    elif rows[-1].colour != AFTER:
        yield "No model with discovered effects was evaluated at the held-out poses."


def _hidden(rows: list[_Row]) -> str:
    """Say of which joints no error can be seen: what was measured lies on their axes."""
    largest = np.array([np.abs(row.error).max(axis=0) for row in rows]).max(axis=0)
    joints = [str(joint + 1) for joint in np.flatnonzero(largest < _NOTHING * largest.max())]
    return f" None of joint {', '.join(joints)} can be seen." if joints else ""


def joint_errors(chain: Chain, left: PoseResiduals, p_ee_target_m: Array) -> Array:
    """Return by how much further joints stand than the model says, (P, n) [rad, m].

    Least squares over the readings of a pose, position and attitude weighed by what is left of
    each, and every joint's error by what is possible.

    Args:
        chain: of the nominal arm, which is near enough for this.
        left: what the model leaves.
        p_ee_target_m: (3,) place of what was measured, in the end-effector frame.
    """
    end = chain.forward_with_screws(left.q)
    screws = end.screws[:, :, chain.joint_columns]
    arm_m = end.T[:, :3, :3] @ p_ee_target_m
    along: Array = screws[:, :3] + np.cross(screws[:, 3:], arm_m[:, :, None], axis=1)
    rows, off = _weighed(along, -1e-3 * left.position_mm)
    if left.rotation_deg is not None:
        turned, more = _weighed(screws[:, 3:], -np.radians(left.rotation_deg))
        rows, off = np.concatenate([rows, turned], axis=1), np.concatenate([off, more], axis=1)
    across = rows.transpose(0, 2, 1)
    normal = across @ rows + np.eye(rows.shape[2]) / _POSSIBLE**2
    return np.asarray(np.linalg.solve(normal, across @ off[:, :, None])[:, :, 0])


def _weighed(rows: Array, off: Array) -> tuple[Array, Array]:
    """Return rows (P, 3, n) and what is off (P, 3) over what passes for noise."""
    size = _NOISE_SHARE * float(np.sqrt(np.mean(off**2)))
    return (rows / size, off / size) if size > 0.0 else (rows, off)


def running_mean(x: Array, y: Array, width: float) -> tuple[Array, Array]:
    """Return the middles (B,) of bins, and the mean of each: nan where it holds hardly a point."""
    bins = np.floor((x - x.min()) / width).astype(np.intp)
    count = np.bincount(bins)
    mean = np.bincount(bins, y) / np.maximum(count, 1)
    middle = x.min() + width * (np.arange(len(count)) + 0.5)
    return middle, np.where(count >= _LEAST_IN_BIN, mean, np.nan)


# Residual torque of every joint, by direction of arrival and joint angle.

_TITLE = "Residual torque, logged minus static, joint by joint"
_HEIGHT_MM_OF_TORQUE = 128.0
_NOISES = 2.0
#: Torques below this are those of a log that was calculated [N m].
_LEAST_NM = 1e-6
#: Directions of arrival: sign, marker and colour, and what they are called.
_SIDES: tuple[tuple[int, dict[str, Any], str], ...] = (
    (1, {"color": BLUE, "marker": "^"}, "joint arrived in + direction"),
    (-1, {"color": ORANGE, "marker": "v"}, "in − direction"),
    (0, {"color": GREY, "marker": "o"}, "had not moved"),
)


@picture(
    title="Where: remaining torque at each joint",
    needs=("analysis",),
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
def draw_where_torque(results: Results) -> Figure:
    """Draw residual torques before above those after, a column a joint."""
    found = results.analysis()
    joints = found.before.cells.joints
    if any(joint.torque_residual_Nm is None for joint in joints):
        raise NothingToShowError("no torques were logged, or the weights are not known")
    if max(map(_limit_of_torque, (found.before, found.after))) < _LEAST_NM:
        raise NothingToShowError("the torques logged are those of the weights: none remain")
    figure = new_figure(_HEIGHT_MM_OF_TORQUE, _TITLE)
    for fit, bottom, when in ((found.before, 76.0, "before"), (found.after, 24.0, "after")):
        limit = _limit_of_torque(fit)
        label = f"{when}: residual [N m]"
        panels = joint_panels(figure, len(joints), bottom, 38.0, label)
        for axes, joint, part in zip(panels, fit.cells.joints, fit.by_torque, strict=True):
            _draw_torques(axes, joint)
            noise = _NOISES * part.noise_Nm
            axes.axhspan(-noise, noise, color=SEPARATOR, alpha=0.5, linewidth=0.0)
            axes.set_ylim(-limit, limit)
            axes.set_title(f"joint {joint.joint}" if when == "before" else "")
    label_below(figure, 13.5, "joint angle [deg]")
    legend_at(figure, LEFT_MM, 6.0, _legend(found.before), ncols=4)
    return figure


def _limit_of_torque(fit: LackOfFit) -> float:
    """Return how far the torques of any joint reach, and at least their noise."""
    reach = [
        float(np.abs(np.asarray(joint.torque_residual_Nm)).max()) for joint in fit.cells.joints
    ]
    return 1.1 * max(*reach, *(_NOISES * part.noise_Nm for part in fit.by_torque))


def _draw_torques(axes: Axes, joint: CellJoint) -> None:
    q_deg, left_Nm = np.degrees(joint.q_rad), np.asarray(joint.torque_residual_Nm)
    side = np.sign(joint.arrival)
    for sign, look, _ in _SIDES:
        rows = side == sign
        if rows.any():
            axes.plot(q_deg[rows], left_Nm[rows], markersize=2.5, linestyle="none", **look)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    over_angle(axes, q_deg)


def _legend(fit: LackOfFit) -> list[Any]:
    """Return what the markers mean, those that occur."""
    sides = {int(side) for joint in fit.cells.joints for side in np.sign(joint.arrival)}
    shown = [
        Line2D([], [], linestyle="none", label=label, **look)
        for sign, look, label in _SIDES
        if sign in sides
    ]
    band = Line2D([], [], color=SEPARATOR, linewidth=5.0, label="noise, ± 2 standard deviations")
    return [*shown, band]
