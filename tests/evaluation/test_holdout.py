"""Held-out errors by hand, and a model carried to another campaign, whose instrument moved."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from changed_arm import Change, draw_changed
from drawn_examples import examples
from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.verdict_records import Extended
from pa10cal.errors import CalibrationError
from pa10cal.evaluation import carried_model as parts
from pa10cal.evaluation.carried_model import (
    base_steps_s,
    with_enough_poses,
    with_frames_refitted,
)
from pa10cal.evaluation.holdout import (
    Evaluation,
    base_motion_line,
    held_out_record,
    judged_where_repeated,
    transfer_record,
)
from pa10cal.evaluation.model_errors import constant_tool_twist, held_out_errors
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.points import Points
from pa10cal.results.evaluation import PartOfCampaign
from pa10cal.terms.effects.joint import GearRatioError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.field import Nameless
from pa10cal.terms.model import Model
from pa10cal_lab.cell.options import TrackerOptions
from pa10cal_lab.simulated import measure, observations_of, payload_of_individual


@examples(20)
@given(angle=st.floats(1e-4, 0.1), seed=st.integers(0, 100))
def test_a_constant_twist_of_the_tool_explains_all(angle, seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(12, rng=rng)
    axis = rng.normal(size=3)
    twist = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    found = constant_tool_twist(R.as_matrix(), (R * twist).as_matrix())
    assert found.angle_deg == pytest.approx(np.degrees(angle), rel=1e-6)
    assert found.before_deg == pytest.approx(np.degrees(angle), rel=1e-6)
    assert found.after_deg < 1e-5
    np.testing.assert_allclose(np.radians(found.rotation_deg), twist.as_rotvec(), atol=1e-9)


def test_scattered_differences_are_not_explained_by_a_twist():
    rng = np.random.default_rng(1)
    R = Rotation.random(200, rng=rng)
    scatter = Rotation.from_rotvec(rng.normal(scale=0.01, size=(200, 3)))
    found = constant_tool_twist(R.as_matrix(), (R * scatter).as_matrix())
    assert found.after_deg > 0.95 * found.before_deg


def test_judges_by_load_by_point_and_beyond_what_was_learnt():
    arm = load_arm("pa10_6ce")
    model = FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))
    q_rad = np.random.default_rng(2).uniform(-1.0, 1.0, (4, 6))
    T = Chain.of(arm).forward(q_rad)
    T[:, 0, 3] -= [1e-3, 2e-3, 3e-3, 6e-3]
    load = np.array([22.0, 90.0, 22.0, 90.0])
    labels = np.array(["H01", "H01", "H02", "H02"])
    poses = measured_poses(labels, at_rest(q_rad, load_N=load), T, np.zeros((4, 6, 6)))
    found = held_out_errors(model, poses)
    assert found.mean_mm == pytest.approx(3.0)
    assert found.peak_mm == pytest.approx(6.0)
    assert found.per_load["90N"].mean_mm == pytest.approx(4.0)
    assert found.per_point["H01"].mean_mm == pytest.approx(1.5)
    assert found.orientation_deg == pytest.approx(0.0, abs=1e-9)
    assert found.inside is found.outside is None
    assert found.tool_twist.angle_deg == pytest.approx(0.0, abs=1e-6)
    parted = held_out_errors(model, poses, np.array([False, True, True, True]))
    assert parted.inside.rms_mm == pytest.approx(1.0)
    assert parted.outside.rms_mm == pytest.approx(7.0 / np.sqrt(3.0))


# The model of an arm in another campaign of that arm, which was mounted anew.

ARM = load_arm("ur10")
CAMPAIGN = SimpleNamespace(name="b", provenance="p", robot="ur10")
POSES, KNOCKED_AT = 120, 70
SHIFT_M, TURN_RAD = np.array([2.5e-4, -3e-4, 1e-4]), np.array([0.0, 1e-4, 1e-4])


@pytest.fixture(scope="module", name="carried")
def _carried():
    plan = TrackerOptions(poses=POSES, holdout_share=0.0, flexible_joints=(2,), hardening=False)
    robots = draw_changed(ARM, plan, Change(place=True), np.random.default_rng(4))
    before, after = (observations_of(measure(robot, plan, k)) for k, robot in enumerate(robots))
    payload = payload_of_individual(robots[0])
    model = fitted(calibrate_general(ARM, before, find_start(ARM, before), payload))
    after = after.take(np.argsort(after.states.time_s))
    kind = np.where(np.arange(POSES) % 4 < 3, "grid", "holdout")
    return model, replace(after, kind=kind), MeasurementSetup(payload, np.zeros((0, 3)), 20.0)


def knocked(every):
    """Return readings whose instrument was knocked before one of them."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(TURN_RAD).as_matrix(), SHIFT_M
    late = np.arange(POSES) >= KNOCKED_AT
    seen = every.measured.T_instr_target
    return every.with_measured(T_instr_target=np.where(late[:, None, None], T @ seen, seen))


def with_targets(every, seen):
    """Return readings as of targets, of which those in seen (P, B) were measured."""
    p_m = np.where(seen[..., None], np.full(3, 0.5), np.nan)
    names = tuple(map(str, range(seen.shape[1])))
    measured = Points(names, p_m, p_m[..., None] * np.eye(3), None)
    return replace(every, measured=measured)


def elsewhere(carried, every):
    model, _, setup = carried
    return transfer_record(CAMPAIGN, "a", Evaluation(every, {"linear": model}, None, setup))


@pytest.fixture(scope="module", name="in_parts")
def _in_parts(carried):
    return elsewhere(carried, knocked(carried[1]))


@pytest.fixture(scope="module", name="still")
def _still(carried):
    return elsewhere(carried, carried[1])


def test_base_and_tool_are_enough_for_the_same_arm(still):
    assert still.models["linear"].rms_mm < 0.13
    assert still.models["linear"].inside.configurations <= 30
    assert not {"parts", "one_base"} & set(still.model_dump(mode="json"))
    assert base_motion_line(still.parts or ()) == ""


def test_a_tool_that_is_not_stated_is_that_of_the_models_campaign(carried, still):
    model, every, setup = carried
    every = every.with_states(
        replace(every.states, tau_Nm=np.full_like(every.states.tau_Nm, np.nan))
    )
    heavy = replace(setup.payload, mass_kg=20.0)
    light = replace(setup.payload, mass_kg=0.0, known=False)

    def judged(payload):
        models = {"linear": replace(model, payload=heavy)}
        there = replace(setup, payload=payload)
        return transfer_record(CAMPAIGN, "a", Evaluation(every, models, None, there))

    rms_mm = judged(heavy).models["linear"].rms_mm
    assert judged(light).models["linear"].rms_mm == pytest.approx(rms_mm, rel=1e-9)
    assert abs(judged(replace(light, known=True)).models["linear"].rms_mm - rms_mm) > 1e-3


def test_a_base_for_every_part_brings_back_what_the_model_is_worth(still, in_parts):
    rms_mm = still.models["linear"].rms_mm
    assert in_parts.models["linear"].rms_mm < 1.1 * rms_mm
    assert in_parts.one_base["linear"].rms_mm > 1.5 * rms_mm
    plain = in_parts.model_dump(mode="json")
    assert [set(part) for part in plain["parts"]] == [
        {"from", "to", "poses", "held_out", "moved_by_mm", "turned_by_mrad"}
    ] * 2
    assert "a base for every part" in base_motion_line(in_parts.parts)


def test_the_line_on_motion_tells_turns_and_times_since_the_first_reading():
    common = {"poses": 45, "held_out": 15}
    first = {"from": 1712350000.0, "to": 1712350100.0, "moved_by_mm": None, "turned_by_mrad": None}
    second = {"from": 1712350101.5, "to": 1712350200.0, "moved_by_mm": 0.0, "turned_by_mrad": 1.5}
    line = base_motion_line([PartOfCampaign(**each, **common) for each in (first, second)])
    assert "by 0.00 mm and 1.50 mrad before 101.5 s after the first reading:" in line


def test_the_parts_and_the_motion_between_them_are_recovered(carried, in_parts):
    first, second = in_parts.parts
    times_s = carried[1].states.time_s
    # Held-out poses have no part in it, so that the knock is known to within one of them.
    assert abs(np.searchsorted(times_s, second.from_s) - KNOCKED_AT) <= 1
    assert (first.poses + second.poses, first.held_out + second.held_out) == (90, 30)
    assert first.moved_by_mm is None
    places_m = carried[1].measured.T_instr_target[:, :3, 3]
    by_m = places_m @ (Rotation.from_rotvec(TURN_RAD).as_matrix() - np.eye(3)).T + SHIFT_M
    true_mm = 1e3 * np.sqrt(np.mean(np.sum(by_m**2, axis=1)))
    assert second.moved_by_mm == pytest.approx(true_mm, abs=0.05)
    assert second.turned_by_mrad == pytest.approx(1e3 * np.linalg.norm(TURN_RAD), abs=0.05)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("again", [(10, 80), (), range(0, 90, 2), (10,)])
def test_a_step_is_found_however_many_poses_are_repeated(carried, again):
    """A few are too few to show the noise of readings."""
    every = knocked(carried[1])
    grid = np.flatnonzero(every.kind == "grid")
    rows = np.sort(np.append(np.arange(POSES), grid[list(again)])) if again else np.arange(POSES)
    time_s, seen = every.states.time_s[rows], every.measured.T_instr_target[rows].copy()
    second = np.flatnonzero(np.diff(rows) == 0) + 1
    time_s[second] += 1e-3
    rng = np.random.default_rng(2)
    seen[second, :3, 3] += 5e-5 * rng.standard_normal((len(second), 3))
    turn_rad = 2e-4 * rng.standard_normal((len(second), 3))
    seen[second, :3, :3] @= Rotation.from_rotvec(turn_rad).as_matrix()
    every = every.take(rows)
    every = every.with_states(replace(every.states, time_s=time_s))
    every = every.with_measured(T_instr_target=seen)
    (step_s,) = base_steps_s(with_frames_refitted(carried[0], every, carried[2]))
    knocked_s = carried[1].states.time_s[KNOCKED_AT - 1 : KNOCKED_AT + 1]
    assert knocked_s[0] - 5.0 <= step_s <= knocked_s[1] + 5.0, (step_s, knocked_s)


def test_repeats_scatter_by_the_noise_of_single_readings(carried):
    """Readings that are repeated by none, and components of one reading alone, are left out."""
    rng, rows = np.random.default_rng(6), np.tile(np.arange(80), 3)
    seen = np.ones((240, 2), dtype=bool)
    seen[80:, 1], seen[140:160], seen[220:] = np.arange(160) % 80 >= 20, False, False
    every = with_targets(carried[1].take(rows), seen)
    of_pose = 0.1 * rng.standard_normal((80, 6))
    residuals = of_pose[rows] + 1e-3 * rng.standard_normal((240, 6))
    found, deviations = parts._deviations_of_repeats(every, residuals)
    assert set(found) == {*range(20, 60), *range(80, 140), *range(160, 220)}
    known = deviations[every.measured.components_seen[found]]
    assert np.sqrt(np.mean(known**2)) == pytest.approx(1e-3, rel=0.1)


def test_rows_in_the_order_of_their_angles_are_not_cut(carried):
    every = knocked(carried[1])
    ramp = np.linspace(-1.0, 1.0, POSES)[:, None] * np.ones(ARM.n)
    seen = carried[0].predict(ramp, frame="tool").T
    T = np.eye(4)
    T[:3, 3] = SHIFT_M
    seen[KNOCKED_AT:] = T @ seen[KNOCKED_AT:]
    seen[:, :3, 3] += 1e-5 * np.random.default_rng(1).standard_normal((POSES, 3))
    every = every.with_states(replace(every.states, q_rad=ramp))
    assert elsewhere(carried, every.with_measured(T_instr_target=seen)).parts is None


def revisited(carried, moved):
    """Return readings of a scan that comes back to all its places, half of them after a motion.

    Places have other labels the second time, and the model lacks 0.12 mm that goes with them.
    """
    model, every, _ = carried
    rng = np.random.default_rng(8)
    half = POSES // 2
    once = rng.uniform([-2.5, -2, -2, -2, -2, -2.5], [2.5, 0, 2, 2, 2, 2.5], (half, 6))
    once = once[np.argsort(once[:, 0])]
    q_rad = np.tile(once, (2, 1)) + 1e-4 * rng.normal(size=(POSES, 6))
    T = model.T_instr_base @ model.predict(q_rad, frame="tool").T
    lacks = [np.sin(2 * q_rad[:, 1] + q_rad[:, 2] + k) + np.sin(3 * q_rad[:, 4]) for k in range(3)]
    T[:, :3, 3] += 7e-5 * np.transpose(lacks) + 2e-5 * rng.normal(size=(POSES, 3))
    noise = Rotation.from_rotvec(5e-5 * rng.normal(size=(POSES, 3))).as_matrix()
    T[:, :3, :3] = T[:, :3, :3] @ noise
    if moved:
        T[half:, :3, 3] += [1.2e-4, -1.3e-4, 1e-4]
    states = replace(every.states, q_rad=q_rad, tau_Nm=np.full_like(q_rad, np.nan))
    return every.with_states(states).with_measured(T_instr_target=T)


@pytest.mark.slow
def test_a_step_at_which_a_scan_comes_back_to_its_places_parts_the_base(carried):
    found = elsewhere(carried, revisited(carried, moved=True))
    still = elsewhere(carried, revisited(carried, moved=False))
    assert still.parts is None
    _, second = found.parts
    times_s = np.sort(carried[1].states.time_s)
    assert abs(np.searchsorted(times_s, second.from_s) - POSES // 2) <= 1
    assert second.moved_by_mm == pytest.approx(0.203, abs=0.04)
    assert found.one_base["linear"].rms_mm > 1.2 * still.models["linear"].rms_mm
    assert found.models["linear"].rms_mm < 1.05 * still.models["linear"].rms_mm


def test_a_carried_model_that_is_worse_than_the_nominal_arm_is_told(carried, still):
    assert still.worse is None
    model, every, setup = carried
    wrong = replace(model, x=np.where(np.arange(len(model.x)) < 12, 30.0, 1.0) * model.x)
    found = transfer_record(CAMPAIGN, "a", Evaluation(every, {"linear": wrong}, None, setup))
    assert found.models["linear"].rms_mm > found.models["uncalibrated"].rms_mm
    assert found.worse.startswith("worse here than the nominal arm")
    assert f"linear {found.models['linear'].rms_mm:.3f} mm rms" in found.worse


def test_in_its_own_campaign_a_model_is_parted_where_the_verdict_tells_a_step(carried):
    model, _, setup = carried
    every, models = knocked(carried[1]), {"linear": model}
    times_s = every.states.time_s
    step_s = 0.5 * (times_s[KNOCKED_AT - 1] + times_s[KNOCKED_AT])

    def record(extended):
        return held_out_record(CAMPAIGN, "combined", Evaluation(every, models, extended, setup))

    found, still = record(Extended(model, steps_s=(step_s,))), record(Extended(model))
    assert [part.poses + part.held_out for part in found.parts] == [KNOCKED_AT, POSES - KNOCKED_AT]
    whole = Evaluation(every, models, None, setup).judge_carried().errors
    assert found.by_parts["linear"].rms_mm < 0.7 * whole["linear"].rms_mm
    assert still.by_parts is still.parts is None


def test_held_out_poses_before_a_step_of_a_joint_are_judged_as_since_it(carried):
    model, every, setup = carried
    step_s = float(np.median(every.states.time_s))
    between_s, by_rad = np.array([[step_s, step_s]]), np.array([2e-3])
    moved = MovedZeros((2,), (step_s,), between_s, by_rad, np.zeros((1, 1)))
    q_rad = every.states.q_rad.copy()
    q_rad[every.states.time_s <= step_s, 1] += 2e-3  # the model is of the arm after it
    logged = every.with_states(replace(every.states, q_rad=q_rad))

    def error_mm(readings, extended):
        return Evaluation(readings, {"linear": model}, extended, setup).judge()["extended"].rms_mm

    as_it_was = error_mm(every, Extended(model))
    assert error_mm(logged, Extended(model, moved=moved)) == pytest.approx(as_it_was, rel=1e-9)
    assert error_mm(logged, Extended(model)) > as_it_was + 0.1


def test_configurations_repeated_across_a_step_are_judged_before_and_after_it(carried):
    model, every, setup = carried
    pose = every.pose.copy()
    pose[np.flatnonzero(every.kind == "grid")[::5]] = "again"
    every = replace(every, pose=pose)
    cut_s = float(np.median(every.states.time_s))
    evaluation = Evaluation(every, {"linear": model}, Extended(model, steps_s=(cut_s,)), setup)
    judged = judged_where_repeated(evaluation, held_out={})
    assert set(judged) == {"grid"}
    again = every.take(every.pose == "again").states
    configurations = set(zip(again.load_N, again.time_s > cut_s, strict=True))
    assert len(configurations) == 2 * len(set(again.load_N))
    for model in judged["grid"].values():
        assert (model.rows.pose == "again").sum() == len(configurations)


def test_one_base_is_judged_where_the_poses_of_a_part_do_not_identify_its_own(
    carried, in_parts, monkeypatch
):
    def refit_frames(model, poses, cuts_s):
        if cuts_s:
            raise CalibrationError("not identified", where="grid poses", allowed="", remedy="")
        return refit(model, poses, cuts_s)

    refit = parts.refit_frames
    monkeypatch.setattr(parts, "refit_frames", refit_frames)
    found = elsewhere(carried, knocked(carried[1]))
    assert found.parts is found.one_base is None
    assert found.models["linear"].rms_mm == in_parts.one_base["linear"].rms_mm


@pytest.mark.parametrize(
    ("steps", "cuts"),
    [
        ((60, 30), (30, 60)),
        # Eight readings before the first, or between two: across the less certain step.
        ((60, 8), (60,)),
        ((60, 66), (60,)),
        ((66, 60), (66,)),
    ],
)
def test_a_part_with_too_few_poses_joins_its_neighbour(carried, steps, cuts):
    times_s = carried[1].states.time_s
    assert with_enough_poses(carried[1], times_s[list(steps)]) == tuple(times_s[list(cuts)])


def test_components_of_all_readings_of_a_pose_count_for_a_part(carried):
    seen = np.ones((2 * POSES, 2), dtype=bool)
    seen[::2] = False
    every = with_targets(carried[1].take(np.repeat(np.arange(POSES), 2)), seen)
    times_s = carried[1].states.time_s[[60, 30]]
    assert with_enough_poses(every, times_s) == tuple(times_s[::-1])


def judged_with_map(carried, knots):
    """Judge the model elsewhere, with a map of joint 3 that has learnt from half of its turn."""
    model, every, setup = carried
    effect = JointErrorMap("joint 3")
    longer = replace(
        model,
        model=Model(model.model.chain, (*model.model.terms, effect)),
        x=np.concatenate([model.x, knots * np.ones(effect.knots)]),
        covariance=None,
    )
    half = np.array([[-np.pi, 0.0]])
    seen = AngleCoverage((half, *[np.array([[-10.0, 10.0]])] * 5), (False,) * 6)
    extended = Extended(longer, seen)
    return Evaluation(every, {"linear": model}, extended, setup).judge_carried().errors


def test_all_models_are_judged_apart_where_the_source_saw_no_such_angle(carried):
    found = judged_with_map(carried, 1e-6 * np.sin(np.arange(12)))
    assert set(found) == {"uncalibrated", "linear", "extended"}
    counts = {(m.inside.configurations, m.outside.configurations) for m in found.values()}
    assert len(counts) == 1
    assert sum(*counts) == 30
    assert all(count > 5 for count in next(iter(counts)))


def test_effects_that_harm_in_the_poses_of_the_frames_stay_away(carried):
    found = judged_with_map(carried, 2e-3 * np.sin(3.0 * np.arange(12)))
    assert found["extended"] == found["linear"]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("harm_rad", [2e-3, 0.0])
def test_what_has_no_name_and_harms_elsewhere_leaves_the_effects_there(carried, harm_rad):
    model, every, setup = carried
    off = replace(model, x=model.x + 1e-3 * (np.arange(len(model.x)) == 5), covariance=None)
    nameless = Nameless((GearRatioError("joint 2"),), (1e-3,))
    longer = replace(
        model,
        model=Model(model.model.chain, (*model.model.terms, nameless)),
        x=np.append(model.x, harm_rad),
        covariance=None,
    )
    models = {"off": off}
    found = Evaluation(every, models, Extended(longer, None), setup).judge_carried().errors
    alone = Evaluation(every, {"right": model}, None, setup).judge_carried().errors
    assert found["extended"].rms_mm == pytest.approx(alone["right"].rms_mm, rel=1e-9)
    assert found["extended"].rms_mm < 0.9 * found["off"].rms_mm
