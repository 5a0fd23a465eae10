"""Command `export`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pa10cal.results.accuracy import Parameter


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
    from pa10cal.files.schemas import MODEL
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.calibration_record import read_fit

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
        _plain(record.parameters),
        [],
        list(record.warnings),
    )
    if extended is not None:
        with_effects = read(ExtendedRecord, extended, record.campaign)
        # With nothing missing the calibrated model stays as it is.
        if with_effects.effects:
            x, T_instr_base = with_effects.x, with_effects.T_instr_base
            parameters = _plain(with_effects.parameters)
            effects = [each.model_dump(mode="json") for each in with_effects.named]
            warnings = list(with_effects.warnings)
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


def _plain(parameters: Mapping[str, Parameter]) -> dict[str, dict[str, Any]]:
    return {name: parameter.model_dump(mode="json") for name, parameter in parameters.items()}
