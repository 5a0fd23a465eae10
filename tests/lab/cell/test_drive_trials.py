"""Trials of drives: what they hide, and in which campaigns."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.errors import SettingsError
from pa10cal_lab.cell.trials import (
    DRIVE_BENCHES,
    DRIVE_KINDS,
    DRIVE_POSES,
    campaigns_of,
    draw_trials,
)

IDS = {
    "sensor": {"sensor_error"},
    "gear": {"gear_error"},
    "both": {"sensor_error", "gear_error"},
    "neither": {"motor_ripple"},
}


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_benches_of_drives_take_turns_and_a_motor_has_one_ripple(kind):
    trials = draw_trials(kind, 6, 1, "drives")
    assert [trial.bench for trial in trials[:4]] == [bench.name for bench in DRIVE_BENCHES]
    for trial in trials:
        hidden = trial.settings.hidden_effects
        assert {each.id for each in hidden} == IDS[kind]
        assert len({each.parameters["ratio"] for each in hidden}) == 1
        for of in {each.of for each in hidden}:
            ripples = [any(each.parameters["ripple"]) for each in hidden if each.of == of]
            assert sum(ripples) == 1  # a motor has one


def test_a_drive_has_the_gear_ratio_that_is_stated_of_its_joint(monkeypatch):
    ratios = np.array([np.nan, 101.0, 80.0, 120.0, 100.0, 50.0])
    bench = DRIVE_BENCHES[0]
    monkeypatch.setitem(bench.__dict__, "arm", replace(bench.arm, gear_ratio=ratios))
    for trial in draw_trials("gear", 6, 1, "drives", [bench.name]):
        for each in trial.settings.hidden_effects:
            stated = ratios[int(each.of.removeprefix("joint ")) - 1]
            assert np.isnan(stated) or each.parameters["ratio"] == stated


def test_campaigns_are_of_one_robot_in_poses_and_noise_of_their_own():
    for trial in draw_trials("sensor", 4, 3, "drives"):
        each = campaigns_of(trial)
        assert len(each) == int(trial.bench[-1])
        plans = [settings.without_touches for settings in each]
        assert DRIVE_POSES[0] - 4 <= sum(plan.poses for plan in plans) <= DRIVE_POSES[1] + 4
        assert len({settings.random_seed for settings in each}) == len(each)
        assert len({plan.commanded[0] for plan in plans}) == len(each)
        assert all(s.hidden_effects == trial.settings.hidden_effects for s in each)
        q = np.array(plans[0].commanded)
        stays = np.mean(np.diff(q, axis=0) == 0.0)
        assert 0.1 < stays < 0.3
        if trial.bench == "ur10-1":
            assert np.ptp(q) > 700.0  # more than one turn


def test_refuses_another_kind_of_drives():
    with pytest.raises(SettingsError, match="sensor, gear, both, neither"):
        draw_trials("motor", 1, 1, "drives")
