"""Stage `evaluate`, and command `transfer`: models judged on poses that did not fit them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path


def evaluate(
    *,
    campaign_dir: Path,
    poses: Path,
    calibration: Path,
    out: Path,
    extended: Path | None = None,
    iso9283: Path | None = None,
) -> None:
    """Evaluate uncalibrated, calibrated and extended models on held-out points and loads.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        calibration: calibration to evaluate (.json).
        out: errors of every model, to write (.json).
        extended: model with the effects that discovery named (.json).
        iso9283: pose accuracy and repeatability after ISO 9283, to write (.json).

    Examples:
        pa10cal evaluate --campaign-dir data/raw/mine --poses poses.parquet --calibration \\
          calibration/combined.json --extended extended.json --out holdout.json
    """
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.evaluation import holdout
    from pa10cal.evaluation.iso9283 import iso9283_record
    from pa10cal.options import DiscoveryOptions
    from pa10cal.results.codec import write
    from pa10cal.stages.inputs import read_calibrated, read_extended, read_measured

    campaign, arm, observations = read_measured(campaign_dir, poses)
    record, models, options = read_calibrated(calibration, campaign.name)
    with_effects = None if extended is None else read_extended(extended, campaign.name)
    setup = setup_of(campaign, arm, options, DiscoveryOptions())
    evaluation = holdout.Evaluation(observations, models, with_effects, setup)
    held_out = holdout.held_out_record(campaign, record.load, evaluation)
    write(held_out, out)
    if iso9283 is not None:
        *_, calibrated = models.values()
        repeated = holdout.judged_where_repeated(evaluation, held_out=held_out.models)
        R_instr_base = calibrated.T_instr_base[:3, :3]
        found = iso9283_record(
            campaign, record.load, observations, repeated, R_instr_base, evaluation.cuts_s
        )
        write(found, iso9283)
    print(f"{campaign.name}: {holdout.summary(held_out, springs=record.has_springs)}")
    if held_out.parts and held_out.by_parts:
        errors = ", ".join(
            f"{name} {model.mean_mm:.3f}/{model.peak_mm:.3f} mm"
            for name, model in held_out.by_parts.items()
        )
        print(f"{holdout.base_motion_line(held_out.parts)}: mean/peak {errors}")


def transfer(
    *,
    calibration: Path,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    extended: Path | None = None,
) -> None:
    """Evaluate a model of one campaign in another; only base and tool are fitted there.

    Where the calibration poses show that instrument or base moved suddenly, the parts before and
    after have separate base frames.

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
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.errors import CalibrationError, RecordError
    from pa10cal.evaluation.holdout import Evaluation, base_motion_line, transfer_record
    from pa10cal.options import DiscoveryOptions
    from pa10cal.results.calibration import GeneralCalibrationRecord
    from pa10cal.results.codec import write
    from pa10cal.stages.inputs import read_calibrated, read_extended, read_measured

    campaign, arm, observations = read_measured(campaign_dir, poses)
    record, models, options = read_calibrated(calibration)
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
    with_effects = None if extended is None else read_extended(extended, record.campaign)
    if with_effects is not None:  # steps of its own campaign are none of this one
        with_effects = replace(with_effects, moved=None)
    setup = setup_of(campaign, arm, options, DiscoveryOptions())
    evaluation = Evaluation(observations, models, with_effects, setup)
    carried = transfer_record(campaign, record.campaign, evaluation)
    write(carried, out)
    summary = ", ".join(f"{name} {model.rms_mm:.3f} mm" for name, model in carried.models.items())
    print(f"{campaign.name}: model of {record.campaign}, base and tool fitted: rms {summary}")
    if carried.parts and carried.one_base:
        whole = ", ".join(f"{name} {each.rms_mm:.3f} mm" for name, each in carried.one_base.items())
        print(f"{base_motion_line(carried.parts)} (with one base: rms {whole})")
    if carried.worse:
        print(f"warning: {carried.worse}")
