"""Campaigns of instruments that do not touch: poses, noise, effects, and what is hidden."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_robot import logged_q, robot_from_departures, seen_m, seen_p, seen_T, track
from pa10cal.errors import SimulationError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal_curve.angles import chain_arm
from pa10cal_lab.cell.campaign import measure_campaign
from pa10cal_lab.cell.effects.joint import SimulatedBacklash, SimulatedFrictionTorque
from pa10cal_lab.cell.effects.structure import (
    SimulatedBaseDrift,
    SimulatedCmmScale,
    SimulatedThermalGrowth,
    SimulatedToolSag,
)
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions

MANY = {"poses": 2000, "holdout_share": 0.0}
INSTRUMENTS = ("pose", "points", "distance")
EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


@examples(40)
@given(
    poses=st.integers(1, 30),
    share=st.floats(0.0, 0.99),
    every=st.integers(0, 7),
    loads=st.lists(st.sampled_from([0.0, 22.0, 44.0]), min_size=1, max_size=3),
    seed=st.integers(0, 2**31),
)
def test_poses_are_as_many_held_out_and_repeated_as_asked(arm, poses, share, every, loads, seed):
    plan = TrackerOptions(
        poses=poses, holdout_share=share, repeat_every=every, loads_N=tuple(loads)
    )
    campaign = track(arm, plan, seed)
    made, q_motor = campaign.truth.schedule, campaign.truth.q_motor
    held_out = made.kind == "holdout"
    assert held_out.sum() == round(share * poses)
    again = made.repeat == 2
    assert again.sum() == ((poses - held_out.sum()) // every if every else 0)
    assert len(made) == poses + again.sum()
    assert not (again & held_out).any()
    assert (np.diff(campaign.tables["poses"]["time_s"]) > 0.0).all()
    keys = list(zip(made.pose, made.load_N, made.repeat, strict=True))
    assert len(set(keys)) == len(keys)
    for label in made.pose[again]:
        assert np.ptp(q_motor[made.pose == label], axis=0).max() == 0.0
        assert np.ptp(made.load_N[made.pose == label]) == 0.0
    assert set(made.load_N) <= set(loads)


def test_poses_lie_within_the_joint_limits_and_fill_them(any_arm):
    q = logged_q(track(any_arm, TrackerOptions(**MANY), 3))
    low, high = any_arm.limits_rad.T
    assert (q >= low).all()
    assert (q <= high).all()
    largest = np.where(any_arm.prismatic, np.inf, np.radians(300.0))
    reach = np.minimum(0.8 * (high - low), largest)
    assert (np.ptp(q, axis=0) > 0.95 * reach).all()


def test_joints_arrive_straight_from_the_configuration_before(arm):
    schedule = track(arm, TrackerOptions(poses=30)).truth.schedule
    assert not schedule.arrival[0].any()
    assert np.array_equal(schedule.arrival[1:], np.sign(np.diff(schedule.q, axis=0)))


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_the_same_seed_gives_the_same_campaign_and_another_another(any_arm, instrument):
    plan = TrackerOptions(instrument=instrument, poses=10, resolver_rad=1e-5)
    one, same, other = (track(any_arm, plan, seed).tables["poses"] for seed in (1, 1, 2))
    assert one.equals(same)
    read = [name for name in one.columns if name[0] in "qTdx" and not name.startswith("u_")]
    assert all(not one[name].equals(other[name]) for name in read)


def test_the_instrument_changes_neither_poses_nor_arm(arm):
    made = [track(arm, TrackerOptions(instrument=kind), 4) for kind in INSTRUMENTS]
    for other in made[1:]:
        assert np.array_equal(logged_q(other), logged_q(made[0]))
        assert np.array_equal(other.truth.rest.T_base_ee, made[0].truth.rest.T_base_ee)


def test_a_tracker_sees_its_target_with_noise_of_the_stated_size(any_arm):
    campaign = track(any_arm, TrackerOptions(**MANY, position_mm=0.2, attitude_rad=3e-4), 5)
    robot = campaign.truth.robot
    wanted = robot.T_instr_base @ campaign.truth.rest.T_base_ee @ robot.T_ee_target
    seen = seen_T(campaign)
    off_mm = 1e3 * (seen - wanted)[:, :3, 3]
    assert off_mm.std(axis=0) == pytest.approx([0.2] * 3, rel=0.06)
    assert np.abs(off_mm.mean(axis=0)).max() < 0.02
    turned = Rotation.from_matrix(seen[:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2))
    assert turned.as_rotvec().std(axis=0) == pytest.approx([3e-4] * 3, rel=0.06)
    assert np.abs(np.corrcoef(off_mm.T) - np.eye(3)).max() < 0.1


def test_points_are_the_targets_with_noise_and_some_are_not_seen(any_arm):
    plan = TrackerOptions(**MANY, instrument="points", targets=4, unseen_share=0.3, position_mm=0.1)
    campaign = track(any_arm, plan, 6)
    robot, p_m = campaign.truth.robot, seen_p(campaign)
    T_instr_ee = robot.T_instr_base @ campaign.truth.rest.T_base_ee
    for b, point in enumerate(robot.targets.p_ee_m):
        wanted = T_instr_ee @ np.append(point, 1.0)
        off_mm = 1e3 * (p_m[:, b] - wanted[:, :3])
        assert np.nanstd(off_mm, axis=0) == pytest.approx([0.1] * 3, rel=0.08)
    unseen = np.isnan(p_m)
    assert (unseen.all(axis=2) == unseen.any(axis=2)).all()
    assert unseen.mean() == pytest.approx(0.3, abs=0.02)
    assert not unseen.all(axis=(1, 2)).any()
    assert np.isfinite(seen_p(track(any_arm, plan.model_copy(update={"targets": 1}), 6))).all()


def test_a_distance_is_that_of_the_target_from_the_instrument(any_arm):
    campaign = track(any_arm, TrackerOptions(**MANY, instrument="distance"), 7)
    robot = campaign.truth.robot
    T = robot.T_instr_base @ campaign.truth.rest.T_base_ee
    point = T @ np.append(robot.targets.p_ee_m[0], 1.0)
    off_m = seen_m(campaign, "d_mm")[:, 0] - np.linalg.norm(point[:, :3], axis=1)
    assert 1e3 * off_m.std() == pytest.approx(0.05, rel=0.06)
    assert abs(1e3 * off_m.mean()) < 0.005


def test_what_is_logged_is_off_the_motors_by_the_resolvers_alone(odd_arm):
    plan = TrackerOptions(**MANY, resolver_rad=1e-4, resolver_mm=0.03)
    campaign = track(odd_arm, plan, 8)
    off = (logged_q(campaign) - campaign.truth.q_motor).std(axis=0)
    assert off[~odd_arm.prismatic] == pytest.approx([1e-4] * 4, rel=0.06)
    assert off[odd_arm.prismatic] == pytest.approx([3e-5] * 2, rel=0.06)
    exact = track(odd_arm, TrackerOptions(), 8)
    assert logged_q(exact) == pytest.approx(exact.truth.q_motor, abs=1e-15)


def test_links_scatter_about_their_motors_and_no_log_shows_it(arm):
    still, shaking = (track(arm, TrackerOptions(**MANY, unseen_rad=u), 8) for u in (0.0, 1e-4))
    assert np.array_equal(logged_q(still), logged_q(shaking))
    off = (shaking.truth.rest.q - still.truth.rest.q).std(axis=0)
    assert off == pytest.approx([1e-4] * 6, rel=0.06)


def test_torques_are_logged_where_asked_with_noise(arm):
    plan = TrackerOptions(**MANY, logs_torques=True, flexible_joints=(2, 3), loads_N=(0.0, 44.0))
    campaign = track(arm, plan, 9)
    truth = campaign.truth
    logged = campaign.tables["poses"][[f"tau{k}_Nm" for k in range(1, 7)]].to_numpy()
    off = (logged - truth.rest.tau_Nm).std(axis=0)
    assert off == pytest.approx(1.7e-3 * arm.torque_limit_Nm, rel=0.06)
    held = truth.robot.mechanism.statics(truth.rest.q, truth.schedule.load_N).torque_Nm
    assert truth.rest.tau_Nm == pytest.approx(held, abs=1e-6)
    assert "tau1_Nm" not in track(arm, TrackerOptions(), 9).tables["poses"]
    with pytest.raises(SimulationError, match="no masses"):
        track(replace(arm, mass_kg=None, com_m=None), TrackerOptions(logs_torques=True), 9)
    unrated = replace(arm, torque_limit_Nm=np.full(6, np.nan))
    with pytest.raises(SimulationError, match="logs_torques: a joint has no rated torque"):
        track(unrated, TrackerOptions(logs_torques=True), 9)


def test_temperature_is_logged_where_it_drifts(arm):
    steady = track(arm, TrackerOptions(poses=40)).tables["poses"]
    plan = TrackerOptions(poses=40, seconds_a_pose=600.0)
    drifting = track(arm, plan, temperature_drift_C=3.0)
    assert "temperature_C" not in steady
    logged_C = drifting.tables["poses"]["temperature_C"]
    assert logged_C.to_numpy() == pytest.approx(drifting.truth.temperature_C, abs=0.06)
    assert 1.0 < np.ptp(logged_C) <= 6.1
    assert np.abs(logged_C - 21.0).max() < 3.1
    assert np.diff(drifting.tables["poses"]["time_s"]) == pytest.approx(600.0)


def test_a_wrong_statement_changes_what_is_stated_alone(arm):
    plan = TrackerOptions(instrument="points")
    right, wrong = track(arm, plan), track(arm, plan, stated_uncertainty_mm=0.2)
    stated = [name for name in right.tables["poses"] if name.startswith("u_")]
    rest = [name for name in right.tables["poses"] if name not in stated]
    assert right.tables["poses"][rest].equals(wrong.tables["poses"][rest])
    assert (right.tables["poses"][stated] == 0.05).to_numpy().all()
    assert (wrong.tables["poses"][stated] == 0.2).to_numpy().all()


def test_true_masses_may_differ_from_those_described(arm):
    plan = TrackerOptions(logs_torques=True)
    factors = (1.0, 1.2, 1.0, 1.0, 1.0, 1.0)
    described, heavier = track(arm, plan), track(arm, plan, mass_factor=factors)
    assert heavier.truth.robot.mechanism.mass_kg == pytest.approx(arm.mass_kg * factors)
    more = heavier.truth.rest.tau_Nm - described.truth.rest.tau_Nm
    assert np.abs(more[:, 1]).max() > 1.0
    assert np.abs(more[:, 2:]).max() < 1e-9


def test_a_robot_and_its_poses_may_be_stated(arm):
    robot = robot_from_departures(arm, {"delta_a_2": 1e-3})
    postures = np.random.default_rng(2).uniform(-1.0, 1.0, (8, arm.n))
    for commanded in ((), np.degrees(postures).tolist()):
        plan = TrackerOptions(poses=5, commanded=commanded, holdout_share=0.25, **EXACT)
        asked = SimulateOptions(random_seed=11, without_touches=plan)
        campaign = measure_campaign("x", asked, robot)
        assert campaign.truth.robot is robot
        wanted = robot.mechanism.T_base_ee(logged_q(campaign))
        assert seen_T(campaign) == pytest.approx(wanted, abs=1e-6)
    assert logged_q(campaign) == pytest.approx(postures, abs=1e-5)
    assert (campaign.truth.schedule.kind == "holdout").sum() == 2


def test_poses_stated_of_a_sliding_joint_are_in_mm_and_keep_its_limits(tmp_path):
    arm = load_arm("gx4_351s")
    low, high = arm.limits_rad[2]
    middle = (10.0, 20.0, 500.0 * (low + high), 30.0)
    made = track(arm, TrackerOptions(commanded=(middle,), holdout_share=0.0))
    assert logged_q(made)[0] == pytest.approx([*np.radians([10, 20]), 1e-3 * middle[2], np.pi / 6])
    beyond = (10.0, 20.0, 1e3 * high + 1.0, 30.0)
    with pytest.raises(SimulationError, match=r"commanded\[1\]: joint 3 beyond .* mm"):
        track(arm, TrackerOptions(commanded=(middle, beyond)))


def test_rows_alone_may_depart(arm):
    robot = track(arm, TrackerOptions(departs="rows")).truth.robot
    assert robot.departures is not None
    assert np.abs(robot.departures.a_m).max() > 1e-5
    again = robot_from_departures(arm, robot.departures.by_name)
    assert again.mechanism.placements == pytest.approx(robot.mechanism.placements, abs=1e-15)
    assert track(arm, TrackerOptions()).truth.robot.departures is None


# What an effect leaves in the readings, against the same campaign without it.


def moved(arm, plan, *effects, **more):
    """Campaigns of one robot without noise: without effects, and with them."""
    plan = plan.model_copy(update=EXACT)
    asked = SimulateOptions(random_seed=3, without_touches=plan, **more)
    robot = draw_individual(arm, plan, np.random.default_rng(1))
    return [measure_campaign("x", asked, robot, hidden) for hidden in ((), effects)]


CHAIN = chain_arm("chain", 6, 0.15, np.radians(75.0))


@pytest.mark.parametrize("name", [*arm_names(), "chain"])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_any_arm_shows_a_turn_of_its_joint_under_any_instrument(name, instrument):
    arm = CHAIN if name == "chain" else load_arm(name)
    plan = TrackerOptions(instrument=instrument, poses=20, flexible_joints=())
    still, loose = moved(arm, plan, SimulatedBacklash(b=1e-3).at("joint 2"))
    turned = loose.truth.rest.q - still.truth.rest.q
    assert turned[:, 1] == pytest.approx(-1e-3 * still.truth.schedule.arrival[:, 1], abs=1e-12)
    read = [c for c in still.tables["poses"] if c[0] in "xdT"]
    found = loose.tables["poses"][read] - still.tables["poses"][read]
    assert np.abs(found.to_numpy()[1:]).max() > 1e-2
    assert np.abs(found.to_numpy()[0]).max() < 1e-3  # the first has no arrival


def test_a_base_that_drifts_and_links_that_grow_show_under_points(arm):
    plan = TrackerOptions(instrument="points", poses=12, seconds_a_pose=3600.0)
    still, adrift = moved(arm, plan, SimulatedBaseDrift(rate=(1e-5, 0.0, 0.0)).at("base"))
    along = still.truth.robot.T_instr_base[:3, 0]
    hours = still.tables["poses"]["time_s"].to_numpy() / 3600.0
    off_m = seen_p(adrift) - seen_p(still)
    assert off_m[:, 0] == pytest.approx(1e-5 * np.outer(hours, along), abs=1e-9)
    cold, warm = moved(
        arm, plan, SimulatedThermalGrowth(alpha=1e-5).at("arm"), temperature_drift_C=5.0
    )
    assert np.abs(seen_p(warm) - seen_p(cold)).max() > 1e-6


def test_scales_and_sagging_tools_show_in_what_is_read(arm):
    plan = TrackerOptions(poses=12)
    still, scaled = moved(arm, plan, SimulatedCmmScale(s=(1e-3, 0.0, -2e-3)).at("instrument"))
    T = seen_T(still)
    assert seen_T(scaled)[:, :3, 3] == pytest.approx(T[:, :3, 3] * [1.001, 1.0, 0.998], abs=1e-9)
    assert seen_T(scaled)[:, :3, :3] == pytest.approx(T[:, :3, :3], abs=1e-12)
    still, sagging = moved(arm, plan, SimulatedToolSag(c=1e-4).at("tool"))
    robot = still.truth.robot
    R = robot.T_instr_base[:3, :3] @ still.truth.rest.T_base_ee[:, :3, :3]
    down = -robot.T_instr_base[:3, 2]
    wanted = 1e-4 * (down - R[:, :, 2] * (R[:, :, 2] @ down)[:, None])
    assert (seen_T(sagging) - seen_T(still))[:, :3, 3] == pytest.approx(wanted, abs=1e-9)
    distance = plan.model_copy(update={"instrument": "distance"})
    still, scaled = moved(arm, distance, SimulatedCmmScale(s=(1e-3, 1e-3, 1e-3)).at("instrument"))
    longer = scaled.tables["poses"]["d_mm"] / still.tables["poses"]["d_mm"]
    assert longer.to_numpy() == pytest.approx(1.001, abs=1e-7)


def test_friction_shows_in_the_logged_torque_alone(arm):
    plan = TrackerOptions(poses=12, logs_torques=True, torque_fraction=0.0)
    still, rubbing = moved(arm, plan, SimulatedFrictionTorque(tau_c=4.0).at("joint 2"))
    more = rubbing.tables["poses"]["tau2_Nm"] - still.tables["poses"]["tau2_Nm"]
    assert more.to_numpy() == pytest.approx(4.0 * still.truth.schedule.arrival[:, 1], abs=1e-9)
    others = [name for name in still.tables["poses"] if name != "tau2_Nm"]
    assert rubbing.tables["poses"][others].equals(still.tables["poses"][others])
