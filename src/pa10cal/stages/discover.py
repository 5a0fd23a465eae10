"""Stage `discover`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.results.discovery import VerdictKeys


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
    from pa10cal.discovery.verdict_records import (
        analysis_record,
        extended_record,
        verdict_record,
        warnings_of,
    )
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
    judged = verdict_record(found, campaign, ahead)
    model = extended_record(found, judged, campaign.robot, record.load)
    shown = analysis_record(found, campaign)
    table_text = suggestion_table(
        ahead.poses, len(arm.axes_slide), with_sides=ahead.separations is not None
    )
    outputs = (suggested, covariance_path(extended), extended, analysis, verdict)
    with whole_files(*outputs) as besides:
        table_beside, covariance, extended_beside, analysis_beside, verdict_beside = besides
        write_text(table_beside, table_text)
        write_covariance(found.model, covariance)
        write(model, extended_beside)
        write(shown, analysis_beside)
        write(judged, verdict_beside)
    for line in verdict_lines(judged):
        print(f"{campaign.name}: {line}")
    for warning in warnings_of(judged):
        print(f"{campaign.name}: note: {warning}", file=sys.stderr)
    print(f"{campaign.name}: {time.perf_counter() - began:.1f} s")


def verdict_lines(verdict: VerdictKeys) -> Iterator[str]:
    """Yield a verdict in a few lines; in one where effects were not sought."""
    from pa10cal.results.discovery import EvidenceOfSag
    from pa10cal.terms.wording import headline, sag, sentences, sized, wrong

    word, lead = verdict.verdict, verdict.explained
    if word == "not_sought":
        yield f"effects were not sought: {verdict.why}; {verdict.remedy}"
    else:
        yield word if lead is None else f"{headline(lead)} (verdict: {word})"
    yield from (f"  {wrong(fault)}" for fault in verdict.faults)
    if word == "not_sought":
        return
    yield from (f"  {sentence}" for sentence in (() if lead is None else sentences(lead)))
    for effect in verdict.effects_by_share:
        values = sized(effect.parameters) or f"{len(effect.parameters)} knots a turn"
        line = f"  {effect.id} of {effect.of}: {values}"
        if isinstance(effect.evidence, EvidenceOfSag):
            line += f"; {sag(effect.evidence)}"
        line += f"; probability {effect.probability:.2f}"
        if effect.likely:
            others = (f"{each.id} of {each.of} ({each.probability:.2f})" for each in effect.likely)
            line += f", else {' or '.join(others)}"
        if effect.witness is not None and (ripple := effect.witness.ripple) is not None:
            low, high = ripple.interval95
            line += (
                f"; its motor followed {ripple.alpha:.2f} of it ({low:.2f} to {high:.2f}), by "
                f"lines at {', '.join(map(str, ripple.orders))} times {ripple.ratio:g}"
            )
        yield line
    for place in verdict.unexplained.all if verdict.unexplained else ():
        yield f"  without a name, of {place.of or 'unknown place'}: {place.why}"
    for each in verdict.proposed or ():
        yield f"  proposed for {each.of}, no name: {each.formula}, {sized(each.parameters)}"
    for kind, gap in (("train", verdict.gap.train), ("holdout", verdict.gap.holdout)):
        if gap is None:
            continue
        low, high = gap.reduction.interval95_mm
        yield (
            f"{kind} mean {gap.before.mean_mm:.4f} -> {gap.after.mean_mm:.4f} mm, less by "
            f"{low:.4f} to {high:.4f} mm (95 %); noise floor {gap.noise_floor_mm:.4f} mm"
        )
        parts = {
            "inside": gap.inside,
            "outside": gap.outside,
            "without readings far from the model": gap.trusted,
        }
        for name, part in parts.items():
            if part is not None:
                yield (
                    f"  {name}: {part.after.configurations} poses, rms "
                    f"{part.before.rms_mm:.4f} -> {part.after.rms_mm:.4f} mm"
                )
