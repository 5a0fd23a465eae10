"""The least squares solver against scipy's, inside the range of the parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares, lsq_linear

from pa10cal.discovery.evidence.minimise import minimise
from pa10cal.terms.term import Parameter


def ranges(lower, upper, scale):
    """Return parameters of so wide a range."""
    return [
        Parameter(
            f"x{k}",
            "1",
            scale[k],
            lower=None if np.isinf(lower[k]) else lower[k],
            upper=None if np.isinf(upper[k]) else upper[k],
        )
        for k in range(len(lower))
    ]


TIME = np.linspace(0.0, 4.0, 30)
MEASURED = 3.0 * np.exp(-0.7 * TIME) + 0.1 * np.sin(17.0 * TIME)


def decay(x):
    """Residuals of a decay of unknown height and rate, and their derivative."""
    fall = np.exp(-x[1] * TIME)
    return x[0] * fall - MEASURED, np.stack([fall, -x[0] * TIME * fall], axis=1)


@pytest.mark.parametrize("upper_rate", [np.inf, 0.5])
def test_agrees_with_scipy_on_a_curved_problem(upper_rate):
    lower, upper = np.array([-np.inf, 0.0]), np.array([np.inf, upper_rate])
    parameters = ranges(lower, upper, [1.0, 0.1])
    x, cost, converged = minimise(decay, np.array([1.0, 0.1]), parameters)
    expected = least_squares(
        lambda x: decay(x)[0],
        [1.0, 0.1],
        lambda x: decay(x)[1],
        bounds=(lower, upper),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert converged
    assert cost == pytest.approx(2.0 * expected.cost, rel=1e-7)
    np.testing.assert_allclose(x, expected.x, rtol=1e-4)
    assert (x[1] == 0.5) == np.isfinite(upper_rate)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_finds_the_least_of_linear_problems_within_their_bounds(seed):
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 6))
    scale = 10.0 ** rng.uniform(-6, 3, k)
    rows = rng.normal(size=(k + 4, k)) / scale
    target = 3.0 * rng.normal(size=k + 4)
    lower = np.where(rng.random(k) < 0.5, -rng.random(k), -np.inf) * scale
    upper = np.where(rng.random(k) < 0.5, rng.random(k), np.inf) * scale
    x, cost, converged = minimise(
        lambda x: (rows @ x - target, rows), np.zeros(k), ranges(lower, upper, scale)
    )
    expected = lsq_linear(rows * scale, target, (lower / scale, upper / scale), tol=1e-14)
    assert converged
    assert (x >= lower).all()
    assert (x <= upper).all()
    assert cost == pytest.approx(2.0 * expected.cost, rel=1e-6, abs=1e-6)


def test_sets_out_from_within_the_range():
    parameters = ranges(np.array([1.0]), np.array([2.0]), [1.0])
    x, cost, converged = minimise(lambda x: (x - 1.5, np.ones((1, 1))), np.array([9.0]), parameters)
    assert converged
    assert x == pytest.approx([1.5])
    assert cost == pytest.approx(0.0, abs=1e-12)


def test_stays_where_everything_is_held_at_its_bound():
    parameters = ranges(np.zeros(2), np.ones(2), [1.0, 1.0])
    x, cost, converged = minimise(lambda x: (x + 1.0, np.eye(2)), np.zeros(2), parameters)
    assert converged
    np.testing.assert_array_equal(x, 0.0)
    assert cost == 2.0
