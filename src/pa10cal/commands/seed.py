"""Command `seed`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.frame.options import BaseFrameOptions


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
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import read_observations
    from pa10cal.files.arms import load_arm
    from pa10cal.observe.seed import locate_base, summary
    from pa10cal.results.codec import write

    campaign = read_description(campaign_dir)
    every = read_observations(poses, campaign)
    arm = load_arm(campaign.robot, campaign_dir)
    record = locate_base(every, arm, settings, poses, campaign.name, campaign.provenance)
    write(record, out)
    print(f"{campaign.name}: {summary(record)}")
