"""Campaigns without touches: poses, noise, and what is hidden."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.cell.individual_arm import individual_from_departures
from pa10cal.cell.sighted import measure_individual, measure_sighted
from pa10cal.errors import SimulationError
from pa10cal.settings import SightedPlan

MANY = {"poses": 2000, "holdout_share": 0.0}


@settings(deadline=None, max_examples=40)
@given(
    poses=st.integers(1, 30),
    share=st.floats(0.0, 0.99),
    every=st.integers(0, 7),
    loads=st.lists(st.sampled_from([0.0, 22.0, 44.0]), min_size=1, max_size=3),
    seed=st.integers(0, 2**31),
)
def test_poses_are_as_many_held_out_and_repeated_as_asked(arm, poses, share, every, loads, seed):
    plan = SightedPlan(poses=poses, holdout_share=share, repeat_every=every, loads_N=tuple(loads))
    campaign = measure_sighted(arm, plan, seed)
    held_out = campaign.kind == "holdout"
    assert held_out.sum() == round(share * poses)
    again = campaign.repeat == 2
    assert again.sum() == ((poses - held_out.sum()) // every if every else 0)
    assert len(campaign) == poses + again.sum()
    assert not (again & held_out).any()
    assert (np.diff(campaign.time_s) > 0.0).all()
    keys = list(zip(campaign.pose, campaign.load_N, campaign.repeat, strict=True))
    assert len(set(keys)) == len(keys)
    for label in campaign.pose[again]:
        assert np.ptp(campaign.truth.q_motor[campaign.pose == label], axis=0).max() == 0.0
        assert np.ptp(campaign.load_N[campaign.pose == label]) == 0.0
    assert set(campaign.load_N) <= set(loads)


def test_poses_lie_within_the_joint_limits_and_fill_them(any_arm):
    campaign = measure_sighted(any_arm, SightedPlan(**MANY), 3)
    low, high = any_arm.limits_rad.T
    assert (campaign.q >= low).all()
    assert (campaign.q <= high).all()
    largest = np.where(any_arm.prismatic, np.inf, np.radians(300.0))
    reach = np.minimum(0.8 * (high - low), largest)
    assert (np.ptp(campaign.q, axis=0) > 0.95 * reach).all()


@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
def test_the_same_seed_gives_the_same_campaign_and_another_another(any_arm, instrument):
    plan = SightedPlan(instrument=instrument, poses=10, resolver_rad=1e-5)
    one, same, other = (measure_sighted(any_arm, plan, seed) for seed in (1, 1, 2))
    (seen,), (again,), (elsewhere,) = (vars(made.seen).values() for made in (one, same, other))
    assert np.array_equal(seen, again, equal_nan=True)
    assert np.array_equal(one.q, same.q)
    assert not np.array_equal(seen, elsewhere, equal_nan=True)
    assert not np.array_equal(one.q, other.q)


def test_the_instrument_changes_neither_poses_nor_arm(arm):
    made = [
        measure_sighted(arm, SightedPlan(instrument=kind), 4)
        for kind in ("pose", "points", "distance")
    ]
    for other in made[1:]:
        assert np.array_equal(other.q, made[0].q)
        assert np.array_equal(other.truth.rest.T_base_ee, made[0].truth.rest.T_base_ee)


def test_a_tracker_sees_its_target_with_noise_of_the_stated_size(any_arm):
    plan = SightedPlan(**MANY, position_mm=0.2, attitude_rad=3e-4)
    campaign = measure_sighted(any_arm, plan, 5)
    truth = campaign.truth
    wanted = truth.individual.T_instr_base @ truth.rest.T_base_ee @ truth.individual.T_ee_target
    seen = campaign.seen.T_instr_target
    off_mm = 1e3 * (seen - wanted)[:, :3, 3]
    assert off_mm.std(axis=0) == pytest.approx([0.2] * 3, rel=0.06)
    assert np.abs(off_mm.mean(axis=0)).max() < 0.02
    turned = Rotation.from_matrix(seen[:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2))
    assert turned.as_rotvec().std(axis=0) == pytest.approx([3e-4] * 3, rel=0.06)
    assert np.abs(np.corrcoef(off_mm.T) - np.eye(3)).max() < 0.1


def test_points_are_the_targets_with_noise_and_some_are_not_seen(any_arm):
    plan = SightedPlan(**MANY, instrument="points", targets=4, unseen_share=0.3, position_mm=0.1)
    campaign = measure_sighted(any_arm, plan, 6)
    individual, T_base_ee = campaign.truth.individual, campaign.truth.rest.T_base_ee
    T_instr_ee = individual.T_instr_base @ T_base_ee
    for b, place in enumerate(individual.targets.p_ee_m):
        wanted = T_instr_ee @ np.append(place, 1.0)
        off_mm = 1e3 * (campaign.seen.p_instr_m[:, b] - wanted[:, :3])
        assert np.nanstd(off_mm, axis=0) == pytest.approx([0.1] * 3, rel=0.08)
    unseen = np.isnan(campaign.seen.p_instr_m)
    assert (unseen.all(axis=2) == unseen.any(axis=2)).all()
    assert unseen.mean() == pytest.approx(0.3, abs=0.02)
    assert not unseen.all(axis=(1, 2)).any()
    assert np.isfinite(
        measure_sighted(any_arm, plan.model_copy(update={"targets": 1}), 6).seen.p_instr_m
    ).all()


def test_a_distance_is_that_of_the_target_from_the_instrument(any_arm):
    campaign = measure_sighted(any_arm, SightedPlan(**MANY, instrument="distance"), 7)
    individual = campaign.truth.individual
    T = individual.T_instr_base @ campaign.truth.rest.T_base_ee
    place = T @ np.append(individual.targets.p_ee_m[0], 1.0)
    off_mm = 1e3 * (campaign.seen.d_m - np.linalg.norm(place[:, :3], axis=1))
    assert off_mm.std() == pytest.approx(0.05, rel=0.06)
    assert abs(off_mm.mean()) < 0.005


def test_what_is_logged_is_off_the_motors_by_the_resolvers_alone(odd_arm):
    plan = SightedPlan(**MANY, resolver_rad=1e-4, resolver_mm=0.03)
    campaign = measure_sighted(odd_arm, plan, 8)
    off = (campaign.q - campaign.truth.q_motor).std(axis=0)
    assert off[~odd_arm.prismatic] == pytest.approx([1e-4] * 4, rel=0.06)
    assert off[odd_arm.prismatic] == pytest.approx([3e-5] * 2, rel=0.06)
    exact = measure_sighted(odd_arm, SightedPlan(), 8)
    assert np.array_equal(exact.q, exact.truth.q_motor)


def test_torques_are_logged_where_asked_with_noise(arm):
    plan = SightedPlan(**MANY, logs_torques=True, flexible_joints=(2, 3), loads_N=(0.0, 44.0))
    campaign = measure_sighted(arm, plan, 9)
    truth = campaign.truth
    off = (campaign.tau_Nm - truth.rest.tau_Nm).std(axis=0)
    assert off == pytest.approx(1.7e-3 * arm.torque_limit_Nm, rel=0.06)
    held = truth.individual.linkage.torques_Nm(truth.rest.q, campaign.load_N)
    assert truth.rest.tau_Nm == pytest.approx(held, abs=1e-6)
    assert measure_sighted(arm, SightedPlan(), 9).tau_Nm is None
    with pytest.raises(SimulationError, match="hold nothing"):
        measure_sighted(replace(arm, mass_kg=None, com_m=None), SightedPlan(logs_torques=True), 9)
    unrated = replace(arm, torque_limit_Nm=np.full(6, np.nan))
    with pytest.raises(SimulationError, match="logs_torques: a joint has no rated torque"):
        measure_sighted(unrated, SightedPlan(logs_torques=True), 9)


def test_the_truth_tells_where_the_arm_is_at_any_joint_position(arm):
    plan = SightedPlan(flexible_joints=(2, 3, 5), loads_N=(0.0, 44.0))
    truth = measure_sighted(arm, plan, 10).truth
    load_N = np.resize(plan.loads_N, plan.poses)
    again = truth.forward(truth.q_motor, load_N)
    assert np.abs(again - truth.rest.T_base_ee).max() < 1e-12
    unloaded = truth.forward(truth.q_motor)
    lighter = np.abs(unloaded - truth.rest.T_base_ee).max(axis=(1, 2))
    assert lighter[load_N == 0.0].max() < 1e-12
    assert lighter[load_N > 0.0].max() > 1e-4


def test_an_individual_may_be_given(arm):
    individual = individual_from_departures(arm, {"delta_a_2": 1e-3})
    plan = SightedPlan(poses=5, position_mm=1e-5, attitude_rad=1e-8)
    campaign = measure_individual(individual, plan, 11)
    assert campaign.truth.individual is individual
    wanted = individual.forward(campaign.q)
    assert campaign.seen.T_instr_target == pytest.approx(wanted, abs=1e-6)
    drawn = measure_sighted(arm, plan, 11)
    assert np.array_equal(drawn.q, campaign.q)


def test_postures_may_be_given(arm):
    individual = individual_from_departures(arm, {"delta_a_2": 1e-3})
    plan = SightedPlan(poses=5, holdout_share=0.25, position_mm=1e-5, attitude_rad=1e-8)
    postures = np.random.default_rng(2).uniform(-1.0, 1.0, (8, arm.n))
    campaign = measure_individual(individual, plan, 11, postures)
    assert campaign.q == pytest.approx(postures, abs=1e-5)
    assert (campaign.kind == "holdout").sum() == 2
    assert campaign.seen.T_instr_target == pytest.approx(individual.forward(campaign.q), abs=1e-6)
