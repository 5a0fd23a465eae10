"""Rows of an instrument that touches nothing: screened, and refused where a unit is wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask
from pa10cal.campaign import labels, screens
from pa10cal.campaign.base_motion import base_target_names, refuse_base_targets, steadied
from pa10cal.campaign.bounds import Bounds
from pa10cal.campaign.conventions import STILL_WRONG, OtherAxes, other_axes
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.own_words import UNIT_WORDS, refuse_too_many
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    Ingested,
    Quarantined,
    configurations,
    quarantined,
)
from pa10cal.campaign.rows import PoseRows, in_radians, position_columns, read_pose_rows
from pa10cal.campaign.shifted_rows import nominal_fit, refuse_shifted, shifted, steps_agree
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Misfit, RawColumns
from pa10cal.options import IngestOptions

NO_TORQUES = "no torques logged, masses unknown: those of assumed weights are used"
THOSE_OF_MASSES = "no torques logged: those of the described masses are used"
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


def read_tracked(
    description: CampaignDescription, arm: Arm, folder: Path, options: IngestOptions
) -> Ingested:
    """Read a campaign of an instrument that gives one row a configuration.

    Args:
        description: of the campaign.
        arm: the nominal arm.
        folder: its folder.
        options: how to ingest.

    Raises:
        RawDataError: when the file, or too much of it, cannot be used.
    """
    file: RawFile | TwoLogs = (
        RawFile.of(description, folder, "poses", arm.prismatic)
        if description.files.joints is None
        else TwoLogs.of(description, folder, arm, options.still_speed_deg_s)
    )
    instrument, stated = description.instrument.type, description.stated
    refuse_base_targets(description, file, base_target_names(file.names))
    rows, read, columns = read_pose_rows(
        file,
        Bounds(arm),
        instrument,
        stated,
        exclusions_of(description, folder),
        kind_stated=description.holdout is None,
        same_deg=description.repeat_tolerance_deg,
    )
    # Rows that cannot be read are of some configuration too, but for exact repeats.
    unread = sum(row.reason != REPEATED for row in read.quarantined)
    numbers, first = np.unique(rows.configurations, return_index=True)
    logged = len(numbers) + unread
    totals = {read.file: read.total, **file.totals}
    most = options.max_quarantined_fraction
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    other = screens.off_first(
        rows.observations.states.q_rad, rows.configurations, first, arm.prismatic
    )
    shared = again & other
    screen = _Screen(columns, arm, file, rows.take(~again), list(read.quarantined))
    listed = screen.quarantined
    listed += quarantined(read.file, rows.line[again & ~other], screens.READ_BEFORE)
    listed += quarantined(
        read.file, rows.line[shared], screens.ONE_LABEL, rows.observations.pose[shared]
    )
    refuse_too_many(listed, totals, most, file.words)
    screen.run()
    found = screen.found
    off = screens.off_command(found.pose, found.states.q_rad, arm.prismatic)
    screen.leave_out(off, screens.OTHER_COMMAND, found.pose[off])
    refuse_too_many(listed, totals, most, file.words)
    found = screen.found
    found, moved, of_base = steadied(found, str(file.path), screen.T_base_ee)
    notes = [*file.notes, *read.notes, *instrument.raw_notes(columns, stated), *moved]
    if np.isnan(found.states.tau_Nm).all():
        notes.append(NO_TORQUES if arm.mass_kg is None else THOSE_OF_MASSES)
    missing = screens.count_warnings(description.configurations, logged, read.file)
    return Ingested(
        found,
        tuple(listed),
        tuple(notes),
        (
            *missing,
            *screen.warnings,
            *of_base,
            *file.words.contradicted_units(read.file),
            *_other_names(description, found.measured.target_names),
        ),
        timed="time_s" in file.names,
    )


def _other_names(description: CampaignDescription, names: Sequence[str]) -> tuple[str, ...]:
    """Name targets that campaign.yaml places under names that no column has."""
    absent = sorted(set(description.tool.balls_mm) - set(names))
    unplaced = sorted(set(names) - set(description.tool.balls_mm))
    if not absent or not unplaced:
        return ()
    return (
        f"campaign.yaml: tool.balls_mm states {', '.join(absent)}, and the columns are of "
        f"{', '.join(unplaced)}: if these are the same targets, rename them in tool.balls_mm or "
        "in the columns",
    )


@dataclass
class _Screen:
    """Refuses wrong units, and quarantines single readings that cannot be of their pose."""

    columns: RawColumns
    arm: Arm
    file: RawFile | TwoLogs
    rows: PoseRows  # those left
    quarantined: list[Quarantined]
    warnings: tuple[str, ...] = ()

    @property
    def found(self) -> Observations:
        """Return the readings left."""
        return self.rows.observations

    @property
    def T_base_ee(self) -> Array:
        """Return the nominal end at each."""
        return Chain.of(self.arm).forward(self.found.states.q_rad)

    def run(self) -> None:
        """Screen the rows."""
        self._leave_out(
            self._each(lambda p_m, _: screens.out_of_reach(p_m, self.arm)), screens.OUT_OF_REACH
        )
        self._refuse_units()
        self._leave_out_exchanged()
        pose, load_N = self.found.pose, self.found.states.load_N
        far = self._each(lambda p_m, seen: screens.off_repeats(p_m, pose[seen], load_N[seen]))
        self._leave_out(far, screens.OFF_REPEATS)
        misfit = screens.misfit_of(self.found.measured, self.T_base_ee)
        if misfit is not None:
            self.warnings = _poor_fit(misfit)
            if self.warnings:
                self._refuse_shifted()
                self.warnings += (*self._other_axes(), *self._constant())
            self._leave_out(
                screens.off_model(misfit, self.found.kind == "holdout"), screens.OFF_MODEL
            )
        self._leave_out(labels.not_rigid(self.found.measured.places_m), labels.NOT_RIGID)

    def leave_out(self, off: Mask, reason: str, values: Iterable[object]) -> None:
        """Quarantine rows (N,), with what was found in each."""
        where = configurations(self.found.take(off))
        file = self.file.path.name
        self.quarantined += quarantined(file, self.rows.line[off], reason, values, where)
        self.rows = self.rows.take(~off)

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
        modelled = labels.nominal_places(self.T_base_ee, places_m) if len(names) > 1 else None
        if modelled is None:
            return
        orders = labels.exchanged(places_m, modelled)
        swapped = np.array([order is not None for order in orders])
        said = [labels.exchange_text(order, names) for order in orders[swapped]]
        if 2 * swapped.sum() > len(swapped):
            raise RawDataError(
                f"the columns of targets {said[0]} are exchanged",
                where=str(self.file.path),
                value=f"{swapped.sum()} of {len(swapped)} rows fit the arm with their labels "
                "exchanged",
                allowed="every target under its own name",
                remedy="rename the columns",
            )
        self.leave_out(swapped, labels.EXCHANGED, said)

    def _most_seen(self) -> tuple[int, Mask]:
        """Return the target that most rows have, and which these are."""
        seen = np.isfinite(self.found.measured.places_m[..., 0])
        best = int(seen.sum(axis=0).argmax())
        return best, seen[:, best]

    def _refuse_units(self) -> None:
        found, T_base_ee, words = self.found, self.T_base_ee, self.file.words
        attitudes, places_m = found.measured.attitudes, found.measured.places_m
        screens.refuse_one_attitude(
            attitudes, T_base_ee, self.file.path, self.file.in_degrees, words
        )
        best, seen = self._most_seen()
        what = "distances" if places_m.shape[2] == 1 else "positions"
        where, column = f"{self.file.path}: {self._target(best)}", self.columns.targets[best][0]
        scale, logged = found.measured.scale(T_base_ee), self._logged(found.states.q_rad)
        # Of joints that may be in radians the scale says nothing yet.
        if not screens.may_be_radians(logged, self.arm):
            screens.refuse_wrong_length_unit(scale, what, where, column, words)
        screens.refuse_wrong_angle_unit(
            (self.rows.time_s, logged),
            (self.rows.time_s[seen], 1e3 * places_m[seen, best]),
            self.arm,
            0.0,
            self._where_joints,
            words,
        )
        self._refuse_better_unit()
        screens.refuse_wrong_length_unit(scale, what, where, column, words)

    def _refuse_better_unit(self) -> None:
        """Stop when angles in radians, or strokes in metres, explain the measurements."""
        slides, q = self.arm.prismatic, self._logged(self.found.states.q_rad)
        tried = []
        if screens.may_be_radians(q, self.arm):
            tried.append(("angles", "rad", "deg", np.where(slides, 1.0, np.degrees(1.0))))
        if slides.any() and np.abs(q[:, slides]).max() <= LONGEST_STROKE_M:
            tried.append(("strokes", "m", "mm", np.where(slides, 1e3, 1.0)))
        if not tried:
            return
        measured = self.found.measured
        logged = screens.misfit_of(measured, self.T_base_ee)
        if logged is None or np.median(logged.size_m) <= BAD_M:
            return
        for what, unit, right_unit, factor in tried:
            moved = Chain.of(self.arm).forward(in_radians(q * factor, slides))
            misfit = screens.misfit_of(measured, moved)
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
        rows = len(self.rows)
        found = shifted(np.arange(rows), rows, nominal_fit(measured, T_base_ee))
        if found is not None:
            refuse_shifted(found, self.file.path, self.rows.line, "as they stand", "")

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

    def _logged(self, q_rad: Array) -> Array:
        """Return joint positions (N, n) as they were logged: degrees, or millimetres."""
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
