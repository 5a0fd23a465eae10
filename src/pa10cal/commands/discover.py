"""Command `discover`."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.discovery.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.discovery.operating_point import OperatingPoint
    from pa10cal.discovery.preparation import MeasurementSetup
    from pa10cal.observe.observations import Observations
    from pa10cal.observe.pose import Pose
    from pa10cal.results.calibration import CalibrationRecord


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
    """
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import read_observations
    from pa10cal.discovery.operating_point import OperatingPoint
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import whole_files, write_json, write_text
    from pa10cal.files.schemas import ANALYSIS, EXTENDED, VERDICT
    from pa10cal.observe.arrivals import with_arrivals
    from pa10cal.observe.averages import poses_of
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read
    from pa10cal.stages.calibration_record import read_fit, settings_of
    from pa10cal.stages.measurement_setup import setup_of, with_bends

    began = time.perf_counter()
    campaign = read_campaign(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    every, from_order = read_observations(poses, campaign), False
    record = read(CalibrationRecord, calibration, campaign.name)
    used = settings_of(record, calibration)
    model, x, T_instr_base = read_fit(record, arm, calibration, cubic=True)
    setup = setup_of(campaign, arm, used, settings)
    grid = poses_of(every, "grid", average=False, covariance="instrument")
    judge = _by_blocks if _left_out(grid) else _by_repeats
    if judge is _by_blocks:
        every, from_order = with_arrivals(every)
        grid = poses_of(every, "grid", average=False, covariance="instrument")
    held_out = poses_of(every, "holdout")
    if isinstance(record, GeneralCalibrationRecord):
        from pa10cal.stages.general_record import as_modelled, read_general

        fitted = read_general(record, arm, calibration)
        grid, held_out = (as_modelled(rows, fitted, setup.payload) for rows in (grid, held_out))
    outcome = judge(
        grid, held_out, OperatingPoint(with_bends(model), x, T_instr_base), setup, settings, record
    )
    header = {"campaign": campaign.name, "provenance": campaign.provenance}
    verdict_record = {
        "schema": VERDICT,
        **header,
        **outcome.verdict,
        "arrival_from_order": from_order,
        "seconds": time.perf_counter() - began,
    }
    extended_record = {
        "schema": EXTENDED,
        **header,
        "robot": campaign.robot,
        "calibration": record.load,
        "verdict": verdict_record["verdict"],
        "arrival_from_order": from_order,
        "named": [
            {key: effect[key] for key in ("id", "of", "parameters", "alternatives")}
            for effect in verdict_record["effects"]
        ],
        "warnings": _warnings(verdict_record),
        **outcome.extended,
    }
    outputs = (suggested, extended, analysis, verdict)
    with whole_files(*outputs) as (table_beside, extended_beside, analysis_beside, verdict_beside):
        write_text(table_beside, outcome.suggested)
        write_json(extended_beside, extended_record)
        write_json(analysis_beside, {"schema": ANALYSIS, **header, **outcome.analysis})
        write_json(verdict_beside, verdict_record)
    _say(campaign.name, verdict_record)


@dataclass(frozen=True)
class _Outcome:
    """What a search comes to, ready to be written."""

    verdict: dict[str, Any]
    extended: dict[str, Any]
    analysis: dict[str, Any]
    suggested: str


def _left_out(grid: Observations[Pose]) -> bool:
    """Tell whether effects are judged by blocks of poses left out, and not by repeats."""
    from pa10cal.discovery.blocked_cv.survey import enough
    from pa10cal.discovery.evidence.repeatability import LEAST_DIFFERENCES, LEAST_REPEATED, repeated

    repeats = repeated(grid)
    return enough(len(grid)) and repeats < max(LEAST_DIFFERENCES, LEAST_REPEATED * len(grid))


def _by_repeats(
    grid: Observations[Pose],
    held_out: Observations[Pose],
    baseline: OperatingPoint,
    setup: MeasurementSetup,
    settings: DiscoveryOptions,
    record: CalibrationRecord,
) -> _Outcome:
    """Judge effects against the scatter of repeats."""
    from pa10cal.discovery.discover import discover, unresolved
    from pa10cal.discovery.suggest import plan
    from pa10cal.results.calibration import GeneralCalibrationRecord
    from pa10cal.stages.analysis_record import analysis_record
    from pa10cal.stages.extended_record import extended_record
    from pa10cal.stages.suggestion_record import (
        separation_records,
        suggestion_records,
        suggestion_table,
    )
    from pa10cal.stages.verdict_record import verdict_record

    flexible = setup.flexible_joints
    if isinstance(record, GeneralCalibrationRecord):
        flexible = record.springs
    found = discover(
        grid,
        held_out if len(held_out) else None,
        baseline,
        replace(setup, flexible_joints=flexible),
        settings.error_rate,
    )
    ahead = plan(
        found.problem,
        found.judgement.found.fit,
        unresolved(found),
        settings.suggestions,
        settings.random_seed,
    )
    verdict = {
        **verdict_record(found, settings.error_rate),
        "suggested_poses": suggestion_records(ahead.suggestions),
        "separations": separation_records(ahead.separations),
    }
    joints = baseline.model.chain.arm.n
    return _Outcome(
        verdict,
        extended_record(found),
        analysis_record(found),
        suggestion_table(ahead.suggestions, joints),
    )


def _by_blocks(
    grid: Observations[Pose],
    held_out: Observations[Pose],
    baseline: OperatingPoint,
    setup: MeasurementSetup,
    settings: DiscoveryOptions,
    record: CalibrationRecord,
) -> _Outcome:
    """Judge effects by how well blocks of poses are predicted that were left out."""
    import numpy as np

    from pa10cal.discovery.blocked_cv.discover import discover_by_blocks
    from pa10cal.discovery.blocked_cv.fill import fill
    from pa10cal.stages.blocked_cv_analysis import blocked_analysis
    from pa10cal.stages.blocked_cv_record import blocked_extended, blocked_verdict
    from pa10cal.stages.suggestion_record import filling_records, filling_table

    found = discover_by_blocks(
        grid,
        held_out,
        baseline,
        setup,
        settings.error_rate,
        torques_logged=record.torques_logged and bool(np.isfinite(grid.states.tau_Nm).all()),
    )
    ahead = fill(found.survey, found.seen, settings.suggestions, settings.random_seed)
    verdict = {
        **blocked_verdict(found, settings.error_rate),
        "suggested_poses": filling_records(ahead),
    }
    return _Outcome(
        verdict,
        blocked_extended(found),
        blocked_analysis(found),
        filling_table(ahead, baseline.model.chain.arm.n),
    )


def _warnings(verdict: dict[str, Any]) -> list[str]:
    """Return what a reader should know before trusting the extended model."""
    found = []
    for effect in verdict["effects"]:
        rivals = ", ".join(f"{rival['id']} of {rival['of']}" for rival in effect["alternatives"])
        if rivals:
            found.append(f"{effect['id']} of {effect['of']} cannot be told from {rivals}")
    if verdict["verdict"] == "unexplained":
        place = verdict["unexplained"]["of"] or "unknown place"
        found.append(
            f"something without a name is missing, of {place}: uncertainties do not cover it"
        )
    held_out = verdict["gap"]["holdout"]
    if held_out is not None and held_out["reduction"]["interval95_mm"][1] < 0.0:
        found.append(
            "held-out poses are predicted worse than before: do not use the extended model; the "
            "poses fitted are too few or too alike for the effects in it"
        )
    return found


def _say(name: str, verdict: dict[str, Any]) -> None:
    print(f"{name}: {verdict['verdict']}")
    for effect in verdict["effects"]:
        values = (
            ", ".join(
                f"{key} = {entry['value']:.4g} ± {2.0 * entry['std']:.1g} {entry['unit']}"
                for key, entry in effect["parameters"].items()
                if not key.startswith("knot")
            )
            or f"{len(effect['parameters'])} knots a turn"
        )
        rivals = " or ".join(f"{rival['id']} of {rival['of']}" for rival in effect["alternatives"])
        print(
            f"{name}:   {effect['id']} of {effect['of']}: {values}"
            + (f"; cannot be told from {rivals}" if rivals else "")
        )
    if verdict["unexplained"]:
        for place in verdict["unexplained"]["all"]:
            print(f"{name}:   without a name, of {place['of'] or 'unknown place'}: {place['why']}")
    for kind, gap in verdict["gap"].items():
        if isinstance(gap, dict):
            low, high = gap["reduction"]["interval95_mm"]
            print(
                f"{name}: {kind} mean {gap['before']['mean_mm']:.4f} -> "
                f"{gap['after']['mean_mm']:.4f} mm, less by {low:.4f} to {high:.4f} mm (95 %); "
                f"repeatability alone {gap['noise_floor_mm']:.4f} mm"
            )
            for part in ("inside", "extrapolated"):
                if gap.get(part):
                    print(
                        f"{name}:   {part}: {gap[part]['after']['configurations']} poses, rms "
                        f"{gap[part]['before']['rms_mm']:.4f} -> "
                        f"{gap[part]['after']['rms_mm']:.4f} mm"
                    )
    for warning in _warnings(verdict):
        print(f"{name}: note: {warning}", file=sys.stderr)
