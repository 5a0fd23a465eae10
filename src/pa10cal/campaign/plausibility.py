"""Checks of the logs against each other and the nominal arm: units and labels."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.errors import RawDataError

Array = NDArray[np.float64]
#: Times [s], and joint positions or places at them.
TimedJoints = tuple[Array, Array]
TimedPlaces = tuple[Array, Array]
Joints = NDArray[np.bool_]

#: Part of the rows at either end that may be stray when the extent of a motion is taken.
TAIL = 0.02
#: Excess over the largest possible motion that deflections, noise and ball radii may explain.
MARGIN = 1.2
MARGIN_MM = 50.0
#: Joint positions of one label may differ by so much between loads and repeats.
SAME_COMMAND_DEG = 0.5
SAME_COMMAND_MM = 5.0
OTHER_COMMAND = (
    "the joint angles are not those of this pose's other readings: a wrong label, or the clocks "
    "differ"
)


def refuse_wrong_angle_unit(
    log: TimedJoints, places: TimedPlaces, arm: Arm, tool_reach_mm: float, where: str
) -> None:
    """Stop when the tool moved further than the logged joint motion can carry it.

    However the joints move, no point of the tool travels further than the sum of their turns [rad]
    times the stretched length of arm and tool, and of their slides. Angles in radians logged as
    degrees are 57 times too small for that. The whole extents are compared, whatever the clocks;
    and where no angle exceeds 2 pi, so that radians are likely, every move between neighbouring
    places too.

    Args:
        log: logged times [s] and joint positions (N, n) in what should be degrees (millimetres of
            a joint that slides).
        places: times [s] and places (M, 3) [mm] of one point of the tool, or its distances (M, 1)
            from a fixed point, both in order of time.
        arm: the nominal arm.
        tool_reach_mm: distance of that point from the flange.
        where: file and columns, for the message.

    Raises:
        RawDataError: naming both motions.
    """
    reach_mm = 1e3 * arm.reach_m + tool_reach_mm
    lever_mm = np.where(arm.prismatic, 1.0, np.radians(reach_mm))
    low, high = np.quantile(places[1], [TAIL, 1.0 - TAIL], axis=0)
    moved_mm = float((high - low).max())
    ranges = np.ptp(log[1], axis=0)
    radians = may_be_radians(log[1], arm)
    too_far = moved_mm > MARGIN * float(ranges @ lever_mm) + MARGIN_MM
    if not too_far and not (radians and _moves_too_far(log, places, lever_mm)):
        return
    range_deg = float(ranges[~arm.prismatic].sum())
    raise RawDataError(
        "the joint angles look like radians"
        if radians
        else "the joints move too little for the measured motion",
        where=where,
        value=f"joint ranges of {range_deg:.3g} deg in all, while the tool moved {moved_mm:.0f} mm",
        allowed="joint positions in degrees",
        remedy="convert the columns to degrees"
        if radians
        else "check the unit of these columns, and of the measured places",
    )


def may_be_radians(q: Array, arm: Arm) -> bool:
    """Return whether no joint that turns is logged further from zero than one turn in radians."""
    turns = q[:, ~arm.prismatic]
    return bool(turns.size and np.abs(turns).max() <= 2.0 * np.pi)


def _moves_too_far(log: TimedJoints, places: TimedPlaces, lever_mm: Array) -> bool:
    """Return whether most moves are longer than the joints' motion in the same time allows."""
    time_s, q = log
    inside = (places[0] >= time_s[0]) & (places[0] <= time_s[-1])
    moved_mm = np.linalg.norm(np.diff(places[1][inside], axis=0), axis=1)
    q_at = np.column_stack([np.interp(places[0][inside], time_s, column) for column in q.T])
    possible_mm = np.abs(np.diff(q_at, axis=0)) @ lever_mm
    real = moved_mm > MARGIN_MM
    too_far = moved_mm[real] > MARGIN * possible_mm[real] + MARGIN_MM
    return bool(2 * too_far.sum() > len(too_far))


def off_command(pose: NDArray[np.str_], q_rad: Array, slides: Joints) -> Joints:
    """Return (C,) whether the joints (C, n) were far from their median for the same label.

    The same label is the same command, so a difference means that the label or the dwell is
    another's.
    """
    if not len(pose):
        return np.zeros(0, dtype=bool)
    q = pd.DataFrame(q_rad)
    usual = q.groupby(pose).transform("median")
    allowed = np.where(slides, 1e-3 * SAME_COMMAND_MM, np.radians(SAME_COMMAND_DEG))
    return np.asarray(((q - usual).abs() > allowed).any(axis=1), dtype=bool)
