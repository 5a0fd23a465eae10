"""Command `discover`."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.discovery.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.discovery.preparation import MeasurementSetup
    from pa10cal.discovery.records import Outcome
    from pa10cal.fit.fitted_model import FittedModel
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
    from pa10cal.calibration.records import calibration_options, models_of
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import read_observations
    from pa10cal.discovery.records import discovery_records, summary
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import whole_files, write_text
    from pa10cal.fit.model_file import covariance_path, write_covariance
    from pa10cal.observe.arrivals import with_arrivals
    from pa10cal.observe.averages import poses_of
    from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write
    from pa10cal.results.suggestions import suggestion_table
    from pa10cal.stages.measurement_setup import setup_of

    began = time.perf_counter()
    campaign = read_description(campaign_dir)
    arm = load_arm(campaign.robot, campaign_dir)
    every, from_order = read_observations(poses, campaign), False
    record = read(CalibrationRecord, calibration, campaign.name)
    used = calibration_options(record, str(calibration))
    *_, fitted = models_of(record, str(calibration)).values()
    setup = setup_of(campaign, arm, used, settings)
    grid = poses_of(every, "grid", average=False, covariance="instrument")
    judge = _by_blocks if _left_out(grid) else _by_repeats
    if judge is _by_blocks:
        every, from_order = with_arrivals(every)
        grid = poses_of(every, "grid", average=False, covariance="instrument")
    held_out = poses_of(every, "holdout")
    if isinstance(record, GeneralCalibrationRecord):
        grid, held_out = (fitted.as_modelled(rows) for rows in (grid, held_out))
    outcome = judge(grid, held_out, fitted.with_bends(), setup, settings, record)
    records = discovery_records(
        outcome,
        campaign,
        record.load,
        time.perf_counter() - began,
        arrival_from_order=from_order,
    )
    table_text = suggestion_table(
        outcome.verdict.suggested_poses, arm.n, with_sides=judge is _by_repeats
    )
    outputs = (suggested, covariance_path(extended), extended, analysis, verdict)
    with whole_files(*outputs) as besides:
        table_beside, covariance, extended_beside, analysis_beside, verdict_beside = besides
        write_text(table_beside, table_text)
        write_covariance(outcome.model, covariance)
        write(records.extended, extended_beside)
        write(records.analysis, analysis_beside)
        write(records.verdict, verdict_beside)
    for line in summary(records.verdict):
        print(f"{campaign.name}: {line}")
    for warning in records.extended.warnings:
        print(f"{campaign.name}: note: {warning}", file=sys.stderr)


def _left_out(grid: Observations[Pose]) -> bool:
    """Tell whether effects are judged by blocks of poses left out, and not by repeats."""
    from pa10cal.discovery.blocked_cv.survey import enough
    from pa10cal.discovery.evidence.repeatability import LEAST_DIFFERENCES, LEAST_REPEATED, repeated

    repeats = repeated(grid)
    return enough(len(grid)) and repeats < max(LEAST_DIFFERENCES, LEAST_REPEATED * len(grid))


def _by_repeats(
    grid: Observations[Pose],
    held_out: Observations[Pose],
    baseline: FittedModel,
    setup: MeasurementSetup,
    settings: DiscoveryOptions,
    record: CalibrationRecord,
) -> Outcome:
    """Judge effects against the scatter of repeats."""
    from pa10cal.discovery.discover import discover, unresolved
    from pa10cal.discovery.evidence.records import outcome_by_repeats
    from pa10cal.discovery.suggest import plan
    from pa10cal.results.calibration import GeneralCalibrationRecord

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
    return outcome_by_repeats(found, settings.error_rate, ahead)


def _by_blocks(
    grid: Observations[Pose],
    held_out: Observations[Pose],
    baseline: FittedModel,
    setup: MeasurementSetup,
    settings: DiscoveryOptions,
    record: CalibrationRecord,
) -> Outcome:
    """Judge effects by how well blocks of poses are predicted that were left out."""
    import numpy as np

    from pa10cal.discovery.blocked_cv.discover import discover_by_blocks
    from pa10cal.discovery.blocked_cv.fill import fill
    from pa10cal.discovery.blocked_cv.records import outcome_by_blocks

    found = discover_by_blocks(
        grid,
        held_out,
        baseline,
        setup,
        settings.error_rate,
        torques_logged=record.torques_logged and bool(np.isfinite(grid.states.tau_Nm).all()),
    )
    ahead = fill(found.survey, found.seen, settings.suggestions, settings.random_seed)
    return outcome_by_blocks(found, settings.error_rate, ahead)
