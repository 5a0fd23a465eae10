"""Trials of drives: one campaign or a group of two, judged from the raw folders alone."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from pa10cal.calibration.campaign import calibrated
from pa10cal.calibration.load_case import COMBINED
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.read_group import read_group
from pa10cal.cell.campaign import measure_campaign, robot_of
from pa10cal.cell.drive_trials import campaigns_of
from pa10cal.cell.effects.vocabulary import make_effects
from pa10cal.cell.trials import Trial
from pa10cal.cell.write import write_campaign
from pa10cal.discovery.discover import discover
from pa10cal.discovery.records import verdict_keys
from pa10cal.discovery.setup import setup_of
from pa10cal.evaluation.blind_trial import DRIVES
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.files.arms import load_arm
from pa10cal.results.trials import (
    FailedTrialRecord,
    JudgedTrialRecord,
    TrialTruthRecord,
    TrialVerdictRecord,
)
from pa10cal.studies.trial_records import truth_record
from pa10cal.terms.joint_spring import JointSpring


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
