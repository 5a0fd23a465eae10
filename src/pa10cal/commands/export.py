"""Command `export`."""

from __future__ import annotations

from pathlib import Path


def export(
    *,
    calibration: Path,
    model: Path,
    urdf: Path,
    campaign_dir: Path | None = None,
    extended: Path | None = None,
) -> None:
    """Write a calibrated model for other programs: model.yaml and robot.urdf.

    Args:
        calibration: calibration to export (.json).
        model: model.yaml to write.
        urdf: robot.urdf to write.
        campaign_dir: folder that may hold a description of the arm.
        extended: model with the effects that discovery named (.json).
    """
    import numpy as np
    import yaml

    from pa10cal.arm.state import PoseStates
    from pa10cal.arm.urdf import urdf_text
    from pa10cal.errors import CalibrationError
    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_text
    from pa10cal.files.schemas import EXTENDED, MODEL
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import read
    from pa10cal.stages.calibration_record import read_fit
    from pa10cal.stages.records import read_pose_matrix, read_record, read_vector

    record = read(CalibrationRecord, calibration)
    if record.status != "converged":
        raise CalibrationError(
            "a fit that did not converge is not exported",
            where=str(calibration),
            value=record.status,
            allowed="converged",
            remedy="raise calibration.max_iterations, or look at its warnings",
        )
    if record.health.verdict == "not usable":
        raise CalibrationError(
            "a calibration that is not usable is not exported",
            where=f"{calibration}: health",
            value=record.health.line,
            allowed="good or usable",
            remedy="do what the line says",
        )
    arm = load_arm(record.robot, campaign_dir)
    fitted, x, T_instr_base = read_fit(record, arm, calibration, cubic=True)
    parameters, effects, warnings = (
        {name: each.model_dump() for name, each in record.parameters.items()},
        [],
        list(record.warnings),
    )
    if extended is not None:
        with_effects = read_record(
            extended,
            EXTENDED,
            ("effects", "named", "parameters", "warnings"),
            record.campaign,
        )
        # With nothing missing the calibrated model stays as it is.
        if with_effects["effects"]:
            x = read_vector(with_effects, "x", len(x), extended)
            T_instr_base = read_pose_matrix(with_effects, "T_instr_base", extended)
            parameters, effects = with_effects["parameters"], with_effects["named"]
            warnings = with_effects["warnings"]
    zeros, zero = np.zeros((1, arm.n)), np.zeros(1)
    unloaded = PoseStates(zeros, zeros, zeros, zero, zero, zero)
    content = {
        "schema": MODEL,
        "campaign": record.campaign,
        "provenance": record.provenance,
        "robot": arm.name,
        "calibration": record.load,
        "parameters": parameters,
        "T_instr_base": T_instr_base.tolist(),
        "effects": effects,
        "warnings": warnings,
    }
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    write_text(urdf, urdf_text(fitted.chain, fitted.chain_coordinates(unloaded, x)[0], arm.name))
    write_text(model, text)
    print(f"{record.campaign}: model and URDF of the {record.load} calibration written")
