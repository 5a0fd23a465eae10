"""Stage `export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.fit.rigid import RigidPart


def export(
    *,
    calibration: Path,
    model: Path,
    urdf: Path,
    dh: Path | None = None,
    extended: Path | None = None,
    campaign_dir: Path | None = None,
    poses: Path | None = None,
    force: bool = False,
) -> None:
    """Write a calibrated model for other programs: model.yaml, robot.urdf and its rows as a table.

    `robot.urdf` is the rigid part of the model. With it comes the best rigid model
    (`robot_rigid_fit.urdf`, `dh_rigid_fit.csv`): its geometry alone is fitted to the whole model
    over the measured poses with their loads. Each file states its error over these poses. Where the
    arm was imported from a URDF, that URDF is written with calibrated origins. An arm of Universal
    Robots' layout gets the file of kinematics that their driver reads, beside the model.

    Args:
        calibration: calibration to export (.json).
        model: model.yaml to write.
        urdf: robot.urdf to write.
        dh: rows of the arm to write, nominal and calibrated (.csv).
        extended: model with the effects that discovery named (.json).
        campaign_dir: folder of raw files, which may hold the arm's own URDF.
        poses: table of poses, over which the URDF's lack of springs and effects is stated
            (.parquet).
        force: export a calibration that is neither good nor few_poses nor incomplete; the files
            are marked.

    Examples:
        pa10cal export --calibration calibration/combined.json --extended extended.json \\
          --model model.yaml --urdf robot.urdf
    """
    from pa10cal.arm.exports import patched_urdf, urdf_text
    from pa10cal.arm.ur_calibration import (
        flange_off_m,
        ur_deltas,
        ur_deltas_text,
        ur_kinematics,
        ur_layout,
    )
    from pa10cal.errors import CalibrationError, ModelError
    from pa10cal.files.arms import maker_calibration, urdf_of_arm
    from pa10cal.files.coupling import coupling_in_words
    from pa10cal.files.output import write_text
    from pa10cal.fit.fitted_model import save_model
    from pa10cal.fit.rigid import (
        best_rigid_model,
        beyond_rigid,
        dh_text,
        rigid_part,
        terms_beyond_rigid,
    )
    from pa10cal.results.calibration import UNRESERVED
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.inputs import read_calibrated, read_extended, read_measured

    record, models, _ = read_calibrated(calibration)
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
    *_, fitted = models.values()
    warnings = record.warnings
    if extended is not None:
        with_effects = read(ExtendedRecord, extended, record.campaign)
        model_with_them = read_extended(extended, record.campaign).model
        # With nothing missing the calibrated model stays as it is.
        if with_effects.named or model_with_them.model.terms_of("field"):
            # The grade is that of the calibration to export, which may have these effects itself.
            fitted = replace(model_with_them, fitted_to=fitted.fitted_to)
            warnings = with_effects.warnings
    grade = f"{health.grade}: {health.line}"
    forced = f"exported with --force; {grade}" if withheld else None
    source = None if campaign_dir is None else urdf_of_arm(record.robot, campaign_dir)
    comments = [f"{record.campaign}, {record.provenance}", forced or grade]
    if counted := coupling_in_words(fitted.arm):
        comments.append(f"positions of its joints by what the controller counts (J): {counted}")
    part = rigid_part(fitted)
    at = part.chain, part.coordinates

    def urdf_of(links: RigidPart, *about: str) -> str:
        if source is None:
            placed = links.chain, links.coordinates, fitted.arm.name
            return urdf_text(*placed, *about, frames=links.frames)
        return patched_urdf(source, links.chain, links.coordinates, links.frames, *about)

    error, best_text, best_dh, lines = None, None, None, []
    mark = "forced " * withheld + health.grade
    best_urdf = urdf.with_name(f"{urdf.stem}_rigid_fit.urdf")
    if poses is not None and campaign_dir is not None:
        _, _, every = read_measured(campaign_dir, poses)
        beyond = beyond_rigid(fitted, every)
        try:
            error, best = part.error(fitted, every), best_rigid_model(fitted, every)
            of_best = best.error(fitted, every)
        except ModelError as refusal:
            lines.append(f"{best_urdf.name} is not written: {refusal.what}")
            comments.append(beyond)
        else:
            kept = terms_beyond_rigid(fitted) or "all of the model: it is rigid"
            about = (
                "the best rigid model: geometry alone, fitted by least squares to the whole model "
                f"with {kept}; {of_best}; the rigid part alone (robot.urdf): {error.rms_mm:.3f} mm "
                "rms"
            )
            best_text = urdf_of(best, *comments, about)
            best_dh = dh_text(fitted, mark, best, of_best)
            lines += [f"{urdf.name}, the rigid part: {error}"]
            lines += [f"{best_urdf.name}, geometry fitted for it: {of_best}"]
            comments += [beyond, str(error)]
    text = urdf_of(part, *comments)
    off_mm = 1e3 * flange_off_m(*at)
    lacks = f"what the last row departs by across its axis is not in it: {off_mm:.3f} mm"
    of_driver = ur_kinematics(*at, *comments, lacks)
    beside = model.with_name("ur_kinematics.yaml")
    calibrated = None if campaign_dir is None else maker_calibration(record.robot, campaign_dir)
    designed = fitted.arm if calibrated is None else calibrated.designed
    layout = None if designed is None else ur_layout(designed)
    deltas = None if layout is None else ur_deltas(*at, layout)
    of_controller = None
    if designed is not None and deltas is not None:
        of_controller = ur_deltas_text(
            deltas,
            *comments,
            f"departures of Denavit-Hartenberg rows from those of {designed.title}; no checksums, "
            "no calibration_status: those lines are of the controller's own file",
        )
    write_text(urdf, text)
    if dh is not None:
        write_text(dh, dh_text(fitted, mark, error=error))
        _written_or_gone(dh.with_name(f"{dh.stem}_rigid_fit.csv"), best_dh)
    _written_or_gone(best_urdf, best_text)
    _written_or_gone(beside, of_driver)
    _written_or_gone(model.with_name("ur_calibration.conf"), of_controller)
    save_model(fitted, model, forced=forced, warnings=list(warnings))
    print(f"{record.campaign}: model and URDF of the {record.load} calibration written")
    print(*lines, sep="\n", end="\n" * bool(lines))


def _written_or_gone(path: Path, text: str | None) -> None:
    """Write a file that not every model has; one of an earlier model goes."""
    from pa10cal.files.output import write_text

    if text is None:
        path.unlink(missing_ok=True)
    else:
        write_text(path, text)
