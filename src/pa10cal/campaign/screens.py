"""Single readings that cannot be right, and units and labels that cannot: checks of raw logs.

Gross errors are screened here, not poor readings: against the arm's reach, against repeats, against
the nominal model, and against the joints' own motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.own_columns import LENGTHS
from pa10cal.campaign.own_words import CONTRACT_WORDS, UNIT_WORDS, OwnWords
from pa10cal.errors import CalibrationError, RawDataError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: Times [s], and joint positions or places at them.
TimedJoints = tuple[Array, Array]
TimedPlaces = tuple[Array, Array]
#: Rows to fit and their weights, to the misfit of all rows.
Fit = Callable[[NDArray[np.intp], Array], Misfit]

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
#: Repeats of which a median shows the one that is off.
LEAST_REPEATS = 3
#: Reweighted fits towards least distances, rows fitted, and the distance below which all weigh
#: the same.
FITS = 10
FITTED_ROWS = 300
ALIKE_M = 1e-3

#: Part of the rows at either end that may be outliers when the extent of a motion is taken.
TAIL = 0.02
#: Excess over the largest possible motion that deflections, noise and ball radii may explain.
MARGIN = 1.2
MARGIN_MM = 50.0
#: Joint positions of one label may differ by so much between loads and repeats.
SAME_COMMAND_RAD = np.radians(0.5)
SAME_COMMAND_M = 5e-3
#: Orientations that differ by less are one orientation, and a flange that turns by more has
#: several. Three turns in radians, read as degrees, turn by no more; and by so much less than the
#: flange.
RADIANS_RAD = np.radians(3.0 * 2.0 * np.pi)
LIKE_RADIANS = 8.0
ONE_ATTITUDE_RAD = 1e-5
TURNED_RAD = np.radians(5.0)
#: Scales of lengths that differ from one by more than this are of another unit.
SCALE_RATIO = 5.0

OUT_OF_REACH = "further from the other positions than the arm reaches"
OFF_REPEATS = "far from the other readings of this pose and load"
OFF_MODEL = "far from where the joint angles put the end-effector"
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
    """Return readings far from the median of their pose and load, where there are enough.

    Args:
        p_m: (N, 3) positions, or (N, 1) distances.
        pose: (N,) labels.
        load_N: (N,) loads.
    """
    groups = pd.DataFrame(p_m).groupby([pose, load_N])
    distance = np.linalg.norm(p_m - groups.transform("median").to_numpy(), axis=1)
    judged = groups[0].transform("size").to_numpy() >= LEAST_REPEATS
    if not judged.any():
        return judged
    sigma_m = 1.4826 * float(np.median(distance[judged]))
    return np.asarray(judged & (distance > max(REPEATS_M, ROBUST_SIGMAS * sigma_m)))


def robust_misfit(fit: Fit, rows: int) -> Misfit | None:
    """Fit the nominal model to what was measured, towards least distances, not least squares.

    Args:
        fit: the model fitted to some rows with weights, and its misfit in all of them.
        rows: number of rows.

    Returns:
        The misfit of every row; None where the rows do not determine a frame.
    """
    used = np.sort(np.random.default_rng(0).permutation(rows)[:FITTED_ROWS])
    weights = np.ones(len(used))
    try:
        for _ in range(FITS):
            misfit = fit(used, weights)
            # In millimetres, so that weights are about one.
            before, weights = weights, 1e-3 / np.maximum(misfit.size_m[used], ALIKE_M)
            if np.array_equal(weights, before):
                break  # the next fit would be this one
    except CalibrationError:
        return None
    return misfit


def misfit_of(measured: Instrument, T_base_ee: Array) -> Misfit | None:
    """Return how far readings are from the nominal end (P, 4, 4), however placed; see above."""
    count = len(T_base_ee)
    if count < measured.least_rows:
        return None
    return robust_misfit(lambda used, weights: measured.misfit(T_base_ee, used, weights), count)


def off_model(misfit: Misfit, held_out: Mask | None = None) -> Mask:
    """Return targets (N, B) far from where the nominal model, fitted to all, puts them.

    Of rows that are fitted a calibration finds smaller errors; those held out nothing else screens.

    Args:
        misfit: of all rows.
        held_out: (N,) rows that are held out; None for none.
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


def off_command(pose: NDArray[np.str_], q_rad: Array, prismatic: Mask) -> Mask:
    """Return (C,) whether the joints (C, n) were far from their median for the same label.

    The same label is the same command, so a difference means that the label or the dwell is
    another's.
    """
    if not len(pose):
        return np.zeros(0, dtype=bool)
    q = pd.DataFrame(q_rad)
    usual = q.groupby(pose).transform("median")
    allowed = np.where(prismatic, SAME_COMMAND_M, SAME_COMMAND_RAD)
    return np.asarray(((q - usual).abs() > allowed).any(axis=1), dtype=bool)


def off_first(
    q_rad: Array, configuration: NDArray[np.intp], first: NDArray[np.intp], prismatic: Mask
) -> Mask:
    """Return (N,) rows whose joints are not those of the first row of their configuration.

    Args:
        q_rad: (N, n) joint positions.
        configuration: (N,) number of each row's configuration.
        first: first row of every configuration.
        prismatic: (n,) joints that slide.
    """
    allowed = np.where(prismatic, SAME_COMMAND_M, SAME_COMMAND_RAD)
    return np.asarray((np.abs(q_rad - q_rad[first[configuration]]) > allowed).any(axis=1))


def refuse_one_attitude(
    R: Array | None,
    T_base_ee: Array,
    where: object,
    in_degrees: Sequence[str] = (),
    words: OwnWords = CONTRACT_WORDS,
) -> None:
    """Stop when all orientations are the same, or nearly, though the arm turned its flange.

    Args:
        R: (N, 3, 3) measured orientations; None where none are.
        T_base_ee: (N, 4, 4) nominal poses of the end-effector.
        where: file, for the message.
        in_degrees: columns of angles that are said to be in degrees; none of quaternions.
        words: what the file calls its columns.

    Raises:
        RawDataError: naming both spreads.
    """
    if R is None or len(R) < LEAST_REPEATS:
        return
    seen, turned = _spread_rad(R), _spread_rad(T_base_ee[:, :3, :3])
    if turned < TURNED_RAD:
        return
    if in_degrees and ONE_ATTITUDE_RAD < seen < min(RADIANS_RAD, turned / LIKE_RADIANS):
        raise RawDataError(
            "the angles of the orientations look like radians",
            where=f"{where}: {', '.join(f'`{name}`' for name in in_degrees)}",
            value=f"orientations within {np.degrees(seen):.2g} deg as degrees, flange turned by "
            f"{np.degrees(turned):.0f} deg",
            allowed="angles in the unit that columns states: deg",
            remedy=words.set_unit("qw", "rad", "degrees"),
        )
    if seen > ONE_ATTITUDE_RAD:
        return
    raise RawDataError(
        "every row has the same orientation, though the arm turned",
        where=f"{where}: {words.column('qw') if 'qw' in words else 'qw, qx, qy, qz'}",
        value=f"orientations within {np.degrees(seen):.2g} deg, flange turned by "
        f"{np.degrees(turned):.0f} deg",
        allowed="the measured orientation of every row",
        remedy="export the orientations; where none are measured, use instrument.kind points",
    )


def _spread_rad(R: Array) -> float:
    """Return the largest angle between the first orientation and the others."""
    trace = np.einsum("pij,ij->p", R, R[0])
    return float(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)).max())


def refuse_wrong_angle_unit(
    log: TimedJoints,
    places: TimedPlaces,
    arm: Arm,
    tool_reach_mm: float,
    where: str,
    words: OwnWords = CONTRACT_WORDS,
) -> None:
    """Stop when the tool moved further than the logged joint motion can carry it.

    However the joints move, no point of the tool travels further than the sum of their turns [rad]
    times the stretched length of arm and tool, and of their slides. Angles in radians logged as
    degrees are 57 times too small for that. The whole extents are compared, whatever the clocks;
    and where no angle exceeds 2 pi, so that radians are likely, every move between neighbouring
    places too.

    Args:
        log: logged times [s] and joint positions (N, n) in what should be degrees (millimetres of
            a prismatic joint).
        places: times [s] and places (M, 3) [mm] of one point of the tool, or its distances (M, 1)
            from a fixed point, both in order of time.
        arm: the nominal arm.
        tool_reach_mm: distance of that point from the flange.
        where: file and columns, for the message.
        words: what the file calls its columns.

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
        remedy=words.set_unit(f"q{int(np.argmin(arm.prismatic)) + 1}_deg", "rad", "degrees")
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


def refuse_wrong_length_unit(
    scale: float | None,
    what: str,
    where: str,
    column: str = "",
    words: OwnWords = CONTRACT_WORDS,
) -> None:
    """Stop when measured lengths are in another unit than they are read in.

    Args:
        scale: how far the nominal model moves for one that was measured; None where that is not
            known.
        what: `positions` or `distances`.
        where: file and columns, for the message.
        column: one of them, as the contract calls it.
        words: what the file calls its columns.

    Raises:
        RawDataError: naming the scale, and the unit where it is likely.
    """
    if scale is None or 1.0 / SCALE_RATIO <= scale <= SCALE_RATIO:
        return
    own = words.sources.get(column)
    read_in = "mm" if own is None else own.unit
    mm = scale * LENGTHS[read_in]
    unit = next((name for name, of in LENGTHS.items() if 0.5 < mm / of < 1.6), None)
    raise RawDataError(
        f"the {what} look like {UNIT_WORDS[unit]}"
        if unit
        else f"the {what} do not fit the joint motion",
        where=where,
        value=f"one measured millimetre is {scale:.3g} mm of the nominal model's motion",
        allowed=f"{what} in {UNIT_WORDS[read_in]}, as they are read",
        remedy=words.set_unit(column, unit, "millimetres")
        if unit
        else "check the unit of these columns",
    )


# Whether a log holds as many configurations as its campaign states.


def count_warnings(stated: int | None, logged: int, file: str) -> tuple[str, ...]:
    """Say how many configurations a log lacks of those stated, or has beyond them.

    Args:
        stated: configurations measured, as campaign.yaml states; None where it does not.
        logged: configurations in the file, whether they can be used or not.
        file: its name.
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
