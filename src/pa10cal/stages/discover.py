"""Stage `discover`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from pa10cal.options import DiscoveryOptions


def discover(
    *,
    campaign_dir: Path,
    poses: Path,
    calibration: Path,
    verdict: Path,
    analysis: Path,
    extended: Path,
    suggested: Path,
    settings: DiscoveryOptions = DiscoveryOptions(),
) -> None:
    """Find which effects are missing from the calibrated model, and close the gap.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        calibration: the calibrated model to start from (.json).
        verdict: verdict to write (.json).
        analysis: all that the figures show, to write (.json).
        extended: model with the effects that are named, to write (.json).
        suggested: poses to measure next, to write (.csv).
        settings: section discovery.

    Examples:
        pa10cal discover --campaign-dir data/raw/mine --poses poses.parquet --calibration \\
          calibration/combined.json --verdict verdict.json --analysis analysis.json \\
          --extended extended.json --suggested suggested_poses.csv
    """
    from pa10cal.campaign.table import read_findings
    from pa10cal.discovery import discover as search
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.fit.covariance_file import covariance_path, write_covariance
    from pa10cal.results.codec import write
    from pa10cal.results.plan import suggestion_table
    from pa10cal.stages.inputs import read_calibrated, read_measured

    began = time.perf_counter()
    campaign, arm, every = read_measured(campaign_dir, poses)
    record, models, options = read_calibrated(calibration, campaign.name)
    *_, fitted = models.values()
    setup = setup_of(campaign, arm, options, settings)
    found = search.discover(every, fitted, setup, read_findings(poses))
    ahead = found.next_poses(settings.suggestions, settings.random_seed)
    judged = found.record(campaign, ahead)
    model = found.extended_record(judged, campaign.robot, record.load)
    shown = found.analysis(campaign)
    table_text = suggestion_table(ahead.poses, arm.n, with_sides=ahead.separations is not None)
    outputs = (suggested, covariance_path(extended), extended, analysis, verdict)
    with whole_files(*outputs) as besides:
        table_beside, covariance, extended_beside, analysis_beside, verdict_beside = besides
        write_text(table_beside, table_text)
        write_covariance(found.model, covariance)
        write(model, extended_beside)
        write(shown, analysis_beside)
        write(judged, verdict_beside)
    for line in judged.summary:
        print(f"{campaign.name}: {line}")
    for warning in judged.warnings:
        print(f"{campaign.name}: note: {warning}", file=sys.stderr)
    print(f"{campaign.name}: {time.perf_counter() - began:.1f} s")
