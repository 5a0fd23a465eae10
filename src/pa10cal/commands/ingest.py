"""Command `ingest`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.campaign.options import IngestOptions

if TYPE_CHECKING:
    from pa10cal.campaign.measured import MeasuredPoses


def ingest(
    *,
    campaign_dir: Path,
    out: Path,
    quarantine: Path,
    settings: IngestOptions = IngestOptions(),
) -> None:
    """Turn raw logs into a table of poses, and list the rows that are quarantined.

    Args:
        campaign_dir: folder of raw files.
        out: table of poses (.parquet).
        quarantine: rows that are not used, and why (.csv).
        settings: section ingest.
    """
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.ingest import ingest_campaign, repeatability_mm
    from pa10cal.campaign.quarantine import quarantine_csv
    from pa10cal.campaign.table import write_pose_table
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import whole_files

    campaign = read_campaign(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    ingested = ingest_campaign(campaign, arm, campaign_dir, settings)
    poses = ingested.poses
    with whole_files(out, quarantine) as (table, listing):
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
