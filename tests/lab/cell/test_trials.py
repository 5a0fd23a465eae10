"""Trials drawn at random: complete, reproducible, and such as the cell can measure."""

import json

import numpy as np
import pytest

from made_up_robot import nominal_of
from pa10cal.commands.command_line import run_command
from pa10cal.errors import SettingsError
from pa10cal.lab.cell.campaign import simulate_campaign
from pa10cal.lab.cell.effects.effect import Site
from pa10cal.lab.cell.effects.vocabulary import (
    all_effects,
    make_effects,
    outside,
    places_of,
    vocabulary,
)
from pa10cal.lab.cell.options import CellPosesOptions, SimulateOptions
from pa10cal.lab.cell.poses import place_poses
from pa10cal.lab.cell.scenario import TILT_SEEDS
from pa10cal.lab.cell.trials import KINDS, draw_trials

NOTHING_HIDDEN = ("null", "wrong_noise", "wrong_mass")
SHORT = {"repeats": 1, "loads_N": (0.0, 44.0), "holdout_points": 1, "holdout_repeats": 1}


def hidden(trial):
    return [(effect.id, effect.of) for effect in trial.settings.hidden_effects]


def all_kinds(count, seed=5):
    return [trial for kind in KINDS for trial in draw_trials(kind, count, seed)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_trials_and_another_does_not(kind):
    trials = draw_trials(kind, 6, 1)
    assert draw_trials(kind, 6, 1) == trials
    assert draw_trials(kind, 4, 1) == trials[:4]
    others = draw_trials(kind, 6, 2)
    assert not {trial.settings.random_seed for trial in trials} & {
        trial.settings.random_seed for trial in others
    }


def test_names_are_different_and_give_nothing_away():
    names = [trial.name for trial in all_kinds(20)]
    assert len(set(names)) == len(names)
    for word in (*KINDS, *all_effects()):
        assert not any(word in name for name in names)


def test_singles_go_through_the_whole_vocabulary_in_either_layout():
    trials = draw_trials("single", 2 * len(vocabulary()), 3)
    for layout in ("grid", "wide"):
        found = [t for t in trials if t.settings.poses.layout == layout]
        assert sorted(hidden(trial)[0][0] for trial in found) == sorted(vocabulary())
    assert all(len(trial.sizes) == 1 for trial in trials)


def test_outside_goes_through_what_has_no_name():
    assert [hidden(t)[0][0] for t in draw_trials("outside", len(outside()), 3)] == list(outside())


@pytest.mark.parametrize(("kind", "members"), [("pair", 2), ("triple", 3)])
def test_several_effects_are_never_the_same_at_the_same_place(kind, members):
    for trial in draw_trials(kind, 100, 4):
        assert len(set(hidden(trial))) == len(hidden(trial)) == len(trial.sizes) == members
        assert {id_ for id_, _ in hidden(trial)} <= set(vocabulary())


def test_sizes_are_even_in_their_logarithm_within_their_bounds():
    sizes = np.array([min(trial.sizes) for trial in draw_trials("single", 400, 6)])
    assert sizes.min() >= 0.1
    assert sizes.max() <= 3.0
    assert np.mean(sizes < np.sqrt(0.3)) == pytest.approx(0.5, abs=0.08)
    pairs = np.array([trial.sizes for trial in draw_trials("pair", 60, 6)])
    assert pairs.min() >= 0.7
    assert pairs.max() <= 3.0


def test_a_size_can_be_given_and_changes_nothing_else():
    every = len(vocabulary())
    small, large, drawn = (draw_trials("single", every, 7, size=size) for size in (0.5, 2.0, None))
    for trials in zip(small, large, drawn, strict=True):
        assert [min(trial.sizes) for trial in trials[:2]] == [0.5, 2.0]
        assert len({str(hidden(trial)) for trial in trials}) == 1
        one, two, _ = (
            next(iter(trial.settings.hidden_effects[0].parameters.values())) for trial in trials
        )
        fields = vocabulary()[hidden(trials[0])[0][0]].model_fields.values()
        stiffness = "stiffness" in next(iter(fields)).description
        assert two == pytest.approx((0.25 if stiffness else 4.0) * np.array(one))
        bare = [trial.settings.model_copy(update={"hidden_effects": ()}) for trial in trials]
        assert bare[0] == bare[1] == bare[2]


@pytest.mark.parametrize("kind", NOTHING_HIDDEN)
def test_nothing_is_hidden_where_only_a_statement_is_wrong(kind):
    for trial in draw_trials(kind, 30, 8):
        assert trial.settings.hidden_effects == ()
        assert trial.sizes == ()
        stated_mm, factor = trial.settings.stated_uncertainty_mm, trial.settings.mass_factor
        assert (stated_mm is not None) == (kind == "wrong_noise")
        assert (len(factor) == 6) == (kind == "wrong_mass")
        if stated_mm is not None:
            assert 1.5 <= max(stated_mm / 0.0121, 0.0121 / stated_mm) <= 4.0
        if factor:
            wrong = np.abs(np.array(factor) - 1.0)
            assert np.count_nonzero(wrong) == 1
            assert wrong[0] == 0.0
            assert 0.1 <= wrong.max() <= 0.3


def test_statements_are_wrong_both_ways():
    stated_mm = [t.settings.stated_uncertainty_mm for t in draw_trials("wrong_noise", 20, 9)]
    assert min(stated_mm) < 0.0121 < max(stated_mm)
    factors = np.array([t.settings.mass_factor for t in draw_trials("wrong_mass", 20, 9)])
    assert factors.min() < 1.0 < factors.max()


def test_temperature_drifts_where_it_must_and_in_a_third_of_the_rest():
    drifts = {True: [], False: []}
    for trial in draw_trials("single", 20 * len(vocabulary()), 10):
        grows = vocabulary()[hidden(trial)[0][0]].by_temperature
        drifts[grows].append(trial.settings.temperature_drift_C > 0.0)
    assert all(drifts[True])
    assert np.mean(drifts[False]) == pytest.approx(1 / 3, abs=0.08)


def test_robots_layouts_and_paths_vary():
    settings = [trial.settings for trial in draw_trials("null", 60, 11)]
    assert {one.built for one in settings} == {"drawn"}
    assert {one.path for one in settings} == {"same", "alternating"}
    assert [one.poses.layout for one in settings[:4]] == ["grid", "wide", "grid", "wide"]
    assert {one.repeats for one in settings} == {4, 10}
    assert len({one.random_seed for one in settings}) == 60
    assert len({one.poses.tilt_seed for one in settings}) > 30
    only = draw_trials("null", 5, 11, benches=("wide",))
    assert {trial.settings.poses.layout for trial in only} == {"wide"}


def test_every_place_of_a_trial_takes_its_effect(robot):
    rng = np.random.default_rng(0)
    for name, effect in all_effects().items():
        places = places_of(effect.trial_places or effect.places, robot, loaded=(2, 3, 4, 5))
        assert places
        for of in places:
            site = Site(of, rated_Nm=100.0, typical_Nm=30.0, coulomb_Nm=10.0, half_m=0.3)
            raw = {"id": name, "of": of, "parameters": effect.at_size(site, 1.0, rng)}
            settings = SimulateOptions(hidden_effects=(raw,))
            assert make_effects(settings.hidden_effects, robot)[0].of == of


def test_a_drawn_error_map_is_no_single_harmonic():
    rng = np.random.default_rng(1)
    drawn = vocabulary()["joint_error_map"].at_size(Site("joint 1"), 1.0, rng)
    knots = np.array(drawn["knots"])
    assert np.degrees(np.abs(knots).max()) * 3600 == pytest.approx(30.0)
    power = np.abs(np.fft.rfft(knots)) ** 2
    assert power[1:4] / power.sum() == pytest.approx(np.full(3, 1 / 3), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["grid", "wide"])
def test_the_cell_measures_every_single_at_its_largest(arm, layout):
    for trial in draw_trials("single", len(vocabulary()), 12, benches=(layout,), size=3.0):
        campaign = simulate_campaign(trial.name, arm, trial.settings.model_copy(update=SHORT))
        assert [effect.id for effect in campaign.truth.effects] == [hidden(trial)[0][0]]
        assert np.isfinite(campaign.truth.rest.T_base_ee).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "single"])
def test_the_stage_writes_the_trials_of_the_other_kinds(tmp_path, kind):
    for trial in draw_trials(kind, 4, 13):
        raw = trial.settings.model_copy(update=SHORT).model_dump_json()
        out, truth = tmp_path / trial.name, tmp_path / f"{trial.name}.json"
        argv = ["--name", trial.name, "--settings", raw, "--out", str(out), "--truth", str(truth)]
        assert run_command("simulate", argv) == 0
        record = json.loads(truth.read_text())
        assert [(one["id"], one["of"]) for one in record["hidden_effects"]] == hidden(trial)
        text = (out / "campaign.yaml").read_text()
        assert not any(id_ in text for id_, _ in hidden(trial))


@pytest.mark.slow
def test_attitudes_of_the_grid_are_all_within_reach(arm, robot):
    nominal = nominal_of(robot)
    for seed in range(1, TILT_SEEDS["grid"] + 1):
        poses = place_poses(arm, nominal, CellPosesOptions(tilt_seed=seed), 10)
        assert len(poses.holdout) == 10


def test_refuses_a_kind_that_does_not_exist():
    with pytest.raises(SettingsError, match="unknown kind of trial") as refusal:
        draw_trials("quadruple", 1, 0)
    assert "triple" in str(refusal.value)
