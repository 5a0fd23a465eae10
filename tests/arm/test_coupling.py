"""Coupled joints: what an arm's description states, and the same arm at mapped positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from made_up_model import fitted
from made_up_poses import states_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint, Coupling
from pa10cal.arm.statics import Payload, statics
from pa10cal.arm.workspace import above, draw_within
from pa10cal.errors import ArmError, SettingsError
from pa10cal.files.arms import arm_text, load_arm, parse_arm
from pa10cal.files.coupling import coupling_in_words, set_coupling
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.plain_arm import arm_from_plain, arm_to_plain
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import SoftWindup
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures
from pa10cal.terms.weights import Weights, WeightSizes

ROWS = [{"a_m": 0.3, "alpha_deg": 90.0}, {"a_m": 0.5}, {"a_m": 0.4, "alpha_deg": -90.0}]
QUILL = [{"a_m": 0.25}, {"a_m": 0.2, "alpha_deg": 180.0}]
QUILL += [{"prismatic": True, "limits_m": [0.0, 0.17]}, {"d_m": 0.03}]
TELESCOPE = [{"d_m": 0.4}, *({"prismatic": True, "limits_m": [0.0, 0.13]} for _ in range(3))]
#: Arms as their controllers log them: joint 3 to the horizontal, a parallelogram, a quill that
#: rises as it turns, the last joint of a wrist, and one motor that drives a telescope.
LOGGED = {
    "fanuc": (ROWS, [{"joint": 3, "by": 2, "factor": 1}]),
    "parallelogram": (ROWS, [{"joint": 3, "by": 2, "factor": -1}]),
    "quill": (QUILL, [{"joint": 3, "by": 4, "mm_per_turn": 20}]),
    "telescope": (
        TELESCOPE,
        [{"joint": k, "by": 2, "factor": 1, "follows": True} for k in (3, 4)],
    ),
}


def described(name):
    rows, coupling = LOGGED[name]
    return parse_arm({"name": name, "rows": rows, "coupling": coupling}, where="arm.yaml")


def axes_within(arm, count, seed=1):
    low, high = np.clip(arm.axis_limits_rad, -2.5, 2.5).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", LOGGED)
def test_axes_and_joints_are_two_words_for_one_posture(name):
    arm = described(name)
    axes = axes_within(arm, 50)
    q = arm.coupling.to_joints(axes)
    assert arm.coupling.to_axes(q) == pytest.approx(axes, abs=1e-14)
    low, high = arm.coupling.joint_ranges(np.clip(arm.axis_limits_rad, -2.5, 2.5)).T
    assert (np.clip(q, low - 1e-12, high + 1e-12) == q).all()
    assert parse_arm(yaml.safe_load(arm_text(arm)), where="again").coupled == arm.coupled


def test_joints_are_what_is_stated_of_axes():
    axes = np.radians([[10.0, 20.0, 30.0]])
    assert np.degrees(described("fanuc").coupling.to_joints(axes)) == pytest.approx(
        np.array([[10.0, 20.0, 50.0]])
    )
    turned = np.array([[0.0, 0.0, 0.1, np.pi]])
    assert described("quill").coupling.to_joints(turned)[0, 2] == pytest.approx(0.11)
    slid = described("telescope").coupling.to_joints(np.array([[0.5, 0.1]]))
    assert slid == pytest.approx(np.array([[0.5, 0.1, 0.1, 0.1]]))
    words = {name: coupling_in_words(described(name)) for name in LOGGED}
    assert words == {
        "fanuc": "joint 3 = J3 + J2",
        "parallelogram": "joint 3 = J3 - J2",
        "quill": "joint 3 = J3 + 20 mm a turn of J4",
        "telescope": "joint 3 = J2, joint 4 = J2",
    }


def links(arm):
    return (link_departures(arm, Tolerances()),)


def coupled(model, *joints):
    """Return the same model of an arm whose controller counts other axes."""
    arm = replace(model.arm, coupled=joints)
    chain = replace(model.model.chain, arm=arm)
    return replace(model, model=Model(chain, model.model.terms))


COUPLINGS = [
    ("irb120", (CoupledJoint(3, 2, 1.0),)),
    ("irb120", (CoupledJoint(3, 2, -1.0), CoupledJoint(6, 5, 0.02))),
    ("gx4_351s", (CoupledJoint(3, 4, 0.02 / (2.0 * np.pi)),)),
    ("iiwa14", (CoupledJoint(4, 2, 0.5),)),
    ("pa10_6ce", (CoupledJoint(5, 4, -0.5, follows=True),)),
]


@pytest.mark.parametrize(("robot", "joints"), COUPLINGS)
def test_predictions_are_those_of_the_uncoupled_arm_at_mapped_positions(robot, joints, tmp_path):
    plain = fitted(robot, 3, links)
    model = coupled(plain, *joints)
    models = [model]
    if model.arm.mass_kg is not None:
        model.save(tmp_path / "model.yaml")
        models.append(load_model(tmp_path / "model.yaml"))
    axes = axes_within(model.arm, 6)
    q = model.arm.coupling.to_joints(axes)
    for frame in ("flange", "tool"):
        expected = plain.predict(q, frame=frame)
        for each in models:
            found = each.predict(axes, frame=frame)
            assert np.abs(found.T - expected.T).max() < 1e-12
            assert found.u_mm == pytest.approx(expected.u_mm, rel=1e-9)
            assert (found.inside == expected.inside).all()
    step = 1e-6
    moved = axes[:, None] + step * np.eye(axes.shape[1])
    ahead, here = (model.predict(each.reshape(-1, axes.shape[1])) for each in (moved, axes))
    by_steps = (ahead.T[:, :3, 3].reshape(len(axes), -1, 3) - here.T[:, None, :3, 3]) / step
    assert model.jacobian(axes)[:, :3] == pytest.approx(np.swapaxes(by_steps, 1, 2), abs=1e-4)


@pytest.mark.parametrize(("robot", "joints"), COUPLINGS)
def test_commands_are_positions_that_the_controller_counts(robot, joints):
    model = coupled(fitted(robot, 4, links), *joints)
    axes = 0.5 * axes_within(model.arm, 8, seed=5) + 0.5 * model.arm.axis_limits_rad.mean(axis=1)
    wanted = model.predict(axes).T
    found = model.compensate(wanted, seed=axes + 0.01 * ~model.arm.axes_slide)
    low, high = model.arm.axis_limits_rad.T
    reached = np.isin(found.status, ("ok", "near_singular"))
    assert reached.mean() > 0.8
    assert np.abs(model.predict(found.q[reached]).T - wanted[reached]).max() < 1e-6
    assert (np.clip(found.q, low - 1e-9, high + 1e-9) == found.q)[reached].all()
    if len(low) == 6:
        assert found.q[reached] == pytest.approx(axes[reached], abs=1e-6)


def test_turns_stay_within_limits_of_what_is_counted():
    """A turn of a quill's joint is one of its axis, and lifts the quill by what it rises in it."""
    model = coupled(fitted("gx4_351s", 4, links), CoupledJoint(3, 4, 0.02 / (2.0 * np.pi)))
    axes = np.array([[0.4, 0.9, -0.05, 5.5]])
    wanted = model.predict(axes).T
    far = axes + np.array([0.0, 0.0, 0.02, -2.0 * np.pi])
    near, away = (model.compensate(wanted, seed=seed) for seed in (axes, far))
    assert near.q == pytest.approx(axes, abs=1e-3)
    assert away.q == pytest.approx(far, abs=1e-3)
    for found in (near, away):
        assert np.abs(model.predict(found.q).T - wanted).max() < 1e-6


def test_postures_are_drawn_within_limits_of_the_axes():
    arm = replace(load_arm("irb120"), coupled=(CoupledJoint(3, 2, 1.0),))
    chain = fitted("irb120", 1, links).model.chain
    low, high = arm.axis_limits_rad.T
    free = {"anywhere": above(-9.0)}
    drawn = draw_within(replace(chain, arm=arm), np.zeros((1, 3)), (low, high), free, 200, 1)
    axes = arm.coupling.to_axes(drawn.q)
    assert (np.clip(axes, low - 1e-9, high + 1e-9) == axes).all()
    assert (drawn.q[:, 2] < low[2]).any() or (drawn.q[:, 2] > high[2]).any()


@pytest.mark.parametrize(
    ("coupling", "said"),
    [
        ([{"joint": 3, "by": 3, "factor": 1}], "coupled to itself"),
        ([{"joint": 4, "by": 2, "factor": 1}], "joint names no joint"),
        ([{"joint": 3, "by": 9, "factor": 1}], "by names no joint"),
        ([{"joint": 3, "by": 2}], "not stated once"),
        ([{"joint": 3, "by": 2, "factor": 0}], "none that couples"),
        ([{"joint": 3, "by": 2, "factor": 1e4}], "none that couples"),
        ([{"joint": 3, "by": 2, "mm_per_turn": 20}], "slides with one that turns"),
        ([{"joint": 3, "by": 2, "factor": 1}] * 2, "twice"),
        (
            [{"joint": 3, "by": 2, "factor": 1}, {"joint": 2, "by": 3, "factor": 1}],
            "makes two joints one",
        ),
        (
            [
                {"joint": 3, "by": 2, "factor": 1, "follows": True},
                {"joint": 1, "by": 3, "factor": 1},
            ],
            "no axis of its own",
        ),
        (
            [{"joint": 3, "by": 2, "factor": 1, "follows": True, "counted_only": True}],
            "no motor of its own",
        ),
    ],
)
def test_couplings_that_cannot_be_meant_are_refused(coupling, said):
    with pytest.raises(ArmError, match=said) as refused:
        parse_arm({"name": "mine", "rows": ROWS, "coupling": coupling}, where="mine.yaml")
    error = refused.value
    assert "coupling" in str(error.where)
    assert all((error.allowed, error.remedy))


@pytest.mark.parametrize(("key", "most"), [("mm_per_turn", 1000.0), ("factor", 1000.0 / 360.0)])
def test_the_steepest_screw_is_the_same_in_both_units(key, most):
    def arm(size):
        stated = [{"joint": 3, "by": 4, key: size}]
        return parse_arm({"name": "mine", "rows": QUILL, "coupling": stated}, where="mine.yaml")

    again = parse_arm(yaml.safe_load(arm_text(arm(most))), where="again")
    assert again.coupled[0].factor == pytest.approx(arm(most).coupled[0].factor)
    with pytest.raises(ArmError, match="none that couples"):
        arm(1.01 * most)


def test_keys_of_a_coupling_are_those_documented():
    with pytest.raises(SettingsError, match="factors"):
        parse_arm(
            {"name": "mine", "rows": ROWS, "coupling": [{"joint": 3, "by": 2, "factors": 1}]},
            where="mine.yaml",
        )


def test_nothing_is_mapped_where_nothing_is_coupled():
    q = np.random.default_rng(1).normal(size=(4, 6))
    coupling = Coupling(6)
    assert all(each(q) is q for each in (coupling.to_joints, coupling.to_axes, coupling.by_axes))


def test_drives_move_what_bars_and_screws_move():
    """Torques of drives do the work of those of the joints; only counted positions move nothing."""
    rng = np.random.default_rng(1)
    for name in LOGGED:
        coupling = described(name).coupling
        of_drives = np.zeros((20, coupling.n))
        of_drives[:, coupling.own] = rng.normal(size=(20, len(coupling.own)))
        moved = coupling.with_drives(of_drives)
        assert moved == pytest.approx(coupling.to_joints(of_drives[:, coupling.own]), abs=1e-15)
        tau = rng.normal(size=(20, coupling.n))
        work = np.sum(coupling.at_drives(tau) * of_drives, axis=1)
        assert work == pytest.approx(np.sum(tau * moved, axis=1))
        counted = replace(
            coupling, joints=tuple(replace(each, counted_only=True) for each in coupling.joints)
        )
        assert (counted.at_drives(tau)[:, coupling.own] == tau[:, coupling.own]).all()
        assert counted.to_joints(of_drives[:, coupling.own]) == pytest.approx(moved, abs=1e-15)


@pytest.mark.parametrize("counted_only", [True, False])
def test_derivatives_of_springs_at_drives_are_exact(counted_only):
    coupled = CoupledJoint(3, 2, -1.0, counted_only=counted_only)
    arm = replace(load_arm("pa10_6ce"), coupled=(coupled,))
    chain = Chain.of(arm)
    payload = Payload(3.0, np.array([0.02, 0.0, 0.1]), np.zeros(3), np.array([0.3, 0.1, -9.8]))
    states = states_of(arm, poses=8)
    loads = statics(chain, chain.coordinates(states.q_rad), states.load_N, payload)
    states = replace(states, tau_Nm=loads.joint_Nm, static_loads=loads)
    weights = Weights.about(arm, WeightSizes(np.full(6, 0.1), np.full(6, 0.05), 1.0, 0.1, 0.02))
    springs = (JointSpring(2, 60.0), JointSpring(3, 40.0), SoftWindup("joint 3", 40.0, 40.0))
    model = Model(chain, (*links(arm), weights, *springs))
    rng = np.random.default_rng(2)
    x = np.array([p.scale for p in model.parameters]) * rng.normal(size=len(model.parameters))
    for spring in springs[:2]:
        x[model.columns_of(spring)] = [1e-3, 0.2]
    x[model.columns_of(springs[2])] = [3e-4, 8.0]
    found = model.predict_with_jacobian(states, x)
    for k, parameter in enumerate(model.parameters):
        step = 1e-4 * parameter.scale * (np.arange(len(x)) == k)
        ahead, behind = (model.predict(states, x + sign * step)[:, :3, 3] for sign in (1.0, -1.0))
        by_steps = (ahead - behind) / (2e-4 * parameter.scale)
        size = max(float(np.abs(by_steps).max()), 1e-9 / parameter.scale)
        assert found.jacobian[:, :3, k] == pytest.approx(by_steps, abs=1e-5 * size), parameter.name


def test_couplings_of_older_models_are_only_counted():
    arm = replace(load_arm("irb120"), coupled=(CoupledJoint(3, 2, -1.0),))
    plain = arm_to_plain(arm)
    assert arm_from_plain(plain).coupled == arm.coupled
    del plain["coupling"][0]["counted_only"]
    assert arm_from_plain(plain).coupled == (CoupledJoint(3, 2, -1.0, counted_only=True),)


def test_the_remedy_says_that_a_coupling_may_only_be_counted():
    """Positions do not tell it; springs under the wrong torques are worse (a measured FANUC)."""
    arm = load_arm("pa10_6ce")
    said = set_coupling((CoupledJoint(3, 2, 1.0),), arm)
    assert "[{joint: 3, by: 2, factor: 1}]" in said
    assert "counted_only: true where the motor of joint 3 is at the joint itself" in said
    known = set_coupling((CoupledJoint(3, 2, 1.0, counted_only=True),), arm)
    assert known.endswith("or in the arm's description")
    assert "{joint: 3, by: 2, factor: 1, counted_only: true}" in known
    assert "where the motor" not in set_coupling((CoupledJoint(3, 2, 1.0, follows=True),), arm)
