"""Command `ingest`."""

from __future__ import annotations

import sys
from pathlib import Path

from pa10cal.campaign.options import IngestOptions


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

    Examples:
        pa10cal ingest --campaign-dir data/raw/mine --out poses.parquet --quarantine quarantine.csv
    """
    from pa10cal.campaign.raw_rows import quarantine_csv
    from pa10cal.campaign.read import read_campaign
    from pa10cal.campaign.table import write_pose_table
    from pa10cal.files.output import whole_files

    campaign = read_campaign(campaign_dir, settings)
    with whole_files(out, quarantine) as (table, listing):
        write_pose_table(
            table,
            campaign.observations,
            campaign.arm.prismatic,
            campaign.name,
            campaign.wrong_rows,
        )
        listing.write_text(quarantine_csv(campaign.quarantined), encoding="utf-8", newline="\n")
    print(campaign.summary)
    for warning in campaign.warnings:
        print(f"pa10cal ingest: warning: {campaign.name}: {warning}", file=sys.stderr)
