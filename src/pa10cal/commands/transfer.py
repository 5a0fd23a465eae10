"""Command `transfer`."""

from __future__ import annotations

from pathlib import Path


def transfer(
    *,
    calibration: Path,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    extended: Path | None = None,
) -> None:
    """Judge a model of one campaign in another; only base and tool are fitted there.

    Where the calibration poses show that instrument or base moved at once, every part before and
    after has a base of its own.

    Args:
        calibration: combined calibration of the campaign that the model is of (.json).
        campaign_dir: folder of raw files of the campaign to judge it in.
        poses: table of poses of that campaign (.parquet).
        out: errors of the model there, to write (.json).
        extended: the model with the effects that discovery named (.json).

    Examples:
        pa10cal transfer --calibration results/ur10-a/calibration/combined.json \\
          --campaign-dir data/raw/ur10-c --poses results/ur10-c/ingest/poses.parquet --out \\
          transfer_ur10-a.json
    """
    from pa10cal.calibration.options import CalibrationOptions
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import arm_of, read_observations
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.errors import CalibrationError, RecordError
    from pa10cal.evaluation.compared import Evaluation, said_of_parts, transfer_record
    from pa10cal.fit.fitted_model import models_of
    from pa10cal.options import DiscoveryOptions
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write
    from pa10cal.settings_reading import parse_section
    from pa10cal.stages.extended import read_extended

    campaign = read_description(campaign_dir)
    every = read_observations(poses, campaign)
    arm = arm_of(campaign, campaign_dir, every)
    record = read(CalibrationRecord, calibration)
    if not isinstance(record, GeneralCalibrationRecord) or record.robot != campaign.robot:
        raise RecordError(
            "the calibration cannot be carried over",
            where=str(calibration),
            value=f"{record.model} model of {record.robot}",
            allowed=f"a general model of {campaign.robot}",
            remedy="give the combined calibration of another campaign of the same robot",
        )
    if record.status != "converged":
        raise CalibrationError(
            "a fit that did not converge is not carried over",
            where=str(calibration),
            value=record.status,
            allowed="converged",
            remedy="raise calibration.max_iterations, or look at its warnings",
        )
    options = parse_section(CalibrationOptions, record.settings, where=str(calibration))
    evaluation = Evaluation(
        every,
        models_of(record, str(calibration)),
        None if extended is None else read_extended(extended, record.campaign),
        setup_of(campaign, arm, options, DiscoveryOptions()),
    )
    carried = transfer_record(campaign, record.campaign, evaluation)
    write(carried, out)
    summary = ", ".join(f"{name} {model.rms_mm:.3f} mm" for name, model in carried.models.items())
    print(f"{campaign.name}: model of {record.campaign}, base and tool fitted: rms {summary}")
    if carried.parts and carried.one_base:
        whole = ", ".join(f"{name} {each.rms_mm:.3f} mm" for name, each in carried.one_base.items())
        print(f"{said_of_parts(carried.parts)} (with one base: rms {whole})")
