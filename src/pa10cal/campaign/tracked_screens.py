"""Screens of readings that touch nothing: wrong units, axes and labels, and single gross errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.campaign import screens
from pa10cal.campaign.column_map import UNIT_WORDS
from pa10cal.campaign.conventions import (
    STILL_WRONG,
    OtherAxes,
    other_axes,
    other_scale,
)
from pa10cal.campaign.description import DESCRIPTION_FILE
from pa10cal.campaign.inverse_poses import other_inverse
from pa10cal.campaign.joint_conventions import Coupled, coupling_that_fits
from pa10cal.campaign.joint_positions import in_radians, position_columns
from pa10cal.campaign.nominal_fit import (
    ReadingsAtStations,
    find_shift,
    misfit_of,
    nominal_places,
    refuse_shifted,
    steps_agree,
)
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import Quarantined, configurations, quarantined
from pa10cal.campaign.target_labels import (
    EXCHANGED,
    NOT_RIGID,
    exchange_text,
    exchanged,
    exchanged_by_distances,
    not_rigid,
    told_of_computed,
    told_of_one_reading,
)
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Misfit, RawColumns

#: Joint positions are in another unit if it reduces the median misfit of the nominal model by this
#: factor, and the misfit as logged is above this.
BETTER, BAD_M = 5.0, 2e-3
#: Rows in another unit than the others, at least.
LEAST_OTHER_UNIT = 3
#: Strokes may be in metres if no logged number exceeds this.
LONGEST_STROKE_M = 10.0
#: Median misfits of the nominal model, base and target fitted, above which there is a warning: of
#: positions those of an arm of usual size.
WARN_MM, WARN_DEG = 50.0, 10.0
#: Three angles in radians, read as degrees, turn by no more than this, and by so many times less
#: than the flange.
RADIANS_RAD, LIKE_RADIANS = np.radians(3.0 * 2.0 * np.pi), 8.0
#: Orientations within this are the same; a flange that turns by more has several.
ONE_ATTITUDE_RAD, TURNED_RAD = 1e-5, np.radians(5.0)


@dataclass
class Screen:
    """Refuses wrong units, and quarantines single readings that cannot be of their pose.

    Rows (N,) are those that remain.
    """

    columns: RawColumns
    arm: Arm
    file: RawFile | TwoLogs
    line: NDArray[np.int64]  # (N,) line of each row
    found: Observations  # the rows as readings
    quarantined: list[Quarantined]  # rows that do not remain are added
    warnings: tuple[str, ...] = ()

    # What the nominal arm makes of the rows that remain: found anew once some are quarantined.

    @cached_property
    def T_base_ee(self) -> Array:
        """Return the nominal end (N, 4, 4)."""
        return Chain.of(self.arm).forward(self.found.states.q_rad)

    @cached_property
    def modelled_m(self) -> Array | None:
        """Return where it puts the targets, (N, B, 3); None where that is not determined."""
        return nominal_places(self.T_base_ee, self.found.measured.places_m)

    @cached_property
    def misfit(self) -> Misfit | None:
        """Return how far the readings are from it; None where that is not determined."""
        return misfit_of(self.found.measured, self.T_base_ee)

    def run(self) -> None:
        """Screen the rows, from the coarsest check to the finest."""

        def missing(p_m: Array, _: Mask) -> Mask:
            return screens.not_detected(p_m)

        def reach(p_m: Array, _: Mask) -> Mask:
            return screens.out_of_reach(p_m, self.arm)

        def repeats(p_m: Array, seen: Mask) -> Mask:
            return screens.off_repeats(p_m, self.found.pose[seen], self.found.states.load_N[seen])

        self._quarantine_targets(self._by_target(missing), screens.NOT_DETECTED)
        self._refuse_inverse_poses()
        far = self._by_target(reach)
        if far.any() and (
            # Not where one factor of all lengths puts them right.
            self.misfit is None
            or other_scale(self.found.measured, self.T_base_ee, self.misfit) is None
        ):
            self._quarantine_targets(far, screens.OUT_OF_REACH)
        self._refuse_units()
        self._quarantine_targets(self._held_last(), screens.HELD)
        self._quarantine_exchanged()
        self._quarantine_targets(self._by_target(repeats), screens.OFF_REPEATS)
        self._quarantine_targets(self._off_their_like(), screens.OFF_REPEATS)
        misfit = self.misfit
        if misfit is not None:
            self._look_at_poor_fit(misfit)
            held_out = self.found.kind == "holdout"
            off = screens.off_model(misfit, held_out)
            if off.any() and self._coupled is not None:  # rows that fit coupled joints are right
                off &= screens.off_model(self._coupled[1], held_out)
            self._quarantine_targets(off, screens.OFF_MODEL)
        self._quarantine_targets(not_rigid(self.found.measured.places_m), NOT_RIGID)
        measured = self.found.measured
        self.warnings = (*self.warnings, *told_of_one_reading(measured))
        self.warnings = (*self.warnings, *told_of_computed(measured, self.T_base_ee))

    @cached_property
    def _coupled(self) -> tuple[Coupled, Misfit] | None:
        """Return another coupling with which the nominal arm fits all rows; None for none."""
        axes = self.arm.coupling.to_axes(self.found.states.q_rad)
        return coupling_that_fits(self.arm, axes, self.found.measured)

    def quarantine(self, off: Mask, reason: str, values: Iterable[object]) -> None:
        """Quarantine rows (N,), with what was found in each."""
        if not off.any():
            return
        where = configurations(self.found.take(off))
        file = self.file.path.name
        self.quarantined += quarantined(file, self.line[off], reason, values, where)
        self.line, self.found = self.line[~off], self.found.take(~off)
        for of_all in ("T_base_ee", "modelled_m", "misfit"):
            self.__dict__.pop(of_all, None)

    def _by_target(self, judge: Callable[[Array, Mask], Mask]) -> Mask:
        """Return (N, B) the verdicts of `judge` on the places (N', k) of each target where seen."""
        places_m = self.found.measured.places_m
        off = np.zeros(places_m.shape[:2], dtype=bool)
        for b in range(places_m.shape[1]):
            seen = np.isfinite(places_m[:, b, 0])
            off[seen, b] = judge(places_m[seen, b], seen)
        return off

    def _quarantine_targets(self, off: Mask, reason: str) -> None:
        """Quarantine rows with a target that is `off` (N, B), with the place of the first such."""
        lost, first = np.asarray(off.any(axis=1)), off.argmax(axis=1)
        values = []
        for row in np.flatnonzero(lost):
            place_mm = 1e3 * self.found.measured.places_m[row, first[row]]
            numbers = ", ".join(f"{value:g}" for value in place_mm)
            values.append(f"{self._target(int(first[row]))} = {numbers}")
        self.quarantine(lost, reason, values)

    def _held_last(self) -> Mask:
        """Return the targets (N, B) whose reading repeats that of the row before."""
        places_m = self.found.measured.places_m
        if not (places_m[1:] == places_m[:-1]).all(axis=2).any():
            return np.zeros(places_m.shape[:2], dtype=bool)
        # The model decides whether a target moved: the arm may have turned about it.
        modelled = self.modelled_m if places_m.shape[2] == 3 else None
        if modelled is None:
            modelled = np.repeat(self.T_base_ee[:, None, :3, 3], places_m.shape[1], axis=1)
        elif 1e3 * np.nanmedian(np.linalg.norm(places_m - modelled, axis=2)) > WARN_MM:
            # The description of the arm is too far off to say where targets went.
            return np.zeros(places_m.shape[:2], dtype=bool)
        return screens.held_last(places_m, modelled)

    def _off_their_like(self) -> Mask:
        """Return the targets (N, B) that a row with the same joints and the nominal arm contradict.

        A calibration gives such a row little weight where it fits it; if it is held out, and that
        is not yet known, nothing else finds it.
        """
        states, places_m = self.found.states, self.found.measured.places_m
        same = np.where(self.arm.prismatic, screens.LIKE_M, screens.LIKE_RAD)
        rows, like = screens.alike(states.q_rad / same, states.load_N)
        modelled = self.modelled_m if len(rows) and places_m.shape[2] == 3 else None
        if modelled is None:
            return np.zeros(places_m.shape[:2], dtype=bool)
        return screens.off_its_like(places_m, modelled, rows, like)

    def _quarantine_exchanged(self) -> None:
        """Quarantine rows whose targets are exchanged; refuse the file where most rows are so."""
        names = self.found.measured.target_names
        if len(names) > 2:
            orders = exchanged_by_distances(self.found.measured.places_m)
            swapped = np.array([order is not None for order in orders])
            self.quarantine(
                swapped, EXCHANGED, [exchange_text(order, names) for order in orders[swapped]]
            )
        places_m = self.found.measured.places_m
        modelled = self.modelled_m if len(names) > 1 else None
        if modelled is None:
            return
        orders = exchanged(places_m, modelled)
        swapped = np.array([order is not None for order in orders])
        texts = [exchange_text(order, names) for order in orders[swapped]]
        if 2 * len(texts) > len(swapped):
            value = f"{len(texts)} of {len(swapped)} rows fit the arm with their labels exchanged"
            raise RawDataError(
                f"the columns of targets {texts[0]} are exchanged",
                where=str(self.file.path),
                value=value,
                allowed="every target under its own name",
                remedy="rename the columns",
            )
        self.quarantine(swapped, EXCHANGED, texts)

    def _most_seen(self) -> tuple[int, Mask]:
        """Return the target that was seen in most rows, and in which (N,)."""
        seen = np.isfinite(self.found.measured.places_m[..., 0])
        best = int(seen.sum(axis=0).argmax())
        return best, seen[:, best]

    def _refuse_inverse_poses(self) -> None:
        """Refuse poses that fit the nominal arm only if other of them are inverse than stated."""
        R, places_m, stated = self.found.measured.attitudes, self.found.measured.places_m, self.file
        if R is None:
            return
        other = other_inverse(self.T_base_ee, places_m[:, 0], R, stated.inverse)
        if other is None:
            return
        key, wanted = stated.words.key("qw"), str(other.inverse).lower()
        raise RawDataError(
            "the poses are those of the instrument in the target's frame"
            if other.inverse == "pose"
            else "the positions are those of the target, not of an inverse pose",
            where=f"{stated.path}: {self._target(0)}",
            value=f"the nominal arm, base and target fitted, is {1e3 * other.as_read_m:.0f} mm off,"
            f" and {1e3 * other.would_leave_m:.2g} mm if the poses are read so",
            allowed="poses of the target in the instrument's frame, or stated to be inverse",
            remedy=f"set {key}.inverse: {wanted}"
            if key
            else f"invert the poses, or name their columns under columns in {DESCRIPTION_FILE}, "
            f"with rotation.inverse: {wanted}",
        )

    def _refuse_units(self) -> None:
        """Refuse orientations, lengths or joint positions in another unit."""
        measured, T_base_ee, words = self.found.measured, self.T_base_ee, self.file.words
        self._refuse_one_orientation(measured.attitudes, T_base_ee)
        best, seen = self._most_seen()
        places_m, column = measured.places_m, self.columns.targets[best][0]
        what = "distances" if places_m.shape[2] == 1 else "positions"
        where, scale = f"{self.file.path}: {self._target(best)}", measured.scale(T_base_ee)
        slides, coupling = self.arm.axes_slide, self.arm.coupling
        q_rad = coupling.to_axes(self.found.states.q_rad)
        q = np.where(slides, 1e3 * q_rad, np.degrees(q_rad))  # as logged
        if not screens.may_be_radians(q, self.arm):  # else the scale of lengths means nothing yet
            screens.refuse_wrong_length_unit(scale, what, where, column, words)
        names = position_columns(slides)
        where_joints = f"{self.file.path}: {words.column(names[0])} … {words.column(names[-1])}"
        time_s = self.found.states.time_s
        places = time_s[seen], 1e3 * places_m[seen, best]
        screens.refuse_wrong_angle_unit((time_s, q), places, self.arm, 0.0, where_joints, words)
        self._refuse_units_of_joints(q, names, where_joints)
        screens.refuse_wrong_length_unit(scale, what, where, column, words)

    def _refuse_units_of_joints(self, q: Array, names: Sequence[str], where: str) -> None:
        """Refuse logged positions q (N, m) if another unit makes the nominal model fit far better.

        Angles in radians may be in some rows only.
        """
        measured, slides, words = self.found.measured, self.arm.axes_slide, self.file.words
        tried = []  # quantity, unit, unit of the contract, rows (N, 1) that may be in it, factor
        small = np.array([screens.may_be_radians(row[None], self.arm) for row in q])[:, None]
        if small.sum() >= LEAST_OTHER_UNIT:
            tried.append(("angles", "rad", "deg", small, np.where(slides, 1.0, np.degrees(1.0))))
        if slides.any() and np.abs(q[:, slides]).max() <= LONGEST_STROKE_M:
            all_rows = np.ones((len(q), 1), dtype=bool)
            tried.append(("strokes", "m", "mm", all_rows, np.where(slides, 1e3, 1.0)))
        logged = self.misfit if tried else None
        # As logged the poses may not even determine where the instrument is.
        logged_m = np.inf if logged is None else float(np.median(logged.size_m))
        if logged_m <= BAD_M:
            return
        for quantity, unit, right_unit, rows, factor in tried:
            axes = in_radians(np.where(rows, factor, 1.0) * q, slides)
            T_base_ee = Chain.of(self.arm).forward(self.arm.coupling.to_joints(axes))
            misfit = misfit_of(measured, T_base_ee)
            misfit_m = np.inf if misfit is None else float(np.median(misfit.size_m))
            if misfit_m > (BAD_M if logged is None else logged_m / BETTER):
                continue
            named, right = UNIT_WORDS[unit], UNIT_WORDS[right_unit]
            value = (
                f"a median misfit of the nominal model of {1e3 * logged_m:.0f} mm, and of "
                f"{1e3 * misfit_m:.0f} mm with {named}"
            )
            if logged is None:
                value = f"no fit as logged, a misfit of {1e3 * misfit_m:.0f} mm with {named}"
            first = next(name for name in names if name.endswith(f"_{right_unit}"))
            what, remedy = f"the joint {quantity} look like", words.set_unit(first, unit, right)
            if not rows.all():
                what = f"in {rows.sum()} of {len(rows)} rows {what}"
                where = where.replace(":", f":{self.line[rows.argmax()]}:", 1)
                remedy = "convert these rows to the unit of the others"
            raise RawDataError(
                f"{what} {named}",
                where=where,
                value=value,
                allowed=f"joint {quantity} in {right}",
                remedy=remedy,
            )

    def _refuse_one_orientation(self, R: Array | None, T_base_ee: Array) -> None:
        """Refuse orientations that are all the same, or nearly, though the flange turned."""
        if R is None or len(R) < screens.LEAST_REPEATS:
            return

        def spread_rad(R: Array) -> float:
            """Return the largest angle between the first orientation and the others."""
            cosine = 0.5 * (np.einsum("pij,ij->p", R, R[0]) - 1.0)
            return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())

        seen, turned = spread_rad(R), spread_rad(T_base_ee[:, :3, :3])
        words, angles = self.file.words, self.file.in_degrees
        within = f"orientations within {np.degrees(seen):.2g} deg"
        flange = f"flange turned by {np.degrees(turned):.0f} deg"
        if turned < TURNED_RAD:
            return
        if angles and ONE_ATTITUDE_RAD < seen < min(RADIANS_RAD, turned / LIKE_RADIANS):
            where = f"{self.file.path}: {', '.join(f'`{name}`' for name in angles)}"
            raise RawDataError(
                "the angles of the orientations look like radians",
                where=where,
                value=f"{within} as degrees, {flange}",
                allowed="angles in the unit that columns states: deg",
                remedy=words.set_unit("qw", "rad", "degrees"),
            )
        if seen <= ONE_ATTITUDE_RAD:
            name = words.column("qw") if "qw" in words else "qw, qx, qy, qz"
            where = f"{self.file.path}: {name}"
            raise RawDataError(
                "every row has the same orientation, though the arm turned",
                where=where,
                value=f"{within}, {flange}",
                allowed="the measured orientation of every row",
                remedy="export the orientations; where none are measured, use instrument.kind "
                "points",
            )

    def _look_at_poor_fit(self, misfit: Misfit) -> None:
        """Seek the cause where the nominal model is far from most readings.

        Readings a row away from their joints, and exchanged or mirrored axes of the instrument, are
        refused. Other causes, and joints with the same number in all rows, are warnings.
        """
        off = self._large_misfit(misfit)
        if not off:
            return
        other_axes_warnings = []
        if self.found.measured.places_m.shape[2] == 3:
            self._refuse_rows_away()
            other_axes_warnings = self._refuse_other_axes()
        fits = f"the nominal model, base and target fitted, is {off} off in the median"
        measured, T_base_ee = self.found.measured, self.T_base_ee
        if self._coupled is not None:
            coupled, with_coupling = self._coupled
            in_words = coupling_in_words(replace(self.arm, coupled=coupled)) or "each is counted"
            causes = [
                f"{fits}, and {1e3 * float(np.median(with_coupling.size_m)):.2g} mm if joints move "
                f"together ({in_words}): {set_coupling(coupled, self.arm)}"
            ]
        elif (scale := other_scale(measured, T_base_ee, misfit)) is not None:
            times, left_m = scale
            causes = [
                f"{fits}, and {1e3 * left_m:.2g} mm if lengths are divided by {times:.3g}: check "
                "the size of the tag or target as the instrument holds it, and their unit"
            ]
        else:
            causes = [
                f"{fits}: check robot, and order, signs and zeros of the joints and of the "
                "quaternion",
                *other_axes_warnings,
            ]
        self.warnings = (*causes, *self._joints_that_stay())

    def _large_misfit(self, misfit: Misfit) -> str:
        """Return the median misfits that are too large for a nominal arm, in words; empty if none.

        A misfit of lengths is compared with their stated uncertainty, too.
        """
        length_mm = 1e3 * float(np.nanmedian(misfit.length_m))
        turn_deg = float(np.degrees(np.median(misfit.turn_rad)))
        measured = self.found.measured
        positions = measured.position_columns
        variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)[:, positions]
        seen_variance = variance[measured.components_seen[:, positions]]
        stated_mm = 1e3 * float(np.sqrt(min(len(positions), 3) * np.median(seen_variance)))
        far_mm = max(WARN_MM * self.arm.size_ratio, 2.0 * stated_mm)
        off = [f"{length_mm:.{0 if length_mm > 10.0 else 1}f} mm"] if length_mm > far_mm else []
        off += [f"{turn_deg:.0f} deg"] if turn_deg > WARN_DEG else []
        return " and ".join(off)

    def _refuse_rows_away(self) -> None:
        """Refuse positions that stand a row away from their joints."""
        measured, T_base_ee, rows = self.found.measured, self.T_base_ee, np.arange(len(self.line))
        best, _ = self._most_seen()
        if steps_agree(T_base_ee, measured.places_m[:, best]):
            all_usable = np.ones(len(rows), dtype=bool)
            shift = find_shift(ReadingsAtStations(measured, T_base_ee, all_usable), rows)
            if shift is not None:
                refuse_shifted(shift, self.file.path, self.line, "as they stand", "")

    def _refuse_other_axes(self) -> list[str]:
        """Refuse exchanged or mirrored axes; return a warning of axes that are only better."""
        best, seen = self._most_seen()
        measured = self.found.measured
        R = None if measured.attitudes is None else measured.attitudes[seen]
        axes = other_axes(self.T_base_ee[seen], measured.places_m[seen, best], R)
        if axes is None:
            return []
        value = (
            f"the nominal arm, base and target fitted, is {1e3 * axes.left_m:.0f} mm off, "
            f"and {1e3 * axes.would_leave_m:.2g} mm with these axes"
        )
        if axes.puts_right:
            raise RawDataError(
                f"the instrument's axes are {axes.name}",
                where=f"{self.file.path}: {self._target(best)}",
                value=value,
                allowed="positions in a right-handed frame, orientations in the same",
                remedy=self._remedy_of_axes(axes, self.columns.targets[best]),
            )
        return [f"if the instrument's axes are {axes.name}: {value}, {STILL_WRONG}"]

    def _joints_that_stay(self) -> list[str]:
        """Return a warning for each joint with the same number in all rows."""
        names = position_columns(self.arm.axes_slide)
        logged = self.arm.coupling.to_axes(self.found.states.q_rad)
        return [
            f"{self.file.path.name}: {self.file.words.column(names[k])}: the same number in all "
            "rows: if that joint moved, export what was logged of it"
            for k in np.flatnonzero(np.ptp(logged, axis=0) == 0.0)
        ]

    def _remedy_of_axes(self, axes: OtherAxes, names: Sequence[str]) -> str:
        """Return the remedy for other axes of the instrument, whose columns x, y, z are `names`."""
        words, remedy = self.file.words, []
        if sorted(axes.order) != list(axes.order):
            meant = [names[axes.order.index(k)] for k in range(3)]
            remedy.append(
                words.set_names(meant)
                if words.key(names[0])
                else f"rename the columns {', '.join(names)}: they hold {', '.join(meant)}"
            )
        if axes.turned:
            turned = [words.column(names[k]) for k in axes.turned]
            which = f"one of {', '.join(turned)}" if axes.any_one else " and of ".join(turned)
            remedy.append(
                f"turn the sign of {which} in the instrument's software, or of the numbers in the "
                "file"
            )
        return " and ".join(remedy)

    def _target(self, b: int) -> str:
        """Return the columns of a target, in words."""
        return self.file.words.text(", ".join(self.columns.targets[b]))
