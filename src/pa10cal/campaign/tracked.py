"""Rows of an instrument that touches nothing: screened, and refused where a unit is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.campaign import screens
from pa10cal.campaign.base_motion import (
    base_columns,
    base_target_names,
    base_targets,
    refuse_base_targets,
    steadied,
)
from pa10cal.campaign.bounds import Bounds, labelled, within_bounds
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.own_words import refuse_too_many
from pa10cal.campaign.raw_file import RawFile
from pa10cal.campaign.raw_rows import (
    Exclusions,
    Ingested,
    RawRows,
    in_radians,
    position_columns,
    quarantined,
    with_labels,
)
from pa10cal.campaign.two_logs import TwoLogs
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.quantities import RawColumns
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
        RawFile.of(description, folder, "poses", arm.prismatic)
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
    screen = screens.Screen(columns, arm, file, raw.line[once], found.take(once), listed)
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
