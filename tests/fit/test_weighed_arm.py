"""The arm of a campaign with its weights: stated, not meant, assumed, or by logged torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import made_up_sightings
import pa10cal
from made_up_poses import at_rest
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import weights_known
from pa10cal.campaign import read as campaign_read
from pa10cal.campaign.description import CampaignDescription, Masses
from pa10cal.campaign.table import write_pose_table
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import torque_noise
from pa10cal.fit.loads import statics_of
from pa10cal.fit.logged_torques import without_torque_errors
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.model_writing import save_model
from pa10cal.fit.position_errors import position_noise_mm
from pa10cal.fit.weighed_arm import weighed_arm, weighed_model, weights_finding
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.stages.inputs import read_measured
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures

ARM = load_arm("ur10")
BARE = replace(ARM, mass_kg=None, com_m=None)


def described(**more):
    content = made_up_sightings.described("pose", 1.0, (0, 0, 50), **more)
    del content["schema"]
    return CampaignDescription.model_validate(content)


def weighed(campaign, arm, every):
    """Return the arm of a campaign with weights."""
    total_kg = None if campaign.masses is None else campaign.masses.total_kg
    return weighed_arm(arm, every, campaign.payload, total_kg)


def readings(arm=ARM, *, logged=True, noise_Nm=0.3, gain=1.0, count=120):
    """Return poses of an arm whose torques were logged, as its weights make them."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.0, 2.0, (count, arm.n))
    states = at_rest(q, tau_Nm=np.full_like(q, np.nan), temperature_C=np.full(count, 20.0))
    if logged:
        payload = described().payload(arm)
        torque_Nm = statics_of(Model(Chain.of(arm), ()), np.zeros(0), states, payload).joint_Nm
        noise = noise_Nm * rng.standard_normal(torque_Nm.shape)
        states = replace(states, tau_Nm=gain * torque_Nm + noise)
    covariance = np.tile(1e-10 * np.eye(6), (count, 1, 1))
    measured = Pose(Chain.of(arm).forward(q), covariance, np.zeros((count, 6, 0)))
    return Observations.single(np.arange(count).astype(str), states, measured)


def test_an_arm_without_masses_gets_assumed_ones():
    arm = weighed(described(), BARE, readings(logged=False))
    assert weights_known(arm).origin == "assumed"
    assert weights_finding(arm) == ()


def test_the_mass_of_the_whole_arm_is_taken():
    campaign = described(masses={"total_kg": 28.9})
    assert campaign.masses == Masses(total_kg=28.9)
    arm = weighed(campaign, BARE, readings(logged=False))
    assert arm.mass_kg.sum() == pytest.approx(28.9)


@pytest.mark.parametrize("masses", [np.zeros(6), np.ones(6), np.array([0.0, 1, 1, 1, 1, 0])])
def test_placeholders_of_a_drawing_program_are_no_masses(masses):
    arm = weighed(described(), replace(ARM, mass_kg=masses), readings(logged=False))
    assert weights_known(arm).origin == "assumed"
    (finding,) = weights_finding(arm)
    assert "0 or 1 kg" in finding.what
    assert finding.kind == "masses"


def test_a_total_that_contradicts_the_parts_makes_both_unknown():
    campaign = described(masses={"total_kg": 290.0})
    arm = weighed(campaign, ARM, readings(logged=False))
    assert weights_known(arm).origin == "assumed"
    (finding,) = weights_finding(arm)
    assert "290 kg" in finding.what
    assert weighed(described(masses={"total_kg": 30.0}), ARM, readings(logged=False)) is ARM


def test_logged_torques_weigh_an_arm_that_states_nothing():
    arm = weighed(described(), BARE, readings())
    assert weights_known(arm).origin == "logged"
    poses = readings(logged=False)
    payload = described().payload(ARM)

    def torque_Nm(of):
        model = Model(Chain.of(of), ())
        return statics_of(model, np.zeros(0), poses.states, payload).joint_Nm

    off = np.sqrt(np.mean((torque_Nm(arm) - torque_Nm(ARM)) ** 2))
    assert off < 0.1 * np.sqrt(np.mean(torque_Nm(ARM) ** 2))


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_torques_that_fit_leave_stated_masses_alone(gain):
    arm = weighed(described(), ARM, readings(gain=gain))
    known = weights_known(arm)
    assert known.origin == "stated"
    assert known.by_log.said == ""
    np.testing.assert_array_equal(arm.mass_kg, ARM.mass_kg)


def model_on_springs(arm, tool_kg, u=1e-12):
    """Return a model with springs of known stiffness, fitted to logged torques."""
    springs = tuple(JointSpring(joint, 100.0, cubic=False) for joint in (2, 3))
    payload = replace(described().payload(arm), mass_kg=tool_kg)
    x = np.concatenate([spring.solved(3e4, 0.0) for spring in springs])
    covariance = u * np.eye(len(x) + 6)
    model = Model(Chain.of(arm), springs)
    return FittedModel(model, x, np.eye(4), payload=payload, covariance=covariance)


@pytest.mark.parametrize(("stated_kg", "says"), [(1.0, False), (3.0, True)])
def test_predictions_go_by_the_masses_that_the_log_has(stated_kg, says, tmp_path):
    """The arm carries 1 kg, and each link weighs 5 % more than stated."""
    logged = readings(replace(ARM, mass_kg=1.05 * ARM.mass_kg))
    tool = {"mass_kg": stated_kg, "com_mm": [0, 0, 50], "load_point_mm": [0, 0, 0]}
    arm = weighed(described(tool=tool), ARM, logged)
    said = weights_known(arm).by_log.said
    assert said.startswith("the tool is stated with 3 kg, and logged torques have it at") == says
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    true = model_on_springs(replace(ARM, mass_kg=1.05 * ARM.mass_kg), 1.0).predict(q)
    stated = model_on_springs(ARM, stated_kg).predict(q)
    model = model_on_springs(arm, stated_kg)
    save_model(model, tmp_path / "model.yaml")
    for found in (model.predict(q), load_model(tmp_path / "model.yaml").predict(q)):
        off_mm, before_mm = (
            1e3 * np.linalg.norm(each.T[:, :3, 3] - true.T[:, :3, 3], axis=1)
            for each in (found, stated)
        )
        assert np.sqrt(np.mean(off_mm**2)) < 0.1 * np.sqrt(np.mean(before_mm**2))
        # What the log leaves open is in the uncertainty, and was in none.
        assert 0.3 < np.sqrt(np.mean(off_mm**2) / np.mean(found.u_parameters_mm**2)) < 2.0
        assert np.all(found.u_parameters_mm > stated.u_parameters_mm)


def test_predictions_hold_what_a_log_leaves_of_weights_that_nobody_stated(tmp_path):
    arm = weighed(described(), BARE, readings())
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    true = model_on_springs(ARM, 1.0).predict(q)
    model = model_on_springs(arm, 1.0)
    save_model(model, tmp_path / "model.yaml")
    for found in (model.predict(q), load_model(tmp_path / "model.yaml").predict(q)):
        off_mm = 1e3 * np.linalg.norm(found.T[:, :3, 3] - true.T[:, :3, 3], axis=1)
        assert 0.2 < np.sqrt(np.mean(off_mm**2) / np.mean(found.u_parameters_mm**2)) < 2.0


@pytest.mark.parametrize("stated_kg", [1.0, 3.0])
def test_links_and_base_carry_what_the_log_has(stated_kg):
    """The arm carries 1 kg, and each link weighs 5 % more than stated."""
    heavier = replace(ARM, mass_kg=1.05 * ARM.mass_kg)
    tool = {"mass_kg": stated_kg, "com_mm": [0, 0, 50], "load_point_mm": [0, 0, 0]}
    arm = weighed(described(tool=tool), ARM, readings(heavier))
    poses, payload = readings(logged=False), described().payload(ARM)

    def moments_Nm(of, kg):
        model, carried = Model(Chain.of(of), ()), replace(payload, mass_kg=kg)
        loads = statics_of(model, np.zeros(0), poses.states, carried)
        return np.concatenate([loads.base_Nm, loads.link_Nm[:, 1], loads.joint_Nm], axis=1)

    true = moments_Nm(heavier, 1.0)
    off, before = (moments_Nm(of, stated_kg) - true for of in (arm, ARM))
    assert np.sqrt(np.mean(off**2)) < 0.2 * np.sqrt(np.mean(before**2))


def test_weights_of_a_log_are_those_of_the_fitted_postures():
    """Zeros of joints 2 and 3 off by 8 and -6 mrad change torques by up to 1 N m at joint 2."""
    off_rad = np.array([0.0, 8e-3, -6e-3, 0.0, 0.0, 0.0])
    plain, payload = readings(logged=False), described().payload(ARM)
    true = replace(plain.states, q_rad=plain.states.q_rad + off_rad)
    tau_Nm = statics_of(Model(Chain.of(ARM), ()), np.zeros(0), true, payload).joint_Nm
    noise_Nm = 0.05 * np.random.default_rng(4).standard_normal(tau_Nm.shape)
    log = plain.with_states(replace(plain.states, tau_Nm=tau_Nm + noise_Nm))
    arm = weighed(described(), ARM, log)
    zeros = link_departures(ARM, Tolerances())
    x = np.zeros(len(zeros.parameters))
    names = [parameter.name for parameter in zeros.parameters]
    x[[names.index(f"delta_theta_{joint}") for joint in (2, 3)]] = off_rad[1:3]
    model = FittedModel(Model(Chain.of(arm), (zeros,)), x, np.eye(4), payload=payload)
    about = weighed_model(model, log)

    def rms_Nm(of):
        loads = statics_of(of.model, of.x, plain.states, payload)
        return np.sqrt(np.mean((loads.joint_Nm - tau_Nm) ** 2))

    assert rms_Nm(about) < 0.02
    assert rms_Nm(model) > 5.0 * rms_Nm(about)


#: Zeros of the torques of a log; 1 % of the rated torques is usual.
ZEROS_NM = np.array([5.0, -8.0, 6.0, 1.5, -1.0, 0.4])


def with_torques_more(every, more_Nm, **known):
    states = every.states
    return every.with_states(replace(states, tau_Nm=states.tau_Nm + more_Nm, **known))


@pytest.mark.parametrize("gain", [1.0, 0.9])
@pytest.mark.parametrize("stated", [ARM, BARE, replace(ARM, mass_kg=1.05 * ARM.mass_kg)])
def test_zeros_of_logged_torques_are_taken_out_and_the_large_ones_told(stated, gain):
    plain = readings(gain=gain)
    log = with_torques_more(plain, ZEROS_NM)
    arm, as_without = weighed(described(), stated, log), weighed(described(), stated, plain)
    known, other = weights_known(arm).by_log, weights_known(as_without).by_log
    np.testing.assert_allclose(known.zero_Nm, ZEROS_NM, atol=0.13)
    assert all(f"N m at joint {joint}" in known.said for joint in (1, 2, 3, 4, 5))
    assert "joint 6" not in known.said  # as the zero of any sensor
    cleared = without_torque_errors(log, arm)
    np.testing.assert_allclose(cleared.states.tau_Nm - plain.states.tau_Nm, 0.0, atol=0.13)
    # Neither masses nor level take up what a zero is: the torques of both arms are the same.
    np.testing.assert_allclose(known.x, other.x, atol=0.05 * np.sqrt(other.covariance.max()))
    payload, poses = described().payload(as_without), readings(logged=False)
    with_zeros, without = (
        statics_of(Model(Chain.of(each), ()), np.zeros(0), poses.states, payload).joint_Nm
        for each in (arm, as_without)
    )
    differ_Nm = np.sqrt(np.mean((with_zeros - without) ** 2, axis=0))
    assert np.all(differ_Nm < 0.02 * np.abs(ZEROS_NM).max())


def test_torques_without_zeros_are_left_as_they_are():
    log = readings()
    arm = weighed(described(), ARM, log)
    assert not len(weights_known(arm).by_log.zero_Nm)
    assert without_torque_errors(log, arm) is log
    assert without_torque_errors(log, ARM) is log


@pytest.mark.parametrize("off_rad", [[0, 0.02, 0.02, 0, 0.02, 0], [0, -0.02, 0, 0, 0, 0]])
def test_joints_that_are_mastered_a_degree_off_are_no_errors_of_weights_or_log(off_rad):
    """They were told as a wrong centre of link 3, and taken out as a zero of joint 3."""
    arm, rng = load_arm("pa10_6ce"), np.random.default_rng(1)
    tool = {"mass_kg": 2.4, "com_mm": [0, 0, 190], "load_point_mm": [0, 0, 30]}
    campaign, plain = described(tool=tool), readings(arm, logged=False, count=200)
    q = rng.uniform(-0.5, 0.5, (200, 6)) + np.array([0.0, 0.3, 1.3, 0.0, -0.5, 0.0])
    loads_N = np.resize((0.0, 22.0, 44.0, 90.0), 200)
    true = replace(plain.states, q_rad=q + off_rad, load_N=loads_N)
    payload = campaign.payload(arm)
    tau_Nm = statics_of(Model(Chain.of(arm), ()), np.zeros(0), true, payload).joint_Nm
    tau_Nm += 0.05 * rng.standard_normal(tau_Nm.shape)
    log = plain.with_states(replace(true, q_rad=q, tau_Nm=tau_Nm))
    known = weights_known(weighed(campaign, arm, log))
    assert known.why == ""
    assert not known.by_log.zero_Nm.any()


FRICTION_NM = np.array([9.0, 8.0, 4.0, 1.5, 0.02, 0.0])


def with_friction(every, repeats=1, only=slice(None)):
    """Return readings whose torques hold friction, in a random order, each that often."""
    every = every.take(np.repeat(np.arange(len(every)), repeats))
    rng = np.random.default_rng(8)
    arrival = np.where(rng.uniform(size=every.states.tau_Nm.shape) < 0.5, -1.0, 1.0)
    friction_Nm = np.zeros(6)
    friction_Nm[only] = FRICTION_NM[only]
    return with_torques_more(every, friction_Nm * arrival, arrival=arrival)


@pytest.mark.parametrize("stated", [ARM, BARE])
def test_friction_of_motors_is_taken_out_and_that_of_sensors_left(stated):
    plain = readings()
    log = with_friction(plain)
    arm = weighed(described(), stated, log)
    known = weights_known(arm).by_log
    of_motors = FRICTION_NM > 1.0
    np.testing.assert_array_equal(known.friction_Nm > 0.0, of_motors)
    off_Nm = (known.friction_Nm - FRICTION_NM)[of_motors]
    assert np.all(np.abs(off_Nm) < 4.0 * known.u_friction_Nm[of_motors])
    assert np.all(known.u_friction_Nm[of_motors] < 0.1)
    assert "logged torques hold friction at 4 joints, at the most +9" in known.said
    cleared_Nm = without_torque_errors(log, arm).states.tau_Nm
    np.testing.assert_allclose(cleared_Nm - plain.states.tau_Nm, 0.0, atol=0.3)


def test_friction_of_one_joint_is_that_of_a_joint():
    log = with_friction(readings(), only=0)
    said = weights_known(weighed(described(), ARM, log)).by_log.said
    assert "friction at 1 joint, at the most +9" in said


def test_friction_is_an_effect_to_be_sought_where_poses_are_repeated():
    log = with_friction(readings(), repeats=2)
    arm = weighed(described(), ARM, log)
    assert not len(weights_known(arm).by_log.friction_Nm)
    assert without_torque_errors(log, arm) is log


def test_friction_against_the_direction_of_arrival_is_none():
    log = with_friction(readings())
    reversed_ = log.with_states(replace(log.states, arrival=-log.states.arrival))
    assert not len(weights_known(weighed(described(), ARM, reversed_)).by_log.friction_Nm)


@pytest.mark.parametrize("stated", [ARM, BARE])
def test_zeros_larger_than_the_torques_of_the_weights_are_found(stated):
    zeros_Nm = 0.2 * ARM.torque_limit_Nm
    arm = weighed(described(), stated, with_torques_more(readings(), zeros_Nm))
    np.testing.assert_allclose(weights_known(arm).by_log.zero_Nm, zeros_Nm, atol=0.13)


@pytest.mark.parametrize("both_sides", [True, False])
def test_friction_is_no_zero(both_sides):
    """What joints that always arrive from one side show may be either, and is not told."""
    plain = readings()
    rng = np.random.default_rng(5)
    arrival = np.sign(rng.standard_normal(plain.states.tau_Nm.shape))
    arrival = arrival if both_sides else np.ones_like(arrival)
    friction_Nm = 0.02 * ARM.torque_limit_Nm * arrival
    log = with_torques_more(plain, friction_Nm, arrival=arrival)
    assert not len(weights_known(weighed(described(), ARM, log)).by_log.zero_Nm)
    if both_sides:
        log = with_torques_more(log, ZEROS_NM)
        found = weights_known(weighed(described(), ARM, log)).by_log.zero_Nm
        np.testing.assert_allclose(found, ZEROS_NM, atol=0.13)


def test_a_load_of_another_size_is_no_zero():
    plain = readings()
    load_N = np.repeat([0.0, 50.0, 100.0], 40)
    states = replace(plain.states, tau_Nm=np.full_like(plain.states.tau_Nm, np.nan), load_N=load_N)
    true = replace(states, load_N=np.where(load_N > 60.0, 115.0, load_N))
    model, payload = Model(Chain.of(ARM), ()), described().payload(ARM)
    torque_Nm = statics_of(model, np.zeros(0), true, payload).joint_Nm
    noise_Nm = 0.3 * np.random.default_rng(4).standard_normal(torque_Nm.shape)
    log = plain.with_states(replace(states, tau_Nm=torque_Nm + noise_Nm))
    assert not len(weights_known(weighed(described(), ARM, log)).by_log.zero_Nm)
    log = with_torques_more(log, ZEROS_NM)
    found = weights_known(weighed(described(), ARM, log)).by_log.zero_Nm
    np.testing.assert_allclose(found, ZEROS_NM, atol=0.2)


def test_zeros_are_kept_with_the_model(tmp_path):
    arm = weighed(described(), ARM, with_torques_more(readings(), ZEROS_NM))
    save_model(model_on_springs(arm, 1.0), tmp_path / "model.yaml")
    back = weights_known(load_model(tmp_path / "model.yaml").arm).by_log
    np.testing.assert_array_equal(back.zero_Nm, weights_known(arm).by_log.zero_Nm)


def test_what_is_read_of_a_campaign_has_no_zeros(tmp_path):
    """Fit, search and held-out poses take the torques that predictions calculate."""
    made = made_up_sightings.sighted(tmp_path, "pose", poses=60)
    campaign = CampaignDescription.model_validate(
        {key: value for key, value in made.description.items() if key != "schema"}
    )
    states = at_rest(made.q)
    model, payload = Model(Chain.of(ARM), ()), campaign.payload(ARM)
    torque_Nm = statics_of(model, np.zeros(0), states, payload).joint_Nm
    logged_Nm = torque_Nm + ZEROS_NM
    logged_Nm += 0.1 * np.random.default_rng(2).standard_normal(logged_Nm.shape)
    names = ",".join(f"tau{joint}_Nm" for joint in range(1, 7))
    torques = [names, *(",".join(f"{each:.4f}" for each in row) for row in logged_Nm)]
    made.poses = [f"{line},{more}" for line, more in zip(made.poses, torques, strict=True)]
    folder = made.write()
    raw = campaign_read.read_campaign(folder)
    write_pose_table(tmp_path / "poses.parquet", raw.observations, ARM.prismatic, raw.name)
    _, _, staged = read_measured(folder, tmp_path / "poses.parquet")
    for every in (staged, pa10cal.read_campaign(folder).observations):
        left_Nm = (
            every.states.tau_Nm - statics_of(model, np.zeros(0), every.states, payload).joint_Nm
        )
        np.testing.assert_allclose(left_Nm.mean(axis=0), 0.0, atol=0.1)


@pytest.mark.parametrize("noise_Nm", [0.5, 3.0])
def test_the_noise_of_torques_puts_the_end_off_through_the_springs(noise_Nm):
    logged, exact = (readings(noise_Nm=each, count=200) for each in (noise_Nm, 0.0))
    model = model_on_springs(ARM, 1.0)
    noisy, true = (model.model.predict(each.states, model.x) for each in (logged, exact))
    off_mm = 1e3 * np.linalg.norm((noisy - true)[:, :3, 3], axis=1)
    residual, payload = model.compared(logged).residual, described().payload(ARM)
    found = torque_noise(model, logged, payload, residual, logged.measured.stated_covariance)
    found_mm = position_noise_mm(logged.measured, found.cov)
    assert found_mm == pytest.approx(np.sqrt(np.mean(off_mm**2)), rel=0.15)
    np.testing.assert_allclose(found.torque_Nm, noise_Nm, rtol=0.15)
    assert found.share == 1.0
    assert torque_noise(model, logged, None, residual, found.cov) is None


def test_a_mass_that_torques_contradict_is_told_and_taken_from_them():
    stated = np.where(np.arange(6) == 4, 1000.05, ARM.mass_kg)
    arm = weighed(described(), replace(ARM, mass_kg=stated), readings())
    (finding,) = weights_finding(arm)
    assert "link 5 is stated with 1000 kg" in finding.what
    assert arm.mass_kg[4] < 20.0


def with_tool(tool_kg):
    return described(tool={"mass_kg": tool_kg, "com_mm": [0, 0, 50], "load_point_mm": [0, 0, 0]})


def carrying(tool_kg, com_m=0.05):
    """Return readings of an arm that carries a tool of this mass and centre."""
    payload, every = with_tool(tool_kg).payload(ARM), readings()
    payload = replace(payload, com_m=np.array([0.0, 0.0, com_m]))
    model = Model(Chain.of(ARM), ())
    stated, true = (
        statics_of(model, np.zeros(0), every.states, each).joint_Nm
        for each in (described().payload(ARM), payload)
    )
    return with_torques_more(every, true - stated)


@pytest.mark.parametrize("zero_Nm", [0.0, 20.0])
def test_a_tool_far_heavier_than_stated_is_told_and_predictions_go_by_the_log(zero_Nm):
    log = with_torques_more(carrying(3.0), np.where(np.arange(6) == 1, zero_Nm, 0.0))
    arm = weighed(with_tool(1.4), ARM, log)
    (finding,) = weights_finding(arm)
    assert "or of the tool" in finding.what
    known = weights_known(arm).by_log
    assert ("zero of +20" in known.said) == (zero_Nm > 0.0)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    found, true = model_on_springs(arm, 1.4).predict(q), model_on_springs(ARM, 3.0).predict(q)
    assert 1e3 * np.linalg.norm((found.T - true.T)[:, :3, 3], axis=1).max() < 0.1


def stated_times(factor, link):
    return replace(ARM, mass_kg=np.where(np.arange(6) == link - 1, factor, 1.0) * ARM.mass_kg)


@pytest.mark.parametrize("tool_kg", [1.4, 4.0])
def test_a_wrong_mass_far_in_is_told_as_mass_or_centre_whatever_the_tool(tool_kg):
    """Torques are of products of mass and lever."""
    arm = weighed(with_tool(1.4), stated_times(2.5, 2), carrying(tool_kg))
    (finding,) = weights_finding(arm)
    assert finding.what.startswith("the mass or the centre of link 2 is stated wrongly: ")
    assert "link 2 is stated with 31.75 kg, and logged torques have it at 12." in finding.what
    assert ("link 6, or of the tool" in finding.what) == (tool_kg != 1.4)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    found, true = model_on_springs(arm, 1.4).predict(q), model_on_springs(ARM, tool_kg).predict(q)
    assert 1e3 * np.linalg.norm((found.T - true.T)[:, :3, 3], axis=1).max() < 0.02


def test_a_wrong_centre_of_the_tool_is_not_that_of_a_link():
    arm = weighed(with_tool(1.4), ARM, carrying(1.4, com_m=0.3))
    (finding,) = weights_finding(arm)
    assert "the centre stated of link 5 or link 6, or of the tool" in finding.what
    np.testing.assert_array_equal(arm.mass_kg, ARM.mass_kg)
    np.testing.assert_array_equal(arm.com_m, ARM.com_m)
    assert weights_known(arm).by_log.x[4 * 5 + 3] == pytest.approx(1.4 * 0.25, rel=0.1)


@pytest.mark.parametrize("stated_kg", [3.0, 6.0])
def test_a_tool_that_is_not_there_has_no_mass_below_zero(stated_kg):
    arm = weighed(with_tool(stated_kg), ARM, carrying(0.0))
    assert "or of the tool" in weights_finding(arm)[0].what
    known = weights_known(arm).by_log
    assert known.x[-3] >= -stated_kg
    assert "at -" not in known.said


# Of the last two logged torques no longer follow those of the weights described.
@pytest.mark.parametrize(
    ("away_m", "said"), [(0.6, "is stated at"), (0.9, "is stated at"), (3.0, "from its frame")]
)
def test_a_centre_that_torques_contradict_is_told(away_m, said):
    com_m = ARM.com_m.copy()
    com_m[2, 0] += away_m
    arm = weighed(described(), replace(ARM, com_m=com_m), readings())
    (found,) = weights_finding(arm)
    assert "of link 3" in found.what
    assert said in found.what
    moment = arm.com_m[2, 0] * arm.mass_kg[2]
    assert moment == pytest.approx(ARM.com_m[2, 0] * ARM.mass_kg[2], abs=0.6)


def test_torques_of_the_other_sign_are_no_weights():
    logged = readings()
    states = replace(logged.states, tau_Nm=-logged.states.tau_Nm)
    arm = weighed(described(), ARM, replace(logged, states=states))
    assert not weights_finding(arm)
    np.testing.assert_array_equal(arm.mass_kg, ARM.mass_kg)


def supported(force_N, anchor_m=(-0.3, -0.2), radius_m=0.25):
    """Return readings of an arm whose link 2 a gas spring pushes up, by virtual work on its length.

    Its cylinder is pinned to the column and to a lever behind the axis of joint 2.
    """
    every = readings()

    def length_m(q_rad):
        pin_m = -radius_m * np.stack([np.cos(q_rad), np.sin(q_rad)], axis=-1)
        return np.linalg.norm(pin_m - np.array(anchor_m), axis=-1)

    step, q_rad = 1e-6, every.states.q_rad[:, 1]
    by_angle = (length_m(q_rad + step) - length_m(q_rad - step)) / (2.0 * step)
    more_Nm = np.zeros((len(q_rad), ARM.n))
    more_Nm[:, 1] = -force_N * by_angle
    return with_torques_more(every, more_Nm)


def test_a_gas_spring_is_no_centre_of_mass_outside_its_link():
    (finding,) = weights_finding(weighed(described(), ARM, supported(1500.0)))
    assert "centre of mass" not in finding.what
    assert "gas spring that nobody stated acts on joint 2" in finding.what


def test_a_wrong_centre_of_the_link_that_lifts_may_be_a_balancer_and_that_of_another_not():
    for link, may_be in ((2, True), (3, False)):
        com_m = ARM.com_m.copy()
        com_m[link - 1, 0] += 0.3
        (finding,) = weights_finding(weighed(described(), replace(ARM, com_m=com_m), readings()))
        assert f"centre of mass of link {link}" in finding.what
        assert (f"acts on joint {link}" in finding.what) == may_be
