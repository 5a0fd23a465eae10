"""Residual torque of every joint, by direction of arrival and joint angle."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures.joint_columns import LEFT_MM, joint_panels, label_below, over_angle
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import BLUE, GREY, ORANGE, SEPARATOR, legend_at, new_figure
from pa10cal.results.analysis import CellJoint, LackOfFit

PICTURE = Picture(
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

_TITLE = "Residual torque, logged minus static, joint by joint"
_HEIGHT_MM = 128.0
_NOISES = 2.0
#: Torques below this are those of a log that was calculated [N m].
_LEAST_NM = 1e-6
#: Directions of arrival: sign, marker and colour, and what they are called.
_SIDES: tuple[tuple[int, dict[str, Any], str], ...] = (
    (1, {"color": BLUE, "marker": "^"}, "joint arrived in + direction"),
    (-1, {"color": ORANGE, "marker": "v"}, "in − direction"),
    (0, {"color": GREY, "marker": "o"}, "had not moved"),
)


def draw(results: Results) -> Figure:
    """Draw residual torques before above those after, a column a joint."""
    found = results.analysis()
    joints = found.before.cells.joints
    if any(joint.torque_residual_Nm is None for joint in joints):
        raise NothingToShowError("no torques were logged, or the weights are not known")
    if max(map(_limit, (found.before, found.after))) < _LEAST_NM:
        raise NothingToShowError("the torques logged are those of the weights: none remain")
    figure = new_figure(_HEIGHT_MM, _TITLE)
    for fit, bottom, when in ((found.before, 76.0, "before"), (found.after, 24.0, "after")):
        limit = _limit(fit)
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


def _limit(fit: LackOfFit) -> float:
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
