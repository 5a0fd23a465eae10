"""Stage: two-level calibration of one load case, or of all together."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("calibrate", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, required=True)
    parser.add_argument("--poses", type=Path, required=True, help="table of poses (parquet)")
    parser.add_argument("--base-frame", type=Path, required=True, help="seed of the base frame")
    parser.add_argument("--load", required=True, help="a load such as 44N, or combined")
    parser.add_argument("--settings", default="{}", help="calibration section, JSON or YAML file")
    parser.add_argument("--out", type=Path, required=True)


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.calibration.load_case import work_out
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import observations, read_pose_table
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import BASE_FRAME, CALIBRATION
    from pa10cal.settings import CalibrationSettings, read_settings_argument
    from pa10cal.stages.calibration_record import load_case_record, study_of
    from pa10cal.stages.records import read_pose_matrix, read_record

    settings = read_settings_argument(CalibrationSettings, arguments.settings)
    campaign = read_campaign(arguments.campaign_dir)
    seed = read_record(arguments.base_frame, BASE_FRAME, ("T_cmm_base",), campaign.name)
    case = work_out(
        load_arm(campaign.robot),
        observations(read_pose_table(arguments.poses, campaign.name), kind="grid", average=False),
        read_pose_matrix(seed, "T_cmm_base", arguments.base_frame),
        arguments.load,
        1e-3 * settings.apparatus_uncertainty_mm,
        study_of(settings),
    )
    record = load_case_record(case)
    header = {
        "schema": CALIBRATION,
        "campaign": campaign.name,
        "provenance": campaign.provenance,
        "robot": campaign.robot,
    }
    write_json(arguments.out, {**header, **record, "settings": settings.model_dump(mode="json")})
    _say(f"{campaign.name} {arguments.load}", record)


def _say(title: str, record: dict[str, Any]) -> None:
    after = ", ".join(
        f"{load} {errors['after']['mean_mm']:.3f}/{errors['after']['peak_mm']:.3f} mm"
        for load, errors in record["errors"].items()
    )
    print(
        f"{title}: {record['status']}, rank {record['rank']} of {record['unknowns']}, "
        f"mean/peak after: {after}"
    )
    for warning in record["warnings"]:
        print(f"{title}: note: {warning}", file=sys.stderr)


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
