"""Effects at one joint against the forms of the vocabulary, written out once more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.couplings import described, industrial, scara
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from made_up_poses import context_of, states_of
from pa10cal.arm.chain import Chain
from pa10cal.calibration.general.problem import loaded_joints
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint import GearRatioError, moved_along
from pa10cal.terms.effects.vocabulary import candidates, every_effect
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal_lab.cell.effects.effect import JointState
from pa10cal_lab.cell.effects.joint import SimulatedMoveSettling


def solved(effect, **reported):
    """Solved parameters of an effect of one parameter, by Newton's method on its report."""
    x = effect.starts[0] + 1e-4
    for _ in range(30):
        report = effect.report(x)
        assert [p.name for p in report.parameters] == list(reported)
        x = x + np.linalg.solve(report.jacobian, list(reported.values()) - report.values)
    return x


@pytest.mark.parametrize(
    ("name", "of", "coordinate", "form"),
    [
        ("gear_ratio_error", "joint 4", "theta_4", lambda s: 0.7 * s.q_rad[:, 3]),
        ("backlash", "joint 3", "theta_3", lambda s: -0.7 * s.arrival[:, 2]),
        ("arrival_error", "joint 3", "theta_3", lambda s: 0.7 * s.arrival[:, 2]),
        ("wrist_coupling", "wrist", "theta_6", lambda s: 0.7 * s.q_rad[:, 4]),
        ("joint_coupling", "joint 3", "theta_3", lambda s: 0.7 * s.q_rad[:, 1]),
        ("joint_coupling", "joint 5", "theta_5", lambda s: 0.7 * s.q_rad[:, 3]),
        ("joint_coupling", "joint 6", "theta_6", lambda s: 0.7 * s.q_rad[:, 3]),
        ("joint_compliance", "joint 4", "theta_4", lambda s: -0.7 * s.tau_Nm[:, 3]),
    ],
)
def test_turns_the_joint_as_the_vocabulary_says(name, of, coordinate, form, at, states):
    effect = at(name, of)
    assert effect.coordinates == (coordinate,)
    np.testing.assert_allclose(effect.shift(states, np.array([0.7]))[:, 0], form(states))


def test_a_line_of_a_gear_has_waves_at_multiples_of_its_cycles(states):
    line, q = GearLine("joint 2", 40.0, multiples=(3,)), states.q_rad[:, 1]
    assert line.formula.split(", k near")[0] == (
        "theta_2 += A sin(k q_2 + phi) + A_3 sin(3 k q_2 + phi_3)"
    )
    x = np.array([3e-4, 4e-4, 1e-4, 0.0, 40.2])
    expected = 3e-4 * np.sin(40.2 * q) + 4e-4 * np.cos(40.2 * q) + 1e-4 * np.sin(120.6 * q)
    np.testing.assert_allclose(line.shift(states, x)[:, 0], expected, rtol=1e-12)
    report = line.report(x)
    told = {p.name: value for p, value in zip(report.parameters, report.values, strict=True)}
    assert told == pytest.approx(
        {"A": 5e-4, "phi": np.arctan2(4.0, 3.0), "A_3": 1e-4, "phi_3": 0.0, "k": 40.2}
    )
    assert not line.same_as(GearLine("joint 2", 40.0))


def test_the_pitch_of_a_rail_moves_along_it(states):
    rail = [{"prismatic": True, "alpha_deg": 90.0, "limits_m": [0.0, 3.0]}]
    arm = described(rail + industrial(np.random.default_rng(1), 1))
    known = SimpleNamespace(arm=arm)
    first, *others = GearRatioError.everywhere(known)
    assert (first.of, first.slides, first.coordinates) == ("joint 1", True, ("d_1",))
    assert not any(each.slides for each in others)
    assert others[0].coordinates == ("theta_2",)
    moved_m = first.shift(states, np.array([2e-4]))[:, 0]
    np.testing.assert_allclose(moved_m, 2e-4 * states.q_rad[:, 0])


# Joints that move along with others: which may, what it does to the arm, and that it is found.


@pytest.mark.parametrize(
    ("name", "pairs"),
    [
        ("pa10_6ce", {3: 2, 5: 4, 6: 4}),
        ("ur10", {3: 2, 4: 3, 5: 4, 6: 4}),
        ("irb120", {3: 2, 5: 4, 6: 4}),
        ("iiwa14", {6: 5, 7: 5}),
        ("gx4_351s", {2: 1, 3: 4}),
    ],
)
def test_joints_move_along_that_their_drives_tie_together(name, pairs):
    assert moved_along(load_arm(name)) == pairs


def test_an_arm_on_a_rail_has_the_couplings_of_the_arm():
    rail = [{"prismatic": True, "alpha_deg": 90.0, "limits_m": [0.0, 3.0]}]
    rows = industrial(np.random.default_rng(1), 1)
    assert moved_along(described(rail + rows)) == {4: 3, 6: 5, 7: 5}
    assert moved_along(described(rows)) == {3: 2, 5: 4, 6: 4}


def test_a_joint_without_a_motor_of_its_own_has_no_coupling_beside_it():
    follows = {"joint": 3, "by": 2, "factor": -1.0, "follows": True}
    rows = industrial(np.random.default_rng(1), 1)
    assert moved_along(described(rows, follows)) == {5: 4, 6: 4}


#: What needs a motor, gear or sensor.
OF_DRIVES = {
    "arrival_error",
    "backlash",
    "encoder_eccentricity",
    "encoder_ellipticity",
    "friction_torque",
    "gear_error",
    "gear_line",
    "gear_ratio_error",
    "joint_compliance",
    "sensor_error",
    "soft_windup",
    "torque_gain",
    "transmission_error",
}


def test_a_joint_that_only_follows_others_has_no_motor_gear_or_sensor_that_errs():
    follows = {"joint": 3, "by": 2, "factor": -1.0, "follows": True}
    arm = described(industrial(np.random.default_rng(1), 1), follows)
    context = context_of(arm, flexible_joints=(), lifts=None)
    possible = {
        of: {kind.id for kind in every_effect() if of in {e.of for e in kind.everywhere(context)}}
        for of in ("joint 2", "joint 3")
    }
    assert possible["joint 2"] - possible["joint 3"] == OF_DRIVES
    assert {"joint_error_map", "periodic_error", "lateral_compliance"} < possible["joint 3"]
    tau_Nm = np.random.default_rng(2).uniform(-50.0, 50.0, (20, arm.n))
    assert loaded_joints(arm, tau_Nm, 0.1) == (1, 2, 4, 5, 6)


def test_each_stage_of_a_telescope_has_a_pitch_whichever_motor_drives_it():
    stage = {"prismatic": True, "limits_m": [0.0, 0.13]}
    follows = {"joint": 3, "by": 2, "factor": 1.0, "follows": True}
    arm = described([{"d_m": 0.4}, stage, stage], follows)
    found = GearRatioError.everywhere(context_of(arm))
    assert [(each.of, each.slides) for each in found] == [
        ("joint 1", False),
        ("joint 2", True),
        ("joint 3", True),
    ]


@examples(25)
@given(seed=st.integers(0, 2**31), c=st.floats(-2e-3, 2e-3), quill=st.booleans())
def test_a_coupling_is_the_arm_at_joints_that_moved_along(seed, c, quill):
    """Exact: the chain at the joints as they really stand; so is its derivative by c."""
    rng = np.random.default_rng(seed)
    arm = described(scara(rng) if quill else industrial(rng, 1))
    effects = [each for each in candidates(context_of(arm)) if each.id == "joint_coupling"]
    assert len(effects) == (2 if quill else 3)
    states = states_of(arm, seed % 1000, 8)
    for effect in effects:
        model = Model(Chain.of(arm), (effect,))
        stood = states.q_rad.copy()
        stood[:, effect.joint - 1] += c * stood[:, effect.by - 1]
        T = Model(Chain.of(arm), ()).predict(replace(states, q_rad=stood), np.zeros(0))
        np.testing.assert_allclose(model.predict(states, np.array([c])), T, atol=1e-13)
        found = model.predict_with_jacobian(states, np.array([c]))
        step = 1e-5
        after, before = (model.predict(states, np.array([c + way * step])) for way in (1, -1))
        slope = (after[:, :3, 3] - before[:, :3, 3]) / (2.0 * step)
        np.testing.assert_allclose(found.jacobian[:, :3, 0], slope, atol=1e-7)


def test_a_controller_errs_where_the_joint_moved_and_backlash_where_it_came_from(at, states):
    moved = np.where(np.arange(len(states))[:, None] % 2 == 0, 0.0, states.arrival)
    stayed = replace(states, moved=moved)
    error, backlash = at("arrival_error", "joint 3"), at("backlash", "joint 3")
    one = np.ones(1)
    np.testing.assert_array_equal(error.shift(stayed, one)[:, 0], moved[:, 2])
    np.testing.assert_array_equal(backlash.shift(stayed, one)[:, 0], -states.arrival[:, 2])


def test_a_link_that_its_gear_pushes_through_play_lags_by_backlash(at, states):
    """The play is modelled by itself: the flanks of the motor's wheel carry the link along."""
    rng = np.random.default_rng(7)
    motor_rad, b_rad = rng.uniform(-1.0, 1.0, len(states) + 1), 3e-4
    link_rad = np.zeros_like(motor_rad)
    for k in range(1, len(motor_rad)):
        link_rad[k] = np.clip(link_rad[k - 1], motor_rad[k] - b_rad, motor_rad[k] + b_rad)
    arrived = replace(states, arrival=np.sign(np.diff(motor_rad))[:, None] * np.ones(states.n))
    off_rad = at("backlash", "joint 3").shift(arrived, np.array([b_rad]))[:, 0]
    np.testing.assert_allclose(link_rad[1:], motor_rad[1:] + off_rad, atol=1e-12)


def test_an_arm_that_is_braked_at_its_end_settles_as_the_cell_has_it(at, states):
    furthest_rad = np.linspace(0.2, 1.0, len(states))
    moves = states.move_share / np.abs(states.move_share).max(axis=1, keepdims=True)
    states = replace(states, move_share=moves)
    came = furthest_rad[:, None] * moves
    motion = JointState(
        states.q_rad,
        states.arrival,
        np.ones(6),
        move=came,
        end_goes_m=states.move_end_m * furthest_rad,
    )
    left = SimulatedMoveSettling(c=2e-3).at("arm").added(motion)
    effect = at("move_settling", "arm")
    found = effect.shift(states, np.array([2e-3]))
    np.testing.assert_allclose(found, left[:, [joint - 1 for joint in effect.joints]])


def test_a_controller_errs_by_another_amount_in_each_campaign(at, states, context):
    grouped = replace(context, campaigns=("one", "two"))
    (error,) = (
        each for each in candidates(grouped) if (each.id, each.of) == ("arrival_error", "joint 3")
    )
    assert [p.name for p in error.reported] == ["c@one", "c@two"]
    campaign = np.arange(len(states)) % 2
    shift = error.shift(replace(states, campaign=campaign), np.array([2.0, 5.0]))[:, 0]
    np.testing.assert_allclose(shift, np.where(campaign, 5.0, 2.0) * states.arrival[:, 2])
    alone = error.shift(states, np.array([2.0, 5.0]))[:, 0]
    np.testing.assert_allclose(alone, 2.0 * states.arrival[:, 2])


@pytest.mark.parametrize("kind", ["along_move", "move_settling"])
def test_each_campaign_is_read_at_its_own_instant(kind, at, states, context):
    grouped = replace(context, campaigns=("one", "two"))
    (late,) = (each for each in candidates(grouped) if each.id == kind)
    assert [p.name for p in late.reported] == ["c@one", "c@two"]
    campaign = np.arange(len(states)) % 2
    shift = late.shift(replace(states, campaign=campaign), np.array([2.0, 5.0]))
    once = at(kind, "arm").shift(states, np.ones(1))
    np.testing.assert_allclose(shift, np.where(campaign, 5.0, 2.0)[:, None] * once)
    elsewhere = late.elsewhere()
    assert elsewhere.term == at(kind, "arm")
    assert not elsewhere.same_amounts


def test_a_controller_cannot_err_where_angles_were_read_back(context):
    logged = candidates(replace(context, commanded=False))
    assert {e.id for e in candidates(context)} - {e.id for e in logged} == {"arrival_error"}


@pytest.mark.parametrize("order", [1, 2])
def test_an_error_map_follows_eccentricity_and_ellipticity(order, at, states):
    effect = at("joint_error_map", "joint 2")
    knots_rad = np.radians(30.0 * np.arange(12))
    shift = effect.shift(states, np.sin(order * knots_rad + 0.4))[:, 0]
    np.testing.assert_allclose(shift, np.sin(order * states.q_rad[:, 1] + 0.4), atol=0.01)


def test_neighbouring_knots_go_together_across_the_turn_too(at):
    factor = at("joint_error_map", "joint 2").prior_factor
    expected = factor @ factor.T
    assert expected[0, 1] == pytest.approx(expected[0, 11]) == pytest.approx(expected[5, 6])
    assert expected[0, 1] > 0.7 * expected[0, 0]
    assert expected[0, 6] < 0.05 * expected[0, 0]


def test_springs_see_the_torque_without_friction_and_gain(at, arm, states):
    friction, gain = at("friction_torque", "joint 2"), at("torque_gain", "joint 3")
    logged_Nm = states.tau_Nm.copy()
    logged_Nm[:, 1] += 4.0 * states.arrival[:, 1]
    logged_Nm[:, 2] *= 1.06
    # The gain is of the torque that the weights ask for, which here is the true one.
    carried = replace(states.static_loads, joint_Nm=states.tau_Nm)
    logged = replace(states, tau_Nm=logged_Nm, static_loads=carried)
    spring = JointSpring(2, 100.0), JointSpring(3, 50.0)
    springs_x = [term.solved(2e4, 1e7) for term in spring]
    x = np.concatenate([*springs_x, solved(friction, tau_c=4.0), solved(gain, g=0.06)])
    model = Model(Chain.of(arm), (*spring, friction, gain))
    np.testing.assert_allclose(
        model.with_joint_torques(logged, x).tau_Nm, states.tau_Nm, atol=1e-12
    )
    np.testing.assert_allclose(
        model.torque_Nm(logged, x), logged_Nm - states.tau_Nm, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        model.predict(logged, x),
        Model(Chain.of(arm), spring).predict(states, np.concatenate(springs_x)),
        atol=1e-14,
    )


def test_a_compliant_joint_is_one_with_a_linear_spring(at, states):
    effect = at("joint_compliance", "joint 4")
    spring = JointSpring(4, 10.0, cubic=False)
    np.testing.assert_allclose(
        effect.shift(states, solved_compliance(effect, 2500.0)),
        spring.shift(states, spring.solved(2500.0, 0.0)),
        rtol=1e-12,
    )


def solved_compliance(effect, stiffness):
    x = np.array([1.0 / stiffness])
    assert effect.report(x).values == pytest.approx([stiffness])
    return x


def test_a_rigid_joint_is_reported_with_a_finite_stiffness(at):
    report = at("joint_compliance", "joint 4").report(np.zeros(1))
    assert report.values[0] >= 1e9
    assert np.isfinite(report.jacobian).all()


def test_soft_windup_is_steep_at_zero_torque_and_saturates(at, states):
    effect = at("soft_windup", "joint 2")
    tau_Nm = np.zeros_like(states.tau_Nm)
    tau_Nm[:, 1] = [0.0, 1e-4, -1e-4, 200.0, -200.0, 5.0]
    shift = effect.shift(replace(states, tau_Nm=tau_Nm), np.array([3e-4, 5.0]))[:, 0]
    expected = [0.0, -6e-9, 6e-9, -3e-4, 3e-4, -3e-4 * np.tanh(1.0)]
    np.testing.assert_allclose(shift, expected, rtol=1e-9)


def test_soft_windup_is_looked_for_at_the_torques_carried(at, context):
    starts = np.array(at("soft_windup", "joint 2").starts)
    np.testing.assert_allclose(starts[:, 1], context.largest_tau_Nm[1] * np.array([0.1, 0.3, 1.0]))
    little = replace(context, largest_tau_Nm=0.011 * context.arm.torque_limit_Nm)
    (effect,) = [e for e in type(at("soft_windup", "joint 2")).everywhere(little) if e.joint == 2]
    np.testing.assert_allclose([start[1] for start in effect.starts], [0.005 * 232, 0.011 * 232])
