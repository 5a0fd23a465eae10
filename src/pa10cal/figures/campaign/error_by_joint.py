"""Remaining error expressed as errors of the joint positions, against each position."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pa10cal.figures.joint_columns import joint_panels, label_below, over_angle
from pa10cal.figures.joint_errors import PoseResiduals, joint_errors, running_mean
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    GREY,
    ORANGE,
    new_figure,
    points,
    write_text_at,
)
from pa10cal.results.accuracy import ResidualRows
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.evaluation import HeldOutRows

PICTURE = Picture(
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

Array = NDArray[np.float64]

_ROW_MM, _BETWEEN_MM, _BELOW_MM, _ABOVE_MM = 38.0, 4.0, 33.0, 14.0
#: Bins of the running mean over what a joint turned, and share of the errors that is in sight.
_BINS = 90
_IN_SIGHT = 0.998


@dataclass(frozen=True)
class _Row:
    """A row of panels.

    Attributes:
        title: what its poses are.
        colour: of its points.
        q: (P, n) joint positions [deg, mm].
        error: (P, n) errors of the joints [mrad, mm].
        beyond: (P,) poses with a joint at an angle that the model has not learnt from.
    """

    title: str
    colour: str
    q: Array
    error: Array
    beyond: NDArray[np.bool_]


def draw(results: Results) -> Figure:
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
    said = "{}, before" if "extended" in models else "calibrated model, {}"
    yield said.format("fitted"), ORANGE, case.residuals
    if "linear" in models:
        yield said.format("held out"), BEFORE, models["linear"].rows
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
            middle, mean = running_mean(q, error, span / _BINS)
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
    yield (
        f"Rows of {', '.join(str(len(row.q)) for row in rows)} poses, {model}; "
        f"{beyond} points lie outside the panels.{' Black: mean.' if averaged else ''}"
    )
    extrapolated = int(rows[-1].beyond.sum())
    if extrapolated:
        yield f"Grey: {extrapolated} extrapolated poses, beyond the angles of the fit."
    if case.residuals.rotation_deg is None:
        yield "Positions alone were measured: an error of one joint appears in several."
    elif rows[-1].colour != AFTER:
        yield "No model with discovered effects was evaluated at the held-out poses."
