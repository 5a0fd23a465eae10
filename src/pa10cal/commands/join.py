"""Command `join`."""

from __future__ import annotations

from pathlib import Path


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
    from dataclasses import replace

    from pa10cal.calibration.general.calibrate import start_of
    from pa10cal.campaign.description import DESCRIPTION_FILE, read_description
    from pa10cal.campaign.group import MemberRead, describe_group, group_text
    from pa10cal.campaign.raw_rows import joined_listings
    from pa10cal.campaign.table import read_findings, read_observations, write_pose_table
    from pa10cal.errors import RawDataError
    from pa10cal.files.arms import copy_description, load_arm
    from pa10cal.files.output import whole_files
    from pa10cal.observe.joined import Member
    from pa10cal.observe.joined import join as join_campaigns
    from pa10cal.results.codec import read
    from pa10cal.results.seed import BaseFrameRecord

    if not len(campaign_dir) == len(poses) == len(base_frame):
        raise RawDataError(
            "the campaigns of the group are not complete",
            where="--campaign-dir, --poses, --base-frame",
            value=f"{len(campaign_dir)}, {len(poses)}, {len(base_frame)}",
            allowed="one of each for every campaign, in the same order",
            remedy="give them all",
        )
    members, placed = [], []
    for folder, table, frame in zip(campaign_dir, poses, base_frame, strict=True):
        description = read_description(folder)
        every = read_observations(table, description)
        seed = read(BaseFrameRecord, frame, description.name)
        members.append(MemberRead(description, load_arm(description.robot, folder), every))
        start = start_of(seed, every.measured)
        placed.append(Member(description.name, every, start))
    group = describe_group(name, members)
    together = join_campaigns(placed)
    findings = [
        replace(finding, where=f"{each.name}: {finding.where}")
        for each, table in zip(placed, poses, strict=True)
        for finding in read_findings(table)
    ]
    listings = {
        each.name: table.with_name("quarantine.csv")
        for each, table in zip(placed, poses, strict=True)
    }
    out_dir.mkdir(parents=True, exist_ok=True)
    copy_description(group.robot, campaign_dir[0], out_dir)
    outputs = [out_dir / file for file in ("poses.parquet", "quarantine.csv", DESCRIPTION_FILE)]
    with whole_files(*outputs) as (table, listing, text):
        write_pose_table(table, together, members[0].arm.prismatic, name, findings)
        listing.write_text(joined_listings(listings), encoding="utf-8", newline="\n")
        text.write_text(group_text(group), encoding="utf-8", newline="\n")
    counts = ", ".join(f"{each.name} {len(each.observations)}" for each in placed)
    print(f"{name}: {len(together)} configurations of one {group.robot}: {counts}")
