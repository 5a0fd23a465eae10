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

#: Part of the rows at either end that may be stray when the extent of a motion is taken.
TAIL = 0.02
#: Excess over the largest possible motion that deflections, noise and ball radii may explain.
MARGIN = 1.2
MARGIN_MM = 50.0
#: Spreads of measured and modelled positions that differ by more than this are in other units.
SPREAD_RATIO = 5.0
#: Joint positions of one label may differ by so much between loads and repeats.
SAME_COMMAND_DEG = 0.5
OTHER_COMMAND = (
    "the joint angles are not those of this pose's other readings: a wrong label, or the clocks "
    "differ"
)


def refuse_wrong_angle_unit(
    log: TimedJoints, places: TimedPlaces, arm: Arm, tool_reach_mm: float, where: str
) -> None:
    """Stop when the tool moved further than the logged joint motion can carry it.

    However the joints move, no point of the tool travels further than the sum of their turns [rad]
    times the stretched length of arm and tool. Angles in radians logged as degrees are 57 times too
    small for that. The whole extents are compared, whatever the clocks; and where no angle exceeds
    2 pi, so that radians are likely, every move between neighbouring places too.

    Args:
        log: logged times [s] and joint positions (N, n) in what should be degrees.
        places: times [s] and places (M, 3) [mm] of one point of the tool, both in order of time.
        arm: the nominal arm.
        tool_reach_mm: distance of that point from the flange.
        where: file and columns, for the message.

    Raises:
        RawDataError: naming both motions.
    """
    reach_mm = 1e3 * float(np.hypot(arm.a_m, arm.d_m).sum()) + tool_reach_mm
    q_deg = log[1]
    low, high = np.quantile(places[1], [TAIL, 1.0 - TAIL], axis=0)
    moved_mm = float((high - low).max())
    range_deg = float(np.ptp(q_deg, axis=0).sum())
    possible_mm = np.radians(range_deg) * reach_mm
    radians = bool(np.abs(q_deg).max() <= 2.0 * np.pi)
    too_far = moved_mm > MARGIN * possible_mm + MARGIN_MM
    if not too_far and not (radians and _moves_too_far(log, places, reach_mm)):
        return
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


def refuse_wrong_length_unit(p_mm: Array, nominal_mm: Array, where: str) -> None:
    """Stop when measured positions spread far less or more than the nominal model's.

    Args:
        p_mm: (N, 3) measured positions in what should be millimetres.
        nominal_mm: (N, 3) the nominal model's for the same joint positions, in any frame.
        where: file and columns, for the message.

    Raises:
        RawDataError: naming both spreads, and the unit where it is likely.
    """
    measured, modelled = (
        float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))
        for p in (p_mm, nominal_mm)
    )
    least, most = sorted((measured, modelled))
    if most <= MARGIN_MM or most <= SPREAD_RATIO * least:
        return
    size = modelled / max(measured, np.finfo(float).tiny)
    units = {1e-3: "micrometres", 10.0: "centimetres", 25.4: "inches", 1e3: "metres"}
    unit = next((name for mm, name in units.items() if 0.5 < size / mm < 1.6), None)
    raise RawDataError(
        f"the positions look like {unit}" if unit else "the positions do not fit the joint motion",
        where=where,
        value=f"a median distance of {measured:.3g} mm from their middle, where the nominal model "
        f"has {modelled:.3g} mm",
        allowed="positions in millimetres",
        remedy="convert the columns to millimetres" if unit else "check the unit of these columns",
    )


def _moves_too_far(log: TimedJoints, places: TimedPlaces, reach_mm: float) -> bool:
    """Return whether most moves are longer than the joints' motion in the same time allows."""
    time_s, q_deg = log
    inside = (places[0] >= time_s[0]) & (places[0] <= time_s[-1])
    moved_mm = np.linalg.norm(np.diff(places[1][inside], axis=0), axis=1)
    q_at = np.column_stack([np.interp(places[0][inside], time_s, column) for column in q_deg.T])
    possible_mm = np.radians(np.abs(np.diff(q_at, axis=0)).sum(axis=1)) * reach_mm
    real = moved_mm > MARGIN_MM
    too_far = moved_mm[real] > MARGIN * possible_mm[real] + MARGIN_MM
    return bool(2 * too_far.sum() > len(too_far))


def off_command(pose: NDArray[np.str_], q_rad: Array) -> Array:
    """Return (C,) how far [deg] the joints were from their median for the same label.

    The same label is the same command, so more than `SAME_COMMAND_DEG` means that the label or the
    dwell is another's.
    """
    if not len(pose):
        return np.zeros(0)
    q = pd.DataFrame(np.degrees(q_rad))
    usual = q.groupby(pose).transform("median")
    return np.asarray((q - usual).abs().max(axis=1), dtype=float)
