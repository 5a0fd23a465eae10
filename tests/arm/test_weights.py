"""Weights of an arm that states none: assumed from its lengths, and said to be so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_up_poses import states_of
from pa10cal.arm.chain import Chain, link_spans_m
from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.fit.uncertain_weights import unknown_weights, weight_sizes, with_assumed_weights
from pa10cal.terms.model import Model
from pa10cal.terms.plain import term_from_plain, term_to_plain
from pa10cal.terms.weights import Weights

PAYLOAD = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81]), known=False)


def bare(name="ur10"):
    return replace(load_arm(name), mass_kg=None, com_m=None)


@pytest.mark.parametrize("name", arm_names())
def test_the_longest_link_is_the_heaviest_and_none_is_without_mass(name):
    arm = with_assumed_weights(bare(name))
    lengths = np.linalg.norm(link_spans_m(arm), axis=1)
    heavier = arm.mass_kg[np.argmax(lengths)]
    assert heavier == arm.mass_kg.max()
    assert (arm.mass_kg > 0.0).all()


def test_masses_that_are_stated_stay():
    arm = load_arm("ur10")
    assert with_assumed_weights(arm, total_kg=99.0) is arm
    assert weights_known(arm).origin == "stated"
    assert not weights_known(arm).assumed


@settings(deadline=None)
@given(st.floats(0.2, 3.0))
def test_weights_scale_with_the_cube_of_the_arm_and_uncertainty_with_them(factor):
    arm = bare()
    larger = replace(
        arm,
        a_m=factor * arm.a_m,
        d_m=factor * arm.d_m,
        limits_rad=arm.limits_rad,
    )
    small, large = with_assumed_weights(arm), with_assumed_weights(larger)
    np.testing.assert_allclose(large.mass_kg, factor**3 * small.mass_kg, rtol=1e-9)
    np.testing.assert_allclose(large.com_m, factor * small.com_m, atol=1e-12)
    known = weights_known(large)
    np.testing.assert_allclose(known.com_m, factor * weights_known(small).com_m, rtol=1e-9)
    assert known.origin == "assumed"


def test_a_boom_weighs_as_it_is_long_and_not_as_its_cube():
    """The cube of 20 m would be 120 t, and stiffness beside such weights as far off."""

    def total_kg(reach_m):
        arm = bare()
        size = reach_m / arm.reach_m
        larger = replace(arm, a_m=size * arm.a_m, d_m=size * arm.d_m)
        return float(with_assumed_weights(larger).mass_kg.sum())

    assert total_kg(7.0) == pytest.approx(8.0 * total_kg(3.5))
    assert total_kg(21.0) == pytest.approx(3.0 * total_kg(7.0))


def test_a_rail_makes_the_arm_on_it_no_heavier():
    def on_rail(rail_m):
        limits_rad = load_arm("ur10").limits_rad.copy()
        limits_rad[0] = (0.0, rail_m)
        slides = np.arange(6) == 0
        return with_assumed_weights(replace(bare(), prismatic=slides, limits_rad=limits_rad))

    fixed_kg = with_assumed_weights(bare()).mass_kg.sum()
    assert on_rail(1.0).mass_kg.sum() == pytest.approx(fixed_kg)
    assert on_rail(20.0).mass_kg.sum() == pytest.approx(fixed_kg)


def test_a_total_is_what_the_parts_add_up_to():
    arm = with_assumed_weights(bare(), total_kg=29.0)
    assert arm.mass_kg.sum() == pytest.approx(29.0)
    assert weights_known(arm).origin == "total"
    assert (weights_known(arm).mass < weights_known(with_assumed_weights(bare())).mass).all()


def poses_of(arm, count=40, load_N=0.0):
    nan, loads_N = np.full((count, arm.n), np.nan), np.linspace(0.0, load_N, count)
    states = states_of(arm, 1, count, tau_Nm=nan, load_N=loads_N)
    return with_torques(Model(Chain.of(arm), ()), np.zeros(0), states, PAYLOAD)[0]


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_weights_that_nobody_stated_add_torques_at_right_angles_to_those_assumed(seed):
    """So stiffness, which scales all of them, is known relative to weights as assumed."""
    arm = with_assumed_weights(bare())
    states = poses_of(arm)
    (weights,) = unknown_weights(arm, PAYLOAD, states)
    assert weights.held is not None
    draws = np.random.default_rng(seed).standard_normal(len(weights.sizes))
    of_links = np.array(weights.columns) <= 4 * arm.n
    x = np.where(of_links, draws, 0.0) * weights.sizes
    added_Nm = -weights.torque_Nm(states, x)
    part = np.sum(added_Nm * states.tau_Nm) / np.sum(states.tau_Nm**2)
    assert abs(part) < 1e-9
    assert np.abs(added_Nm).max() > 0.0


def test_loads_of_known_size_set_the_scale():
    arm = with_assumed_weights(bare())
    (weights,) = unknown_weights(arm, PAYLOAD, poses_of(arm, load_N=50.0))
    assert weights.held is None
    tools = tuple(replace(PAYLOAD, mass_kg=kg, known=True) for kg in (1.0, 5.0))
    group = replace(PAYLOAD, of_campaigns=tools)
    (weights,) = unknown_weights(arm, group, poses_of(arm))
    assert weights.held is None


def test_weights_that_are_stated_are_none_of_a_calibration():
    arm = load_arm("ur10")
    assert unknown_weights(arm, replace(PAYLOAD, mass_kg=1.0, known=True), poses_of(arm)) == ()


def test_the_derivative_by_weights_is_that_of_the_torques():
    arm = with_assumed_weights(bare())
    states = poses_of(arm)
    weights = Weights.about(arm, weight_sizes(arm, PAYLOAD))
    k = weights.columns.index(4 * 2 + 1)  # the first moment of link 3 along x
    x = np.zeros(len(weights.columns))
    x[k] = 0.01 * arm.mass_kg[2]
    moved = arm.com_m.copy()
    moved[2, 0] += 0.01
    after = statics_of(
        Model(Chain.of(replace(arm, com_m=moved)), ()), np.zeros(0), states, PAYLOAD
    ).joint_Nm
    np.testing.assert_allclose(states.tau_Nm - weights.torque_Nm(states, x), after, atol=1e-9)


def test_a_term_of_weights_is_written_and_read_back():
    arm = with_assumed_weights(bare())
    (weights,) = unknown_weights(arm, PAYLOAD, poses_of(arm))
    plain = term_to_plain(weights)
    assert term_from_plain(plain, where="here") == weights
    assert "held" in plain["form"]
    full = Weights.about(arm, weight_sizes(arm, PAYLOAD))
    assert "held" not in term_to_plain(full)["form"]
