"""Stage: a model calibrated in one campaign judged in another, only base and tool fitted there."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.stages.command import limit_threads, run_stage

if TYPE_CHECKING:
    import pandas as pd

    from pa10cal.campaign.seen import Sightings


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("transfer", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--calibration", type=Path, required=True, help="of the other campaign")
    parser.add_argument("--extended", type=Path, help="its model with the effects found missing")
    parser.add_argument("--campaign-dir", type=Path, required=True, help="campaign to judge in")
    parser.add_argument("--poses", type=Path, required=True, help="its table of poses (parquet)")
    parser.add_argument("--out", type=Path, required=True, help="its errors there (.json)")


def _run(arguments: argparse.Namespace) -> None:
    from dataclasses import replace

    from pa10cal.calibration.general.calibrate import with_torques
    from pa10cal.calibration.general.transfer import refit_frames
    from pa10cal.campaign.arrival_order import with_arrivals
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.sightings import sightings
    from pa10cal.campaign.table import read_pose_table
    from pa10cal.errors import CalibrationError, RecordError
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import CALIBRATION, TRANSFER
    from pa10cal.settings import CalibrationSettings, DiscoverySettings, parse_section
    from pa10cal.stages.blocked_cv_model import extended_model
    from pa10cal.stages.discovery_setting import payload_of, setting_of
    from pa10cal.stages.general_evaluation import (
        general_models,
        held_out_with_torques,
        judged_record,
    )
    from pa10cal.stages.records import read_record

    campaign = read_campaign(arguments.campaign_dir)
    arm = load_arm(campaign.robot, arguments.campaign_dir)
    table = read_pose_table(arguments.poses, campaign.name)
    record = read_record(
        arguments.calibration, CALIBRATION, ("model", "robot", "settings", "status")
    )
    if record["model"] != "general" or record["robot"] != campaign.robot:
        raise RecordError(
            "the calibration cannot be carried over",
            where=str(arguments.calibration),
            value=f"{record['model']} model of {record['robot']}",
            allowed=f"a general model of {campaign.robot}",
            remedy="give the combined calibration of another campaign of the same robot",
        )
    if record["status"] != "converged":
        raise CalibrationError(
            "a fit that did not converge is not carried over",
            where=str(arguments.calibration),
            value=record["status"],
            allowed="converged",
            remedy="raise calibration.max_iterations, or look at its warnings",
        )

    def sighted(rows: pd.DataFrame) -> tuple[Sightings, Sightings]:
        """Return grid and held-out poses with torques, as springs need them."""
        grid = sightings(rows, campaign, "grid")
        states, _ = with_torques(arm, grid.states, payload_of(campaign, arm))
        return replace(grid, states=states), held_out_with_torques(rows, campaign, arm)

    grid, held_out = sighted(table)
    judged = {
        name: judged_record(refit_frames(model, grid), held_out)
        for name, model in general_models(record, arm, arguments.calibration).items()
    }
    if arguments.extended is not None:
        extended = extended_model(arguments.extended, record, arm, arguments.calibration)
        calibration = parse_section(
            CalibrationSettings, record["settings"], where=str(arguments.calibration)
        )
        setting = setting_of(campaign, arm, calibration, DiscoverySettings())
        if extended.arrival_from_order:
            grid, held_out = sighted(with_arrivals(table)[0])
        grid, held_out = (extended.completed(poses, setting) for poses in (grid, held_out))
        judged["extended"] = judged_record(
            refit_frames(extended.fitted, grid),
            held_out,
            extended.extrapolated(held_out.states),
        )
    write_json(
        arguments.out,
        {
            "schema": TRANSFER,
            "campaign": campaign.name,
            "provenance": campaign.provenance,
            "from": record["campaign"],
            "configurations": len(held_out),
            "models": judged,
        },
    )
    summary = ", ".join(f"{name} {found['rms_mm']:.3f} mm" for name, found in judged.items())
    print(f"{campaign.name}: model of {record['campaign']}, base and tool fitted: rms {summary}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
