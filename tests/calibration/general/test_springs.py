"""Springs under weights that nobody stated stay where poses held out need them, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.general import springs
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import average_repeats
from pa10cal.observe.paths import along_a_path
from pa10cal_lab.cell.campaign import measure_campaign, robot_of
from pa10cal_lab.cell.effects.vocabulary import make_effects
from pa10cal_lab.cell.measured_trials import joint_bounds
from pa10cal_lab.cell.trials import draw_trials
from pa10cal_lab.cell.write import write_campaign

POSES = 600


def trial_of(number):
    """Return a trial of an arm of unstated masses."""
    return draw_trials("unstated_masses", 1, 20080427, "wild", first=number)[0]


def along(trial):
    """Return the trial with its poses along a path through twelve places."""
    plan, arm = trial.settings.without_touches, load_arm(trial.settings.robot)
    low, high = joint_bounds(arm)
    way = np.random.default_rng(trial.settings.random_seed).uniform(
        low + 0.2 * (high - low), high - 0.2 * (high - low), (12, arm.n)
    )
    q = CubicSpline(np.linspace(0, 1, 12), way)(np.linspace(0, 1, POSES)).clip(low, high)
    changes = {"commanded": tuple(map(tuple, np.degrees(q).round(4).tolist())), "poses": POSES}
    changes |= {"repeats": 1, "order": "same", "holdout_share": 0.0}
    settings = {"without_touches": plan.model_copy(update=changes)}
    return replace(trial, settings=trial.settings.model_copy(update=settings))


def measured(trial, folder):
    """Return the campaign of a trial."""
    settings = trial.settings
    robot = robot_of(load_arm(settings.robot), settings)
    effects = make_effects(settings.hidden_effects, robot)
    write_campaign(measure_campaign(trial.name, settings, robot, effects), folder / "raw")
    return read_campaign(folder / "raw")


def calibrated(trial, folder):
    """Return whether the poses follow a path, and the calibration of the trial."""
    campaign = measured(trial, folder)
    poses, payload = campaign.calibration, campaign.description.payload(campaign.arm)
    path = along_a_path(poses.states.q_rad[np.argsort(poses.states.time_s)])
    used = average_repeats(poses)
    start = find_start(campaign.arm, used)
    return path, calibrate_general(campaign.arm, used, start, payload)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("path", [False, True])
def test_springs_that_are_there_stay(tmp_path, path):
    trial = trial_of(8)
    hidden = {e.of for e in trial.settings.hidden_effects if e.id == "joint_compliance"}
    assert hidden == {"joint 3"}
    follows, found = calibrated(along(trial) if path else trial, tmp_path)
    assert follows is path
    assert 3 in found.springs
    assert 3 not in found.unproven


@pytest.mark.slow
def test_a_note_says_of_which_weights_torques_are(tmp_path):
    read = measured(trial_of(8), tmp_path)
    about = read.description, read.arm, read.observations
    case = LoadCase(*about, "combined", CalibrationOptions(), ())
    said = "torques were not logged: those of assumed weights are used"
    assert said in calibrated_record(case).warnings


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("path", [False, True])
def test_springs_that_stand_for_something_else_go_and_are_told(tmp_path, monkeypatch, path):
    trial = along(trial_of(3)) if path else trial_of(3)
    assert not any(each.id == "joint_compliance" for each in trial.settings.hidden_effects)
    follows, found = calibrated(trial, tmp_path / "judged")
    assert follows is path
    assert not found.springs
    assert found.unproven
    monkeypatch.setattr(springs, "predicts_unseen", lambda *_: True)
    _, unjudged = calibrated(trial, tmp_path / "unjudged")
    assert unjudged.springs == found.unproven
