"""Stage: draw trials, write each as a raw campaign, and judge it without its truth.

The judging part is given the folder of the raw campaign and nothing else. The truth goes from what
was drawn straight into a file of its own, which the scoring stage alone reads.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from pa10cal.settings import CalibrationSettings, DiscoverySettings, Section
from pa10cal.stages.command import limit_threads, run_stage

if TYPE_CHECKING:
    from pa10cal.cell.trials import Trial

_KCUB_READING = "text_e7"


class JudgingSettings(Section):
    """The settings by which trials are judged."""

    calibration: CalibrationSettings = CalibrationSettings()
    discovery: DiscoverySettings = DiscoverySettings()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("blind_trials", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--kind", required=True, help="what the trials hide: null, single, ...")
    parser.add_argument("--count", type=int, required=True, help="how many trials")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--random-seed", type=int, required=True)
    parser.add_argument("--layouts", default="grid,wide", help="layouts of the poses, in turn")
    parser.add_argument("--size", type=float, help="factor of all effects; drawn where not given")
    parser.add_argument(
        "--settings", default="{}", help="sections calibration and discovery: JSON or YAML file"
    )
    parser.add_argument("--verdicts", type=Path, required=True, help="JSON lines, one a trial")
    parser.add_argument("--truths", type=Path, required=True, help="what they hide, apart")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.cell.trials import draw_trials
    from pa10cal.errors import DiscoveryError
    from pa10cal.files.output import whole_files
    from pa10cal.settings import read_settings_argument
    from pa10cal.stages.trial_records import json_line, truth_record

    settings = read_settings_argument(JudgingSettings, arguments.settings)
    last = arguments.first + _at_least_one(arguments.count)
    trials = draw_trials(
        arguments.kind, last, arguments.random_seed, _layouts(arguments.layouts), arguments.size
    )[arguments.first :]
    progress = _Progress(f"{arguments.kind} trials", len(trials))
    verdicts = []
    for trial in trials:
        verdicts.append(_try(trial, settings))
        progress(verdicts[-1])
    with whole_files(arguments.verdicts, arguments.truths) as (judged, hidden):
        judged.write_text("".join(map(json_line, verdicts)), encoding="utf-8", newline="\n")
        lines = (json_line(truth_record(trial)) for trial in trials)
        hidden.write_text("".join(lines), encoding="utf-8", newline="\n")
    failed = [record for record in verdicts if "failed" in record]
    if len(failed) == len(trials):
        raise DiscoveryError(
            "every trial failed",
            where=f"{arguments.kind} trials",
            value=failed[0]["failed"],
            allowed="at least one verdict",
            remedy="run discover on one such campaign with --debug",
        )


def _at_least_one(count: int) -> int:
    from pa10cal.errors import SettingsError

    if count < 1:
        raise SettingsError(
            "no trial to run",
            where="--count",
            value=count,
            allowed="1 or more",
            remedy="ask for more trials",
        )
    return count


def _layouts(text: str) -> list[Any]:
    from pa10cal.cell.references import Layout
    from pa10cal.errors import SettingsError

    names = text.split(",")
    if unknown := sorted(set(names) - set(get_args(Layout))):
        raise SettingsError(
            "no such layout of poses",
            where="--layouts",
            value=unknown[0],
            allowed=", ".join(get_args(Layout)),
            remedy="correct the name",
        )
    return names


def _try(trial: Trial, settings: JudgingSettings) -> dict[str, Any]:
    """Return the verdict on a trial, or what went wrong: no trial is dropped."""
    from pa10cal.files.schemas import VERDICT

    try:
        with tempfile.TemporaryDirectory() as name:
            began = time.perf_counter()
            raw = Path(name) / "raw"
            _measure(trial, raw)
            measured = time.perf_counter() - began
            return {**judge_campaign(raw, settings), "seconds_simulating": measured}
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        return {"schema": VERDICT, "campaign": trial.name, "failed": message}


def _measure(trial: Trial, raw: Path) -> None:
    """Write a trial's raw campaign; the record of what it hides is thrown away."""
    from pa10cal.cell.campaign import simulate_campaign
    from pa10cal.cell.write import write_campaign
    from pa10cal.files.arms import load_arm

    arm = load_arm(trial.settings.robot)
    campaign = simulate_campaign(trial.name, arm, trial.settings, _KCUB_READING)
    with tempfile.TemporaryDirectory() as elsewhere:
        write_campaign(campaign, raw, Path(elsewhere) / "truth.json")


def judge_campaign(raw: Path, settings: JudgingSettings) -> dict[str, Any]:
    """Return the verdict on a raw campaign: ingested, calibrated on all loads, searched.

    Args:
        raw: folder of the campaign.
        settings: how to calibrate and to search.
    """
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.ingest import ingest_campaign
    from pa10cal.campaign.table import observations, read_pose_table, write_pose_table
    from pa10cal.discovery.discover import discover
    from pa10cal.discovery.problem import Baseline
    from pa10cal.files.arms import load_arm
    from pa10cal.files.schemas import VERDICT
    from pa10cal.settings import IngestSettings
    from pa10cal.stages.discovery_setting import setting_of, with_bends
    from pa10cal.stages.verdict_record import verdict_record

    began = time.perf_counter()
    campaign = read_campaign(raw)
    arm = load_arm(campaign.robot)
    ingested = ingest_campaign(campaign, arm, raw, IngestSettings())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.parquet"
        write_pose_table(path, ingested.poses, campaign.name)
        table = read_pose_table(path, campaign.name)
    readings = observations(table, kind="grid", average=False, covariance="instrument")
    held_out = observations(table, kind="holdout")
    found = _calibrated(
        arm, observations(table, kind="grid", average=False), settings.calibration
    )
    error_rate = settings.discovery.error_rate
    discovery = discover(
        readings,
        held_out if len(held_out) else None,
        Baseline(with_bends(found.level.model), found.solution.x, found.T_cmm_base),
        setting_of(campaign, arm, settings.calibration, settings.discovery),
        error_rate,
    )
    return {
        "schema": VERDICT,
        "campaign": campaign.name,
        **verdict_record(discovery, error_rate),
        "seconds": time.perf_counter() - began,
    }


def _calibrated(arm: Any, readings: Any, settings: CalibrationSettings) -> Any:
    """Calibrate the cubic model on all loads from the nominal arm, elsewhere if that fails."""
    from dataclasses import replace

    import numpy as np

    from pa10cal.calibration.calibrate import calibrate
    from pa10cal.calibration.uncertainty import ErrorSources
    from pa10cal.campaign.averages import average_repeats
    from pa10cal.stages.calibration_record import study_of
    from pa10cal.terms.baseline import baseline

    study = study_of(settings)
    poses = average_repeats(readings)
    model = baseline(
        arm,
        study.flexible_joints,
        study.tolerances,
        tau_ref_Nm=np.abs(poses.states.tau_Nm).max(axis=0),
    )
    errors = ErrorSources(readings, 1e-3 * settings.apparatus_uncertainty_mm)
    found = calibrate(model, poses, replace(study.options, starts=1), errors)
    return found if found.converged else calibrate(model, poses, study.options, errors)


class _Progress:
    """Prints how many trials are done, how long one takes, and how long the rest will."""

    def __init__(self, title: str, count: int) -> None:
        self._title, self._count = title, count
        self._began, self._done = time.monotonic(), 0

    def __call__(self, record: dict[str, Any]) -> None:
        self._done += 1
        seconds = (time.monotonic() - self._began) / self._done
        left = seconds * (self._count - self._done)
        print(
            f"{self._title}: {self._done} of {self._count}, {seconds:.1f} s a trial, "
            f"{left:.0f} s left; {record['campaign']}: "
            + (f"failed: {record['failed']}" if "failed" in record else record["verdict"]),
            file=sys.stderr,
            flush=True,
        )


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
