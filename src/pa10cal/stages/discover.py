"""Stage `discover`: effects that are missing from the calibrated model."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.results.discovery import FoundEffect, SetGap, VerdictKeys

#: Mean error in the poses fitted, in the noise floor, below which it says nothing of the model.
_THROUGH_POSES = 0.5


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
    from pa10cal.discovery import verdict_records
    from pa10cal.discovery.discover import discover as search
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.fit.covariance_file import covariance_path, write_covariance
    from pa10cal.results.codec import write
    from pa10cal.results.plan import suggestion_table
    from pa10cal.stages.inputs import read_calibrated, read_measured

    began_s = time.perf_counter()
    campaign, arm, observations = read_measured(campaign_dir, poses)
    record, models, options = read_calibrated(calibration, campaign.name)
    *_, fitted = models.values()
    setup = setup_of(campaign, arm, options, settings)
    found = search(observations, fitted, setup, read_findings(poses))
    suggestions = found.next_poses(settings.suggestions, settings.random_seed)
    judged = verdict_records.verdict_record(found, campaign, suggestions)
    model = verdict_records.extended_record(found, judged, campaign.robot, record.load)
    analysed = verdict_records.analysis_record(found, campaign)
    with_sides = suggestions.separations is not None
    table = suggestion_table(suggestions.poses, arm.axes_slide.tolist(), with_sides=with_sides)
    outputs = (suggested, covariance_path(extended), extended, analysis, verdict)
    with whole_files(*outputs) as files:
        suggested_file, covariance_file, extended_file, analysis_file, verdict_file = files
        write_text(suggested_file, table)
        write_covariance(found.model, covariance_file)
        write(model, extended_file)
        write(analysed, analysis_file)
        write(judged, verdict_file)
    for line in verdict_lines(judged):
        print(f"{campaign.name}: {line}")
    for warning in model.warnings:
        print(f"{campaign.name}: note: {warning}", file=sys.stderr)
    print(f"{campaign.name}: {time.perf_counter() - began_s:.1f} s")


def verdict_lines(verdict: VerdictKeys) -> Iterator[str]:
    """Yield a verdict in a few lines; in one, faults and what changed, where none were sought."""
    from pa10cal.terms.wording import fault_text, headline, parameters_text, sentences

    word, lead = verdict.verdict, verdict.explained
    if word == "not_sought":
        yield f"effects were not sought: {verdict.why}; {verdict.remedy}"
    else:
        yield word if lead is None else f"{headline(lead)} (verdict: {word})"
    for fault in verdict.faults:
        yield f"  {fault_text(fault)}"
    for sentence in () if lead is None else sentences(lead):
        yield f"  {sentence}"
    for effect in verdict.effects_by_share:
        yield f"  {_effect_line(effect)}"
    for place in verdict.unexplained.all if verdict.unexplained else ():
        yield f"  without a name, of {place.of or 'unknown place'}: {place.why}"
    if word == "not_sought":
        return
    for proposed in verdict.proposed or ():
        size = parameters_text(proposed.parameters)
        yield f"  proposed for {proposed.of}, no name: {proposed.formula}, {size}"
    yield from gap_lines("train", verdict.gap.train)
    if verdict.gap.holdout is not None:
        yield from gap_lines("holdout", verdict.gap.holdout)


def _effect_line(effect: FoundEffect) -> str:
    """Return an effect with its size, its evidence, its probability and its rivals."""
    from pa10cal.results.discovery import EvidenceOfSag
    from pa10cal.results.number_text import shown_probability
    from pa10cal.terms.wording import parameters_text, sag_text

    values = parameters_text(effect.parameters) or f"{len(effect.parameters)} knots a turn"
    parts = [f"{effect.id} of {effect.of}: {values}"]
    if isinstance(effect.evidence, EvidenceOfSag):
        parts.append(sag_text(effect.evidence))
    rivals = [
        f"{rival.id} of {rival.of} ({shown_probability(rival.probability)})"
        for rival in effect.likely
    ]
    probability = f"probability {shown_probability(effect.probability)}"
    parts.append(f"{probability}, else {' or '.join(rivals)}" if rivals else probability)
    if effect.witness is not None and (ripple := effect.witness.ripple) is not None:
        low, high = ripple.interval95
        parts.append(
            f"its motor followed {ripple.alpha:.2f} of it ({low:.2f} to {high:.2f}), by "
            f"lines at {', '.join(map(str, ripple.orders))} times {ripple.ratio:g}"
        )
    return "; ".join(parts)


def gap_lines(kind: str, gap: SetGap) -> Iterator[str]:
    """Yield the errors before and after, over poses of one kind and over parts of them."""
    low_mm, high_mm = gap.reduction.interval95_mm
    less = f"less by {low_mm:.4f} to {high_mm:.4f} mm (95 %)"
    if kind == "train" and gap.after.mean_mm < _THROUGH_POSES * gap.noise_floor_mm:
        less = "below the noise: the fit passes through its poses, or the noise is smaller"
    elif low_mm <= 0.0 <= high_mm:
        less += ", within chance"
    yield (
        f"{kind} mean {gap.before.mean_mm:.4f} -> {gap.after.mean_mm:.4f} mm, {less}; "
        f"noise floor {gap.noise_floor_mm:.4f} mm"
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
