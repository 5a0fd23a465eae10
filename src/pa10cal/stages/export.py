"""Stage: the calibrated model as `model.yaml` and `robot.urdf`, for other programs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("export", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--campaign-dir", type=Path, help="where the arm may be described")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration to export")
    parser.add_argument("--extended", type=Path, help="model with the effects that were missing")
    parser.add_argument("--model", type=Path, required=True, help="model.yaml to write")
    parser.add_argument("--urdf", type=Path, required=True, help="robot.urdf to write")


def _run(arguments: argparse.Namespace) -> None:
    import numpy as np
    import yaml

    from pa10cal.arm.state import PoseStates
    from pa10cal.arm.urdf import urdf_text
    from pa10cal.errors import CalibrationError
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_text
    from pa10cal.files.schemas import CALIBRATION, EXTENDED, MODEL
    from pa10cal.stages.calibration_record import read_fit
    from pa10cal.stages.records import read_pose_matrix, read_record, read_vector

    record = read_record(arguments.calibration, CALIBRATION, ("parameters", "robot", "status"))
    if record["status"] != "converged":
        raise CalibrationError(
            "a fit that did not converge is not exported",
            where=str(arguments.calibration),
            value=record["status"],
            allowed="converged",
            remedy="raise calibration.max_iterations, or look at its warnings",
        )
    health = record.get("health", {})
    if health.get("verdict") == "not usable":
        raise CalibrationError(
            "a calibration that is not usable is not exported",
            where=f"{arguments.calibration}: health",
            value=health["line"],
            allowed="good or usable",
            remedy="do what the line says",
        )
    arm = load_arm(record["robot"], arguments.campaign_dir)
    model, x, T_instr_base = read_fit(record, arm, arguments.calibration, cubic=True)
    parameters, effects, warnings = record["parameters"], [], record["warnings"]
    if arguments.extended is not None:
        extended = read_record(
            arguments.extended,
            EXTENDED,
            ("effects", "named", "parameters", "warnings"),
            record["campaign"],
        )
        # With nothing missing the calibrated model stays as it is.
        if extended["effects"]:
            x = read_vector(extended, "x", len(x), arguments.extended)
            T_instr_base = read_pose_matrix(extended, "T_instr_base", arguments.extended)
            parameters, effects = extended["parameters"], extended["named"]
            warnings = extended["warnings"]
    zeros, zero = np.zeros((1, arm.n)), np.zeros(1)
    unloaded = PoseStates(zeros, zeros, zeros, zero, zero, zero)
    urdf = urdf_text(model.chain, model.chain_coordinates(unloaded, x)[0], arm.name)
    content = {
        "schema": MODEL,
        "campaign": record["campaign"],
        "provenance": record["provenance"],
        "robot": arm.name,
        "calibration": record["load"],
        "parameters": parameters,
        "T_instr_base": T_instr_base.tolist(),
        "effects": effects,
        "warnings": warnings,
    }
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    write_text(arguments.urdf, urdf)
    write_text(arguments.model, text)
    print(f"{record['campaign']}: model and URDF of the {record['load']} calibration written")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
