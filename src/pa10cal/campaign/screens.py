"""Single readings that cannot be right, and units and labels that cannot: checks of raw logs.

Gross errors are screened here, not poor readings: against the arm's reach, against repeats, against
the nominal model, and against the joints' own motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.conventions import STILL_WRONG, OtherAxes, other_axes
from pa10cal.campaign.labels import (
    EXCHANGED,
    NOT_RIGID,
    exchange_text,
    exchanged,
    nominal_places,
    not_rigid,
)
from pa10cal.campaign.nominal_fit import (
    misfit_of,
    nominal_fit,
    refuse_shifted,
    shifted,
    steps_agree,
)
from pa10cal.campaign.own_columns import LENGTHS
from pa10cal.campaign.own_words import CONTRACT_WORDS, UNIT_WORDS, OwnWords
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    Quarantined,
    configurations,
    in_radians,
    position_columns,
    quarantined,
)
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Misfit, RawColumns

#: Times [s], and at them joint positions (N, n) in what should be degrees (millimetres of a
#: prismatic joint), or places (M, 3) [mm], or distances (M, 1) from a fixed point.
TimedJoints = tuple[Array, Array]
TimedPlaces = tuple[Array, Array]

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
    """Return readings (N, 3), or distances (N, 1), far from the median of their pose and load.

    There must be enough of these.
    """
    groups = pd.DataFrame(p_m).groupby([pose, load_N])
    distance = np.linalg.norm(p_m - groups.transform("median").to_numpy(), axis=1)
    judged = groups[0].transform("size").to_numpy() >= LEAST_REPEATS
    if not judged.any():
        return judged
    sigma_m = 1.4826 * float(np.median(distance[judged]))
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
        log: logged times and joint positions.
        places: times and places of one point of the tool, in order of time.
        arm: the nominal arm.
        tool_reach_mm: distance of that point from the flange.
        where: file and columns, for the message.
        words: what the file calls its columns.
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
    """Stop when positions, or distances, are in another unit than they are read in.

    Args:
        scale: how far the nominal model moves for one that was measured; None where that is not
            known.
        what: `positions` or `distances`.
        where: file and columns, for the message.
        column: one of them, as the contract calls it.
        words: what the file calls its columns.
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


# The pipeline of an instrument that touches nothing.

#: The nominal model fitted in another unit of joint positions must be this much nearer to count,
#: and as logged be further off than this.
BETTER = 5.0
BAD_M = 2e-3
#: Logged positions of prismatic joints that never exceed the longest stroke in metres may be in
#: metres.
LONGEST_STROKE_M = 10.0
#: Median misfits of the nominal model, fitted, that are worth a warning.
WARN_MM = 50.0
WARN_DEG = 10.0


@dataclass
class Screen:
    """Refuses wrong units, and quarantines single readings that cannot be of their pose."""

    columns: RawColumns
    arm: Arm
    file: RawFile | TwoLogs
    line: NDArray[np.int64]  # (N,) of the rows that remain
    found: Observations  # the same as readings
    quarantined: list[Quarantined]  # to which those are added that do not
    warnings: tuple[str, ...] = ()

    @property
    def T_base_ee(self) -> Array:
        """Return the nominal end at each."""
        return Chain.of(self.arm).forward(self.found.states.q_rad)

    def run(self) -> None:
        """Screen the rows."""
        self._leave_out(self._each(lambda p_m, _: out_of_reach(p_m, self.arm)), OUT_OF_REACH)
        self._refuse_units()
        self._leave_out_exchanged()
        pose, load_N = self.found.pose, self.found.states.load_N
        far = self._each(lambda p_m, seen: off_repeats(p_m, pose[seen], load_N[seen]))
        self._leave_out(far, OFF_REPEATS)
        misfit = misfit_of(self.found.measured, self.T_base_ee)
        if misfit is not None:
            if poor := _poor_fit(misfit):
                self._refuse_shifted()
                self.warnings = (*poor, *self._other_axes(), *self._constant())
            self._leave_out(off_model(misfit, self.found.kind == "holdout"), OFF_MODEL)
        self._leave_out(not_rigid(self.found.measured.places_m), NOT_RIGID)

    def leave_out(self, off: Mask, reason: str, values: Iterable[object]) -> None:
        """Quarantine rows (N,), with what was found in each."""
        where = configurations(self.found.take(off))
        file = self.file.path.name
        self.quarantined += quarantined(file, self.line[off], reason, values, where)
        self.line, self.found = self.line[~off], self.found.take(~off)

    def _each(self, judge: Callable[[Array, Mask], Mask]) -> Mask:
        """Judge the targets one by one, by where each was measured: (N, B)."""
        places_m = self.found.measured.places_m
        judged = np.zeros(places_m.shape[:2], dtype=bool)
        for b in range(places_m.shape[1]):
            seen = np.isfinite(places_m[:, b, 0])
            judged[seen, b] = judge(places_m[seen, b], seen)
        return judged

    def _leave_out(self, off: Mask, reason: str) -> None:
        """Quarantine rows with a target (N, B) that is off, naming the first of them."""
        lost, first = np.asarray(off.any(axis=1)), off.argmax(axis=1)
        values = []
        for row in np.flatnonzero(lost):
            place_mm = 1e3 * self.found.measured.places_m[row, first[row]]
            numbers = ", ".join(f"{value:g}" for value in place_mm)
            values.append(f"{self._target(int(first[row]))} = {numbers}")
        self.leave_out(lost, reason, values)

    def _leave_out_exchanged(self) -> None:
        """Quarantine rows whose targets are exchanged; refuse columns that are, in most rows."""
        names, places_m = self.found.measured.target_names, self.found.measured.places_m
        modelled = nominal_places(self.T_base_ee, places_m) if len(names) > 1 else None
        if modelled is None:
            return
        orders = exchanged(places_m, modelled)
        swapped = np.array([order is not None for order in orders])
        said = [exchange_text(order, names) for order in orders[swapped]]
        if 2 * swapped.sum() > len(swapped):
            raise RawDataError(
                f"the columns of targets {said[0]} are exchanged",
                where=str(self.file.path),
                value=f"{swapped.sum()} of {len(swapped)} rows fit the arm with their labels "
                "exchanged",
                allowed="every target under its own name",
                remedy="rename the columns",
            )
        self.leave_out(swapped, EXCHANGED, said)

    def _most_seen(self) -> tuple[int, Mask]:
        """Return the target that most rows have, and which these are."""
        seen = np.isfinite(self.found.measured.places_m[..., 0])
        best = int(seen.sum(axis=0).argmax())
        return best, seen[:, best]

    def _refuse_units(self) -> None:
        found, T_base_ee, words = self.found, self.T_base_ee, self.file.words
        self._refuse_one_attitude()
        places_m = found.measured.places_m
        best, seen = self._most_seen()
        what = "distances" if places_m.shape[2] == 1 else "positions"
        where, column = f"{self.file.path}: {self._target(best)}", self.columns.targets[best][0]
        scale, logged = found.measured.scale(T_base_ee), self._logged
        # Of joints that may be in radians the scale says nothing yet.
        if not may_be_radians(logged, self.arm):
            refuse_wrong_length_unit(scale, what, where, column, words)
        time_s, p_mm = found.states.time_s, 1e3 * places_m[seen, best]
        refuse_wrong_angle_unit(
            (time_s, logged), (time_s[seen], p_mm), self.arm, 0.0, self._where_joints, words
        )
        self._refuse_better_unit()
        refuse_wrong_length_unit(scale, what, where, column, words)

    def _refuse_one_attitude(self) -> None:
        """Stop when all orientations are the same, or nearly, though the arm turned its flange."""
        R, words, angles = self.found.measured.attitudes, self.file.words, self.file.in_degrees
        if R is None or len(R) < LEAST_REPEATS:
            return
        seen, turned = _spread_rad(R), _spread_rad(self.T_base_ee[:, :3, :3])
        if turned < TURNED_RAD:
            return
        flange = f"flange turned by {np.degrees(turned):.0f} deg"
        if angles and ONE_ATTITUDE_RAD < seen < min(RADIANS_RAD, turned / LIKE_RADIANS):
            raise RawDataError(
                "the angles of the orientations look like radians",
                where=f"{self.file.path}: {', '.join(f'`{name}`' for name in angles)}",
                value=f"orientations within {np.degrees(seen):.2g} deg as degrees, {flange}",
                allowed="angles in the unit that columns states: deg",
                remedy=words.set_unit("qw", "rad", "degrees"),
            )
        if seen <= ONE_ATTITUDE_RAD:
            name = words.column("qw") if "qw" in words else "qw, qx, qy, qz"
            raise RawDataError(
                "every row has the same orientation, though the arm turned",
                where=f"{self.file.path}: {name}",
                value=f"orientations within {np.degrees(seen):.2g} deg, {flange}",
                allowed="the measured orientation of every row",
                remedy="export the orientations; where none are measured, use instrument.kind "
                "points",
            )

    def _refuse_better_unit(self) -> None:
        """Stop when angles in radians, or strokes in metres, explain the measurements."""
        slides, q = self.arm.prismatic, self._logged
        tried = []
        if may_be_radians(q, self.arm):
            tried.append(("angles", "rad", "deg", np.where(slides, 1.0, np.degrees(1.0))))
        if slides.any() and np.abs(q[:, slides]).max() <= LONGEST_STROKE_M:
            tried.append(("strokes", "m", "mm", np.where(slides, 1e3, 1.0)))
        if not tried:
            return
        measured = self.found.measured
        logged = misfit_of(measured, self.T_base_ee)
        if logged is None or np.median(logged.size_m) <= BAD_M:
            return
        for what, unit, right_unit, factor in tried:
            moved = Chain.of(self.arm).forward(in_radians(q * factor, slides))
            misfit = misfit_of(measured, moved)
            if misfit is None or BETTER * np.median(misfit.size_m) > np.median(logged.size_m):
                continue
            named, right = UNIT_WORDS[unit], UNIT_WORDS[right_unit]
            first = next(
                name for name in position_columns(slides) if name.endswith(f"_{right_unit}")
            )
            raise RawDataError(
                f"the joint {what} look like {named}",
                where=self._where_joints,
                value="a median misfit of the nominal model of "
                f"{1e3 * np.median(logged.size_m):.0f} mm, and of "
                f"{1e3 * np.median(misfit.size_m):.0f} mm with {named}",
                allowed=f"joint {what} in {right}",
                remedy=self.file.words.set_unit(first, unit, right),
            )

    def _refuse_shifted(self) -> None:
        """Stop when the readings stand a row away from their joints."""
        T_base_ee, measured = self.T_base_ee, self.found.measured
        best, _ = self._most_seen()
        places_m = measured.places_m
        if places_m.shape[2] != 3 or not steps_agree(T_base_ee, places_m[:, best]):
            return
        rows = len(self.line)
        found = shifted(np.arange(rows), rows, nominal_fit(measured, T_base_ee))
        if found is not None:
            refuse_shifted(found, self.file.path, self.line, "as they stand", "")

    def _constant(self) -> tuple[str, ...]:
        """Name joints whose column has the same number in all rows, where the arm does not fit."""
        same = np.ptp(self.found.states.q_rad, axis=0) == 0.0
        names = position_columns(self.arm.prismatic)
        return tuple(
            f"{self.file.path.name}: {self.file.words.column(names[k])}: the same number in all "
            "rows: if that joint moved, export what was logged of it"
            for k in np.flatnonzero(same)
        )

    def _other_axes(self) -> tuple[str, ...]:
        """Stop when exchanged or mirrored axes of the instrument explain what is far off.

        Where they explain a part of it, that is returned.
        """
        measured = self.found.measured
        if measured.places_m.shape[2] != 3:
            return ()
        best, seen = self._most_seen()
        R = None if measured.attitudes is None else measured.attitudes[seen]
        found = other_axes(self.T_base_ee[seen], measured.places_m[seen, best], R)
        if found is None:
            return ()
        value = (
            f"the nominal arm, base and target fitted, is {1e3 * found.left_m:.0f} mm off, "
            f"and {1e3 * found.would_leave_m:.2g} mm with these axes"
        )
        if not found.puts_right:
            return (f"if the instrument's axes are {found.name}: {value}, {STILL_WRONG}",)
        raise RawDataError(
            f"the instrument's axes are {found.name}",
            where=f"{self.file.path}: {self._target(best)}",
            value=value,
            allowed="positions in a right-handed frame, orientations in the same",
            remedy=self._remedy_of_axes(found, self.columns.targets[best]),
        )

    def _remedy_of_axes(self, found: OtherAxes, names: Sequence[str]) -> str:
        """Return what to state, or to change in the file, for other axes of the instrument."""
        words, remedy = self.file.words, []
        if sorted(found.order) != list(found.order):
            meant = [names[found.order.index(k)] for k in range(3)]
            remedy.append(
                words.set_names(meant)
                if words.key(names[0])
                else f"rename the columns {', '.join(names)}: they hold {', '.join(meant)}"
            )
        if found.turned:
            turned = [words.column(names[k]) for k in found.turned]
            which = f"one of {', '.join(turned)}" if found.any_one else " and of ".join(turned)
            remedy.append(
                f"turn the sign of {which} in the instrument's software, or of the numbers in the "
                "file"
            )
        return " and ".join(remedy)

    @property
    def _logged(self) -> Array:
        """Return joint positions (N, n) as they were logged: degrees, or millimetres."""
        q_rad = self.found.states.q_rad
        return np.asarray(np.where(self.arm.prismatic, 1e3 * q_rad, np.degrees(q_rad)))

    @property
    def _where_joints(self) -> str:
        names = position_columns(self.arm.prismatic)
        first, last = map(self.file.words.column, (names[0], names[-1]))
        return f"{self.file.path}: {first} … {last}"

    def _target(self, b: int) -> str:
        """Return the columns of a target."""
        return self.file.words.text(", ".join(self.columns.targets[b]))


def _poor_fit(misfit: Misfit) -> tuple[str, ...]:
    """Describe where the nominal model, however placed, is far from most of what was measured."""
    length_mm = 1e3 * float(np.nanmedian(misfit.length_m))
    turn_deg = float(np.degrees(np.median(misfit.turn_rad)))
    off = [f"{length_mm:.0f} mm"] if length_mm > WARN_MM else []
    off += [f"{turn_deg:.0f} deg"] if turn_deg > WARN_DEG else []
    if not off:
        return ()
    return (
        f"the nominal model, base and target fitted, is {' and '.join(off)} off in the median: "
        "check robot, and order, signs and zeros of the joints and of the quaternion",
    )
