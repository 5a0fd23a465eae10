"""Command `export`."""

from __future__ import annotations

from pathlib import Path


def export(
    *,
    calibration: Path,
    model: Path,
    urdf: Path,
    extended: Path | None = None,
    force: bool = False,
) -> None:
    """Write a calibrated model for other programs: model.yaml and robot.urdf.

    Args:
        calibration: calibration to export (.json).
        model: model.yaml to write.
        urdf: robot.urdf to write.
        extended: model with the effects that discovery named (.json).
        force: export a calibration that is neither good nor few_poses nor incomplete; the files
            are marked.

    Examples:
        pa10cal export --calibration calibration/combined.json --extended extended.json \\
          --model model.yaml --urdf robot.urdf
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
    from pa10cal.results.health import UNRESERVED

    record = read(CalibrationRecord, calibration)
    health = record.health
    converged = record.status == "converged"
    withheld = not converged or health.grade not in UNRESERVED
    if withheld and not force:
        raise CalibrationError(
            f"a calibration of grade {health.grade} is not exported",
            where=f"{calibration}: health",
            value=health.line if converged else f"{record.status}: {record.reason}",
            allowed="good, few_poses or incomplete",
            remedy="follow the remedy in the line, or export it with --force",
        )
    *_, fitted = models_of(record, str(calibration)).values()
    warnings = record.warnings
    if extended is not None:
        with_effects = read(ExtendedRecord, extended, record.campaign)
        # With nothing missing the calibrated model stays as it is.
        if with_effects.named:
            fitted = read_extended(extended, record.campaign).model
            warnings = with_effects.warnings
    grade = f"{health.grade}: {health.line}"
    forced = f"exported with --force; {grade}" if withheld else None
    write_text(urdf, urdf_text(*fitted.rigid_part(), fitted.arm.name, forced or grade))
    save_model(fitted, model, forced=forced, warnings=list(warnings))
    print(f"{record.campaign}: model and URDF of the {record.load} calibration written")
