"""Stage ingest: raw logs to a table of poses, and a list of every row left out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.stages.command import limit_threads, run_stage

if TYPE_CHECKING:
    from pa10cal.campaign.measured import MeasuredPoses


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("ingest", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, required=True, help="folder of raw files")
    parser.add_argument("--settings", default="{}", help="the ingest section: JSON or YAML file")
    parser.add_argument("--out", type=Path, required=True, help="table of poses (.parquet)")
    parser.add_argument("--quarantine", type=Path, required=True, help="rows left out (.csv)")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.ingest import ingest_campaign, repeatability_mm
    from pa10cal.campaign.quarantine import quarantine_csv
    from pa10cal.campaign.table import write_pose_table
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import whole_files
    from pa10cal.settings import IngestSettings, read_settings_argument

    settings = read_settings_argument(IngestSettings, arguments.settings)
    folder: Path = arguments.campaign_dir
    campaign = read_campaign(folder)
    ingested = ingest_campaign(campaign, load_arm(campaign.robot, folder), folder, settings)
    poses = ingested.poses
    with whole_files(arguments.out, arguments.quarantine) as (table, listing):
        write_pose_table(table, poses, campaign.name)
        listing.write_text(quarantine_csv(ingested.left_out), encoding="utf-8", newline="\n")
    repeatability = ", ".join(
        f"{spread:.3f} mm at {load:g} N" for load, spread in repeatability_mm(poses).items()
    )
    parts = [
        f"{len(poses)} configurations",
        *_targets(poses),
        f"{len(ingested.left_out)} rows left out",
        f"repeatability {repeatability or 'unknown'}",
        *ingested.notes,
    ]
    print(f"{campaign.name}: {'; '.join(parts)}")
    for warning in ingested.warnings:
        print(f"pa10cal ingest: warning: {campaign.name}: {warning}", file=sys.stderr)


def _targets(poses: MeasuredPoses) -> list[str]:
    """Say how many balls were located, or other targets seen."""
    import numpy as np

    if not poses.ball_names:
        return []
    count = poses.ball_touches.size
    if poses.ball_touches.any():
        return [f"{count} balls"]
    seen = int(np.isfinite(poses.p_instr_balls_mm[..., 0]).sum())
    return [f"targets {', '.join(poses.ball_names)} seen {seen} times of {count}"]


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
