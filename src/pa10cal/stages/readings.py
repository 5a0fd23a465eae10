"""Stages from raw files to readings and frames: `ingest`, `join`, `seed`."""

from __future__ import annotations

import sys
from pathlib import Path

from pa10cal.options import BaseFrameOptions, IngestOptions


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
    from pa10cal.files.output import whole_files, write_text

    campaign = read_campaign(campaign_dir, settings)
    with whole_files(out, quarantine) as (table, listing):
        prismatic, rejected = campaign.arm.prismatic, campaign.wrong_rows
        write_pose_table(table, campaign.observations, prismatic, campaign.name, rejected)
        write_text(listing, quarantine_csv(campaign.quarantined))
    print(campaign.summary)
    for warning in campaign.warnings:
        print(f"pa10cal ingest: warning: {campaign.name}: {warning}", file=sys.stderr)


def join(
    *,
    name: str,
    campaign_dir: tuple[Path, ...],
    poses: tuple[Path, ...],
    base_frame: tuple[Path, ...],
    out_dir: Path,
) -> None:
    """Join campaigns of one robot to a group, which other commands take like a campaign.

    The folder gets poses.parquet, quarantine.csv, and a campaign.yaml that describes all of them:
    it is the folder to give as --campaign-dir.

    Args:
        name: of the group.
        campaign_dir: folders of raw files, one a campaign; the first gives the frame.
        poses: their tables of poses, in the same order (.parquet).
        base_frame: their base frames, in the same order (.json).
        out_dir: gets the group.

    Examples:
        pa10cal join --name ur10 --campaign-dir data/raw/ur10-a data/raw/ur10-c --poses \\
          results/ur10-a/ingest/poses.parquet results/ur10-c/ingest/poses.parquet --base-frame \\
          results/ur10-a/seed/base_frame.json results/ur10-c/seed/base_frame.json --out-dir ur10
    """
    from pa10cal.calibration.general.calibrate import start_of
    from pa10cal.campaign import description
    from pa10cal.campaign.raw_rows import joined_listings
    from pa10cal.campaign.table import read_findings, read_observations, write_pose_table
    from pa10cal.errors import RawDataError
    from pa10cal.files.arms import copy_description
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.observe.joined import GroupCampaign
    from pa10cal.observe.joined import join as join_campaigns
    from pa10cal.results.calibration import BaseFrameRecord
    from pa10cal.results.codec import read

    if not len(campaign_dir) == len(poses) == len(base_frame):
        raise RawDataError(
            "the campaigns of the group are not complete",
            where="--campaign-dir, --poses, --base-frame",
            value=f"{len(campaign_dir)}, {len(poses)}, {len(base_frame)}",
            allowed="one of each for every campaign, in the same order",
            remedy="give them all",
        )
    described, members, findings, listings = [], [], [], {}
    for folder, table, frame in zip(campaign_dir, poses, base_frame, strict=True):
        campaign = description.read_description(folder)
        observations = read_observations(table, campaign)
        seed_record = read(BaseFrameRecord, frame, campaign.name)
        described.append((campaign, description.nominal_arm(campaign, folder)))
        start = start_of(seed_record, observations.measured)
        members.append(GroupCampaign(campaign.name, observations, start))
        for finding in read_findings(table):
            where = f"{campaign.name}: {finding.where}"
            findings.append(finding.model_copy(update={"where": where}))
        listings[campaign.name] = table.with_name("quarantine.csv")
    group = description.describe_group(name, described)
    joined = join_campaigns(members)
    out_dir.mkdir(parents=True, exist_ok=True)
    copy_description(group.robot, campaign_dir[0], out_dir)
    if group.controller is not None and group.controller.model is not None:
        copy_description(group.controller.model, campaign_dir[0], out_dir)
    names = ("poses.parquet", "quarantine.csv", description.DESCRIPTION_FILE)
    outputs = [out_dir / file_name for file_name in names]
    _, first_arm = described[0]
    with whole_files(*outputs) as (table, listing, description_file):
        write_pose_table(table, joined, first_arm.prismatic, name, findings)
        write_text(listing, joined_listings(listings))
        write_text(description_file, description.group_text(group))
    counts = ", ".join(f"{member.name} {len(member.observations)}" for member in members)
    print(f"{name}: {len(joined)} configurations of one {group.robot}: {counts}")


def seed(
    *,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    settings: BaseFrameOptions = BaseFrameOptions(),
) -> None:
    """Locate the base frame, and targets, from straight-line moves or the nominal arm.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        out: base frame in the instrument's frame, to write (.json).
        settings: section base_frame.

    Examples:
        pa10cal seed --campaign-dir data/raw/mine --poses poses.parquet --out base_frame.json
    """
    from pa10cal.calibration.campaign import located_base
    from pa10cal.campaign.description import nominal_arm, read_description
    from pa10cal.campaign.table import read_observations
    from pa10cal.observe.seed import summary
    from pa10cal.results.codec import write

    campaign = read_description(campaign_dir)
    observations = read_observations(poses, campaign)
    arm = nominal_arm(campaign, campaign_dir)
    record = located_base(campaign, arm, observations, settings, str(poses))
    write(record, out)
    print(f"{campaign.name}: {summary(record)}")
