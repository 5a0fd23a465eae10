"""The closed form of the mean error against the cases one can write down, and integration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.montecarlo.plane import expected_error

SIGMA = 2e-4


def by_integration(variances):
    """E√Q = 1/(2√π) ∫ (1 - E exp(-tQ)) t^(-3/2) dt, by the trapezoidal rule in y = log(t)/2."""
    y = np.linspace(-45, 45, 1801)
    t_variances = np.exp(2 * y[:, None]) * variances / max(variances)
    one_less_transform = -np.expm1(-0.5 * np.log1p(2 * t_variances).sum(axis=1))
    integral = (one_less_transform * np.exp(-y)).sum() * (y[1] - y[0])
    return np.sqrt(max(variances) / np.pi) * integral


@pytest.mark.parametrize(
    ("lengths", "mean"),
    [
        ((1.0, 1.0, 1.0), np.sqrt(8 / np.pi)),  # Maxwell
        ((1.0, 1.0, 0.0), np.sqrt(np.pi / 2)),  # Rayleigh
        ((0.0, 1.0, 0.0), np.sqrt(2 / np.pi)),  # half normal
        ((0.0, 0.0, 0.0), 0.0),
    ],
)
def test_textbook_distributions(lengths, mean):
    mean_m, std_m = expected_error(0.7 * np.diag(lengths)[None], SIGMA)
    square = 0.7**2 * SIGMA**2 * np.sum(np.square(lengths))
    assert mean_m == pytest.approx([0.7 * SIGMA * mean], rel=1e-14)
    assert std_m**2 == pytest.approx([square - mean_m[0] ** 2], rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=18, max_size=18),
    st.sampled_from([1.0, 1e-2, 1e-5, 1e-9, 0.0]),
)
def test_any_jacobian_near_singular_too(entries, thin):
    jacobian = np.array(entries).reshape(3, 6) + np.eye(3, 6)
    jacobian[2] = thin * jacobian[2] + (1 - thin) * (jacobian[0] - jacobian[1])
    variances = np.linalg.svd(SIGMA * jacobian, compute_uv=False) ** 2
    mean_m, _ = expected_error(jacobian[None], SIGMA)
    assert mean_m[0] == pytest.approx(by_integration(variances), rel=1e-10)


def test_against_drawing():
    source = np.random.default_rng(3)
    jacobian = source.normal(size=(3, 6))
    errors = np.linalg.norm(source.normal(0, SIGMA, (400_000, 6)) @ jacobian.T, axis=1)
    mean_m, std_m = expected_error(jacobian[None], SIGMA)
    assert mean_m[0] == pytest.approx(errors.mean(), rel=3e-3)
    assert std_m[0] == pytest.approx(errors.std(), rel=5e-3)


def test_turning_the_frame_changes_nothing():
    source = np.random.default_rng(4)
    jacobian = source.normal(size=(5, 3, 6))
    turn = np.linalg.qr(source.normal(size=(3, 3)))[0]
    before, after = expected_error(jacobian, SIGMA), expected_error(turn @ jacobian, SIGMA)
    np.testing.assert_allclose(after, before, rtol=1e-12)
