"""Rows of an instrument that touches nothing, read to single readings and screened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates, loads_as_named
from pa10cal.arrays import Array, Index
from pa10cal.campaign import screens
from pa10cal.campaign.bounds import only_labelled_rows, outside_bounds, unwrapped, within_bounds
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.instrument_motion import (
    base_columns,
    base_target_names,
    base_targets,
    is_base_column,
    refuse_base_targets,
    without_instrument_motion,
)
from pa10cal.campaign.joint_conventions import arm_of_log, without_turns
from pa10cal.campaign.joint_positions import (
    in_radians,
    position_columns,
    with_labels,
)
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    Exclusions,
    Ingested,
    Quarantined,
    RawRows,
    configurations,
    quarantined,
)
from pa10cal.campaign.reading_noise import Uncertainty, Unstated, with_noise_shown
from pa10cal.campaign.rounded_joints import (
    axes_in_counts,
    axes_in_steps,
    notes_on_counts,
    uncertainty_of,
    warnings_of_possible_steps,
    warnings_of_steps,
    with_rounding,
)
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.campaign.stands import StandsAveraged, with_stands_averaged
from pa10cal.campaign.tracked_screens import Screen
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.errors import CalibrationError
from pa10cal.frame.point_fits import cross_matrix
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.pose import u_of_attitude
from pa10cal.observe.quantities import RawColumns
from pa10cal.options import IngestOptions

NO_TORQUES = "no torques logged, masses unknown: those of assumed weights are used"
THOSE_OF_MASSES = "no torques logged: those of the described masses are used"
NO_GRAVITY = "no torques logged, gravity not stated: no springs are fitted"


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
        else TwoLogs.of(description, folder, arm, options)
    )
    base_names = base_target_names(file.names)
    refuse_base_targets(description, file.path, file.words, base_names)
    columns = description.instrument.type.raw_columns(
        [name for name in file.names if not is_base_column(name)]
    )
    exclusions = exclusions_of(description, folder)
    read = _read_rows(file, columns, base_names, description, arm)
    raw = _usable_rows(read, file, columns, base_names, description, arm, exclusions)
    counts_per_turn, steps = axes_in_counts(raw, arm), axes_in_steps(raw, arm)
    readings = _as_readings(raw, columns, base_names, description, arm, counts_per_turn)
    unstated = _unstated(raw, columns, description)
    once, again = _first_of_each_configuration(raw, readings, arm)
    logged_count = len(once) + _configurations_lost(read, raw)
    listed = [*raw.quarantined, *again]
    del read
    raw = replace(raw, columns={})  # the readings hold them

    def refuse_too_many_lost(left: int) -> None:
        refuse_too_many(listed, raw.totals, options.max_quarantined_fraction, file.words, left)

    refuse_too_many_lost(len(once))
    screen = Screen(columns, arm, file, raw.line[once], readings.take(once), listed)
    screen.run()
    off = screens.off_command(screen.found.pose, screen.found.states.q_rad, arm.prismatic)
    screen.quarantine(off, screens.OTHER_COMMAND, screen.found.pose[off])
    refuse_too_many_lost(len(screen.found))
    corrected = without_instrument_motion(screen.found, str(file.path), screen.T_base_ee)
    beside_counts = {axis: steps[axis] for axis in steps.keys() - counts_per_turn.keys()}
    payload = description.payload(arm)
    rounding = with_rounding(corrected.readings, beside_counts, arm, payload)
    readings = rounding.readings
    chain, own = Chain.of(arm), readings.measured.stated_covariance
    uncertain = _uncertain_as_joints(readings, chain)
    noise = with_noise_shown(
        readings,
        unstated,
        Uncertainty(description.stated.uncertainty_m, u_of_attitude(description.stated)),
        chain,
        payload,
        uncertain.measured.stated_covariance - own,
    )
    unchanged = noise.readings is readings
    readings = uncertain if unchanged else _uncertain_as_joints(noise.readings, chain)
    averaged = with_stands_averaged(readings)
    listed += _left_out_of_stands(averaged, readings, raw.file, screen.line)
    refuse_too_many_lost(len(averaged.readings))
    instrument_notes = description.instrument.type.raw_notes(columns, description.stated)
    notes = [
        *raw.notes,
        *notes_on_counts(counts_per_turn),
        *instrument_notes,
        *corrected.notes,
        *noise.notes,
    ]
    torques = notes_on_torques(readings.states, arm, gravity=any(description.gravity_m_s2))
    notes += [*torques, *_notes_on_temperatures(readings.states), *averaged.notes]
    warnings = [
        *raw.warnings,
        *screens.count_warnings(description.configurations, logged_count, raw.file),
        *screen.warnings,
        *corrected.warnings,
        *warnings_of_steps(rounding.steps, rounding.times),
        *warnings_of_possible_steps(rounding.possible),
        *file.words.contradicted_units(raw.file),
    ]
    absent = sorted(set(description.tool.balls_mm) - set(readings.measured.target_names))
    unplaced = sorted(set(readings.measured.target_names) - set(description.tool.balls_mm))
    if absent and unplaced:
        warnings.append(
            f"campaign.yaml: tool.balls_mm states {', '.join(absent)}, and the columns are of "
            f"{', '.join(unplaced)}: if these are the same targets, rename them in tool.balls_mm "
            "or in the columns"
        )
    timed = "time_s" in file.names
    return Ingested(averaged.readings, tuple(listed), tuple(notes), tuple(warnings), timed)


def _unstated(raw: RawRows, measured: RawColumns, description: CampaignDescription) -> Unstated:
    """Return what is not stated of the uncertainty of readings along the axes of an instrument."""
    u = raw.numbers_of([f"u_{name}" for name in measured.names])
    of_turns = np.isin(measured.names, measured.others)
    turns_stated = description.stated.attitude_rad is not None
    return Unstated(
        places=bool(np.isnan(u[:, ~of_turns]).all()),
        turns=bool(np.isnan(u[:, of_turns]).all()) and not turns_stated,
    )


def _left_out_of_stands(
    averaged: StandsAveraged, readings: Observations, file: str, line: NDArray[np.int64]
) -> list[Quarantined]:
    """List the readings (P,), of lines of a file, that are in no mean of their stand."""
    left_out: list[Quarantined] = []
    for reason in (screens.OFF_STAND, screens.STAND_DISAGREES):
        rows = averaged.why_left_out == reason
        values = [f"{1e3 * off_m:.3g} mm off the median" for off_m in averaged.off_m[rows]]
        where = configurations(readings.take(rows))
        left_out += quarantined(file, line[rows], reason, values, where)
    return left_out


def _optional_columns(measured: RawColumns, base_names: tuple[str, ...], arm: Arm) -> list[str]:
    """Return the columns, beside `kind` and torques, that a file may lack."""
    q = position_columns(arm.axes_slide)
    lengths = [*measured.names, *base_columns(base_names)]
    return ["temperature_C", *(f"u_{name}" for name in (*q, *_torque_columns(q), *lengths))]


def _read_rows(
    file: RawFile | TwoLogs,
    measured: RawColumns,
    base_names: tuple[str, ...],
    description: CampaignDescription,
    arm: Arm,
) -> RawRows:
    """Read the rows of a file; `measured` are the columns of what was measured of the arm."""
    q = position_columns(arm.axes_slide)
    labelling = ["pose", "load_N", "repeat", *(["kind"] if description.holdout is None else [])]
    required = ["time_s", *labelling, *q, *measured.names, *base_columns(base_names)]
    optional = _optional_columns(measured, base_names, arm)
    return file.read(required, ["kind", *optional], _torque_columns(q))


def _usable_rows(
    raw: RawRows,
    file: RawFile | TwoLogs,
    measured: RawColumns,
    base_names: tuple[str, ...],
    description: CampaignDescription,
    arm: Arm,
    exclusions: Exclusions,
) -> RawRows:
    """Return the rows of a file in order of time; those that cannot be used are quarantined.

    `measured` are the columns of what was measured of the arm.
    """
    instrument, on_base = description.instrument.type, base_columns(base_names)
    q = position_columns(arm.axes_slide)
    tau = _torque_columns(q)
    lengths = [*measured.names, *on_base]
    optional = _optional_columns(measured, base_names, arm)
    # Before rows are judged, so that one that is excluded cannot be quarantined for something else.
    raw = exclusions.without(raw)
    if "kind" not in raw.columns:
        raw = raw.with_columns({"kind": np.full(len(raw), "grid", dtype=object)})
    raw = raw.choices("kind", KINDS)
    logged = [name for name in tau if name in raw.columns]
    given = [name for name in optional if name in raw.columns]
    raw = raw.finite(["time_s", "load_N", *q, *logged])
    raw = raw.finite(measured.names, may_be_blank=measured.may_be_blank)
    raw = raw.finite([*on_base, *given], may_be_blank=True)
    raw = unwrapped(raw, q, arm)
    other_bounded = ["time_s", *logged, *lengths, *given]
    arm_in_limits = arm
    if outside_bounds(raw, q, arm).any():
        raw, arm_in_limits = _within_limits(raw, q, other_bounded, description, measured, arm)
    raw = within_bounds(raw, ["time_s", *q, *logged, *lengths, *given], arm_in_limits)
    remaining = np.ones(len(raw), dtype=bool)
    for off in instrument.unusable(measured, raw.numbers_of(measured.names)):
        shown = list(map(file.words.text, off.values))
        raw = raw.take(~off.rows[remaining], off.reason, shown)
        remaining &= ~off.rows
    raw = exclusions.without(with_labels(raw, q, description.repeat_tolerance_deg))
    exclusions.refuse_missed(raw.file)
    return only_labelled_rows(raw, arm).in_time()


def _first_of_each_configuration(
    raw: RawRows, readings: Observations, arm: Arm
) -> tuple[Index, tuple[Quarantined, ...]]:
    """Return the rows (C,) that are the first of their configuration, and list the others."""
    configuration = raw.configurations
    first = np.unique(configuration, return_index=True)[1]
    again = np.ones(len(raw), dtype=bool)
    again[first] = False
    q_rad = readings.states.q_rad
    elsewhere = again & screens.not_one_command(q_rad, q_rad[first[configuration]], arm.prismatic)
    return np.flatnonzero(~again), (
        *quarantined(raw.file, raw.line[again & ~elsewhere], screens.READ_BEFORE),
        *quarantined(raw.file, raw.line[elsewhere], screens.ONE_LABEL, readings.pose[elsewhere]),
    )


def _configurations_lost(read: RawRows, usable: RawRows) -> int:
    """Return how many configurations of the readings' file have no usable row.

    A row without readable labels counts as one of its own, and an exact repeat as none.
    """
    lost = {
        row.line for row in usable.quarantined if row.file == usable.file and row.reason != REPEATED
    }
    names = [name for name in ("kind", "pose", "repeat") if name in read.columns]
    if not {"pose", "repeat"} <= set(names):
        return len(lost)

    def labels(raw: RawRows) -> list[tuple[object, ...]]:
        columns = [raw[name].tolist() for name in names]
        return list(zip(loads_as_named(raw["load_N"]).tolist(), *columns, strict=True))

    labelled_rows = read.at(np.flatnonzero(np.isin(read.line, list(lost))))
    unlabelled_count = len(lost) - len(labelled_rows)
    return unlabelled_count + len(set(labels(labelled_rows)) - set(labels(usable)))


def _torque_columns(q: Sequence[str]) -> list[str]:
    """Return the columns of torques of axes whose positions are in the columns `q`."""
    return [f"tau{axis}_Nm" for axis in range(1, len(q) + 1)]


def _as_readings(
    raw: RawRows,
    measured: RawColumns,
    base_names: tuple[str, ...],
    description: CampaignDescription,
    arm: Arm,
    counts_per_turn: Mapping[int, float],
) -> Observations:
    """Return rows as readings; nan where nothing was logged, 0 for arrivals that are not known.

    `base_names` are the targets on the base. `counts_per_turn` of an axis, from 0, makes its
    positions as uncertain as their rounding.
    """
    instrument, stated, coupling = description.instrument.type, description.stated, arm.coupling
    q, on_base = position_columns(arm.axes_slide), base_columns(base_names)
    tau = _torque_columns(q)

    def uncertainties(names: Sequence[str]) -> Array:
        return raw.numbers_of([f"u_{name}" for name in names])

    arrivals = [f"arrival{joint}" for joint in range(1, arm.n + 1)]
    states = PoseStates(
        q_rad=coupling.to_joints(in_radians(raw.numbers_of(q), arm.axes_slide)),
        tau_Nm=coupling.beside_joints(raw.numbers_of(tau)),
        arrival=np.nan_to_num(raw.numbers_of(arrivals)),
        load_N=raw["load_N"],
        temperature_C=raw.numbers_of(["temperature_C"])[:, 0],
        time_s=raw["time_s"],
    )
    u_q = uncertainties(q)
    rounded = np.zeros_like(u_q)
    for axis, counts in counts_per_turn.items():
        u_q[:, axis] = rounded[:, axis] = uncertainty_of(360.0 / counts)
    log = JointLog(
        coupling.uncertainty(in_radians(u_q, arm.axes_slide)),
        coupling.beside_joints(uncertainties(tau)),
        np.nan_to_num(raw.numbers_of(["dwell_samples"])[:, 0]).astype(np.int64),
        coupling.uncertainty(in_radians(rounded, arm.axes_slide)) if counts_per_turn else None,
    )
    values, u = raw.numbers_of(measured.names), uncertainties(measured.names)
    u_base, u_m = uncertainties(on_base), stated.uncertainty_m
    return Observations(
        pose=raw.text_of("pose"),
        states=states,
        measured=instrument.from_raw(measured, values, u, stated),
        kind=raw.text_of("kind"),
        repeat=raw["repeat"],
        readings=np.ones(len(raw), dtype=np.int64),
        log=log,
        base=base_targets(base_names, raw.numbers_of(on_base), u_base, u_m),
    )


def notes_on_torques(states: PoseStates, arm: Arm, *, gravity: bool = True) -> list[str]:
    """Return a note where the torques of readings are not those of a log.

    Args:
        gravity: whether it is stated, so that torques can be calculated.
    """
    logged = np.isfinite(states.tau_Nm)
    if not logged.any() and not gravity:
        return [NO_GRAVITY]
    if not logged.any():
        return [NO_TORQUES if arm.mass_kg is None else THOSE_OF_MASSES]
    followers = sorted({c.joint for c in arm.coupled if c.follows})
    if not followers:
        return []
    joints = ", ".join(f"joint {joint}" for joint in followers)
    return [f"logged torques are not used: there is none of {joints} (follows: true)"]


def _notes_on_temperatures(states: PoseStates) -> list[str]:
    """Return a note where some of the readings lack a temperature."""
    blank = np.isnan(states.temperature_C)
    if blank.all() or not blank.any():
        return []
    return [f"temperature_C is blank in {blank.sum()} of {len(blank)} rows"]


def _uncertain_as_joints(found: Observations, chain: Chain) -> Observations:
    """Return readings as uncertain as stated uncertainties of the joint positions make the end.

    The nominal arm says how: it is right enough for a covariance. Readings stay as they are where
    it does not show where the instrument is.
    """
    u = np.zeros((0, 0)) if found.log is None else found.log.q_u_stated
    if not u.any():
        return found
    end = chain.forward_with_screws(found.states.q_rad)
    try:
        located = found.measured.locate(end.T, roughly=True)
    except CalibrationError:
        return found
    R, places_m = located.T_instr_base[:3, :3], located.targets(end.T)[..., :3, 3]
    moved = end.screws[:, :, chain.joint_columns] * u[:, None, :]
    shift, turn = R @ moved[:, :3], R @ moved[:, 3:]
    end_m = (located.T_instr_base @ end.T)[:, :3, 3]
    about_origin = np.concatenate([shift + cross_matrix(end_m) @ turn, turn], axis=1)
    motion_cov = about_origin @ about_origin.swapaxes(1, 2)
    return replace(found, measured=found.measured.with_end_uncertain(motion_cov, places_m))


def _within_limits(
    raw: RawRows,
    q: Sequence[str],
    other_bounded: Sequence[str],
    description: CampaignDescription,
    measured: RawColumns,
    arm: Arm,
) -> tuple[RawRows, Arm]:
    """Return rows, and the arm whose limits they obey, of a log with joints beyond the limits.

    The joints are columns `q`; rows with other columns out of bounds are not used to decide.
    """
    instrument = description.instrument.type
    values = raw.numbers_of(measured.names)
    usable = ~outside_bounds(raw, other_bounded, arm)
    for off in instrument.unusable(measured, values):
        usable &= ~off.rows
    unknown_u = np.full(values[usable].shape, np.nan)
    seen = instrument.from_raw(measured, values[usable], unknown_u, description.stated)
    rows = np.flatnonzero(usable)
    raw = without_turns(raw, q, arm, rows, seen)
    if outside_bounds(raw, q, arm).any():
        return raw, arm_of_log(raw.at(rows), q, arm, seen)
    return raw, arm
