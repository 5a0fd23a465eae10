"""Stage: uncalibrated, linear and cubic models on held-out points and loads."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.stages.command import limit_threads, run_stage

if TYPE_CHECKING:
    import pandas as pd

    from pa10cal.campaign.description import Campaign
    from pa10cal.campaign.observations import PoseObservations
    from pa10cal.evaluation.holdout import HeldOut


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("evaluate", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, required=True)
    parser.add_argument("--poses", type=Path, required=True, help="table of poses (parquet)")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration to evaluate")
    parser.add_argument("--extended", type=Path, help="model with the effects that were missing")
    parser.add_argument("--out", type=Path, required=True)


def _run(arguments: argparse.Namespace) -> None:
    import numpy as np

    from pa10cal.calibration.accuracy import align_nominal
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import observations, read_pose_table
    from pa10cal.evaluation.holdout import judge
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import CALIBRATION, HOLDOUT
    from pa10cal.stages.calibration_record import accuracy_records, read_fit
    from pa10cal.stages.records import read_record
    from pa10cal.terms.baseline import nominal

    campaign = read_campaign(arguments.campaign_dir)
    arm = load_arm(campaign.robot, arguments.campaign_dir)
    table = read_pose_table(arguments.poses, campaign.name)
    needs = ("parameters", *(() if arguments.extended is None else ("settings",)))
    record = read_record(arguments.calibration, CALIBRATION, needs, campaign.name)
    header = {
        "schema": HOLDOUT,
        "campaign": campaign.name,
        "provenance": campaign.provenance,
        "calibration": record["load"],
    }
    if not (table["kind"] == "holdout").any():
        write_json(
            arguments.out,
            {**header, "configurations": 0, "models": {}, "note": "no held-out rows measured"},
        )
        print(f"{campaign.name}: no held-out rows to evaluate")
        return
    if record.get("model") == "general":
        _judge_general(arguments, header, record, campaign, table)
        return
    held_out = observations(table, kind="holdout")
    rigid = nominal(arm)
    fits = {
        "uncalibrated": (
            rigid,
            np.zeros(0),
            align_nominal(rigid, observations(table, kind="grid")),
        ),
        "linear": read_fit(record, arm, arguments.calibration, cubic=False),
        "cubic": read_fit(record, arm, arguments.calibration, cubic=True),
    }
    judged = {
        name: judge(model.predict(held_out.states, x), T_instr_base, held_out)
        for name, (model, x, T_instr_base) in fits.items()
    }
    if arguments.extended is not None:
        judged["extended"] = _extended(arguments, record, campaign, table)
    models = {
        name: {
            **asdict(found.overall),
            "per_load": accuracy_records(found.by_load),
            "per_point": {key: asdict(value) for key, value in found.by_point.items()},
            "tool_twist": _twist_record(found),
            "rows": _row_records(found, held_out),
        }
        for name, found in judged.items()
    }
    write_json(arguments.out, {**header, "configurations": len(held_out), "models": models})
    _say(campaign.name, models, len(held_out))


def _judge_general(
    arguments: argparse.Namespace,
    header: dict[str, Any],
    record: dict[str, Any],
    campaign: Campaign,
    table: pd.DataFrame,
) -> None:
    """Judge the models of a general calibration on what the instrument saw."""
    from pa10cal.campaign.arrival_order import with_arrivals
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.settings import CalibrationSettings, DiscoverySettings, parse_section
    from pa10cal.stages.blocked_cv_model import extended_model
    from pa10cal.stages.discovery_setting import setting_of
    from pa10cal.stages.general_evaluation import (
        general_models,
        held_out_with_torques,
        judged_record,
    )

    arm = load_arm(campaign.robot, arguments.campaign_dir)
    held_out = held_out_with_torques(table, campaign, arm)
    models = {
        name: judged_record(model, held_out)
        for name, model in general_models(record, arm, arguments.calibration).items()
    }
    if arguments.extended is not None:
        extended = extended_model(arguments.extended, record, arm, arguments.calibration)
        if extended.arrival_from_order:
            held_out = held_out_with_torques(with_arrivals(table)[0], campaign, arm)
        calibration = parse_section(
            CalibrationSettings, record["settings"], where=str(arguments.calibration)
        )
        setting = setting_of(campaign, arm, calibration, DiscoverySettings())
        held_out = extended.completed(held_out, setting)
        models["extended"] = judged_record(
            extended.fitted, held_out, extended.extrapolated(held_out.states)
        )
    write_json(arguments.out, {**header, "configurations": len(held_out), "models": models})
    _say(campaign.name, models, len(held_out))


def _say(name: str, models: dict[str, dict[str, Any]], configurations: int) -> None:
    summary = ", ".join(
        f"{model} {found['mean_mm']:.3f}/{found['peak_mm']:.3f} mm"
        for model, found in models.items()
    )
    print(f"{name} held out ({configurations}): mean/peak {summary}")


def _extended(
    arguments: argparse.Namespace,
    record: dict[str, Any],
    campaign: Campaign,
    table: pd.DataFrame,
) -> HeldOut:
    """Judge the model with the effects that discovery named."""
    from pa10cal.campaign.arrival_order import with_arrivals
    from pa10cal.campaign.table import observations
    from pa10cal.discovery.fit import as_read
    from pa10cal.discovery.problem import Baseline, complete_about
    from pa10cal.evaluation.holdout import judge
    from pa10cal.files.arms import load_arm
    from pa10cal.files.schemas import EXTENDED
    from pa10cal.settings import CalibrationSettings, DiscoverySettings, parse_section
    from pa10cal.stages.calibration_record import read_fit
    from pa10cal.stages.discovery_setting import setting_of, with_bends
    from pa10cal.stages.extended_record import read_extended
    from pa10cal.stages.records import read_record, read_vector

    arm = load_arm(campaign.robot, arguments.campaign_dir)
    calibration = parse_section(
        CalibrationSettings, record["settings"], where=str(arguments.calibration)
    )
    model, _, _ = read_fit(record, arm, arguments.calibration, cubic=True)
    extended = read_record(
        arguments.extended, EXTENDED, ("effects", "x", "targets_off_m"), campaign.name
    )
    baseline, model, x, T_instr_base = read_extended(
        extended, with_bends(model), arguments.extended
    )
    if extended.get("arrival_from_order"):
        table, _ = with_arrivals(table)
    poses = complete_about(
        observations(table, kind="holdout"),
        baseline,
        Baseline(model, x, T_instr_base),
        setting_of(campaign, arm, calibration, DiscoverySettings()),
    )
    coordinates = poses.by_apparatus.shape[2]
    places_m = read_vector(extended, "targets_off_m", coordinates, arguments.extended)
    T_base_ee = as_read(model.predict(poses.states, x), T_instr_base, poses, places_m)
    return judge(T_base_ee, T_instr_base, poses)


def _twist_record(found: HeldOut) -> dict[str, Any]:
    twist = found.tool_twist
    return {**asdict(twist), "rotation_deg": twist.rotation_deg.tolist()}


def _row_records(found: HeldOut, held_out: PoseObservations) -> list[dict[str, Any]]:
    return [
        {
            "pose": str(held_out.pose[k]),
            "load_N": float(held_out.states.load_N[k]),
            "position_mm": found.found.position_mm[k].tolist(),
            "rotation_deg": found.found.rotation_deg[k].tolist(),
        }
        for k in range(len(held_out))
    ]


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
