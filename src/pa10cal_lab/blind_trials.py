"""Blind trials: simulated raw campaigns, judged by the stages of an ordinary run.

The stages get raw folders and settings, nothing else. The truth of a trial, and how far each hidden
effect changes the residual, go into a record of their own that only the scoring reads.
"""

from __future__ import annotations

import io
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import orth
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.load_case import COMBINED, LoadCase
from pa10cal.campaign.read import read_campaign
from pa10cal.command_settings import ChainOptions, EvaluationOptions
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from pa10cal.fit.logged_torques import without_torque_errors
from pa10cal.fit.model_reading import models_of
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.stages.pipeline import CampaignFiles, Stage, stages
from pa10cal.terms.joint_spring import JointSpring
from pa10cal_lab import trial_records as records
from pa10cal_lab.blind_trial import DRIVES, TRACKED, WILD
from pa10cal_lab.cell.campaign import (
    SimulatedCampaign,
    measure_campaign,
    robot_of,
    simulate_campaign,
)
from pa10cal_lab.cell.disturbances import DISTURBANCES
from pa10cal_lab.cell.effects.vocabulary import make_effects
from pa10cal_lab.cell.instruments.instrument import Truth
from pa10cal_lab.cell.measured_trials import BACKGROUND, MIXED, SUBJECTS
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.scenario import Trial
from pa10cal_lab.cell.trials import DRIVE_KINDS, WILD_KINDS, campaigns_of
from pa10cal_lab.cell.write import Places as WrittenPlaces
from pa10cal_lab.cell.write import write_campaign


def try_trial(
    trial: Trial, options: ChainOptions
) -> tuple[records.TrialVerdictRecord, records.TrialTruthRecord]:
    """Return verdict and truth of a trial; where judging fails, the verdict is the failure.

    Args:
        options: how the campaign is judged, by a calibration of all its loads together.
    """
    options = _options(trial, options)
    calibration = None
    with tempfile.TemporaryDirectory() as place:
        began = time.process_time()
        folders, places = _write(trial, Path(place, "raw"))
        results, simulating = Path(place, "results", trial.name), time.process_time() - began
        try:
            began = time.process_time()
            calibration = calibrated_by_stages(folders, results, options)
            last = "evaluate" if trial.kind in WILD_KINDS else "discover"
            found, left_out = judged_by_stages(folders, results, calibration, options, last)
            seconds = time.process_time() - began
            verdict: records.TrialVerdictRecord = _judged(
                found, calibration, left_out, seconds=seconds, seconds_simulating=simulating
            )
        except Pa10calError as error:
            refused = calibration is None  # a refusal after calibration counts as a crash
            verdict = records.FailedTrialRecord(
                campaign=trial.name, failed=str(error), refused=refused
            )
        except Exception as error:
            verdict = records.FailedTrialRecord(campaign=trial.name, failed=_crash(error))
    return verdict, _truth(trial, places, calibration, options)


def _options(trial: Trial, options: ChainOptions) -> ChainOptions:
    """Return the options, without what verdicts do not depend on.

    Wild trials keep it: they try every command as a user runs it, and count failures.
    """
    changes: dict[str, Any] = {"evaluation": EvaluationOptions(calibration=COMBINED)}
    if trial.kind not in WILD_KINDS:
        changes["discovery"] = options.discovery.model_copy(update={"suggestions": 0})
    return options.model_copy(update=changes)


def _write(trial: Trial, raw: Path) -> tuple[tuple[Path, ...], WrittenPlaces]:
    """Write the raw campaigns of a trial: one, or for drives maybe two of one robot.

    Returns:
        The folders, and the places of the disturbances in the first.
    """
    settings = trial.settings
    robot = robot_of(load_arm(settings.robot), settings)
    effects = make_effects(settings.hidden_effects, robot)
    campaigns = campaigns_of(trial) if trial.kind in DRIVE_KINDS else (settings,)
    names = [f"{trial.name}-{number}" for number in range(len(campaigns))]
    names = names if len(names) > 1 else [trial.name]
    places = [
        write_campaign(measure_campaign(name, each, robot, effects), raw / name)
        for name, each in zip(names, campaigns, strict=True)
    ]
    return tuple(raw / name for name in names), places[0]


def _crash(error: Exception) -> str:
    """Return the text of an internal fault, with the place in the code."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{text} (in {Path(last.filename).name}, line {last.lineno})"


def _truth(
    trial: Trial,
    places: WrittenPlaces,
    calibration: CalibrationRecord | None,
    options: ChainOptions,
) -> records.TrialTruthRecord:
    """Return the truth of a trial: effects, disturbances, and how far each changes the residual.

    The change is the root mean square, over the fitted poses, of the difference between residuals
    of the calibrated model and those of a twin: the same campaign, noise included, without the
    effect. In trials like measured robots (`SUBJECTS`) springs of the calibrated model may absorb
    an effect: there the change is what the effect leaves after the geometry is fitted again. For
    drives it is not computed.
    """
    began, settings = time.process_time(), trial.settings
    arm, plan = load_arm(settings.robot), settings.without_touches
    twins = _without_each(settings, "hidden_effects")
    residual_mm: Sequence[float | None] = [None] * len(twins)
    partial_mm, noise_mm = residual_mm, None

    def moved_by(twin: SimulateOptions) -> float | None:
        """Return the change of the residual by what a twin lacks; None where it has no residual."""
        try:
            assert calibration is not None
            off_mm = calibration.residuals.position_mm - _residual_mm(trial.name, twin, options)
        except Exception:  # no calibration to compare with, or other poses were quarantined
            return None
        return float(np.sqrt(np.mean(np.sum(off_mm**2, axis=1))))

    if trial.kind in SUBJECTS:
        whole, *others = (simulate_campaign(trial.name, arm, twin) for twin in (settings, *twins))
        residual_mm, partial_mm, noise_mm = after_geometry(whole, others)
    elif trial.kind not in DRIVE_KINDS:
        residual_mm = [moved_by(twin) for twin in twins]
    put_in = []
    twins = _without_each(settings, "disturbances")
    for entry, where, twin in zip(settings.disturbances, places, twins, strict=True):
        disturbance = DISTURBANCES[entry.id]
        put_in.append(
            records.TrialDisturbance(
                id=disturbance.id,
                stressor=disturbance.stressor,
                kinds=disturbance.kinds,
                measured=disturbance.measured,
                where=where,
                moved_mm=moved_by(twin) if disturbance.measured else None,
            )
        )
    return records.TrialTruthRecord(
        campaign=trial.name,
        kind=trial.kind,
        measured=_study_of(trial),
        layout=trial.bench,
        path=settings.path if plan is None else "",
        temperature_drift_C=settings.temperature_drift_C,
        flexible_joints=(settings if plan is None else plan).flexible_joints,
        hidden_effects=tuple(
            records.HiddenEffect(
                **effect.model_dump(mode="json"),
                size=size,
                moved_mm=moved_mm,
                apart_mm=apart_mm,
                outside=None if trial.kind != MIXED else effect.id in BACKGROUND,
            )
            for effect, size, moved_mm, apart_mm in zip(
                settings.hidden_effects, trial.sizes, residual_mm, partial_mm, strict=True
            )
        ),
        put_in=tuple(put_in),
        stated_uncertainty_mm=settings.stated_uncertainty_mm,
        mass_factor=settings.mass_factor,
        seconds_twin=time.process_time() - began,
        noise_mm=noise_mm,
    )


def _study_of(trial: Trial) -> str:
    """Return the study of a trial, as `TrialTruthRecord.measured` has it."""
    if trial.kind in WILD_KINDS:
        return WILD
    if trial.kind in DRIVE_KINDS:
        return DRIVES
    return "touched" if trial.settings.without_touches is None else TRACKED


def _without_each(settings: SimulateOptions, key: str) -> list[SimulateOptions]:
    """Return, for each entry of a key, the settings without it."""
    entries = getattr(settings, key)
    return [
        settings.model_copy(update={key: (*entries[:k], *entries[k + 1 :])})
        for k in range(len(entries))
    ]


def _residual_mm(name: str, settings: SimulateOptions, options: ChainOptions) -> Array:
    """Return the residuals of positions of a calibrated campaign, (C, 3)."""
    with tempfile.TemporaryDirectory() as place:
        raw = Path(place, "raw", name)
        write_campaign(simulate_campaign(name, load_arm(settings.robot), settings), raw)
        if options.calibration.effects in ((), "named"):
            # Calibration as by the stages, but without checks of the input, and from one start if
            # that converges: others end at the same residuals.
            read, calibration = read_campaign(raw, options.ingest), options.calibration
            every = without_torque_errors(read.observations, read.arm)
            about = read.description, read.arm, every, COMBINED
            once = calibration.model_copy(update={"starts": 1})
            record = calibrated_record(LoadCase(*about, once), options.base_frame)
            if record.status != "converged":
                record = calibrated_record(LoadCase(*about, calibration), options.base_frame)
            return record.residuals.position_mm
        return calibrated_by_stages((raw,), raw.parents[1] / name, options).residuals.position_mm


# A campaign judged by the stages of an ordinary run, in files, in one process.


def calibrated_by_stages(
    folders: tuple[Path, ...], results: Path, options: ChainOptions
) -> CalibrationRecord:
    """Read a campaign, locate its base and calibrate it on all its loads.

    Args:
        folders: the raw folder; for a group those of its campaigns, which are read first.
        results: folder of the results; those of the campaigns of a group are beside it.
        options: how to ingest, to locate the base and to calibrate.

    Raises:
        Pa10calError: where a stage refuses.
    """
    if len(folders) > 1:
        for folder in folders:
            _run("seed", (folder,), results.with_name(folder.name), options)
    stage = _run("calibrate", folders, results, options)
    return read(CalibrationRecord, stage.writes["calibration"])


def judged_by_stages(
    folders: tuple[Path, ...],
    results: Path,
    calibration: CalibrationRecord,
    options: ChainOptions,
    last: str = "evaluate",
) -> tuple[VerdictRecord, tuple[str, ...]]:
    """Judge a campaign that `calibrated_by_stages` has calibrated, in the same folders.

    Args:
        folders, results, options: as given there.
        calibration: what it returned.
        last: the stage with which to end.

    Returns:
        The verdict, and the poses that have quarantined rows or are suspected outliers.
    """
    _run(last, folders, results, options, after="calibrate")
    left_out = {outlier.pose for outlier in getattr(calibration, "suspected_outliers", ())}
    for folder in folders:
        own = results if len(folders) == 1 else results.with_name(folder.name)
        left_out |= set(_quarantined(folder, CampaignFiles(own).quarantine))
    return read(VerdictRecord, CampaignFiles(results).verdict), tuple(sorted(left_out))


def _judged(
    verdict: VerdictRecord,
    calibration: CalibrationRecord,
    left_out: tuple[str, ...],
    **seconds: float,
) -> records.JudgedTrialRecord:
    """Return the record of a verdict on a trial, with the processor times that it took [s]."""
    *_, model = models_of(calibration, verdict.campaign).values()
    health = calibration.health
    return records.JudgedTrialRecord(
        **{name: getattr(verdict, name) for name in VerdictKeys.model_fields},
        **seconds,
        campaign=verdict.campaign,
        springs=tuple(term.joint for term in model.model.terms if isinstance(term, JointSpring)),
        health=records.TrialHealth(
            grade=health.grade,
            findings=tuple(f"{each.kind} of {each.where}" for each in health.findings),
            departures=tuple(each.place for each in health.departures),
            left_out=left_out,
        ),
    )


def _run(
    last: str, folders: tuple[Path, ...], results: Path, options: ChainOptions, after: str = ""
) -> Stage:
    """Run the stages of all loads together, without output, to the first stage of a command.

    Args:
        last: the command.
        after: the command whose first stage, and all before it, have run already.

    Returns:
        The last stage.
    """
    all_stages = list(stages(folders, results, options, load=COMBINED))
    commands = [stage.command for stage in all_stages]
    first = 1 + commands.index(after) if after else 0
    end = commands.index(last)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        for stage in all_stages[first : end + 1]:
            stage.run()
    return all_stages[end]


def _quarantined(raw: Path, listing: Path) -> Iterator[str]:
    """Yield the labels of the poses of quarantined rows."""
    rows = pd.read_csv(listing)
    for name in set(rows["file"]):
        path = raw / str(name)
        header = pd.read_csv(path, nrows=0).columns
        if "pose" not in header:
            continue
        labels = pd.read_csv(path, usecols=["pose"], dtype=str)["pose"]
        lines = rows.loc[rows["file"] == name, "line"].to_numpy() - 2
        yield from labels.iloc[lines[lines < len(labels)]]


# The part of an effect that no geometry can reproduce.
#
# It is computed from the truth: the difference of readings without noise, with the effect and
# without it, is projected off all small motions of the base, of every joint's frame and of the
# tool.

#: Singular value, relative to the largest, below which a motion is a combination of others.
_REDUNDANT = 1e-9


class AfterGeometry(NamedTuple):
    """Residuals of positions by each effect of a campaign, and by noise, root mean square."""

    residual_mm: tuple[float, ...]  # by each effect, after the geometry is fitted again
    partial_residual_mm: tuple[float, ...]  # after the sizes of all other effects are fitted too
    noise_mm: float  # by noise, averaged over repeats


def after_geometry(made: SimulatedCampaign, without: Sequence[SimulatedCampaign]) -> AfterGeometry:
    """Return the residuals by the effects of a campaign after its geometry is fitted again.

    Args:
        made: the campaign of a tracker.
        without: for each of its effects, the campaign without that effect.
    """
    plan, truth = made.settings.without_touches, made.truth
    if plan is None:
        raise ValueError("touched balls are not refitted here")
    schedule, mechanism = truth.schedule, truth.robot.mechanism
    rows = np.flatnonzero((schedule.kind == "grid") & (schedule.repeat == 1))  # each pose once
    turns = plan.instrument == "pose"

    def as_read(truth: Truth) -> tuple[Array, Array]:
        """Return positions (P, B, 3) [m] and orientations, in the base's frame, without noise."""
        T, robot = truth.rest.T_base_ee[rows], truth.robot
        on_tool_m = robot.T_ee_target[None, :3, 3] if turns else robot.targets.p_ee_m
        along_m = on_tool_m + truth.tool_shift_m[rows, None]
        p_m = np.einsum("pij,pbj->pbi", T[:, :3, :3], along_m) + T[:, None, :3, 3]
        R, t_m = robot.T_instr_base[:3, :3], robot.T_instr_base[:3, 3]
        return (truth.as_read(p_m @ R.T + t_m) - t_m) @ R, T[:, :3, :3]

    p_m, R = as_read(truth)

    def stacked(moved_m: Array, turned: Array) -> Array:
        """Return positions (P, B, 3, k) and rotations (P, 3, k) as k columns, over their noise."""
        columns = [1e3 / plan.position_mm * moved_m.reshape(-1, moved_m.shape[-1])]
        if turns:
            columns.append(turned.reshape(-1, moved_m.shape[-1]) / plan.attitude_rad)
        return np.concatenate(columns)

    def moved_with(T: Array) -> tuple[Array, Array]:
        """Return the derivatives of positions (P, B, 3, 6) and orientations (P, 3, 6) by frames.

        They are by rotations about the axes of frames T (P, 4, 4), then by shifts along these.
        """
        axes = T[:, :3, :3]
        lever_m = p_m - T[:, None, :3, 3]
        turned = np.cross(axes[:, None], lever_m[..., None], axisa=2, axisb=2, axisc=2)
        shifted = np.broadcast_to(axes[:, None], turned.shape)
        return np.concatenate([turned, shifted], -1), np.concatenate([axes, 0.0 * axes], -1)

    def difference(twin: SimulatedCampaign) -> Array:
        """Return the difference of readings from those of a twin, as a column."""
        other_m, R_other = as_read(twin.truth)
        turned = Rotation.from_matrix(R @ R_other.transpose(0, 2, 1), assume_valid=True).as_rotvec()
        return stacked((p_m - other_m)[..., None], turned[..., None])[:, 0]

    def position_mm(difference: Array) -> float:
        """Return the root mean square of the positions in a column."""
        p_mm = difference[: p_m.size] * plan.position_mm
        return float(np.sqrt(3.0 * np.mean(p_mm**2)))

    frames = mechanism.T_base_joints(truth.rest.q[rows])
    base = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
    basis = _basis(np.hstack([stacked(*moved_with(T)) for T in (base, *frames)]))
    residual = [_projected_off(difference(twin), basis) for twin in without]
    partial = []
    for k, of_effect in enumerate(residual):
        others = _basis(np.column_stack([basis, *residual[:k], *residual[k + 1 :]]))
        partial.append(_projected_off(of_effect, others))
    noise_mm2 = 3.0 * plan.position_mm**2
    off_mm = 1e3 * np.hypot(plan.unseen_rad, plan.resolver_rad)  # of links about their motors
    for slides, T in zip(mechanism.slides, frames, strict=True):
        along_z = moved_with(T)[0][..., 5 if slides else 2]
        noise_mm2 += float(np.mean(np.sum((off_mm * along_z) ** 2, axis=-1)))
    return AfterGeometry(
        tuple(map(position_mm, residual)),
        tuple(map(position_mm, partial)),
        float(np.sqrt(noise_mm2 / plan.repeats)),
    )


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of the span of columns, whatever their scales."""
    length = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, length > 0.0] / length[length > 0.0], rcond=_REDUNDANT))


def _projected_off(difference: Array, basis: Array) -> Array:
    """Return the part of a column that is orthogonal to an orthonormal basis."""
    return np.asarray(difference - basis @ (basis.T @ difference))
