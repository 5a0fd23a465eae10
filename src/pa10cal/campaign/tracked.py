"""Rows of an instrument that touches nothing: screened, and refused where a unit is wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.campaign import labels, screens
from pa10cal.campaign.base_motion import (
    base_columns,
    base_target_names,
    base_targets,
    refuse_base_targets,
    steadied,
)
from pa10cal.campaign.bounds import Bounds, labelled, within_bounds
from pa10cal.campaign.conventions import STILL_WRONG, OtherAxes, other_axes
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.own_words import UNIT_WORDS, refuse_too_many
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    Exclusions,
    Ingested,
    Quarantined,
    RawRows,
    configurations,
    in_radians,
    position_columns,
    quarantined,
    with_labels,
)
from pa10cal.campaign.shifted_rows import nominal_fit, refuse_shifted, shifted, steps_agree
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import KINDS, JointLog, Observations
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
    raw, found, columns = _read_poses(file, description, arm, exclusions_of(description, folder))
    # Rows that cannot be read are of some configuration too, but for exact repeats.
    unread = sum(row.reason != REPEATED for row in raw.quarantined)
    of_row = raw.configurations
    first = np.unique(of_row, return_index=True)[1]
    logged = len(first) + unread
    again = np.ones(len(raw), dtype=bool)
    again[first] = False
    other = again & screens.off_first(found.states.q_rad, of_row, first, arm.prismatic)
    once = np.flatnonzero(~again)
    listed = list(raw.quarantined)
    listed += quarantined(raw.file, raw.line[again & ~other], screens.READ_BEFORE)
    listed += quarantined(raw.file, raw.line[other], screens.ONE_LABEL, found.pose[other])

    def refuse_too_many_lost() -> None:
        refuse_too_many(listed, raw.totals, options.max_quarantined_fraction, file.words)

    refuse_too_many_lost()
    screen = _Screen(columns, arm, file, raw.line[once], found.take(once), listed)
    screen.run()
    off = screens.off_command(screen.found.pose, screen.found.states.q_rad, arm.prismatic)
    screen.leave_out(off, screens.OTHER_COMMAND, screen.found.pose[off])
    refuse_too_many_lost()
    found, moved, of_base = steadied(screen.found, str(file.path), screen.T_base_ee)
    instrument_notes = description.instrument.type.raw_notes(columns, description.stated)
    notes = [*raw.notes, *instrument_notes, *moved]
    if np.isnan(found.states.tau_Nm).all():
        notes.append(NO_TORQUES if arm.mass_kg is None else THOSE_OF_MASSES)
    warnings = (
        *screens.count_warnings(description.configurations, logged, raw.file),
        *screen.warnings,
        *of_base,
        *file.words.contradicted_units(raw.file),
        *_other_names(description, found.measured.target_names),
    )
    timed = "time_s" in file.names
    return Ingested(found, tuple(listed), tuple(notes), warnings, timed)


def _read_poses(
    file: RawFile | TwoLogs, description: CampaignDescription, arm: Arm, exclusions: Exclusions
) -> tuple[RawRows, Observations, RawColumns]:
    """Read the configurations of an instrument that touches nothing, in order of time.

    Returns:
        The rows; the same as readings: no approach (arrivals are 0) and no dwell, what was not
        logged is nan; and the columns that hold what was measured.
    """
    instrument, stated, bounds = description.instrument.type, description.stated, Bounds(arm)
    watched = base_target_names(file.names)
    refuse_base_targets(description, file.path, file.words, watched)
    on_base = base_columns(watched)
    measured = instrument.raw_columns([n for n in file.names if base_target_names([n]) == ()])
    q = position_columns(arm.prismatic)
    tau = [f"tau{joint}_Nm" for joint in range(1, arm.n + 1)]
    labelling = ["pose", "load_N", "repeat", *(["kind"] if description.holdout is None else [])]
    lengths = [*measured.names, *on_base]
    optional = ["temperature_C", *(f"u_{name}" for name in (*q, *tau, *lengths))]
    raw = file.read(["time_s", *labelling, *q, *lengths], ["kind", *optional], tau)
    raw = exclusions.lines(raw)
    if "kind" not in raw.columns:
        raw = raw.with_columns({"kind": np.full(len(raw), "grid", dtype=object)})
    raw = raw.choices("kind", KINDS)
    logged = [name for name in tau if name in raw.columns]
    given = [name for name in optional if name in raw.columns]
    raw = raw.finite(["time_s", "load_N", *q, *logged])
    raw = raw.finite(measured.names, may_be_blank=measured.may_be_blank)
    raw = raw.finite([*on_base], may_be_blank=True).finite(given, may_be_blank=True)
    raw = within_bounds(raw, ["time_s", *q, *logged, *lengths, *given], bounds)
    remaining = np.ones(len(raw), dtype=bool)
    for off in instrument.unusable(measured, raw.numbers_of(measured.names)):
        shown = list(map(file.words.text, off.values))
        raw = raw.take(~off.rows[remaining], off.reason, shown)
        remaining &= ~off.rows
    raw = exclusions.labels(with_labels(raw, q, description.repeat_tolerance_deg))
    raw = labelled(raw, bounds).in_time()

    def uncertain(names: Sequence[str]) -> Array:
        return raw.numbers_of([f"u_{name}" for name in names])

    states = PoseStates(
        q_rad=in_radians(raw.numbers_of(q), arm.prismatic),
        tau_Nm=raw.numbers_of(tau),
        # 0 where the file says nothing of it
        arrival=np.nan_to_num(raw.numbers_of([f"arrival{joint}" for joint in range(1, arm.n + 1)])),
        load_N=raw["load_N"],
        temperature_C=raw.numbers_of(["temperature_C"])[:, 0],
        time_s=raw["time_s"],
    )
    values, u = raw.numbers_of(measured.names), uncertain(measured.names)
    base = base_targets(watched, raw.numbers_of(on_base), uncertain(on_base), stated.uncertainty_m)
    samples = np.zeros(len(raw), dtype=np.int64)
    found = Observations(
        pose=raw.text_of("pose"),
        states=states,
        measured=instrument.from_raw(measured, values, u, stated),
        kind=raw.text_of("kind"),
        repeat=raw["repeat"],
        readings=samples + 1,
        log=JointLog(in_radians(uncertain(q), arm.prismatic), uncertain(tau), samples),
        base=base,
    )
    return raw, found, measured


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
            (found.states.time_s, logged),
            (found.states.time_s[seen], 1e3 * places_m[seen, best]),
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
