"""Stage `export`: a calibrated model as files for other programs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm
    from pa10cal.arm.urdf_writing import UrdfSource
    from pa10cal.fit.fitted import Fitted
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.fit.rigid import RigidError, RigidPart
    from pa10cal.observe.observations import Observations
    from pa10cal.results.calibration import CalibrationRecord


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
    from pa10cal.errors import ModelError, SettingsError
    from pa10cal.files.arms import maker_calibration, urdf_of_arm
    from pa10cal.files.coupling import coupling_in_words
    from pa10cal.fit.fitted import predicting_model
    from pa10cal.fit.model_writing import save_model
    from pa10cal.fit.rigid import beyond_rigid, dh_text, rigid_part
    from pa10cal.stages.inputs import read_calibrated, read_measured

    if poses is not None and campaign_dir is None:
        raise SettingsError(
            "a table of poses is read with the description of its campaign",
            where="--poses",
            value=str(poses),
            allowed="--poses together with --campaign-dir",
            remedy="give both, or neither of them",
        )
    record, models, _ = read_calibrated(calibration)
    *_, calibrated = models.values()
    exported, warnings = _exported_model(calibrated, record, extended)
    grade: str = record.health.grade
    line = record.health.line
    if (about := exported.fitted_to) is not None and about != calibrated.fitted_to:
        grade, line = about.grade, about.health  # the effects confirm what was suspected
    withheld = _is_withheld(record, grade, calibration, force=force)
    fitted = predicting_model(exported)  # tables and URDF are of the model that is used
    forced = f"exported with --force; {grade}: {line}" if withheld else None
    mark = f"forced {grade}" if withheld else grade  # in tables
    comments = [f"{record.campaign}, {record.provenance}", forced or f"{grade}: {line}"]
    if coupling := coupling_in_words(fitted.arm):
        comments.append(f"positions of its joints by what the controller counts (J): {coupling}")

    source: UrdfSource | None = None
    designed: Arm | None = fitted.arm
    if campaign_dir is not None:
        source = urdf_of_arm(record.robot, campaign_dir)
        by_maker = maker_calibration(record.robot, campaign_dir)
        designed = fitted.arm if by_maker is None else by_maker.designed
    part = rigid_part(fitted)
    part_comments, best, lines = [*comments], None, []
    best_urdf = urdf.with_name(f"{urdf.stem}_rigid_fit.urdf")
    if poses is not None and campaign_dir is not None:
        _, _, observations = read_measured(campaign_dir, poses)
        part_comments.append(beyond_rigid(fitted, observations))
        try:
            best = _best_rigid(fitted, part, observations)
        except ModelError as refusal:
            lines = [f"{best_urdf.name} is not written: {refusal.what}"]
        else:
            part_comments.append(str(best.error_of_part))
            lines = [
                f"{urdf.name}, the rigid part: {best.error_of_part}",
                f"{best_urdf.name}, geometry fitted for it: {best.error}",
            ]

    # All texts are made before the first is written; a file without a text that an earlier export
    # wrote is not there afterwards.
    texts: dict[Path, str | None] = {
        urdf: _urdf(part, source, fitted.arm.name, part_comments),
        best_urdf: None,
        model.with_name("ur_kinematics.yaml"): _ur_driver_text(part, part_comments),
        model.with_name("ur_calibration.conf"): _ur_controller_text(part, designed, part_comments),
    }
    if best is not None:
        best_comments = [*comments, _about_best_rigid(fitted, best)]
        texts[best_urdf] = _urdf(best.model, source, fitted.arm.name, best_comments)
    if dh is not None:
        best_dh = dh.with_name(f"{dh.stem}_rigid_fit.csv")
        texts[dh] = dh_text(fitted, mark, error=None if best is None else best.error_of_part)
        texts[best_dh] = None if best is None else dh_text(fitted, mark, best.model, best.error)
    lines += write_exported(texts, (urdf, dh))
    save_model(exported, model, forced=forced, warnings=list(warnings))
    print(f"{record.campaign}: model and URDF of the {record.load} calibration written")
    for line in lines:
        print(line)


#: What stands in the files that some exports write and others do not: others are a user's own.
_NOT_IN_IT = "what the last row departs by across its axis is not in it"
DEPARTURES = "departures of Denavit-Hartenberg rows from those of"
_BEST_RIGID = "the best rigid model: geometry alone"
_COLUMN_OF_ERROR = "error_rms_mm"


def write_exported(
    texts: Mapping[Path, str | None], asked_for: Collection[Path | None]
) -> list[str]:
    """Write texts, and remove files of texts that are no more (None) of an earlier export.

    Files of another origin stay, unless they are asked for by name; the lines returned name those
    that are not written for that.
    """
    from pa10cal.files.output import write_text

    lines = []
    for path, text in texts.items():
        if text is None:
            if _is_exported(path):
                path.unlink()
        elif path in asked_for or not path.exists() or _is_exported(path):
            write_text(path, text)
        else:
            lines.append(f"{path.name} is not written: a file of another origin is there")
    return lines


def _is_exported(path: Path) -> bool:
    """Return whether a file is there that an earlier export wrote."""
    with suppress(FileNotFoundError, UnicodeDecodeError):
        text = path.read_text(encoding="utf-8")
        return any(own in text for own in (_NOT_IN_IT, DEPARTURES, _BEST_RIGID, _COLUMN_OF_ERROR))
    return False


def _is_withheld(record: CalibrationRecord, grade: str, path: Path, *, force: bool) -> bool:
    """Return whether a model of a grade is exported by force alone; without force refuse it."""
    from pa10cal.errors import CalibrationError
    from pa10cal.results.calibration import UNRESERVED

    health, converged = record.health, record.status == "converged"
    withheld = not converged or grade not in UNRESERVED
    if withheld and not force:
        raise CalibrationError(
            f"a calibration of grade {health.grade} is not exported",
            where=f"{path}: health",
            value=health.line if converged else f"{record.status}: {record.reason}",
            allowed="good, few_poses or incomplete",
            remedy="follow the remedy in the line, or export it with --force",
        )
    return withheld


def _exported_model(
    calibrated: FittedModel, record: CalibrationRecord, extended: Path | None
) -> tuple[FittedModel, Sequence[str]]:
    """Return the model to export, and its warnings: the extended one where it adds anything."""
    from pa10cal.fit.fitted import predicting_model
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.inputs import read_extended

    if extended is not None:
        with_effects = read(ExtendedRecord, extended, record.campaign)
        model = read_extended(extended, record.campaign).model
        # Where effects hold nowhere, the field is in the model that it falls back to.
        if with_effects.adds_parameters or predicting_model(model).model.terms_of("field"):
            # The grade is that of the calibration to export, which may have these effects itself,
            # unless the effects confirm what was suspected of it.
            about = calibrated.fitted_to
            if about is not None and about.is_confirmed_as(model.fitted_to):
                about = model.fitted_to
            return replace(model, fitted_to=about), with_effects.warnings
    return calibrated, record.warnings


class _BestRigid(NamedTuple):
    """The rigid geometry that is nearest to a fitted model over the measured poses."""

    model: RigidPart
    error: RigidError  # of `model`
    error_of_part: RigidError  # of the model's own rigid part


def _best_rigid(fitted: Fitted, part: RigidPart, observations: Observations) -> _BestRigid:
    from pa10cal.fit.rigid import best_rigid_model

    best = best_rigid_model(fitted, observations)
    return _BestRigid(best, best.error(fitted, observations), part.error(fitted, observations))


def _about_best_rigid(fitted: Fitted, best: _BestRigid) -> str:
    """Return the comment that the URDF of the best rigid model begins with."""
    from pa10cal.fit.rigid import terms_beyond_rigid

    beyond = terms_beyond_rigid(fitted) or "all of the model: it is rigid"
    return (
        f"{_BEST_RIGID}, fitted by least squares to the whole model "
        f"with {beyond}; {best.error}; the rigid part alone (robot.urdf): "
        f"{best.error_of_part.rms_mm:.3f} mm rms"
    )


def _urdf(
    part: RigidPart, source: UrdfSource | None, arm_name: str, comments: Sequence[str]
) -> str:
    """Return rigid links as a URDF: the arm's own with calibrated origins, where it has one.

    A URDF whose joints lead to the arm's base and not from it cannot take its origins.
    """
    from pa10cal.arm.urdf_writing import patched_urdf, urdf_text

    if source is None or source.tree.turned:
        return urdf_text(part.chain, part.coordinates, arm_name, *comments, frames=part.frames)
    return patched_urdf(source, part.chain, part.coordinates, part.frames, *comments)


def _ur_driver_text(part: RigidPart, comments: Sequence[str]) -> str | None:
    """Return the kinematics file of Universal Robots' driver; None for an arm of another layout."""
    from pa10cal.arm.ur_calibration import flange_off_m, ur_kinematics

    off_mm = 1e3 * flange_off_m(part.chain, part.coordinates)
    lacks = f"{_NOT_IN_IT}: {off_mm:.3f} mm"
    return ur_kinematics(part.chain, part.coordinates, *comments, lacks)


def _ur_controller_text(
    part: RigidPart, designed: Arm | None, comments: Sequence[str]
) -> str | None:
    """Return the calibration file of Universal Robots' controller; None where it has no such rows.

    They are differences from the rows of the arm as designed, which has to be known.
    """
    from pa10cal.arm.ur_calibration import ur_deltas, ur_deltas_text, ur_layout

    layout = None if designed is None else ur_layout(designed)
    deltas = None if layout is None else ur_deltas(part.chain, part.coordinates, layout)
    if designed is None or deltas is None:
        return None
    return ur_deltas_text(
        deltas,
        *comments,
        f"{DEPARTURES} {designed.title}; no checksums, "
        "no calibration_status: those lines are of the controller's own file",
    )
