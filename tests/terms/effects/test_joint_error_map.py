"""Maps of a joint's error with a stated spacing and smoothness, by laws."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drawn_examples import examples
from made_up_poses import at_rest
from pa10cal.numerics.periodic_spline import (
    b_splines,
    b_splines_by_knots,
    harmonic_orders,
    harmonics_at_knots,
)
from pa10cal.terms.effects.joint_error_map import (
    TYPICAL,
    FadingPrior,
    GearError,
    JointErrorMap,
    SensorError,
)

FINE = JointErrorMap("joint 2", 36, FadingPrior(1e-4, 4.0))
TURN = 2.0 * np.pi
angles = arrays(float, 7, elements=st.floats(-20.0, 20.0))
errors = arrays(float, 36, elements=st.floats(-1e-3, 1e-3))


def at(q_rad):
    q_rad = np.asarray(q_rad)
    states = np.zeros((len(q_rad), 6))
    states[:, 1] = q_rad
    return at_rest(states)


@examples(40)
@given(angles, errors)
def test_the_error_is_what_its_derivative_says(q_rad, x):
    shift = FINE.shift(at(q_rad), x)
    assert shift.shape == (7, 1)
    np.testing.assert_allclose(shift, FINE.derivative(at(q_rad), x) @ x, atol=1e-15)


@examples(40)
@given(angles, errors, st.integers(-3, 3))
def test_it_comes_again_after_a_turn(q_rad, x, turns):
    there = FINE.shift(at(q_rad + turns * TURN), x)
    np.testing.assert_allclose(there, FINE.shift(at(q_rad), x), atol=1e-15 + 1e-13)


def test_it_goes_through_its_knots():
    x = np.random.default_rng(1).standard_normal(36)
    knots_rad = TURN * np.arange(36) / 36
    np.testing.assert_allclose(FINE.shift(at(knots_rad), x)[:, 0], x, atol=1e-12)


@pytest.mark.parametrize("knots", [12, 25, 36, 360])
def test_b_splines_are_the_spline_through_knots(knots):
    rng = np.random.default_rng(2)
    q_rad = np.concatenate([rng.uniform(-9.0, 9.0, 200), [0.0, TURN, -TURN, -1e-17, 3.0 * TURN]])
    x = rng.standard_normal(knots)
    sparse = b_splines(knots, q_rad)
    assert sparse.shape == (len(q_rad), knots)
    assert sparse.nnz == 4 * len(q_rad)
    effect = JointErrorMap("joint 2", knots)
    np.testing.assert_allclose(
        sparse @ (b_splines_by_knots(knots) @ x), effect.shift(at(q_rad), x)[:, 0], atol=1e-11
    )


@pytest.mark.parametrize("knots", [25, 36])
def test_harmonics_are_independent_and_complete(knots):
    waves, orders = harmonics_at_knots(knots), harmonic_orders(knots)
    products = waves.T @ waves
    np.testing.assert_allclose(products, np.diag(np.diag(products)), atol=1e-11)
    assert orders[0] == 0.0
    assert orders[-1] == knots // 2


def test_the_finer_the_wave_the_less_of_it_is_expected():
    expected = FINE.prior_factor @ FINE.prior_factor.T
    np.testing.assert_allclose(expected[0], np.roll(expected[5], -5), atol=1e-20)
    waves = harmonics_at_knots(36)
    sizes = [np.sqrt(wave @ expected @ wave) / (wave @ wave) for wave in waves.T]
    np.testing.assert_allclose(sizes[3], 1e-4 / (1.0 + (2 / 4.0) ** 2))
    np.testing.assert_allclose(sizes[8], 1e-4 / 2.0)
    assert np.all(np.diff(sizes[1:]) <= 1e-18)


def test_a_constant_belongs_to_the_offset_of_the_joint():
    constant = np.ones(36) / 36.0
    expected = FINE.prior_factor @ FINE.prior_factor.T
    assert constant @ expected @ constant < 1e-5 * expected[0, 0]


def test_every_knot_is_reported_under_a_name_of_its_own():
    names = [parameter.name for parameter in FINE.report(np.zeros(36)).parameters]
    assert (names[0], names[-1], len(set(names))) == ("knot_00", "knot_35", 36)
    assert replace(FINE, knots=216).reported[7].name == "knot_007"
    plausible = FINE.parameters[0].plausible
    assert plausible == pytest.approx(np.sqrt((FINE.prior_factor**2).sum(axis=1)[0]))


def test_without_a_stated_smoothness_it_is_what_twelve_knots_can_follow(context):
    (usual,) = (e for e in JointErrorMap.everywhere(context) if e.of == "joint 2")
    assert usual == JointErrorMap("joint 2")
    assert (usual.knots, usual.spectrum, len(usual.parameters)) == (12, None, 12)


@pytest.mark.parametrize("kind", [SensorError, GearError])
def test_a_sensor_and_a_gear_have_one_form(kind):
    effect = kind("joint 2")
    assert (effect.knots, effect.spectrum) == (360, TYPICAL)
    x = np.random.default_rng(3).standard_normal(360)
    q_rad = np.linspace(-4.0, 4.0, 50)
    as_map = JointErrorMap("joint 2", 360, TYPICAL)
    np.testing.assert_array_equal(effect.shift(at(q_rad), x), as_map.shift(at(q_rad), x))
    np.testing.assert_array_equal(effect.prior_factor, as_map.prior_factor)
    assert effect.role_in_search == "proposed"
    assert effect.parameters[0].name == f"{kind.id}_2_knot_000"


def test_a_band_has_its_levels_and_falls_above_it_to_its_floor():
    sizes = TYPICAL.sizes_rad(np.array([1.0, 2.0, 3.0, 15.0, 60.0, 180.0]))
    np.testing.assert_allclose(sizes[:2], 1.2e-4, rtol=0.01)
    np.testing.assert_allclose(sizes[2], 4.5e-5, rtol=0.01)
    np.testing.assert_allclose(sizes[3], 7.5e-5, rtol=0.05)
    assert sizes[4] < 1e-5
    np.testing.assert_allclose(sizes[5], TYPICAL.floor_rad, rtol=0.01)


def test_where_no_angle_was_seen_it_is_nothing_and_says_how_uncertain():
    """Fitted to 200 degrees of a turn: intervals hold there and everywhere else."""
    rng, effect, noise_rad = np.random.default_rng(5), SensorError("joint 2", 120), 3e-5
    visited = at(np.radians(rng.uniform(0.0, 200.0, 2000)))
    every = at(np.radians(np.arange(0.0, 360.0, 1.0)))
    factor = effect.prior_factor
    rows = effect.derivative(visited, np.zeros(120))[:, 0] @ factor / noise_rad
    covariance = factor @ np.linalg.inv(rows.T @ rows + np.eye(120)) @ factor.T
    by_knot = effect.derivative(every, np.zeros(120))[:, 0]
    std = np.sqrt(np.einsum("pk,kl,pl->p", by_knot, covariance, by_knot))
    prior = np.sqrt(np.einsum("pk,kl,pl->p", by_knot, factor @ factor.T, by_knot))
    seen, far = slice(10, 190), slice(220, 340)
    assert std[seen].max() < 0.1 * prior.min()
    np.testing.assert_allclose(std[far], prior[far], rtol=0.35)
    inside, left = [], []
    for _ in range(20):
        true = factor @ rng.standard_normal(120)
        data = effect.shift(visited, true)[:, 0] + noise_rad * rng.standard_normal(2000)
        found = covariance @ np.linalg.solve(factor.T, rows.T @ data / noise_rad)
        off = by_knot @ (found - true)
        inside.append(np.abs(off) < 1.96 * std)
        left.append([np.mean((by_knot @ each)[far] ** 2) for each in (found, true)])
    shares = np.mean(inside, axis=0)
    assert shares[seen].mean() == pytest.approx(0.95, abs=0.04)
    assert shares[far].mean() == pytest.approx(0.95, abs=0.08)
    said, there = np.mean(left, axis=0)
    assert said < 0.5 * there
