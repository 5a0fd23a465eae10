"""Checks of raw logs: single readings with gross errors, and quantities in a wrong unit.

Readings are compared with the arm's reach, with repeats, with the nominal model, and with the
motion of the joints. Only gross errors are found here, not imprecise readings. A file of which too
many rows are set aside is refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pa10cal.arm.description import Arm
from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.campaign.column_map import CONTRACT_COLUMNS, LENGTHS, UNIT_WORDS, ColumnMap
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.raw_rows import COMMA, EXCLUDED, Quarantined
from pa10cal.campaign.sniffing import time_format
from pa10cal.errors import RawDataError
from pa10cal.observe.quantities import Misfit

#: Distances from repeats, and from the nominal model, that are always allowed, and the multiple of
#: the standard deviation, or of the median misfit, that is.
REPEATS_M, MODEL_M, MODEL_RAD, ROBUST_SIGMAS = 0.01, 0.1, np.radians(10.0), 10.0
#: The same multiple where a row with the same joints contradicts, and what counts as the same.
LIKE_SIGMAS, LIKE_RAD, LIKE_M = 5.0, np.radians(0.1), 1e-3
#: Distances from the nominal model that are allowed of held-out rows.
HELD_OUT_M, HELD_OUT_RAD = 0.01, np.radians(2.0)
#: Where a reading is further off than the model's limits, they are reduced to this part: errors of
#: one cause differ by the error of the arm itself, and should be quarantined together.
BESIDE_ANOTHER = 0.5
#: A target that moved by this much, and by so many of the least steps between readings, cannot have
#: the same reading in every digit.
HELD_M, HELD_STEPS = 2e-3, 5.0
#: Part of the rows that may repeat the one before, at most; else the cause is another.
_MOST_HELD = 0.5
#: Repeats whose median shows which one is off, at least.
LEAST_REPEATS = 3
#: Part of the rows at either end that is ignored as outliers in the extent of a motion.
TAIL = 0.02
#: A motion may exceed the largest possible one by this factor and length (deflections, noise).
MARGIN, MARGIN_MM = 1.2, 50.0
#: Joint positions of one label differ by at most this between loads and repeats.
SAME_COMMAND_RAD, SAME_COMMAND_M = np.radians(0.5), 5e-3
#: Lengths whose scale differs from one by more than this factor are in another unit.
SCALE_RATIO = 5.0

NOT_DETECTED = "reads 0, 0, 0, as a target that was not detected"
OUT_OF_REACH = "further from the other positions than the arm reaches"
OFF_REPEATS = "far from the other readings of this pose and load"
OFF_STAND = "far from the other readings of this stand, in which the arm did not move"
STAND_DISAGREES = "the readings of this stand, in which the arm did not move, contradict each other"
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


def not_detected(p_m: Array) -> Mask:
    """Return positions (N, 3), or distances (N, 1), that are zero in every digit, as no reading is.

    None is marked where only one is, or most are: the target may be the origin of the readings.
    """
    zero = np.all(p_m == 0.0, axis=1)
    return np.asarray(zero & (1 < zero.sum() < 0.5 * len(zero)))


def out_of_reach(p_m: Array, arm: Arm) -> Mask:
    """Return positions (N, 3), or distances (N, 1), further from their median than the arm's span.

    None is marked where most are further.
    """
    if not len(p_m):
        return np.zeros(0, dtype=bool)
    far = np.linalg.norm(p_m - np.median(p_m, axis=0), axis=1) > 2.0 * arm.reach_m
    return np.asarray(far & (2 * far.sum() < len(far)))


def off_repeats(p_m: Array, pose: NDArray[np.str_], load_N: Array) -> Mask:
    """Return readings (N, 3), or distances (N, 1), far from the median of their pose and load.

    Poses with too few repeats are not judged.
    """
    groups = pd.DataFrame(p_m).groupby([pose, load_N])
    judged = np.asarray(groups[0].transform("size") >= LEAST_REPEATS)
    if not judged.any():
        return judged
    distance = np.linalg.norm(p_m - groups.transform("median").to_numpy(), axis=1)
    sigma_m = MEDIAN_TO_SIGMA * float(np.median(distance[judged]))
    return np.asarray(judged & (distance > max(REPEATS_M, ROBUST_SIGMAS * sigma_m)))


def alike(near: Array, load_N: Array) -> tuple[Index, Index]:
    """Return rows that have another one with the same joints and load, and that other of each.

    Args:
        near: (N, n) joint positions over what counts as the same.
    """
    rows: Index = np.arange(len(near))
    if len(near) < 2:
        return rows[:0], rows[:0]
    found = cKDTree(near).query(near, k=2, p=np.inf, distance_upper_bound=1.0)
    distance, nearest = np.asarray(found[0]), np.asarray(found[1])
    other = np.where(nearest[:, 0] == rows, 1, 0)  # of the two nearest rows one is the row itself
    rows = rows[np.isfinite(distance[rows, other])]
    like: Index = nearest[rows, other[rows]]
    of_one_load = load_N[rows] == load_N[like]
    return rows[of_one_load], like[of_one_load]


def off_its_like(p_m: Array, modelled_m: Array, rows: Index, like: Index) -> Mask:
    """Return targets (N, B) far from where another row with the same joints and load has them.

    Of the two it is the one that the nominal arm contradicts, by a multiple of the median misfit.

    Args:
        p_m: (N, B, 3) measured places, nan where not seen.
        modelled_m: (N, B, 3) the same by the nominal arm, base and targets fitted.
        rows, like: of `alike`.
    """
    off = np.zeros(p_m.shape[:2], dtype=bool)
    away_m = p_m - modelled_m
    misfit_m = np.linalg.norm(away_m, axis=2)
    apart_m = np.linalg.norm(away_m[rows] - away_m[like], axis=2)
    limit_m = np.maximum(0.5 * apart_m, 2.0 * misfit_m[like])
    limit_m = np.maximum(limit_m, LIKE_SIGMAS * float(np.nanmedian(misfit_m)))
    off[rows] = (apart_m > REPEATS_M) & (misfit_m[rows] > limit_m)
    return off


def off_model(misfit: Misfit, held_out: Mask | None = None) -> Mask:
    """Return targets (N, B) far from where the nominal model, fitted to all, puts them.

    Limits of rows `held_out` (N,) are tighter: a calibration finds smaller errors of the rows that
    it fits, but of these nothing else does.
    """

    def far(off: Array, limit: float, held_out_limit: float) -> Mask:
        typical = ROBUST_SIGMAS * float(np.nanmedian(off))
        if (off > max(limit, typical)).any():
            limit *= BESIDE_ANOTHER
        limits = np.full(len(off), limit)
        if held_out is not None:
            limits[held_out] = held_out_limit
        return np.asarray((np.maximum(limits, typical) < off.T).T)

    turned = far(misfit.turn_rad, float(MODEL_RAD), float(HELD_OUT_RAD))
    return far(misfit.length_m, MODEL_M, HELD_OUT_M) | turned[:, None]


def held_last(p_m: Array, modelled_m: Array) -> Mask:
    """Return targets (N, B) with exactly the reading of the row before, though they moved.

    Targets were measured at p_m (N, B, k), in order of time, nan where not seen; the nominal arm
    puts them at modelled_m (N, B, 3). Of distances (k = 1) all in a row must be those before.
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
    first = modelled_m[0].copy()  # (B, 3) modelled place at the row in which the reading was new
    for row in range(1, len(p_m)):
        again = same[row - 1]
        far = np.linalg.norm(modelled_m[row] - first, axis=1) > least_m
        held[row] = again & far
        first[~again] = modelled_m[row, ~again]
    return held if held.any(axis=1).mean() <= _MOST_HELD else np.zeros_like(held)


def _least_move(p_m: Array) -> float:
    """Return the motion after which a target cannot have the same reading."""
    steps = np.abs(np.diff(np.sort(p_m.reshape(-1, p_m.shape[2]), axis=0), axis=0))
    real = steps[steps > 1e-9]
    return max(HELD_M, HELD_STEPS * float(real.min()) if real.size else 0.0)


def off_command(pose: NDArray[np.str_], q_rad: Array, prismatic: Mask) -> Mask:
    """Return (C,) whether the joints (C, n) are far from their median for the same label.

    One label is one command, so the label or the dwell is wrong then.
    """
    median_rad = pd.DataFrame(q_rad).groupby(pose).transform("median").to_numpy()
    return not_one_command(q_rad, median_rad, prismatic)


def not_one_command(q_rad: Array, other_rad: Array, prismatic: Mask) -> Mask:
    """Return (C,) whether two joint positions (C, n) differ too much for one command."""
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
    """Refuse joint positions that cannot have moved the tool as far as it was measured to move.

    No point of the tool travels further than the sum of joint rotations [rad] times the stretched
    length of arm and tool, plus the sum of strokes. Angles in radians logged as degrees are 57
    times too small for that. The whole extents are compared; where no angle exceeds 2 pi, so that
    radians are likely, also every move between neighbouring places.

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
    """Return whether all positions q (N, n) of revolute joints are within 2 pi."""
    turns = q[:, ~arm.axes_slide]
    return bool(turns.size and np.abs(turns).max() <= 2.0 * np.pi)


def refuse_wrong_length_unit(
    scale: float | None,
    what: str,
    where: str,
    column: str = "",
    words: ColumnMap = CONTRACT_COLUMNS,
) -> None:
    """Refuse positions, or distances, in another unit than they are read in.

    The scale is the motion of the nominal model over measured motion, None where not known;
    `column` is one of the columns, as the contract names it.
    """
    if scale is None or 1.0 / SCALE_RATIO <= scale <= SCALE_RATIO:
        return
    read_in = words.sources[column].unit if column in words else "mm"
    mm = scale * LENGTHS[read_in]
    unit = next((name for name, size in LENGTHS.items() if 0.5 < mm / size < 1.6), "")
    finding = f"look like {UNIT_WORDS[unit]}" if unit else "do not fit the joint motion"
    set_unit = words.set_unit(column, unit, "millimetres")
    raise RawDataError(
        f"the {what} {finding}",
        where=where,
        value=f"one measured millimetre is {scale:.3g} mm of the nominal model's motion",
        allowed=f"{what} in {UNIT_WORDS[read_in]}, as they are read",
        remedy=set_unit if unit else "check the unit of these columns",
    )


def count_warnings(stated: int | None, logged: int, file: str) -> tuple[str, ...]:
    """Return a warning if a log has more or fewer configurations than campaign.yaml states.

    Unusable configurations count; None is stated where campaign.yaml says nothing.
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


# The refusal of a file of which too many rows are quarantined.


def refuse_too_many(
    rows: Iterable[Quarantined],
    totals: Mapping[str, int],
    max_fraction: float,
    words: ColumnMap = CONTRACT_COLUMNS,
    left: int | None = None,
) -> None:
    """Refuse a file of which all rows, or more than allowed, are quarantined.

    Where several rows are one configuration, which is quarantined as one row, it may be that none
    is `left` though few rows are listed.

    Allowed is `ingest.max_quarantined_fraction` of its rows; rows that campaign.yaml excludes do
    not count. The message names the file, the commonest reason and the first line with it.
    """
    rows, totals = sorted(rows), dict(totals)
    for row in rows:
        totals[row.file] -= row.reason.startswith(EXCLUDED)
        if not totals[row.file]:
            raise RawDataError(
                "every row is excluded",
                where=row.file,
                allowed="at least some rows to calibrate with",
                remedy="correct exclude in campaign.yaml",
            )
    for name, total in totals.items():
        listed = [r for r in rows if r.file == name and not r.reason.startswith(EXCLUDED)]
        few = len(listed) <= max_fraction * total and len(listed) < total
        if few and not (left == 0 and listed):
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        struck = [row for row in listed if row.reason == reason]
        columns = Counter(row.value.partition(" = ")[0] for row in struck if " = " in row.value)
        column, in_column = columns.most_common(1)[0] if columns else ("", 0)
        if 2 * in_column > times:
            struck = [row for row in struck if row.value.startswith(f"{column} = ")]
        raise RawDataError(
            f"{'no configuration is left: ' if few else ''}{len(listed)} of {total} rows would be "
            f"quarantined, {times} of them because: {reason}",
            where=f"{name}:{struck[0].line}" + (f": {words.called(column)}" if column else ""),
            value=struck[0].value or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=_remedy_of_rows(words, reason, struck, most=2 * len(listed) > total),
        )


def _remedy_of_rows(
    words: ColumnMap, reason: str, listed: Sequence[Quarantined], *, most: bool
) -> str:
    """Return the remedy for rows `listed` that are quarantined for one reason.

    Where `most` rows of the file are quarantined the others cannot suffice.
    """
    column, key = "", ""
    if " = " in listed[0].value:
        column = listed[0].value.partition(" = ")[0]
        key = words.key_called(column)
    values = [row.value.partition(" = ")[2] for row in listed]
    if reason == REPEATED:
        return "remove the rows that stand there twice"
    if listed[0].value.endswith(COMMA):
        return (
            f"set {key.rpartition('.')[0]}.decimal: ','"
            if key
            else "export the file with decimal points, or state decimal: ',' under columns in "
            "campaign.yaml"
        )
    if key.endswith(".time"):
        texts = [value.strip("'\"") for value in values]
        if all(texts) and (how := time_format(texts)[0]):
            return f"set {key}.format: '{how}'"
    if key.endswith(".kind"):
        return f"add {', '.join(dict.fromkeys(values))} to {key}.words, as grid or as holdout"
    look = f"look at column {words.called(column)} first; " if column else ""
    if reason.startswith("beyond the limits of joint"):
        return (
            f"{look}check robot in campaign.yaml, and the unit, order, signs and zeros of the "
            "joints (joint_signs, joint_offsets_deg)"
        )
    rest = "" if most else ", or raise the setting if the other rows suffice"
    return f"{look}correct the file{rest}"
