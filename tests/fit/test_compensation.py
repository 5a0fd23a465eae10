"""Compensation: the joint positions it finds, on which branch, and what it says of the others."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from made_up_model import fitted, fitted_to, postures, vocabulary
from pa10cal.arm.chain import Chain
from pa10cal.errors import ArmError, ModelError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage, nothing_seen
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures, tool_frame


def links(arm):
    return (link_departures(arm, Tolerances()),)


def links_and_springs(arm):
    springs = [JointSpring(joint, 80.0) for joint in range(1, arm.n + 1)]
    return (link_departures(arm, Tolerances()), *springs)


def regular(model, q, frame="flange"):
    """Postures away from singularities and limits."""
    low, high = model.arm.limits_rad.T
    sizes = np.linalg.svd(model.jacobian(q, frame=frame), compute_uv=False)[:, -1]
    clear = (q > low + 0.05).all(axis=1) & (q < high - 0.05).all(axis=1)
    return q[(sizes > 0.02) & clear]


Q_IRB, Q_PA10 = (
    np.array([0.3, 0.5, row3, 0.4, row5, -0.6]) for row3, row5 in ((0.2, 0.9), (0.9, 0.8))
)
#: The wrist of the first turned over: the same pose, on another branch.
FLIPPED = Q_IRB + np.array([0.0, 0.0, 0.0, -np.pi, -1.8, np.pi])


def limited(model, limits_rad):
    """Return the same model of an arm with other limits."""
    arm = replace(model.arm, limits_rad=limits_rad)
    return FittedModel(Model(Chain.of(arm), model.model.terms), model.x, np.eye(4))


def off_m(T, other):
    return np.abs(T - other).max()


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pa10_6ce", "ur10", "iiwa14"])
@settings(
    max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 2**32 - 1))
def test_with_the_whole_vocabulary_the_round_trip_ends_where_it_began(robot, seed):
    model = fitted(robot, seed, vocabulary)
    q = regular(model, postures(model.arm, seed, 12), "tool")
    given = {"frame": "tool", "load_N": 22.0, "arrival": 1.0, "temperature_C": 24.0}
    T = model.predict(q, **given).T
    near = q + 0.02 * np.random.default_rng(seed).normal(size=q.shape)
    found = model.compensate(T, seed=near, **given)
    assert set(found.status) <= {"ok"}
    assert off_m(model.predict(found.q, **given).T, T) < 1e-9
    assert found.error_mm.max(initial=0.0) < 1e-6
    np.testing.assert_allclose(found.u_mm, model.predict(found.q, **given).u_mm, rtol=1e-6)
    if model.arm.n == 6:
        np.testing.assert_allclose(found.q, q, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("robot", arm_names())
def test_targets_anywhere_are_reached_without_a_seed(robot):
    model = fitted(robot, 3, links)
    q = regular(model, postures(model.arm, 4, 60))
    T = model.predict(q).T
    found = model.compensate(T)
    arm = model.arm
    # An arm of fewer than six joints that is not as designed cannot turn as it was found turned.
    assert set(found.status) <= {"ok", "near_singular"}
    assert off_m(model.predict(found.q).T[:, :3, 3], T[:, :3, 3]) < 1e-9
    assert (found.q >= arm.limits_rad[:, 0]).all()
    assert (found.q <= arm.limits_rad[:, 1]).all()


@pytest.mark.slow
def test_ten_thousand_poses_with_springs_take_seconds():
    model = fitted("pa10_6ce", 5, links_and_springs)
    q = postures(model.arm, 6, 10_000)
    T = model.predict(q, load_N=22.0).T
    begun = time.process_time()
    found = model.compensate(T, load_N=22.0)
    assert time.process_time() - begun < 15.0  # 3 s on an idle core; a busy machine takes longer
    assert np.isin(found.status, ["ok", "near_singular"]).mean() > 0.999
    ok = found.status == "ok"
    assert off_m(model.predict(found.q[ok], load_N=22.0).T, T[ok]) < 1e-9


@pytest.mark.parametrize("robot", ["ur10", "iiwa14", "gx4_351s"])
def test_a_path_stays_on_its_branch(robot):
    model = fitted(robot, 7, links)
    arm = model.arm
    low, high = np.clip(arm.limits_rad, -2.0, 2.0).T
    ends = low + np.array([[0.6], [0.9]]) * (high - low)
    along = np.linspace(0.0, 1.0, 80)[:, None]
    q = ends[0] + along * (ends[1] - ends[0])
    found = model.compensate(model.predict(q).T, seed=q[0])
    assert set(found.status) <= {"ok", "near_singular"}
    assert np.abs(np.diff(found.q, axis=0)).max() < 0.3
    if arm.n <= 6:
        np.testing.assert_allclose(found.q, q, atol=1e-4)


def test_a_row_of_nan_follows_the_row_before_and_a_seed_chooses_the_branch():
    model = fitted("irb120", 8, links)
    T = np.tile(model.predict(Q_IRB).T, (3, 1, 1))
    found = model.compensate(T, seed=np.array([Q_IRB, FLIPPED, np.full(6, np.nan)]))
    assert list(found.status) == ["ok"] * 3
    np.testing.assert_allclose(found.q[0], Q_IRB, atol=1e-9)
    assert np.abs(found.q[1] - FLIPPED).max() < 0.1
    np.testing.assert_allclose(found.q[2], found.q[1], atol=1e-9)


@pytest.mark.parametrize("robot", [pytest.param("ur10", marks=pytest.mark.slow), "irb120"])
def test_a_seed_that_reaches_its_pose_is_kept_where_the_wrist_is_nearly_straight(robot):
    # There the branches of the arm as designed are far from those of the calibrated one.
    model = fitted(robot, 3, links)
    q = np.clip(postures(model.arm, 5, 300), -1.5, 1.5)
    q[:, 4] = np.radians(np.linspace(-1.0, 1.0, len(q)))
    T = model.predict(q).T
    found = model.compensate(T, seed=q)
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    assert set(found.status) <= {"ok", "near_singular"}
    assert set(found.branch) == {"nearest"}
    # A seed that reaches the pose but for a tenth of what counts as reached keeps it, too.
    T[:, :3, 3] += 1e-7
    assert np.abs(model.compensate(T, seed=q).q - q).max() < 0.1


def test_a_seed_keeps_its_branch_where_the_calibrated_arm_just_misses_the_pose():
    # Nearly stretched, the arm as designed reaches poses that the calibrated one does not: turned
    # round by half a turn it may, which nobody who gave a seed wants without being told.
    model = fitted("irb120", 3, links)
    q = postures(model.arm, 4, 300)
    T = Chain.of(model.arm).forward(q)
    found = model.compensate(T, seed=q)
    short = found.status == "unreachable"
    assert 5 <= np.count_nonzero(short) <= 30
    assert found.error_mm[short].max() < 2.0
    assert set(found.branch[short]) == {"nearest"}
    swung = np.abs(found.q - q).max(axis=1) > 0.5
    assert not np.any(swung & (found.status == "ok") & (found.branch == "nearest"))
    # Where nobody asks for a branch, some other reaches some of them.
    assert any(model.compensate(one[None]).status[0] == "ok" for one in T[short])


def test_another_branch_is_told_where_that_of_the_seed_is_beyond_a_limit():
    model = fitted("irb120", 8, links)
    limits = model.arm.limits_rad.copy()
    limits[4, 1] = 0.8
    found = limited(model, limits).compensate(model.predict(Q_IRB).T, seed=Q_IRB)
    assert (found.status[0], found.branch[0]) == ("ok", "other")
    assert np.abs(found.q[0] - FLIPPED).max() < 0.1


def test_beyond_the_limits_of_all_branches():
    model = fitted("irb120", 11, links)
    T, tight = model.predict(Q_IRB).T, limited(model, np.tile([-0.1, 0.1], (6, 1)))
    found = tight.compensate(T)
    assert list(found.status) == ["outside_limits"]
    assert off_m(tight.predict(found.q).T, T) < 1e-9


def test_joints_that_turn_further_than_once_stay_near_the_row_before():
    model = fitted("ur10", 9, links)
    q = np.array([4.0, -1.2, 1.5, 0.4, 5.0, -4.5])
    found = model.compensate(model.predict(q).T, seed=q + 0.01)
    np.testing.assert_allclose(found.q[0], q, atol=1e-8)


def test_what_cannot_be_done_is_said_and_no_row_is_dropped():
    model = fitted("pa10_6ce", 10, links_and_springs)
    T = np.tile(model.predict(Q_PA10).T, (3, 1, 1))
    T[1, :3, 3] *= 3.0
    found = model.compensate(T, seed=Q_PA10)
    assert list(found.status) == ["ok", "unreachable", "ok"]
    assert found.error_mm[1] > 100.0
    assert np.isfinite(found.q).all()
    assert found.error_mm[[0, 2]].max() < 1e-6


@pytest.mark.parametrize("bent", [0.0, 1e-7, 0.003, 0.3])
def test_a_straight_wrist_is_near_singular(bent):
    model = FittedModel(Model(Chain.of(load_arm("pa10_6ce")), ()), np.zeros(0), np.eye(4))
    q = np.where(np.arange(6) == 4, bent, Q_PA10)
    T = model.predict(q).T
    found = model.compensate(T, seed=q)
    assert list(found.status) == ["ok" if bent > 0.1 else "near_singular"]
    assert off_m(model.predict(found.q).T, T) < 1e-6


def test_weights_and_direction_of_arrival_count():
    model = fitted("pa10_6ce", 12, vocabulary)
    T = model.predict(Q_PA10).T
    empty, loaded = (model.compensate(T, seed=Q_PA10, load_N=load).q for load in (0.0, 44.0))
    assert 1e-5 < np.abs(loaded - empty).max() < 0.1
    assert model.compensate(T, seed=Q_PA10, arrival=1.0).q.tolist() != empty.tolist()


def test_notebooks_show_tables_and_no_pose_is_no_fault():
    model = fitted("pa10_6ce", 12, links)
    predicted = model.predict(Q_PA10)
    assert "u_mm" in predicted._repr_html_()
    shown = model.compensate(predicted.T)._repr_html_()
    assert "q6" in shown
    assert "ok" in shown
    assert len(model.compensate(np.zeros((0, 4, 4)))) == 0  # no pose is no fault


TRANSPOSED = np.stack([np.eye(4), np.eye(4)])
TRANSPOSED[1, 3, 0] = 0.5


@pytest.mark.parametrize(
    ("T", "more", "message"),
    [
        (np.eye(3), {}, "not a pose"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), {}, r"T\[0\]: not a pose"),
        (np.full((1, 4, 4), np.nan), {}, r"T\[0\]: not a pose"),
        (TRANSPOSED, {}, r"T\[1\]: not a pose.*last row 0, 0, 0, 1;.*transposed"),
        (np.eye(4), {"seed": np.zeros(5)}, "seeds of another arm"),
        (np.zeros((0, 4, 4)), {"seed": np.zeros(2)}, "seeds of another arm"),
        (np.eye(4), {"seed": [0.0, np.nan, 0.0, 0.0, 0.0, 0.0]}, "a seed of some joints"),
        (np.eye(4), {"seed": np.full(6, np.inf)}, "a seed of some joints"),
        (np.eye(4), {"frame": "tol"}, "unknown frame.*flange, tool"),
        (np.eye(4), {"load_N": -1.0}, "does not know this load.*give the weight of what hangs"),
        (np.eye(4), {"load_N": [0.0, 1.0]}, r"load_N: not one number.*shape \(1,\)"),
        (np.eye(4), {"temperature_C": "warm"}, "temperature_C: not one number"),
        (np.eye(4), {"arrival": [1.0, 1.0]}, r"arrival: not one number.*\(1, 6\)"),
        (np.eye(4), {"load_N": np.nan}, "does not know this load"),
        (np.eye(4), {"load_N": 45.0}, "does not know this load.*0 to 44 N.*extrapolate"),
    ],
)
def test_bad_requests_are_refused(T, more, message):
    model = fitted("pa10_6ce", 14, links)
    model = replace(model, fitted_to=fitted_to("c1", loads_N=(0.0, 44.0)))
    with pytest.raises(ModelError, match=message):
        model.compensate(T, **more)


def test_a_load_heavier_than_those_seen_can_be_insisted_on():
    model = fitted("pa10_6ce", 14, links_and_springs)
    model = replace(model, fitted_to=fitted_to("c1", loads_N=(0.0, 44.0)))
    q = postures(load_arm("pa10_6ce"), 15)
    with pytest.raises(ModelError, match=r"load_N of pose 3.*45"):
        model.predict(q, load_N=np.where(np.arange(len(q)) == 2, 45.0, 0.0))
    assert np.isfinite(model.predict(q, load_N=45.0, extrapolate=True).T).all()


def test_where_the_model_falls_back_the_commands_are_those_of_what_it_falls_back_to():
    model = fitted("pa10_6ce", 16, vocabulary)
    without = replace(model.nominal(), T_instr_base=np.eye(4))
    held = AngleCoverage((np.array([[-9.0, 0.5]]), *[np.array([[-9.0, 9.0]])] * 5), (False,) * 6)
    model = replace(model, falls_back=FallBack(held, without))
    q = regular(model, postures(model.arm, 17, 30))
    T = model.predict(q).T
    found = model.compensate(T, seed=q)
    outside = q[:, 0] > 0.5
    assert outside.any()
    assert not outside.all()
    np.testing.assert_allclose(found.q, q, atol=1e-8)
    np.testing.assert_array_equal(found.inside, model.predict(q).inside)
    assert set(found.status) == {"ok"}


def test_where_effects_hold_nowhere_inside_is_of_the_calibrated_model():
    model = fitted("pa10_6ce", 16, vocabulary)
    q = regular(model, postures(model.arm, 17, 30))
    seen = AngleCoverage((np.array([[-9.0, 0.5]]), *[np.array([[-9.0, 9.0]])] * 5), (False,) * 6)
    without = replace(model.nominal(), T_instr_base=np.eye(4), seen=seen)
    model = replace(model, falls_back=FallBack(nothing_seen(6), without))
    found = model.predict(q)
    np.testing.assert_array_equal(found.inside, q[:, 0] <= 0.5)
    np.testing.assert_allclose(found.T, without.predict(q).T, atol=1e-12)
    assert 0 < found.inside.sum() < len(q)


def test_an_orientation_out_of_reach_is_so_where_the_model_falls_back_too():
    model = fitted("gx4_351s", 16, links)
    without = replace(model.nominal(), T_instr_base=np.eye(4))
    held = AngleCoverage((np.array([[-9.0, 9.0]]),) * 4, (False,) * 4)
    q = regular(model, postures(model.arm, 17, 6))
    T = model.predict(q).T
    falls_back = replace(model, falls_back=FallBack(held, without))
    assert set(falls_back.compensate(T, seed=q).status) == {"ok"}
    T[:, :3, :3] = Rotation.from_euler("x", 30.0, degrees=True).as_matrix() @ T[:, :3, :3]
    for tilted in (model, falls_back):
        found = tilted.compensate(T, seed=q)
        assert set(found.status) == {"unreachable"}
        np.testing.assert_allclose(found.error_deg, 30.0, atol=1.2)


def test_a_miss_is_forgiven_only_at_the_step_to_what_the_model_falls_back_to():
    model = fitted("pa10_6ce", 16, links)
    model = replace(model, covariance=1e6 * model.covariance)  # so uncertain as the step is large
    without = replace(model.nominal(), T_instr_base=np.eye(4))
    wide = np.array([[-9.0, 9.0]])
    held = AngleCoverage((np.array([[0.5, 9.0]]), *[wide] * 5), (False,) * 6)
    q = np.array([0.5 - 1e-6, 0.3, 0.9, 0.4, 0.8, -0.6])
    at_step = replace(model, falls_back=FallBack(held, without))
    found = at_step.compensate(model.predict(q).T, seed=q)
    assert found.status[0] == "ok"
    assert 0.1 < found.error_mm[0] < found.u_parameters_mm[0]
    stretched = np.array([0.3, 0.5, 0.0, 0.4, 0.8, -0.6])
    beyond = model.predict(stretched).T
    beyond[:, :3, 3] *= 1.0 + 1e-4
    deep_inside = replace(
        model, falls_back=FallBack(AngleCoverage((wide,) * 6, held.turns), without)
    )
    found = deep_inside.compensate(beyond, seed=stretched)
    assert found.status[0] == "unreachable"
    assert 0.1 < found.error_mm[0] < found.u_parameters_mm[0]


TCP = np.array([[0.0, 0.0, 1.0, 0.1], [0.0, 1.0, 0.0, 0.02], [-1.0, 0.0, 0.0, 0.2], [0, 0, 0, 1]])


@pytest.mark.parametrize("T_flange_tcp", [None, TCP])
@pytest.mark.parametrize("frame", ["flange", "tool"])
def test_a_controller_with_the_nominal_model_comes_to_the_joint_positions(frame, T_flange_tcp):
    model = fitted("pa10_6ce", 15, lambda arm: (*links_and_springs(arm), tool_frame()))
    q = regular(model, postures(model.arm, 16, 12), frame)
    T = model.predict(q, frame=frame).T
    found = model.compensate(T, frame=frame, seed=q, T_flange_tcp=T_flange_tcp)
    tcp = model.T_flange_frame(frame) if T_flange_tcp is None else T_flange_tcp
    np.testing.assert_array_equal(found.T_flange_tcp, tcp)
    nominal = FittedModel(Model(Chain.of(model.arm), ()), np.zeros(0), np.eye(4))
    sent = nominal.compensate(found.T_send @ np.linalg.inv(tcp), seed=q)
    np.testing.assert_allclose(sent.q, found.q, atol=1e-9)


def test_lost_motion_counts_unless_the_side_of_arrival_is_given():
    b_rad = 3.5e-4
    model = fitted("irb120", 17, lambda arm: (*links(arm), Backlash("joint 1")))
    model = replace(model, x=np.append(model.x[:-1], b_rad))
    q = postures(model.arm, 18, 9)
    middle = model.predict(q)
    radius_mm = 1e3 * np.linalg.norm(middle.T[:, :2, 3], axis=1)
    np.testing.assert_allclose(middle.u_mm, b_rad * radius_mm, rtol=0.05)
    sides = [model.predict(q, arrival=side) for side in (-1.0, 1.0)]
    assert max(each.u_mm.max() for each in sides) < 0.01
    half_mm = 500.0 * np.linalg.norm((sides[1].T - sides[0].T)[:, :3, 3], axis=1)
    np.testing.assert_allclose(middle.u_mm, half_mm, rtol=0.05)
    others = np.array([1.0, 0, 0, 0, 0, 0])  # only that of the joint with lost motion matters
    np.testing.assert_allclose(model.predict(q, arrival=others).u_mm, sides[1].u_mm)
    with pytest.raises(ModelError, match="arrival of joint 1, pose 1: no direction of arrival"):
        model.predict(q, arrival=0.5)


def irregular():
    """An arm without a closed form: axis 5 off the wrist's point, axes 2 and 3 not parallel."""
    arm = load_arm("irb120")
    return replace(arm, a_m=arm.a_m + 0.05 * np.eye(6)[4], alpha_rad=arm.alpha_rad + 0.4)


def as_designed(arm):
    return FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))


@pytest.mark.parametrize("arm", ["ur10", "iiwa14", "irregular"])
def test_a_seed_that_counts_whole_turns_beyond_the_limits_is_the_same_posture(arm):
    arm = irregular() if arm == "irregular" else load_arm(arm)
    turns = np.full((arm.n, 2), [-np.pi, np.pi])
    model = limited(as_designed(arm), turns if arm.n == 6 else arm.limits_rad)
    q = np.array([0.3, -1.2, 1.5, 0.4, 0.9, -0.6, 0.5])[: arm.n]
    T = np.tile(model.predict(q).T, (2, 1, 1))
    T[1, 0, 3] += 9.0
    found = model.compensate(T, seed=q + 6.0 * np.pi * np.eye(arm.n)[5])
    assert (found.status[0], found.branch[0]) == ("ok", "nearest")
    np.testing.assert_allclose(found.q[0], q, atol=1e-6)
    assert found.status[1] == "unreachable"


@pytest.mark.parametrize("arm", ["gx4_351s", "irregular"])
def test_without_a_closed_form_a_jump_is_told_and_goes_to_the_nearest(arm):
    model = as_designed(irregular() if arm == "irregular" else load_arm(arm))
    q = regular(model, postures(model.arm, 4, 60))[:20]
    found = model.compensate(model.predict(q).T)
    jumps = np.abs(np.diff(found.q, axis=0)).max(axis=1) > 0.3
    assert jumps.sum() > 8
    np.testing.assert_array_equal(found.branch[1:] == "other", jumps)
    # No row is further from the row before than the posture that the target was made of.
    low, high = model.arm.limits_rad.T
    assert ((q > low) & (q < high)).all()
    further = np.linalg.norm(np.diff(found.q, axis=0), axis=1)
    assert (further < np.linalg.norm(q[1:] - found.q[:-1], axis=1) + 1e-6).all()


def test_a_target_that_few_drawn_postures_lead_to_is_found():
    model = as_designed(irregular())
    q = np.array([-1.334, -1.563, -1.86, 0.889, 1.806, -1.128])
    assert list(model.compensate(model.predict(q).T).status) == ["ok"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"controller": load_arm("iiwa14")}, "controller: .*iiwa14, is of another robot"),
        ({"controller": load_arm("irb120")}, "controller: .*irb120, is of another robot"),
        ({"seed": "abc"}, "seed: not an array of numbers.*abc"),
        ({"seed": [[0.0, 1.0], [2.0]]}, "seed: not an array of numbers"),
        ({"T_flange_tcp": "abc"}, "T_flange_tcp: not an array of numbers"),
        ({"T_flange_tcp": np.eye(3)}, r"T_flange_tcp: not a pose.*\(3, 3\).*: \(4, 4\), a rot"),
    ],
)
def test_what_belongs_to_another_arm_or_is_no_number_is_refused_by_name(more, message):
    model = as_designed(load_arm("ur10"))
    with pytest.raises((ArmError, ModelError), match=message):
        model.compensate(np.eye(4), **more)
