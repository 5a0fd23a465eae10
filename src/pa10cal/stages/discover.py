"""Stage: where model and data disagree, which effect is missing, and the gap with it closed."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("discover", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, required=True)
    parser.add_argument("--poses", type=Path, required=True, help="table of poses (parquet)")
    parser.add_argument("--calibration", type=Path, required=True, help="the calibrated baseline")
    parser.add_argument("--settings", default="{}", help="discovery section, JSON or YAML file")
    parser.add_argument("--verdict", type=Path, required=True, help="verdict to write")
    parser.add_argument("--analysis", type=Path, required=True, help="what figures show, to write")
    parser.add_argument("--extended", type=Path, required=True, help="extended model to write")
    parser.add_argument("--suggested", type=Path, required=True, help="poses to measure, CSV")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import observations, read_pose_table
    from pa10cal.discovery.discover import discover, unresolved
    from pa10cal.discovery.problem import Baseline
    from pa10cal.discovery.suggest import plan
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import whole_files, write_json, write_text
    from pa10cal.files.schemas import ANALYSIS, CALIBRATION, EXTENDED, VERDICT
    from pa10cal.settings import (
        CalibrationSettings,
        DiscoverySettings,
        parse_section,
        read_settings_argument,
    )
    from pa10cal.stages.analysis_record import analysis_record
    from pa10cal.stages.calibration_record import read_fit
    from pa10cal.stages.discovery_setting import setting_of, with_bends
    from pa10cal.stages.extended_record import extended_record
    from pa10cal.stages.records import read_record
    from pa10cal.stages.suggestion_record import (
        separation_records,
        suggestion_records,
        suggestion_table,
    )
    from pa10cal.stages.verdict_record import verdict_record

    began = time.perf_counter()
    settings = read_settings_argument(DiscoverySettings, arguments.settings)
    campaign = read_campaign(arguments.campaign_dir)
    arm = load_arm(campaign.robot, arguments.campaign_dir)
    table = read_pose_table(arguments.poses, campaign.name)
    record = read_record(
        arguments.calibration, CALIBRATION, ("parameters", "settings"), campaign.name
    )
    calibration = parse_section(
        CalibrationSettings, record["settings"], where=str(arguments.calibration)
    )
    model, x, T_cmm_base = read_fit(record, arm, arguments.calibration, cubic=True)
    held_out = observations(table, kind="holdout")
    found = discover(
        observations(table, kind="grid", average=False, covariance="instrument"),
        held_out if len(held_out) else None,
        Baseline(with_bends(model), x, T_cmm_base),
        setting_of(campaign, arm, calibration, settings),
        settings.error_rate,
    )
    ahead = plan(
        found.problem,
        found.judgement.found.fit,
        unresolved(found),
        settings.suggestions,
        settings.random_seed,
    )
    header = {"campaign": campaign.name, "provenance": campaign.provenance}
    verdict = {
        "schema": VERDICT,
        **header,
        **verdict_record(found, settings.error_rate),
        "suggested_poses": suggestion_records(ahead.suggestions),
        "separations": separation_records(ahead.separations),
        "seconds": time.perf_counter() - began,
    }
    extended = {
        "schema": EXTENDED,
        **header,
        "robot": campaign.robot,
        "calibration": record["load"],
        "verdict": verdict["verdict"],
        "named": [
            {key: effect[key] for key in ("id", "of", "parameters", "alternatives")}
            for effect in verdict["effects"]
        ],
        "warnings": _warnings(verdict),
        **extended_record(found),
    }
    outputs = (arguments.suggested, arguments.extended, arguments.analysis, arguments.verdict)
    with whole_files(*outputs) as (table_beside, extended_beside, analysis_beside, verdict_beside):
        write_text(table_beside, suggestion_table(ahead.suggestions, arm.n))
        write_json(extended_beside, extended)
        write_json(analysis_beside, {"schema": ANALYSIS, **header, **analysis_record(found)})
        write_json(verdict_beside, verdict)
    _say(campaign.name, verdict)


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
        values = ", ".join(
            f"{key} = {entry['value']:.4g} ± {2.0 * entry['std']:.1g} {entry['unit']}"
            for key, entry in effect["parameters"].items()
            if not key.startswith("knot")
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
    for warning in _warnings(verdict):
        print(f"{name}: note: {warning}", file=sys.stderr)


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
