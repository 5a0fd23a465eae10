"""Rows of an instrument that touches nothing: read, refused where a unit is wrong, screened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.campaign import screens
from pa10cal.campaign.base_motion import (
    base_columns,
    base_target_names,
    base_targets,
    refuse_base_targets,
    steadied,
)
from pa10cal.campaign.bounds import labelled, outside_bounds, unwrapped, within_bounds
from pa10cal.campaign.conventions import STILL_WRONG, OtherAxes, other_axes, other_scale
from pa10cal.campaign.coupled_logs import Coupled, arm_of_log, coupling_that_fits, without_turns
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.nominal_fit import (
    EXCHANGED,
    NOT_RIGID,
    exchange_text,
    exchanged,
    misfit_of,
    nominal_fit,
    nominal_places,
    not_rigid,
    refuse_shifted,
    shifted,
    steps_agree,
)
from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    UNIT_WORDS,
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
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.quantities import Misfit, RawColumns
from pa10cal.options import IngestOptions

NO_TORQUES = "no torques logged, masses unknown: those of assumed weights are used"
THOSE_OF_MASSES = "no torques logged: those of the described masses are used"


def read_tracked(
    description: CampaignDescription, arm: Arm, folder: Path, options: IngestOptions
) -> Ingested:
    """Read a campaign of an instrument that gives one row a configuration.

    Raises:
        RawDataError: when the file, or too much of it, cannot be used.
    """
    file: RawFile | TwoLogs = (
        RawFile.of(description, folder, "poses", arm.axes_slide)
        if description.files.joints is None
        else TwoLogs.of(description, folder, arm, options.still_speed_deg_s)
    )
    raw, found, columns = _read_poses(file, description, arm, exclusions_of(description, folder))
    # Rows that cannot be read are of some configuration too, but for exact repeats.
    unread = sum(row.reason != REPEATED for row in raw.quarantined)
    of_row = raw.configurations
    first = np.unique(of_row, return_index=True)[1]
    raw = replace(raw, columns={})  # the readings have them
    logged = len(first) + unread
    again = np.ones(len(raw), dtype=bool)
    again[first] = False
    q_rad = found.states.q_rad
    other = again & screens.not_one_command(q_rad, q_rad[first[of_row]], arm.prismatic)
    once = np.flatnonzero(~again)
    listed = list(raw.quarantined)
    listed += quarantined(raw.file, raw.line[again & ~other], screens.READ_BEFORE)
    listed += quarantined(raw.file, raw.line[other], screens.ONE_LABEL, found.pose[other])

    def refuse_too_many_lost() -> None:
        refuse_too_many(listed, raw.totals, options.max_quarantined_fraction, file.words)

    refuse_too_many_lost()
    screen = Screen(columns, arm, file, raw.line[once], found.take(once), listed)
    screen.run()
    off = screens.off_command(screen.found.pose, screen.found.states.q_rad, arm.prismatic)
    screen.quarantine(off, screens.OTHER_COMMAND, screen.found.pose[off])
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
    )
    absent = sorted(set(description.tool.balls_mm) - set(found.measured.target_names))
    unplaced = sorted(set(found.measured.target_names) - set(description.tool.balls_mm))
    if absent and unplaced:
        names = (
            f"campaign.yaml: tool.balls_mm states {', '.join(absent)}, and the columns are of "
            f"{', '.join(unplaced)}: if these are the same targets, rename them in tool.balls_mm "
            "or in the columns"
        )
        warnings = (*warnings, names)
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
    instrument, stated = description.instrument.type, description.stated
    watched = base_target_names(file.names)
    refuse_base_targets(description, file.path, file.words, watched)
    on_base = base_columns(watched)
    measured = instrument.raw_columns([n for n in file.names if base_target_names([n]) == ()])
    q, coupling = position_columns(arm.axes_slide), arm.coupling
    tau = [f"tau{axis}_Nm" for axis in range(1, len(q) + 1)]
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
    raw = unwrapped(raw, q, arm)
    bounded = ["time_s", *q, *logged, *lengths, *given]
    of_log = arm
    if outside_bounds(raw, q, arm).any():
        values = raw.numbers_of(measured.names)
        usable = ~outside_bounds(raw, [name for name in bounded if name not in q], arm)
        for off in instrument.unusable(measured, values):
            usable &= ~off.rows
        unknown = np.full(values[usable].shape, np.nan)
        seen = instrument.from_raw(measured, values[usable], unknown, stated)
        raw = without_turns(raw, q, arm, np.flatnonzero(usable), seen)
        if outside_bounds(raw, q, arm).any():
            of_log = arm_of_log(raw.at(np.flatnonzero(usable)), q, arm, seen)
    raw = within_bounds(raw, bounded, of_log)
    remaining = np.ones(len(raw), dtype=bool)
    for off in instrument.unusable(measured, raw.numbers_of(measured.names)):
        shown = list(map(file.words.text, off.values))
        raw = raw.take(~off.rows[remaining], off.reason, shown)
        remaining &= ~off.rows
    raw = exclusions.labels(with_labels(raw, q, description.repeat_tolerance_deg))
    raw = labelled(raw, arm).in_time()

    def uncertain(names: Sequence[str]) -> Array:
        return raw.numbers_of([f"u_{name}" for name in names])

    states = PoseStates(
        q_rad=coupling.to_joints(in_radians(raw.numbers_of(q), arm.axes_slide)),
        tau_Nm=coupling.beside_joints(raw.numbers_of(tau)),
        # 0 where the file says nothing of it
        arrival=np.nan_to_num(raw.numbers_of([f"arrival{joint}" for joint in range(1, arm.n + 1)])),
        load_N=raw["load_N"],
        temperature_C=raw.numbers_of(["temperature_C"])[:, 0],
        time_s=raw["time_s"],
    )
    values, u = raw.numbers_of(measured.names), uncertain(measured.names)
    base = base_targets(watched, raw.numbers_of(on_base), uncertain(on_base), stated.uncertainty_m)
    # 0 where there is no log of the joints
    samples = np.nan_to_num(raw.numbers_of(["dwell_samples"])[:, 0]).astype(np.int64)
    found = Observations(
        pose=raw.text_of("pose"),
        states=states,
        measured=instrument.from_raw(measured, values, u, stated),
        kind=raw.text_of("kind"),
        repeat=raw["repeat"],
        readings=np.ones(len(raw), dtype=np.int64),
        log=JointLog(
            coupling.uncertainty(in_radians(uncertain(q), arm.axes_slide)),
            coupling.beside_joints(uncertain(tau)),
            samples,
        ),
        base=base,
    )
    return raw, found, measured


# Readings that cannot be of their pose, and units, axes and labels that cannot be right.

#: The nominal model fitted in another unit of joint positions must be this much nearer to count,
#: and as logged be further off than this.
BETTER = 5.0
BAD_M = 2e-3
#: Rows that show another unit than the others have, at least.
LEAST_OTHER_UNIT = 3
#: Logged positions of prismatic joints that never exceed the longest stroke in metres may be in
#: metres.
LONGEST_STROKE_M = 10.0
#: Median misfits of the nominal model, fitted, that are worth a warning.
WARN_MM = 50.0
WARN_DEG = 10.0
#: Orientations that differ by less are one orientation, and a flange that turns by more has
#: several. Three turns in radians, read as degrees, turn by no more; and by so much less than the
#: flange.
RADIANS_RAD = np.radians(3.0 * 2.0 * np.pi)
LIKE_RADIANS = 8.0
ONE_ATTITUDE_RAD = 1e-5
TURNED_RAD = np.radians(5.0)


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

        def reach(p_m: Array, _: Mask) -> Mask:
            return screens.out_of_reach(p_m, self.arm)

        def repeats(p_m: Array, seen: Mask) -> Mask:
            return screens.off_repeats(p_m, self.found.pose[seen], self.found.states.load_N[seen])

        if (far := self._by_target(reach)).any():
            misfit = misfit_of(self.found.measured, self.T_base_ee)
            # One factor puts all of them right.
            if misfit is None or other_scale(self.found.measured, self.T_base_ee, misfit) is None:
                self._quarantine_targets(far, screens.OUT_OF_REACH)
        self._refuse_units()
        self._quarantine_targets(self._held_last(), screens.HELD)
        self._quarantine_exchanged()
        self._quarantine_targets(self._by_target(repeats), screens.OFF_REPEATS)
        misfit = misfit_of(self.found.measured, self.T_base_ee)
        if misfit is not None:
            self._look_at_poor_fit(misfit)
            held_out = self.found.kind == "holdout"
            off = screens.off_model(misfit, held_out)
            if off.any() and self._coupled is not None:  # these rows are right
                off &= screens.off_model(self._coupled[1], held_out)
            self._quarantine_targets(off, screens.OFF_MODEL)
        self._quarantine_targets(not_rigid(self.found.measured.places_m), NOT_RIGID)

    @cached_property
    def _coupled(self) -> tuple[Coupled, Misfit] | None:
        """Return the coupling of joints with which the nominal arm fits all rows; None for none."""
        axes = self.arm.coupling.to_axes(self.found.states.q_rad)
        return coupling_that_fits(self.arm, axes, self.found.measured)

    def quarantine(self, off: Mask, reason: str, values: Iterable[object]) -> None:
        """Quarantine rows (N,), with what was found in each."""
        where = configurations(self.found.take(off))
        file = self.file.path.name
        self.quarantined += quarantined(file, self.line[off], reason, values, where)
        self.line, self.found = self.line[~off], self.found.take(~off)

    def _by_target(self, judge: Callable[[Array, Mask], Mask]) -> Mask:
        """Judge the targets one by one, by where each was measured: (N, B)."""
        places_m = self.found.measured.places_m
        judged = np.zeros(places_m.shape[:2], dtype=bool)
        for b in range(places_m.shape[1]):
            seen = np.isfinite(places_m[:, b, 0])
            judged[seen, b] = judge(places_m[seen, b], seen)
        return judged

    def _quarantine_targets(self, off: Mask, reason: str) -> None:
        """Quarantine rows with a target (N, B) that is off, naming the first of them."""
        lost, first = np.asarray(off.any(axis=1)), off.argmax(axis=1)
        values = []
        for row in np.flatnonzero(lost):
            place_mm = 1e3 * self.found.measured.places_m[row, first[row]]
            numbers = ", ".join(f"{value:g}" for value in place_mm)
            values.append(f"{self._target(int(first[row]))} = {numbers}")
        self.quarantine(lost, reason, values)

    def _held_last(self) -> Mask:
        """Return the targets (N, B) of which the instrument gave the reading before again."""
        places_m = self.found.measured.places_m
        if not (places_m[1:] == places_m[:-1]).all(axis=2).any():
            return np.zeros(places_m.shape[:2], dtype=bool)
        # A target about which the arm turned stayed where it was.
        modelled = nominal_places(self.T_base_ee, places_m) if places_m.shape[2] == 3 else None
        if modelled is None:
            modelled = np.repeat(self.T_base_ee[:, None, :3, 3], places_m.shape[1], axis=1)
        elif 1e3 * np.nanmedian(np.linalg.norm(places_m - modelled, axis=2)) > WARN_MM:
            # An arm that is described so far off says nothing of where targets went.
            return np.zeros(places_m.shape[:2], dtype=bool)
        return screens.held_last(places_m, modelled)

    def _quarantine_exchanged(self) -> None:
        """Quarantine rows whose targets are exchanged; refuse columns that are, in most rows."""
        names, places_m = self.found.measured.target_names, self.found.measured.places_m
        modelled = nominal_places(self.T_base_ee, places_m) if len(names) > 1 else None
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
        """Return the target that most rows have, and which these are."""
        seen = np.isfinite(self.found.measured.places_m[..., 0])
        best = int(seen.sum(axis=0).argmax())
        return best, seen[:, best]

    def _refuse_units(self) -> None:
        """Stop when orientations, lengths or joint positions are in another unit."""
        measured, T_base_ee, words = self.found.measured, self.T_base_ee, self.file.words
        self._refuse_one_orientation(measured.attitudes, T_base_ee)
        best, seen = self._most_seen()
        places_m, column = measured.places_m, self.columns.targets[best][0]
        what = "distances" if places_m.shape[2] == 1 else "positions"
        where, scale = f"{self.file.path}: {self._target(best)}", measured.scale(T_base_ee)
        slides, coupling = self.arm.axes_slide, self.arm.coupling
        q_rad = coupling.to_axes(self.found.states.q_rad)
        q = np.where(slides, 1e3 * q_rad, np.degrees(q_rad))  # as logged
        radians = screens.may_be_radians(q, self.arm)
        if not radians:  # of joints that may be in radians the scale says nothing yet
            screens.refuse_wrong_length_unit(scale, what, where, column, words)
        names = position_columns(slides)
        where_joints = f"{self.file.path}: {words.column(names[0])} … {words.column(names[-1])}"
        time_s = self.found.states.time_s
        places = time_s[seen], 1e3 * places_m[seen, best]
        screens.refuse_wrong_angle_unit((time_s, q), places, self.arm, 0.0, where_joints, words)
        tried = []
        every = np.ones((len(q), 1), dtype=bool)
        small = np.array([screens.may_be_radians(row[None], self.arm) for row in q])[:, None]
        if small.sum() >= LEAST_OTHER_UNIT:
            tried.append(("angles", "rad", "deg", small, np.where(slides, 1.0, np.degrees(1.0))))
        if slides.any() and np.abs(q[:, slides]).max() <= LONGEST_STROKE_M:
            tried.append(("strokes", "m", "mm", every, np.where(slides, 1e3, 1.0)))
        logged = misfit_of(measured, T_base_ee) if tried else None
        # As logged the poses may not even say where the instrument stands.
        logged_m = np.inf if logged is None else float(np.median(logged.size_m))
        for quantity, unit, right_unit, of, factor in tried if logged_m > BAD_M else ():
            axes = in_radians(np.where(of, factor, 1.0) * q, slides)
            moved = Chain.of(self.arm).forward(coupling.to_joints(axes))
            misfit = misfit_of(measured, moved)
            misfit_m = np.inf if misfit is None else float(np.median(misfit.size_m))
            if misfit_m <= (BAD_M if logged is None else logged_m / BETTER):
                named, right = UNIT_WORDS[unit], UNIT_WORDS[right_unit]
                value = (
                    f"a median misfit of the nominal model of {1e3 * logged_m:.0f} mm, and of "
                    f"{1e3 * misfit_m:.0f} mm with {named}"
                )
                if logged is None:
                    value = f"no fit as logged, a misfit of {1e3 * misfit_m:.0f} mm with {named}"
                first = next(name for name in names if name.endswith(f"_{right_unit}"))
                what, remedy = f"the joint {quantity} look like", words.set_unit(first, unit, right)
                if not of.all():
                    what = f"in {of.sum()} of {len(of)} rows {what}"
                    where_joints = where_joints.replace(":", f":{self.line[of.argmax()]}:", 1)
                    remedy = "convert these rows to the unit of the others"
                raise RawDataError(
                    f"{what} {named}",
                    where=where_joints,
                    value=value,
                    allowed=f"joint {quantity} in {right}",
                    remedy=remedy,
                )
        screens.refuse_wrong_length_unit(scale, what, where, column, words)

    def _refuse_one_orientation(self, R: Array | None, T_base_ee: Array) -> None:
        """Stop when all orientations are the same, or nearly, though the arm turned its flange."""
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
            remedy = words.set_unit("qw", "rad", "degrees")
            raise RawDataError(
                "the angles of the orientations look like radians",
                where=where,
                value=f"{within} as degrees, {flange}",
                allowed="angles in the unit that columns states: deg",
                remedy=remedy,
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
        """Look for a cause where the nominal model is far from most of what was measured.

        Readings a row away from their joints, and exchanged or mirrored axes of the instrument, are
        refused; axes that explain a part, and joints whose column has the same number in all rows,
        are warned of.
        """
        length_mm = 1e3 * float(np.nanmedian(misfit.length_m))
        turn_deg = float(np.degrees(np.median(misfit.turn_rad)))
        measured = self.found.measured
        at = measured.position_columns
        variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)[:, at]
        seen_variance = variance[measured.components_seen[:, at]]
        stated_mm = 1e3 * float(np.sqrt(min(len(at), 3) * np.median(seen_variance)))
        off = [f"{length_mm:.0f} mm"] if length_mm > max(WARN_MM, 2.0 * stated_mm) else []
        off += [f"{turn_deg:.0f} deg"] if turn_deg > WARN_DEG else []
        if not off:
            return
        path, words, T_base_ee = self.file.path, self.file.words, self.T_base_ee
        best, seen = self._most_seen()
        warnings = [
            f"the nominal model, base and target fitted, is {' and '.join(off)} off in the median: "
            "check robot, and order, signs and zeros of the joints and of the quaternion"
        ]
        if measured.places_m.shape[2] == 3:
            p_m, rows = measured.places_m[:, best], np.arange(len(self.line))
            if steps_agree(T_base_ee, p_m):
                shift = shifted(rows, len(rows), nominal_fit(measured, T_base_ee))
                if shift is not None:
                    refuse_shifted(shift, path, self.line, "as they stand", "")
            R = None if measured.attitudes is None else measured.attitudes[seen]
            axes = other_axes(T_base_ee[seen], p_m[seen], R)
            if axes is not None:
                value = (
                    f"the nominal arm, base and target fitted, is {1e3 * axes.left_m:.0f} mm off, "
                    f"and {1e3 * axes.would_leave_m:.2g} mm with these axes"
                )
                if axes.puts_right:
                    remedy = self._remedy_of_axes(axes, self.columns.targets[best])
                    where = f"{path}: {self._target(best)}"
                    raise RawDataError(
                        f"the instrument's axes are {axes.name}",
                        where=where,
                        value=value,
                        allowed="positions in a right-handed frame, orientations in the same",
                        remedy=remedy,
                    )
                warnings.append(f"if the instrument's axes are {axes.name}: {value}, {STILL_WRONG}")
        if self._coupled is not None:
            coupled, fits = self._coupled
            in_words = coupling_in_words(replace(self.arm, coupled=coupled)) or "each is counted"
            warnings = [
                f"the nominal model, base and target fitted, is {' and '.join(off)} off in the "
                f"median, and {1e3 * float(np.median(fits.size_m)):.2g} mm if joints move together "
                f"({in_words}): {set_coupling(coupled, self.arm)}"
            ]
        elif (scale := other_scale(measured, T_base_ee, misfit)) is not None:
            times, left_m = scale
            warnings = [
                f"the nominal model, base and target fitted, is {' and '.join(off)} off in the "
                f"median, and {1e3 * left_m:.2g} mm if lengths are divided by {times:.3g}: check "
                "the size of the tag or target as the instrument holds it, and their unit"
            ]
        names = position_columns(self.arm.axes_slide)
        logged = self.arm.coupling.to_axes(self.found.states.q_rad)
        for k in np.flatnonzero(np.ptp(logged, axis=0) == 0.0):
            warnings.append(
                f"{path.name}: {words.column(names[k])}: the same number in all rows: if that "
                "joint moved, export what was logged of it"
            )
        self.warnings = tuple(warnings)

    def _remedy_of_axes(self, axes: OtherAxes, names: Sequence[str]) -> str:
        """Return what to state, or to change in the file, for other axes of the instrument."""
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
        """Return the columns of a target."""
        return self.file.words.text(", ".join(self.columns.targets[b]))
