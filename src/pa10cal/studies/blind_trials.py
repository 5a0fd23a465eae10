"""Blind trials: hidden in raw campaigns, judged from these alone.

What judges is given the folder of the raw campaign and nothing else. What is hidden goes from the
trial straight into a record of its own, which the scoring alone reads.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Literal, cast

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.campaign import calibrated
from pa10cal.calibration.load_case import COMBINED
from pa10cal.campaign.read import read_campaign, read_group
from pa10cal.cell.campaign import measure_campaign, robot_of, simulate_campaign
from pa10cal.cell.drive_trials import DRIVE_KINDS, DriveKind, campaigns_of, draw_drive_trials
from pa10cal.cell.effects.vocabulary import make_effects
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.tracker_trials import BENCHES, REFLECTORS, draw_tracker_trials
from pa10cal.cell.trials import LAYOUTS, Trial, TrialKind, draw_trials
from pa10cal.cell.wild_trials import WILD_KINDS, WildKind, draw_wild_trials
from pa10cal.cell.write import write_campaign
from pa10cal.discovery.discover import discover
from pa10cal.discovery.preparation import setup_of
from pa10cal.discovery.records import verdict_keys
from pa10cal.errors import SettingsError
from pa10cal.evaluation.blind_trial import DRIVES
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.files.arms import load_arm
from pa10cal.results.trials import (
    FailedTrialRecord,
    JudgedTrialRecord,
    TrialTruthRecord,
    TrialVerdictRecord,
)
from pa10cal.studies.judging import CalibratedCampaign, calibrated_campaign
from pa10cal.studies.trial_records import truth_record
from pa10cal.studies.wild_trials import try_wild_trial
from pa10cal.terms.joint_spring import JointSpring

Measured = Literal["touched", "tracked", "points_one", "points_three", "distance", "wild", "drives"]


def draw(
    measured: Measured,
    kind: str,
    count: int,
    random_seed: int,
    layouts: str = "",
    size: float | None = None,
) -> tuple[Trial, ...]:
    """Draw trials of touched balls with repeats, of trackers without, or wild ones of either.

    `points_one`, `points_three` and `distance` are of trackers, too: of so many targets, or of one
    distance. `drives` are sensors and gears that err.

    Args:
        measured: which of these.
        kind: what they hide.
        count: how many.
        random_seed: draws them.
        layouts: layouts of touched balls, or arms under instruments, with commas between them;
            empty for all.
        size: factor of the usual size of all effects; None draws it; not of wild ones.

    Raises:
        SettingsError: for a kind or a layout that does not exist, or no trial at all.
    """
    if count < 1:
        raise SettingsError(
            "no trial to run",
            where="--count",
            value=count,
            allowed="1 or more",
            remedy="request more trials",
        )
    names = layouts.split(",") if layouts else []
    if measured == DRIVES:
        return draw_drive_trials(cast(DriveKind, kind), count, random_seed)
    if measured == "wild":
        return draw_wild_trials(cast(WildKind, kind), count, random_seed, names)
    study = measured if measured in REFLECTORS else ""
    benches = {bench.name: bench for bench in REFLECTORS.get(study, BENCHES)}
    known = LAYOUTS if measured == "touched" else benches
    if unknown := sorted(set(names) - set(known)):
        raise SettingsError(
            "no such layout of poses",
            where="--layouts",
            value=unknown[0],
            allowed=", ".join(known),
            remedy="correct the name",
        )
    if measured != "touched":
        chosen = [benches[name] for name in names or benches]
        return draw_tracker_trials(cast(TrialKind, kind), count, random_seed, chosen, size, study)
    order = [layout for name in names or LAYOUTS for layout in LAYOUTS if layout == name]
    return draw_trials(cast(TrialKind, kind), count, random_seed, order, size)


def try_trial(trial: Trial, options: JudgingOptions) -> tuple[TrialVerdictRecord, TrialTruthRecord]:
    """Return verdict and truth of a trial; a verdict may be what went wrong: none is dropped."""
    if trial.kind in WILD_KINDS:
        return try_wild_trial(trial, options)
    if trial.kind in DRIVE_KINDS:
        return try_drive_trial(trial, options)
    moved_mm: list[float | None] = [None] * len(trial.sizes)
    seconds = 0.0
    began = time.process_time()
    try:
        known = _measured(trial.name, trial.settings, options)
        simulating = time.process_time() - began - known.seconds
        verdict: TrialVerdictRecord = known.verdict(simulating)
        began = time.process_time()
        moved_mm = [
            _moved_mm(trial, number, known.residual_mm, options)
            for number in range(len(trial.sizes))
        ]
        seconds = time.process_time() - began
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        verdict = FailedTrialRecord(campaign=trial.name, failed=message)
    return verdict, truth_record(trial, moved_mm, seconds)


def _measured(name: str, cell: SimulateOptions, options: JudgingOptions) -> CalibratedCampaign:
    """Write a raw campaign without the record of what it hides, and calibrate with that."""
    made = simulate_campaign(name, load_arm(cell.robot), cell)
    with tempfile.TemporaryDirectory() as place:
        write_campaign(made, Path(place) / "raw")
        return calibrated_campaign(Path(place) / "raw", options)


def _moved_mm(trial: Trial, number: int, residual_mm: Array, options: JudgingOptions) -> float:
    """Return how far one of the hidden effects moves the residual of the calibrated baseline.

    Root mean square over the poses fitted of the difference to the same campaign, noise and all,
    without this effect. For the scoring alone: no verdict sees it.
    """
    effects = trial.settings.hidden_effects
    others = (*effects[:number], *effects[number + 1 :])
    without = trial.settings.model_copy(update={"hidden_effects": others})
    moved_mm = residual_mm - _measured(trial.name, without, options).residual_mm
    return float(np.sqrt(np.mean(np.sum(moved_mm**2, axis=1))))


# Trials of drives: one campaign or a group of two, judged from the raw folders alone.


def try_drive_trial(
    trial: Trial, options: JudgingOptions
) -> tuple[TrialVerdictRecord, TrialTruthRecord]:
    """Return verdict and truth of a trial; a verdict may be what went wrong: none is dropped."""
    with tempfile.TemporaryDirectory() as place:
        began = time.process_time()
        folders = _write(trial, Path(place))
        simulating = time.process_time() - began
        try:
            verdict: TrialVerdictRecord = _judged(trial.name, folders, options, simulating)
        except Exception as error:
            message = " ".join(f"{type(error).__name__}: {error}".split())
            verdict = FailedTrialRecord(campaign=trial.name, failed=message)
    return verdict, truth_record(trial, [None] * len(trial.sizes), 0.0, DRIVES)


def _write(trial: Trial, place: Path) -> list[Path]:
    """Measure one robot in every campaign, and return their raw folders."""
    arm, folders = load_arm(trial.settings.robot), []
    robot = robot_of(arm, trial.settings)
    effects = make_effects(trial.settings.hidden_effects, robot)
    for number, settings in enumerate(campaigns_of(trial)):
        name = f"{trial.name}-{number}"
        write_campaign(measure_campaign(name, settings, robot, effects), place / name)
        folders.append(place / name)
    return folders


def _judged(
    name: str, folders: list[Path], options: JudgingOptions, simulating: float
) -> JudgedTrialRecord:
    """Return the verdict on a campaign, or on the group of several."""
    began = time.process_time()
    if len(folders) == 1:
        campaign = read_campaign(folders[0], options.ingest)
    else:
        campaign = read_group(folders, name, options.ingest)
    about = campaign.description, campaign.arm, campaign.observations
    model = calibrated(*about, COMBINED, options.calibration)
    setup = setup_of(campaign.description, campaign.arm, options.calibration, options.discovery)
    found = discover(campaign.observations, model, setup, campaign.wrong_rows)
    return JudgedTrialRecord(
        **dict(verdict_keys(found)),
        campaign=name,
        springs=tuple(term.joint for term in model.model.terms if isinstance(term, JointSpring)),
        seconds=time.process_time() - began,
        seconds_simulating=simulating,
    )
