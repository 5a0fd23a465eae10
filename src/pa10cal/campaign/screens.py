"""Single readings that cannot be right, and units that cannot: checks of raw logs of any kind.

Gross errors are screened here, not poor readings: against the arm's reach, against repeats, against
the nominal model, and against the joints' own motion.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Mask
from pa10cal.campaign.raw_rows import CONTRACT_COLUMNS, LENGTHS, UNIT_WORDS, ColumnMap
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import Misfit

#: Distances that are always allowed from repeats and from the nominal model, in robust sigmas and
#: typical residuals too.
REPEATS_M = 0.01
MODEL_M = 0.1
ROBUST_SIGMAS = 10.0
MODEL_RAD = np.radians(10.0)
#: The same from the nominal model of rows held out.
HELD_OUT_M = 0.01
HELD_OUT_RAD = np.radians(2.0)
#: Part of these distances that is allowed beside a reading that is further off: errors of one size
#: differ by the error of the arm itself, and are to go together.
BESIDE_ANOTHER = 0.5
#: A target that the nominal arm moved by this much, and by so many of the least steps between
#: readings, is not read at the same place in every digit.
HELD_M = 2e-3
HELD_STEPS = 5.0
#: Repeats of which a median shows the one that is off.
LEAST_REPEATS = 3
#: Part of the rows at either end that may be outliers when the extent of a motion is taken.
TAIL = 0.02
#: Excess over the largest possible motion that deflections, noise and ball radii may explain.
MARGIN = 1.2
MARGIN_MM = 50.0
#: Joint positions of one label may differ by so much between loads and repeats.
SAME_COMMAND_RAD = np.radians(0.5)
SAME_COMMAND_M = 5e-3
#: Scales of lengths that differ from one by more than this are of another unit.
SCALE_RATIO = 5.0

OUT_OF_REACH = "further from the other positions than the arm reaches"
OFF_REPEATS = "far from the other readings of this pose and load"
OFF_MODEL = "far from where the joint angles put the end-effector"
HELD = (
    "repeats the reading of the row before, though the arm moved: the instrument held its last one"
)
READ_BEFORE = "this configuration was read before"
ONE_LABEL = (
    "another configuration has this pose, load and repeat: give each a label or a repeat of its own"
)
OTHER_COMMAND = (
    "the joint angles are not those of this pose's other readings: a wrong label, or the clocks "
    "differ"
)


def out_of_reach(p_m: Array, arm: Arm) -> Mask:
    """Return positions (N, 3) further from their median than the arm's span; none if most are.

    Distances (N, 1) are judged the same way.
    """
    if not len(p_m):
        return np.zeros(0, dtype=bool)
    far = np.linalg.norm(p_m - np.median(p_m, axis=0), axis=1) > 2.0 * arm.reach_m
    return np.asarray(far & (2 * far.sum() < len(far)))


def off_repeats(p_m: Array, pose: NDArray[np.str_], load_N: Array) -> Mask:
    """Return readings (N, 3), or distances (N, 1), far from the median of their pose and load.

    There must be enough of these.
    """
    groups = pd.DataFrame(p_m).groupby([pose, load_N])
    distance = np.linalg.norm(p_m - groups.transform("median").to_numpy(), axis=1)
    judged = groups[0].transform("size").to_numpy() >= LEAST_REPEATS
    if not judged.any():
        return judged
    sigma_m = MEDIAN_TO_SIGMA * float(np.median(distance[judged]))
    return np.asarray(judged & (distance > max(REPEATS_M, ROBUST_SIGMAS * sigma_m)))


def off_model(misfit: Misfit, held_out: Mask | None = None) -> Mask:
    """Return targets (N, B) far from where the nominal model, fitted to all, puts them.

    Of rows that are fitted a calibration finds smaller errors; those held out (N,) nothing else
    screens.
    """

    def far(off: Array, always: float, held_out_always: float) -> Mask:
        typical = ROBUST_SIGMAS * float(np.nanmedian(off))
        if (off > max(always, typical)).any():
            always *= BESIDE_ANOTHER
        least = np.full(len(off), always)
        if held_out is not None:
            least[held_out] = held_out_always
        return np.asarray((np.maximum(least, typical) < off.T).T)

    turned = far(misfit.turn_rad, float(MODEL_RAD), float(HELD_OUT_RAD))
    return far(misfit.length_m, MODEL_M, HELD_OUT_M) | turned[:, None]


#: Part of the rows that may repeat the one before: of more the cause is another.
_MOST_HELD = 0.5


def held_last(p_m: Array, modelled_m: Array) -> Mask:
    """Return targets (N, B) read in every digit where the row before has them, though they moved.

    They were measured at (N, B, k), rows in order of time, nan where not seen; the nominal arm puts
    them at (N, B, 3). Of distances all of a row must be those before.
    """
    held = np.zeros(p_m.shape[:2], dtype=bool)
    if len(p_m) < 2:
        return held
    same = np.asarray((p_m[1:] == p_m[:-1]).all(axis=2))
    if p_m.shape[2] == 1:
        seen = np.isfinite(p_m[1:, :, 0])
        # A distance that comes back in other rows too is kept, or read coarsely.
        runs = p_m[np.append(True, ~same.any(axis=1)), :, 0]
        fine = len(np.unique(runs[np.isfinite(runs)])) == np.isfinite(runs).sum()
        same &= ((same == seen).all(axis=1) & (fine | (seen.sum(axis=1) > 1)))[:, None]
    if not same.any():
        return held
    least_m = _least_move(p_m)
    first = modelled_m[0].copy()  # where the arm had each when its reading was new
    for row in range(1, len(p_m)):
        again = same[row - 1]
        far = np.linalg.norm(modelled_m[row] - first, axis=1) > least_m
        held[row] = again & far
        first[~again] = modelled_m[row, ~again]
    # Where most rows are like the one before, no instrument stopped now and then.
    return held if held.any(axis=1).mean() <= _MOST_HELD else np.zeros_like(held)


def _least_move(p_m: Array) -> float:
    """Return how far a target must move to be read elsewhere for certain."""
    steps = np.abs(np.diff(np.sort(p_m.reshape(-1, p_m.shape[2]), axis=0), axis=0))
    real = steps[steps > 1e-9]
    return max(HELD_M, HELD_STEPS * float(real.min()) if real.size else 0.0)


def off_command(pose: NDArray[np.str_], q_rad: Array, prismatic: Mask) -> Mask:
    """Return (C,) whether the joints (C, n) were far from their median for the same label.

    The same label is the same command, so a difference means that the label or the dwell is
    another's.
    """
    usual = pd.DataFrame(q_rad).groupby(pose).transform("median").to_numpy()
    return not_one_command(q_rad, usual, prismatic)


def not_one_command(q_rad: Array, other_rad: Array, prismatic: Mask) -> Mask:
    """Return (C,) whether joint positions (C, n) differ by more than those of one command do."""
    allowed = np.where(prismatic, SAME_COMMAND_M, SAME_COMMAND_RAD)
    return np.asarray((np.abs(q_rad - other_rad) > allowed).any(axis=1))


def refuse_wrong_angle_unit(
    log: tuple[Array, Array],
    places: tuple[Array, Array],
    arm: Arm,
    tool_reach_mm: float,
    where: str,
    words: ColumnMap = CONTRACT_COLUMNS,
) -> None:
    """Stop when the tool moved further than the logged joint motion can carry it.

    However the joints move, no point of the tool travels further than the sum of their turns [rad]
    times the stretched length of arm and tool, and of their slides. Angles in radians logged as
    degrees are 57 times too small for that. The whole extents are compared, whatever the clocks;
    and where no angle exceeds 2 pi, so that radians are likely, every move between neighbouring
    places too.

    Args:
        log: times (N,) [s], and joint positions (N, n) in what should be degrees (millimetres of a
            prismatic joint).
        places: times (M,), and places (M, 3) of one point of the tool [mm], or its distances (M, 1)
            from a fixed point, in order of time.
        arm: the nominal arm.
        tool_reach_mm: distance of that point from the flange.
    """
    (log_s, q), (time_s, p_mm) = log, places
    reach_mm = 1e3 * arm.reach_m + tool_reach_mm
    lever_mm = np.where(arm.axes_slide, 1.0, np.radians(reach_mm))
    low, high = np.quantile(p_mm, [TAIL, 1.0 - TAIL], axis=0)
    moved_mm = float((high - low).max())
    ranges = np.ptp(q, axis=0)
    radians = may_be_radians(q, arm)
    too_far = moved_mm > MARGIN * float(ranges @ lever_mm) + MARGIN_MM
    if radians and not too_far:
        # Most moves are longer than the joints' motion in the same time allows.
        inside = (time_s >= log_s[0]) & (time_s <= log_s[-1])
        moves_mm = np.linalg.norm(np.diff(p_mm[inside], axis=0), axis=1)
        q_at = np.column_stack([np.interp(time_s[inside], log_s, column) for column in q.T])
        possible_mm = np.abs(np.diff(q_at, axis=0)) @ lever_mm
        real = moves_mm > MARGIN_MM
        longer = moves_mm[real] > MARGIN * possible_mm[real] + MARGIN_MM
        too_far = 2 * longer.sum() > len(longer)
    if too_far:
        range_deg = float(ranges[~arm.axes_slide].sum())
        value = (
            f"joint ranges of {range_deg:.3g} deg in all, while the tool moved {moved_mm:.0f} mm"
        )
        what = "the joints move too little for the measured motion"
        remedy = "check the unit of these columns, and of the measured places"
        if radians:
            what = "the joint angles look like radians"
            remedy = words.set_unit(f"q{int(np.argmin(arm.axes_slide)) + 1}_deg", "rad", "degrees")
        raise RawDataError(
            what, where=where, value=value, allowed="joint positions in degrees", remedy=remedy
        )


def may_be_radians(q: Array, arm: Arm) -> bool:
    """Return whether no joint that turns is logged further from zero than one turn in radians."""
    turns = q[:, ~arm.axes_slide]
    return bool(turns.size and np.abs(turns).max() <= 2.0 * np.pi)


def refuse_wrong_length_unit(
    scale: float | None,
    what: str,
    where: str,
    column: str = "",
    words: ColumnMap = CONTRACT_COLUMNS,
) -> None:
    """Stop when positions, or distances, are in another unit than they are read in.

    The scale is how far the nominal model moves for one that was measured, None where that is not
    known; `column` is one of them, as the contract calls it.
    """
    if scale is None or 1.0 / SCALE_RATIO <= scale <= SCALE_RATIO:
        return
    read_in = words.sources[column].unit if column in words else "mm"
    mm = scale * LENGTHS[read_in]
    unit = next((name for name, of in LENGTHS.items() if 0.5 < mm / of < 1.6), "")
    value = f"one measured millimetre is {scale:.3g} mm of the nominal model's motion"
    finding = f"look like {UNIT_WORDS[unit]}" if unit else "do not fit the joint motion"
    set_unit = words.set_unit(column, unit, "millimetres")
    raise RawDataError(
        f"the {what} {finding}",
        where=where,
        value=value,
        allowed=f"{what} in {UNIT_WORDS[read_in]}, as they are read",
        remedy=set_unit if unit else "check the unit of these columns",
    )


def count_warnings(stated: int | None, logged: int, file: str) -> tuple[str, ...]:
    """Say how many configurations a log lacks of those stated, or has beyond them.

    Those count that cannot be used, too; campaign.yaml may state none.
    """
    if stated is None or logged == stated:
        return ()
    if logged < stated:
        return (
            f"{file} has {logged} of the {stated} configurations that campaign.yaml states: "
            f"{stated - logged} are missing, and the log seems cut short",
        )
    return (
        f"{file} has {logged} configurations, and campaign.yaml states {stated}: correct that "
        "number, or remove rows of another campaign",
    )
