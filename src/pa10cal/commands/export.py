"""Command `export`."""

from __future__ import annotations

from pathlib import Path


def export(
    *,
    calibration: Path,
    model: Path,
    urdf: Path,
    extended: Path | None = None,
) -> None:
    """Write a calibrated model for other programs: model.yaml and robot.urdf.

    Args:
        calibration: calibration to export (.json).
        model: model.yaml to write.
        urdf: robot.urdf to write.
        extended: model with the effects that discovery named (.json).
    """
    from pa10cal.arm.urdf import urdf_text
    from pa10cal.calibration.records import models_of
    from pa10cal.commands.extended import read_extended
    from pa10cal.errors import CalibrationError
    from pa10cal.files.output import write_text
    from pa10cal.fit.model_file import save_model
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord

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
            remedy="follow the remedy given in health.line",
        )
    *_, fitted = models_of(record, str(calibration)).values()
    warnings = record.warnings
    if extended is not None:
        with_effects = read(ExtendedRecord, extended, record.campaign)
        # With nothing missing the calibrated model stays as it is.
        if with_effects.named:
            fitted = read_extended(extended, record.campaign).model
            warnings = with_effects.warnings
    write_text(urdf, urdf_text(*fitted.rigid_part(), fitted.arm.name))
    save_model(fitted, model, warnings=list(warnings))
    print(f"{record.campaign}: model and URDF of the {record.load} calibration written")
