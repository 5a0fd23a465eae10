"""Command `evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm
    from pa10cal.campaign.description import Campaign
    from pa10cal.evaluation.holdout import HeldOut
    from pa10cal.observe.observations import Observations
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.evaluation import HeldOutModel


def evaluate(
    *,
    campaign_dir: Path,
    poses: Path,
    calibration: Path,
    out: Path,
    extended: Path | None = None,
) -> None:
    """Judge uncalibrated, calibrated and extended models on held-out points and loads.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        calibration: calibration to evaluate (.json).
        out: errors of every model, to write (.json).
        extended: model with the effects that discovery named (.json).
    """
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import read_observations
    from pa10cal.evaluation.records import holdout_record, summary
    from pa10cal.files.arms import load_arm
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write

    campaign = read_campaign(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    every = read_observations(poses, campaign)
    record = read(CalibrationRecord, calibration, campaign.name)
    models: dict[str, HeldOutModel] = {}
    if (every.kind == "holdout").any():
        if isinstance(record, GeneralCalibrationRecord):
            models = _judge_general(campaign, arm, every, record, calibration, extended)
        else:
            models = _judge_papers(campaign, arm, every, record, calibration, extended)
    found = holdout_record(campaign, record.load, models)
    write(found, out)
    print(f"{campaign.name}: {summary(found)}")


def _judge_papers(
    campaign: Campaign,
    arm: Arm,
    every: Observations,
    record: CalibrationRecord,
    calibration: Path,
    extended: Path | None,
) -> dict[str, HeldOutModel]:
    """Judge the paper's models on held-out poses."""
    import numpy as np

    from pa10cal.calibration.accuracy import align_nominal
    from pa10cal.evaluation.holdout import judge
    from pa10cal.evaluation.records import held_out_model
    from pa10cal.observe.averages import poses_of
    from pa10cal.stages.calibration_record import read_fit
    from pa10cal.terms.baseline import nominal

    held_out = poses_of(every, "holdout")
    rigid = nominal(arm)
    fits = {
        "uncalibrated": (
            rigid,
            np.zeros(0),
            align_nominal(rigid, poses_of(every, "grid")),
        ),
        "linear": read_fit(record, arm, calibration, cubic=False),
        "cubic": read_fit(record, arm, calibration, cubic=True),
    }
    judged = {
        name: judge(model.predict(held_out.states, x), T_instr_base, held_out)
        for name, (model, x, T_instr_base) in fits.items()
    }
    if extended is not None:
        judged["extended"] = _judge_extended(campaign, arm, every, record, calibration, extended)
    return {name: held_out_model(found, held_out) for name, found in judged.items()}


def _judge_general(
    campaign: Campaign,
    arm: Arm,
    every: Observations,
    record: GeneralCalibrationRecord,
    calibration: Path,
    extended: Path | None,
) -> dict[str, HeldOutModel]:
    """Judge the models of a general calibration on what the instrument observed."""
    from pa10cal.discovery.options import DiscoveryOptions
    from pa10cal.observe.arrivals import with_arrivals
    from pa10cal.stages.blocked_cv_model import extended_model
    from pa10cal.stages.calibration_record import settings_of
    from pa10cal.stages.general_evaluation import (
        general_models,
        held_out_with_torques,
        judged_record,
    )
    from pa10cal.stages.measurement_setup import setup_of

    held_out = held_out_with_torques(every, campaign, arm)
    models = {
        name: judged_record(model, held_out)
        for name, model in general_models(record, arm, calibration).items()
    }
    if extended is not None:
        with_effects = extended_model(extended, record, arm, calibration)
        if with_effects.arrival_from_order:
            held_out = held_out_with_torques(with_arrivals(every)[0], campaign, arm)
        used = settings_of(record, calibration)
        setup = setup_of(campaign, arm, used, DiscoveryOptions())
        held_out = with_effects.completed(held_out, setup)
        models["extended"] = judged_record(
            with_effects.fitted, held_out, with_effects.extrapolated(held_out.states)
        )
    return models


def _judge_extended(
    campaign: Campaign,
    arm: Arm,
    every: Observations,
    record: CalibrationRecord,
    calibration: Path,
    extended: Path,
) -> HeldOut:
    """Judge the model with the effects that discovery named."""
    from pa10cal.discovery.evidence.fit import as_read
    from pa10cal.discovery.operating_point import OperatingPoint
    from pa10cal.discovery.options import DiscoveryOptions
    from pa10cal.discovery.preparation import complete_about
    from pa10cal.evaluation.holdout import judge
    from pa10cal.observe.arrivals import with_arrivals
    from pa10cal.observe.averages import poses_of
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.calibration_record import read_fit, settings_of
    from pa10cal.stages.extended_record import read_extended, read_targets_off
    from pa10cal.stages.measurement_setup import setup_of, with_bends

    used = settings_of(record, calibration)
    model, _, _ = read_fit(record, arm, calibration, cubic=True)
    content = read(ExtendedRecord, extended, campaign.name)
    baseline, model, x, T_instr_base = read_extended(content, with_bends(model), extended)
    if content.arrival_from_order:
        every, _ = with_arrivals(every)
    poses = complete_about(
        poses_of(every, "holdout"),
        baseline,
        OperatingPoint(model, x, T_instr_base),
        setup_of(campaign, arm, used, DiscoveryOptions()),
    )
    places_m = read_targets_off(content, poses.measured.by_apparatus.shape[2], extended)
    T_base_ee = as_read(model.predict(poses.states, x), T_instr_base, poses, places_m)
    return judge(T_base_ee, T_instr_base, poses)
