"""Remaining error expressed as errors of the joint positions, against each position.

A picture of where to look, not a test: a joint that does not err takes part of what another does,
wherever a pose has fewer or hardly more readings than joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array
from pa10cal.figures.joint_columns import joint_panels, label_below, over_angle
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
