"""Uncertain weights: what they do to calculated torques, and a model that has them open."""

from dataclasses import replace

import numpy as np
import pytest

from calibrated import general
from made_up_model import on_springs
from made_up_poses import at_rest, context_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.files.arms import load_arm
from pa10cal.fit.loads import statics_of, weighed, with_torques
from pa10cal.fit.model_reading import load_model, model_from_plain
from pa10cal.fit.model_writing import model_to_plain, save_model
from pa10cal.fit.uncertain_weights import (
    open_unknowns,
    unknown_tool,
    weight_sizes,
    with_uncertain_weights,
)
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.structure import BaseCompliance, LinkBending
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights

ARM = load_arm("ur10")
TOOL_KG = 1.5
TOOL = Payload(TOOL_KG, np.array([0.01, -0.02, 0.06]), np.zeros(3), np.array([0.0, 0.0, -9.80665]))
NOT_KNOWN = replace(TOOL, mass_kg=0.0, known=False)
STIFFNESS = {2: 7e4, 3: 5e4, 4: 1.5e4}


def states(count=60, seed=1):
    q_rad = np.random.default_rng(seed).uniform(-2.0, 2.0, (count, ARM.n))
    return at_rest(q_rad, tau_Nm=np.full_like(q_rad, np.nan), temperature_C=np.full(count, 20.0))


def with_springs(payload=TOOL):
    return on_springs("ur10", STIFFNESS, payload)


def predicted(model, states, payload):
    loaded, source = with_torques(model.model, model.x, states, payload)
    assert source == "masses"
    return model.model.predict(loaded, model.x)


def test_a_weight_that_differs_moves_the_arm_as_if_it_were_described():
    arm = replace(ARM, mass_kg=ARM.mass_kg + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    heavier = with_springs(replace(TOOL, mass_kg=TOOL_KG + 0.5))
    heavier = replace(heavier, model=Model(Chain.of(arm), heavier.model.terms))
    weights = with_uncertain_weights(with_springs(), TOOL)
    names = [parameter.name for parameter in weights.model.parameters]
    weights.x[names.index("weight_2_mass")] = 1.0
    weights.x[names.index("weight_tool_mass")] = 0.5
    moved = predicted(weights, states(), TOOL) - predicted(with_springs(), states(), TOOL)
    wanted = predicted(heavier, states(), heavier.payload) - predicted(
        with_springs(), states(), TOOL
    )
    assert np.abs(wanted).max() > 1e-5
    np.testing.assert_allclose(moved, wanted, atol=2e-3 * np.abs(wanted).max())
    # Wherever the model is asked, too.
    q_rad = states().q_rad
    np.testing.assert_allclose(weights.predict(q_rad).T, heavier.predict(q_rad).T, atol=1e-7)


def test_opening_the_weights_changes_no_prediction_and_counts_as_no_unknown(tmp_path):
    model, open_model = with_springs(), with_uncertain_weights(with_springs(), TOOL)
    np.testing.assert_array_equal(
        predicted(model, states(), TOOL), predicted(open_model, states(), TOOL)
    )
    assert open_unknowns(open_model.model) == open_unknowns(model.model) == len(model.x)
    again = with_uncertain_weights(open_model, TOOL)
    assert again.model.terms == open_model.model.terms
    std = np.sqrt(np.diag(open_model.covariance))
    assert std[: len(model.x)] == pytest.approx(1e-6)
    assert std[-6:] == pytest.approx(1e-6)
    assert std[len(model.x) : -6] == pytest.approx(open_model.model.terms[-1].sizes)
    save_model(open_model, tmp_path / "model.yaml")
    loaded = load_model(tmp_path / "model.yaml")
    assert loaded.model.terms == open_model.model.terms
    assert loaded.payload.known


def measured(some, tool=TOOL):
    """Return readings of an arm on springs that carries a tool."""
    T = predicted(with_springs(tool), some, tool)
    T[:, :3, 3] += 2e-5 * np.random.default_rng(5).standard_normal((len(T), 3))
    covariance = np.tile(np.diag([2e-5] * 3 + [1e-4] * 3) ** 2, (len(T), 1, 1))
    return Observations.single(np.arange(len(T)).astype(str), some, Pose.of(T, covariance))


def test_a_centre_of_mass_that_nobody_stated_is_found_and_bends_no_stiffness():
    """What is proposed is 0, 0, 0: springs of the wrist made up for what the centre was off."""
    far = replace(TOOL, mass_kg=4.0, com_m=np.array([0.05, 0.02, 0.12]))
    some = measured(states(150), far)
    nowhere = replace(far, com_m=np.zeros(3))
    off = {}
    for name, tool in (("taken", nowhere), ("unknown", replace(nowhere, com_u_m=0.15))):
        found = general(ARM, some, tool)
        model, x = found.problem.model, found.fit.x
        (at,) = (model.columns_of(t).start for t in model.terms if t.of == "joint 4")
        (spring,) = (t for t in model.terms if isinstance(t, JointSpring) and t.joint == 4)
        off[name] = abs(spring.tau_ref_Nm / x[at] / STIFFNESS[4] - 1.0)
    assert off["taken"] > 0.1
    assert off["unknown"] < 0.03
    (weights,) = (term for term in model.terms if isinstance(term, Weights))
    np.testing.assert_allclose(x[model.columns_of(weights)], 4.0 * far.com_m, atol=0.05)
    plain = model_to_plain(with_springs(replace(nowhere, com_u_m=0.15)))
    assert model_from_plain(plain, where="test").payload.com_u_m == 0.15


def test_a_tool_of_unknown_mass_is_estimated_and_stiffness_is_as_uncertain():
    observations = measured(states(150))
    found = {each.known: general(ARM, observations, each) for each in (TOOL, NOT_KNOWN)}

    def stiffness(known):
        model, std = found[known].problem.model, np.sqrt(np.diag(found[known].fit.covariance))
        for term in model.terms:
            if isinstance(term, JointSpring) and term.joint in STIFFNESS:
                at = model.columns_of(term)
                windup = found[known].fit.x[at][0]
                yield STIFFNESS[term.joint], term.tau_ref_Nm / windup, std[at][0] / windup

    for true, value, share in stiffness(known=False):
        assert abs(value / true - 1.0) < 4.0 * share
    known, unknown = (max(share for *_, share in stiffness(k)) for k in (True, False))
    assert unknown > known
    terms = found[False].problem.model
    (weights,) = (term for term in terms.terms if isinstance(term, Weights))
    assert (weights,) == unknown_tool(ARM, NOT_KNOWN)
    mass_kg = found[False].fit.x[terms.columns_of(weights)][-1]
    std_kg = np.sqrt(np.diag(found[False].fit.covariance))[terms.columns_of(weights)][-1]
    assert abs(mass_kg - TOOL_KG) < 4.0 * std_kg < 4.0 * weights.sizes[-1]
    assert not any(isinstance(term, Weights) for term in found[True].problem.model.terms)


def test_other_weights_move_torques_as_their_derivative_says():
    sizes = weight_sizes(ARM, TOOL).columns(ARM)
    small = 1e-6 * sizes * np.random.default_rng(0).standard_normal(len(sizes))
    rigid = Model(Chain.of(ARM), ())
    before = statics_of(rigid, np.zeros(0), states(), TOOL)
    arm, carried = weighed(ARM, TOOL, small)
    after = statics_of(Model(Chain.of(arm), ()), np.zeros(0), states(), carried)
    wanted = before.by_weights @ small
    assert np.abs(wanted).max() > 1e-6
    np.testing.assert_allclose(
        after.joint_Nm - before.joint_Nm, wanted, atol=1e-5 * np.abs(wanted).max()
    )


def bending():
    """A model of springs, of what bends and of weights, with its parameters."""
    payload, arm = TOOL, ARM
    springs = with_springs(payload)
    soft = (BaseCompliance("base"), *LinkBending.everywhere(context_of(arm)))
    weights = Weights.about(arm, weight_sizes(arm, payload))
    amounts = (
        0.5
        * np.array(weights.sizes)
        * np.random.default_rng(2).uniform(-1.0, 1.0, len(weights.sizes))
    )
    x = np.concatenate([springs.x, [2e-6, 3e-6], [4e-6] * (len(soft) - 1), amounts])
    chain = Chain.of(arm, bends=range(1, arm.n))
    return Model(chain, (*springs.model.terms, *soft, weights)), x


def test_joints_links_and_base_carry_the_weights_found():
    model, x = bending()
    weights, rigid, nothing = model.terms[-1], Model(model.chain, ()), np.zeros(0)
    described = statics_of(rigid, nothing, states(), TOOL)
    loaded = replace(states(), static_loads=described, tau_Nm=described.joint_Nm)
    arm, carried = weighed(ARM, TOOL, weights.amounts(x[model.columns_of(weights)]))
    heavier = statics_of(
        Model(Chain.of(arm, bends=model.chain.bends), ()), nothing, states(), carried
    )
    found = model.carried(loaded, x)
    for part in ("link_Nm", "link_N", "base_Nm"):
        value, wanted = getattr(found.static_loads, part), getattr(heavier, part)
        np.testing.assert_allclose(value, wanted, atol=1e-9)
    assert np.abs(found.static_loads.base_Nm - described.base_Nm).max() > 0.5
    # Of torques, as of a tilt of gravity beside them, what goes with one weight alone.
    np.testing.assert_allclose(found.tau_Nm, heavier.joint_Nm, atol=0.2)


def test_the_pose_follows_weights_by_way_of_all_that_gives_way():
    model, x = bending()
    loads = statics_of(Model(model.chain, ()), np.zeros(0), states(), TOOL)
    loaded = replace(states(), static_loads=loads, tau_Nm=loads.joint_Nm)
    jacobian = model.predict_with_jacobian(loaded, x).jacobian
    for column in range(model.columns_of(model.terms[-1]).start, len(x)):
        step = 1e-3 * model.scale[column] * np.eye(len(x))[column]
        moved = model.predict(loaded, x + step) - model.predict(loaded, x - step)
        np.testing.assert_allclose(
            moved[:, :3, 3] / (2.0 * step[column]), jacobian[:, :3, column], rtol=1e-5, atol=1e-9
        )
