"""Stage `evaluate`."""

from __future__ import annotations

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
    """Judge uncalibrated, calibrated and extended models on held-out points and loads.

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
    from pa10cal.calibration.options import CalibrationOptions
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import arm_of, read_observations
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.evaluation.compared import (
        Evaluation,
        held_out_record,
        judged_where_repeated,
        said_of_parts,
        summary,
    )
    from pa10cal.evaluation.iso9283 import iso9283_record
    from pa10cal.fit.fitted_model import models_of
    from pa10cal.options import DiscoveryOptions
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import read, write
    from pa10cal.settings_reading import parse_section
    from pa10cal.stages.extended import read_extended

    campaign = read_description(campaign_dir)
    every = read_observations(poses, campaign)
    arm = arm_of(campaign, campaign_dir, every)
    record = read(CalibrationRecord, calibration, campaign.name)
    options = parse_section(CalibrationOptions, record.settings, where=str(calibration))
    fitted = models_of(record, str(calibration))
    with_effects = None if extended is None else read_extended(extended, campaign.name)
    setup = setup_of(campaign, arm, options, DiscoveryOptions())
    evaluation = Evaluation(every, fitted, with_effects, setup)
    found = held_out_record(campaign, record.load, evaluation)
    write(found, out)
    if iso9283 is not None:
        *_, last = fitted.values()
        repeated = iso9283_record(
            campaign,
            record.load,
            every,
            judged_where_repeated(evaluation, held_out=found.models),
            last.T_instr_base[:3, :3],
        )
        write(repeated, iso9283)
    print(f"{campaign.name}: {summary(found, springs=record.has_springs)}")
    if found.parts and found.by_parts:
        errors = ", ".join(
            f"{name} {model.mean_mm:.3f}/{model.peak_mm:.3f} mm"
            for name, model in found.by_parts.items()
        )
        print(f"{said_of_parts(found.parts)}: mean/peak {errors}")
