"""Wild trials: reproducible, disturbances where they mean something, in raw files."""

from collections import Counter

import numpy as np
import pytest

from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.lab.cell.campaign import simulate_campaign
from pa10cal.lab.cell.disturbances import DISTURBANCES, disturb
from pa10cal.lab.cell.options import DisturbanceOptions
from pa10cal.lab.cell.raw_log import RawLog
from pa10cal.lab.cell.trials import (
    TOUCHED,
    WILD_BENCHES,
    WILD_KINDS,
    draw_trials,
    subjects_of,
)
from pa10cal.lab.cell.write import campaign_description


def put_in(trial):
    return [entry.id for entry in trial.settings.disturbances]


def log_of(trial):
    made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
    return RawLog.of(campaign_description(made), made.tables, made.truth.robot.arm)


@pytest.mark.parametrize("kind", WILD_KINDS)
def test_the_same_seed_gives_the_same_trials_and_fewer_are_the_first_of_more(kind):
    trials = draw_trials(kind, 6, 1, "wild")
    assert draw_trials(kind, 4, 1, "wild") == trials[:4]
    assert not {trial.name for trial in trials} & {t.name for t in draw_trials(kind, 6, 2, "wild")}


def test_benches_and_subjects_take_turns():
    count = 1 + len(WILD_BENCHES)
    right = Counter(trial.bench for trial in draw_trials("right", count, 3, "wild"))
    assert right == dict.fromkeys([*(bench.name for bench in WILD_BENCHES), TOUCHED], 1)
    for kind in ("stressed", "fault"):
        subjects = subjects_of(kind)
        trials = draw_trials(kind, len(subjects), 3, "wild")
        assert [put_in(trial)[0] for trial in trials] == list(subjects)
    assert set(subjects_of("stressed")) | set(subjects_of("fault")) == set(DISTURBANCES)


def test_the_turn_of_subjects_stays_for_it_decides_what_a_seed_draws() -> None:
    """A published rate belongs to trials of a seed: classes that change places draw others."""
    assert subjects_of("stressed") == (
        *("link_masses_off", "heavy_tails", "random_walk", "temperature_ramp", "misstated_noise"),
        *("one_uncertainty", "gross_errors", "level_off", "unknown_tool"),
    )
    assert subjects_of("fault") == (
        *("joint_zero", "joint_sign", "joints_exchanged", "direction_reversed", "attitudes"),
        *("jump", "labels_exchanged", "poses_exchanged", "loads_exchanged", "load_misstated"),
        *("held_out_reading_off", "one_reading_off", "log_cut", "unit", "uncertainty_off"),
        *("gravity", "payload_off", "payload_centre_off", "length_typo", "places_exchanged"),
    )


def test_an_effect_hides_among_a_stressor():
    for trial in draw_trials("effect", 12, 3, "wild"):
        assert len(trial.settings.hidden_effects) == len(put_in(trial)) == 1
    for trial in draw_trials("beyond", 12, 3, "wild"):
        assert len(trial.settings.hidden_effects) == 1
        assert not put_in(trial)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_changes_the_raw_files_and_says_where(name):
    kind = "stressed" if DISTURBANCES[name].stressor else "fault"
    (trial,) = draw_trials(kind, 1, 5, "wild", only=name)
    clean, log = log_of(trial), log_of(trial)
    places = disturb(log, trial.settings.disturbances, trial.settings.random_seed)
    assert len(places) == 1
    assert places[0]
    changed = clean.description != log.description
    for key, table in clean.tables.items():
        changed = changed or not table.equals(log.tables[key])
    assert changed


def test_repeats_run_in_the_order_of_the_settings():
    for trial in draw_trials("right", 30, 7, "wild", [bench.name for bench in WILD_BENCHES]):
        made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
        schedule, plan = made.truth.schedule, trial.settings.without_touches
        grid = schedule.kind == "grid"
        runs = schedule.pose[grid].reshape(plan.repeats, -1)
        assert np.array_equal(
            schedule.repeat[grid].reshape(runs.shape)[:, 0], 1 + np.arange(plan.repeats)
        )
        back = [not np.array_equal(run, runs[0]) for run in runs]
        if plan.order == "there_there_back_back":
            assert back == [False] * (plan.repeats // 2 + plan.repeats % 2) + [True] * (
                plan.repeats // 2
            )
        if plan.order == "there_and_back":
            assert back == [number % 2 == 1 for number in range(plan.repeats)]
        assert all(sorted(run) == sorted(runs[0]) for run in runs)


def test_refuses_what_is_not_known():
    with pytest.raises(SettingsError, match="no such thing"):
        draw_trials("tame", 1, 1, "wild")
    with pytest.raises(SettingsError, match="no such thing"):
        draw_trials("fault", 1, 1, "wild", only="rust")
    with pytest.raises(SettingsError, match="does nothing at any of the benches"):
        draw_trials("fault", 1, 1, "wild", ["irb120-distance"], only="attitudes")
    (trial,) = draw_trials("right", 1, 1, "wild")
    with pytest.raises(SettingsError, match="unknown disturbance"):
        disturb(log_of(trial), (DisturbanceOptions(id="rust"),), 1)
