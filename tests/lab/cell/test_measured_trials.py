"""Trials as measured robots come: described without masses, weighed otherwise, rows sorted."""

import json
import zlib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pa10cal.arm.chain import Chain, frames
from pa10cal.errors import SettingsError, SimulationError
from pa10cal.files.arms import load_arm, read_arm
from pa10cal_lab.blind_trials import after_geometry
from pa10cal_lab.cell.campaign import robot_of, simulate_campaign
from pa10cal_lab.cell.effects.vocabulary import all_effects
from pa10cal_lab.cell.individual import NAME, REACH_M, TOOL_SHARE
from pa10cal_lab.cell.measured_trials import (
    BACKGROUND,
    BEAMS,
    MIXED,
    NO_SPRINGS,
    NOTHING,
    SAG_RAD,
    SORTED,
    SPRING,
    SUBJECTS,
    UNSTATED,
    measured_benches,
)
from pa10cal_lab.cell.trials import draw_trials
from pa10cal_lab.cell.write import write_campaign

SEED = 4


@pytest.fixture(scope="module")
def unstated():
    return draw_trials(UNSTATED, 5 * len(SUBJECTS[UNSTATED]), SEED, "wild")


@pytest.fixture(scope="module")
def mixed():
    return draw_trials(MIXED, 40, SEED, "wild")


@pytest.fixture(scope="module")
def sorted_rows():
    return draw_trials(SORTED, 4 * len(SUBJECTS[SORTED]), SEED, "wild")


def robot(trial):
    return robot_of(load_arm(trial.settings.robot), trial.settings)


def made(trial, **changed):
    settings = trial.settings.model_copy(update=changed)
    return simulate_campaign(trial.name, load_arm(settings.robot), settings)


def hidden_in(trial):
    return [(entry.id, entry.of) for entry in trial.settings.hidden_effects]


def test_arms_are_of_every_kind_and_of_all_lengths(unstated):
    assert {trial.bench for trial in unstated} <= set(measured_benches())
    assert len({trial.settings.robot for trial in unstated}) == 5
    reach_m = [robot(trial).arm.reach_m for trial in unstated]
    assert REACH_M[0] - 1e-3 < min(reach_m) < 0.6
    assert 2.0 < max(reach_m) < REACH_M[1] + 1e-3
    masses = [sum(trial.settings.without_touches.unstated.mass_kg) for trial in unstated]
    assert np.corrcoef(np.log(reach_m), np.log(masses))[0, 1] > 0.8
    assert min(masses) < 10.0
    assert max(masses) > 500.0


def test_springs_are_in_no_joint_in_some_or_in_all(unstated):
    kinds = Counter()
    for number, trial in enumerate(unstated):
        subject = SUBJECTS[UNSTATED][number % len(SUBJECTS[UNSTATED])]
        hidden = hidden_in(trial)
        springs = [of for name, of in hidden if name == SPRING]
        others = [name for name, _ in hidden if name != SPRING]
        joints = int((~robot(trial).arm.prismatic).sum())
        kinds[subject] += 1
        assert (len(others) == 1) == subject.endswith("_and_more")
        if subject.startswith("no_"):
            assert not springs
        elif subject.startswith("some"):
            assert 1 <= len(springs) < joints
        else:
            assert len(springs) == joints
    assert kinds[NO_SPRINGS] == 10
    losses = [
        entry.parameters["b"]
        for trial in unstated
        for entry in trial.settings.hidden_effects
        if entry.id == "backlash"
    ]
    assert losses
    assert min(losses) > 0.0


def test_the_sag_is_plausible_whatever_the_reach(unstated):
    """A spring alone bends its joint by what was drawn, in arms of some kg and of tons."""
    for trial in unstated[1::14]:
        own = robot(trial)
        q = made(trial).truth.q_motor
        tau_Nm = own.mechanism.statics(q, np.zeros(len(q))).torque_Nm
        for entry in trial.settings.hidden_effects:
            joint = int(entry.of.removeprefix("joint ")) - 1
            bent = np.abs(tau_Nm[:, joint]).max() / entry.parameters["K"]
            assert 0.3 * SAG_RAD[0] < bent < 2.0 * SAG_RAD[1]


def test_the_campaign_says_nothing_of_weights(unstated, tmp_path):
    for trial in unstated[:4]:
        campaign = made(trial)
        folder = tmp_path / trial.name
        write_campaign(campaign, folder)
        arm, truth = read_arm(folder / f"{NAME}.yaml"), campaign.truth.robot
        said = yaml.safe_load((folder / "campaign.yaml").read_text("utf-8"))
        assert arm.mass_kg is None
        assert arm.com_m is None
        assert np.isnan(arm.torque_limit_Nm).all()
        assert np.isnan(arm.gear_ratio).all()
        assert said["tool"]["mass_kg"] == 0.0
        assert "massless" not in said["tool"]
        header = (folder / "poses.csv").read_text("utf-8").splitlines()[0]
        assert "tau" not in header
        own = trial.settings.without_touches.unstated
        assert truth.mechanism.mass_kg.tolist() == list(own.mass_kg)
        share = truth.mechanism.payload.mass_kg / sum(own.mass_kg)
        assert 0.9 * TOOL_SHARE[0] - 1e-3 / sum(own.mass_kg) < share < 1.1 * TOOL_SHARE[1]
        shipped = load_arm(trial.settings.robot)
        if shipped.mass_kg is not None:
            ratio = np.array(own.mass_kg) / shipped.mass_kg
            assert ratio.max() > 1.2 * ratio.min()


def test_rows_are_sorted_and_have_no_time(sorted_rows, tmp_path):
    clocks, correlations = Counter(), []
    for number, trial in enumerate(sorted_rows):
        subject = SUBJECTS[SORTED][number % len(SUBJECTS[SORTED])]
        assert [name for name, _ in hidden_in(trial)] == ([] if subject == NOTHING else [subject])
        plan = trial.settings.without_touches
        clocks[plan.clock] += 1
        q = np.array(plan.commanded)
        rows = np.arange(len(q))
        ranks = q.argsort(axis=0).argsort(axis=0)
        half = len(q) // 2
        parts = [np.corrcoef(rows[part], ranks[part, k])[0, 1]
                 for k in range(q.shape[1]) for part in (slice(None), slice(half))]  # fmt: skip
        correlations.append(np.nanmax(np.abs(parts)))
    assert clocks == {"row": len(sorted_rows) // 2, "none": len(sorted_rows) // 2}
    assert min(correlations) > 0.9
    for trial in sorted_rows[:2]:
        folder = tmp_path / trial.name
        write_campaign(made(trial), folder)
        header, first, second, *_ = (folder / "poses.csv").read_text("utf-8").splitlines()
        said = yaml.safe_load((folder / "campaign.yaml").read_text("utf-8"))
        assert said["holdout"] == {"every": 5}
        numbered = trial.settings.without_touches.clock == "row"
        assert ("time_s" in header) == numbered
        assert ("columns" in said) != numbered
        if numbered:
            assert [float(line.split(",")[0]) for line in (first, second)] == [0.0, 1.0]


def test_what_geometry_can_follow_leaves_nothing(unstated):
    """Twins in another place leave nothing; a spring does, and so does eccentricity in a joint."""
    trial = next(t for t in unstated if [e for e, _ in hidden_in(t)] == [SPRING] * 2)
    whole = made(trial)
    both = after_geometry(whole, [made(trial, hidden_effects=())])
    assert both.residual_mm[0] > 0.05
    T = np.eye(4)
    T[:3, 3] = [1e-4, -2e-4, 3e-4]
    rest = whole.truth.rest
    shifted = replace(whole.truth, rest=replace(rest, T_base_ee=T @ rest.T_base_ee))
    left = after_geometry(whole, [replace(whole, truth=shifted)])
    assert left.residual_mm[0] < 1e-9


def test_what_else_is_hidden_takes_a_part(unstated):
    """An effect leaves no more once the others may follow; alone it leaves the same."""
    trial = next(t for t in unstated if len(hidden_in(t)) > 4)
    entries = trial.settings.hidden_effects
    twins = [
        made(trial, hidden_effects=(*entries[:k], *entries[k + 1 :])) for k in range(len(entries))
    ]
    left = after_geometry(made(trial), twins)
    assert all(
        apart <= moved + 1e-12
        for moved, apart in zip(left.residual_mm, left.partial_residual_mm, strict=True)
    )
    (alone,) = after_geometry(made(trial), twins[:1]).partial_residual_mm
    assert alone == pytest.approx(left.residual_mm[0])
    plan = trial.settings.without_touches
    assert left.noise_mm > np.sqrt(3.0 / plan.repeats) * plan.position_mm


def test_mixed_trials_hide_two_to_six_effects_half_of_them_among_a_background(mixed):
    kinds = Counter()
    for number, trial in enumerate(mixed):
        hidden = hidden_in(trial)
        hidden = [each for each in hidden if each[0] != BEAMS]
        named = [each for each in hidden if each[0] not in BACKGROUND]
        assert 2 <= len(named) <= 6
        assert len({of for _, of in named}) == len(named)  # each at a place of its own
        assert all(all_effects()[name].named for name, _ in named)
        assert (len(hidden) > len(named)) == (number % 2 == 1)
        kinds.update(name for name, _ in hidden)
        joints = (np.flatnonzero(~robot(trial).arm.prismatic) + 1).tolist()
        if number % 2:
            waves = [of for name, of in hidden if name == "small_waves"]
            assert waves == [f"joint {joint}" for joint in joints]
        assert 150 <= trial.settings.without_touches.poses <= 500
    assert len(kinds) > 14
    assert 0 < kinds["along_move"] < 15
    assert kinds[SPRING] > 15


def test_some_mixed_arms_stand_on_a_rail_or_a_column(mixed):
    slides = [trial.settings.without_touches.unstated.slide for trial in mixed]
    assert 2 <= sum(each is not None for each in slides) <= 10
    for trial, slide in zip(mixed, slides, strict=True):
        if slide is None:
            continue
        shipped, arm = load_arm(trial.settings.robot), robot(trial).arm
        assert 0.5 <= slide.stroke_m <= 4.0
        assert arm.prismatic.tolist() == [True, *shipped.prismatic]
        assert arm.limits_rad[0].tolist() == [0.0, slide.stroke_m]
        start, out = Chain.of(arm).forward(np.eye(arm.n)[:1] * [[0.0], [0.5]])
        way = out[:3, 3] - start[:3, 3]
        upright = np.array([0.0, 0.0, 1.0])
        assert way @ upright == pytest.approx(0.0 if slide.kind == "rail" else 0.5)
        assert np.linalg.norm(way) == pytest.approx(0.5)
        # The first axis that turns is upright, but on the side of a column.
        turns = frames(Chain.of(arm), Chain.of(arm).nominal[None]).T_base_joints[1, 0, :3, 2]
        level = slide.kind == "side_of_column"
        assert turns @ upright == pytest.approx(0.0 if level else 1.0)


def test_rails_are_drawn_apart_and_change_no_other_trial(mixed):
    """By what was drawn before there were any."""
    told = [
        (
            trial.bench,
            [each for each in hidden_in(trial) if each[0] != BEAMS],
            trial.settings.without_touches.poses,
        )
        for trial in mixed
        if trial.settings.without_touches.unstated.slide is None
    ]
    assert len(told) == 35
    assert zlib.crc32(json.dumps(told).encode()) == 1843801878


def test_some_mixed_trackers_stand_off_and_read_too_long(mixed):
    read = [trial for trial in mixed if (BEAMS, "instrument") in hidden_in(trial)]
    assert 1 <= len(read) <= 10
    for trial in mixed:
        near_m, far_m = trial.settings.without_touches.stand_off_m
        if trial in read:
            reach_m = robot(trial).arm.reach_m
            assert (near_m, far_m) == pytest.approx((1.8 * reach_m, 3.0 * reach_m), abs=1e-3)
        else:
            assert (near_m, far_m) == (1.5, 2.5)


def test_some_mixed_trials_are_paths_of_small_steps(mixed):
    paths = [trial for trial in mixed if trial.settings.without_touches.commanded]
    assert 4 <= len(paths) <= 16
    for trial in paths:
        q, own = np.array(trial.settings.without_touches.commanded), robot(trial).arm
        step = np.abs(np.diff(np.where(own.prismatic, 1e-3 * q, np.radians(q)), axis=0)).max(axis=1)
        assert np.median(step) < 0.051
        assert 0.7 < np.mean(step < 0.051) < 1.0  # stretches in different places
    assert len({trial.settings.without_touches.holdout_every for trial in paths}) == 2


def test_some_mixed_effects_drown_and_some_dominate(mixed):
    over_noise = []
    for trial in mixed[::4]:
        entries = trial.settings.hidden_effects
        twins = [
            made(trial, hidden_effects=(*entries[:k], *entries[k + 1 :]))
            for k in range(len(entries))
        ]
        left = after_geometry(made(trial), twins)
        over_noise += [moved / left.noise_mm for moved in left.residual_mm]
    assert np.quantile(over_noise, 0.25) < 0.7
    assert np.quantile(over_noise, 0.9) > 3.0


def test_refuses_what_does_nothing_and_weights_of_another_arm():
    with pytest.raises(SettingsError, match="does nothing at any of the benches"):
        draw_trials(UNSTATED, 1, 1, "wild", ["gx4_351s-pose"], only="some_springs")
    with pytest.raises(SettingsError, match="--benches: no such bench"):
        draw_trials(SORTED, 1, 1, "wild", ["ur10-distance"])
    (trial,) = draw_trials(UNSTATED, 1, 1, "wild", ["ur10-pose"])
    with pytest.raises(SimulationError, match="6 entries for 7 rows"):
        simulate_campaign(trial.name, load_arm("iiwa14"), trial.settings)
