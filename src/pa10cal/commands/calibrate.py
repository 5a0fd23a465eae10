"""Command `calibrate`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.calibration.options import CalibrationOptions

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm
    from pa10cal.campaign.description import CampaignDescription
    from pa10cal.observe.observations import Observations
    from pa10cal.results.calibration import CalibrationRecord

#: Load case of the general model beside the paper's: all loads together.
GENERAL = "general"


def calibrate(
    *,
    campaign_dir: Path,
    poses: Path,
    base_frame: Path,
    out: Path,
    load: str | None = None,
    settings: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Calibrate the arm, at every load and at all together, by the paper's model or the general.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        base_frame: base frame that the command seed wrote (.json).
        out: folder for the calibrations, or with --load the calibration to write (.json).
        load: one load case alone: a load such as 44N; combined; or general.
        settings: section calibration.
    """
    from pa10cal.calibration.load_case import load_cases
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import read_observations
    from pa10cal.errors import CalibrationError
    from pa10cal.files.arms import load_arm
    from pa10cal.planning.campaign import takes_general_model
    from pa10cal.results.codec import write

    campaign = read_description(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    every = read_observations(poses, campaign)
    general = takes_general_model(settings.model, campaign.instrument.kind)
    beside = () if general else (GENERAL,)
    cases = (load,) if load else load_cases(every.of_kind("grid").states.load_N) + beside
    records = {}
    for case in cases:
        work = _by_general_model if general or case == GENERAL else _by_papers_model
        try:
            records[case] = work(campaign, arm, every, base_frame, case, settings)
        except CalibrationError as error:
            raise (error if load else error.within(f"load case {case}")) from None
        _say(f"{campaign.name} {case}", records[case])
    for case, record in records.items():
        write(record, out if load else out / f"{case}.json")


def _by_papers_model(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    base_frame: Path,
    load: str,
    settings: CalibrationOptions,
) -> CalibrationRecord:
    """Work out a load case on two levels, with the paper's unknowns."""
    from pa10cal.calibration.load_case import work_out
    from pa10cal.calibration.records import paper_record
    from pa10cal.errors import CalibrationError
    from pa10cal.observe.averages import poses_of
    from pa10cal.results.codec import read
    from pa10cal.results.seed import BaseFrameRecord
    from pa10cal.stages.measurement_setup import payload_of

    if not every.measured.measures_pose:
        raise CalibrationError(
            "the paper's model needs positions and attitudes of the end-effector",
            where="calibration.model",
            value=settings.model,
            allowed=f"auto or general for an instrument of kind {campaign.instrument.kind}",
            remedy="set calibration.model to auto",
        )
    seed = read(BaseFrameRecord, base_frame, campaign.name)
    held_out = poses_of(every, "holdout")
    case = work_out(
        arm,
        poses_of(every, "grid", average=False),
        held_out if len(held_out) else None,
        seed.T_instr_base,
        load,
        settings,
    )
    return paper_record(case, campaign, payload_of(campaign, arm), settings)


def _by_general_model(
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    base_frame: Path,
    load: str,
    settings: CalibrationOptions,
) -> CalibrationRecord:
    """Work out a load case with every parameter that arm and instrument can tell."""
    from pa10cal.calibration.general.case import work_out_general
    from pa10cal.calibration.general.records import general_record
    from pa10cal.calibration.load_case import COMBINED, rows_of_load
    from pa10cal.observe.averages import average_repeats
    from pa10cal.results.codec import read
    from pa10cal.results.seed import BaseFrameRecord
    from pa10cal.stages.general_record import read_start
    from pa10cal.stages.measurement_setup import payload_of

    seed = read(BaseFrameRecord, base_frame, campaign.name)
    grid = average_repeats(every.of_kind("grid"))
    held_out = average_repeats(every.of_kind("holdout"))
    case = work_out_general(
        arm,
        grid,
        held_out if len(held_out) else None,
        rows_of_load(grid.states.load_N, COMBINED if load == GENERAL else load),
        read_start(seed, grid.measured, base_frame),
        load,
        payload_of(campaign, arm),
        settings,
    )
    return general_record(case, campaign, settings)


def _say(title: str, record: CalibrationRecord) -> None:
    after = ", ".join(
        f"{load} {errors.after.mean_mm:.3f}/{errors.after.peak_mm:.3f} mm"
        for load, errors in record.errors.items()
    )
    print(
        f"{title}: {record.status}, rank {record.rank} of {record.unknowns}, "
        f"mean/peak after: {after}"
    )
    print(f"{title}: {record.health.verdict}: {record.health.line}")
    for warning in (text for text in record.warnings if text != record.health.line):
        print(f"{title}: note: {warning}", file=sys.stderr)
