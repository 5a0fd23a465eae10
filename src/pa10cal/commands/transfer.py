"""Command `transfer`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.observe.observations import Observations


def transfer(
    *,
    calibration: Path,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    extended: Path | None = None,
) -> None:
    """Judge a model of one campaign in another; only base and tool are fitted there.

    Args:
        calibration: combined calibration of the campaign that the model is of (.json).
        campaign_dir: folder of raw files of the campaign to judge it in.
        poses: table of poses of that campaign (.parquet).
        out: errors of the model there, to write (.json).
        extended: the model with the effects that discovery named (.json).
    """
    from dataclasses import replace

    from pa10cal.calibration.general.transfer import refit_frames
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import read_observations
    from pa10cal.discovery.options import DiscoveryOptions
    from pa10cal.errors import CalibrationError, RecordError
    from pa10cal.files.arms import load_arm
    from pa10cal.fit.loads import with_torques
    from pa10cal.observe.arrivals import with_arrivals
    from pa10cal.observe.averages import average_repeats
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write
    from pa10cal.results.evaluation import TransferRecord
    from pa10cal.stages.blocked_cv_model import extended_model
    from pa10cal.stages.calibration_record import settings_of
    from pa10cal.stages.general_evaluation import (
        general_models,
        held_out_with_torques,
        judged_record,
    )
    from pa10cal.stages.measurement_setup import payload_of, setup_of

    campaign = read_campaign(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    every = read_observations(poses, campaign)
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

    def observed(every: Observations) -> tuple[Observations, Observations]:
        """Return grid and held-out poses with torques, as springs need them."""
        grid = average_repeats(every.of_kind("grid"))
        states, _ = with_torques(arm, grid.states, payload_of(campaign, arm))
        return replace(grid, states=states), held_out_with_torques(every, campaign, arm)

    grid, held_out = observed(every)
    judged = {
        name: judged_record(refit_frames(model, grid), held_out)
        for name, model in general_models(record, arm, calibration).items()
    }
    if extended is not None:
        with_effects = extended_model(extended, record, arm, calibration)
        used = settings_of(record, calibration)
        setup = setup_of(campaign, arm, used, DiscoveryOptions())
        if with_effects.arrival_from_order:
            grid, held_out = observed(with_arrivals(every)[0])
        grid, held_out = (with_effects.completed(rows, setup) for rows in (grid, held_out))
        judged["extended"] = judged_record(
            refit_frames(with_effects.fitted, grid),
            held_out,
            with_effects.extrapolated(held_out.states),
        )
    found = TransferRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        from_=record.campaign,
        configurations=len(held_out),
        models=judged,
    )
    write(found, out)
    summary = ", ".join(f"{name} {model.rms_mm:.3f} mm" for name, model in judged.items())
    print(f"{campaign.name}: model of {record.campaign}, base and tool fitted: rms {summary}")
