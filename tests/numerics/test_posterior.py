"""Unknowns by products of their rows and a prior, also where rounding makes these indefinite."""

import numpy as np
import pytest

from pa10cal.numerics.posterior import (
    covariance_by_sizes,
    posterior_covariance,
    posterior_mean,
    posterior_means,
)

SIZES = np.array([1e-6, 2.0, 3e3, 0.5])


def products_of(count):
    """Return gram and projection of so many random rows."""
    rng = np.random.default_rng(0)
    A, y = rng.standard_normal((count, 4)) / SIZES, rng.standard_normal(count)
    return A.T @ A, A.T @ y, A, y


def test_mean_and_covariance_are_those_of_rows_with_pseudo_observations():
    gram, projection, A, y = products_of(30)
    prior = np.diag(SIZES**-2.0)
    every = np.concatenate([A, np.diag(1.0 / SIZES)])
    expected = np.linalg.lstsq(every * SIZES, np.append(y, np.zeros(4)), rcond=None)[0] * SIZES
    mean = posterior_mean(gram, projection, prior)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)
    covariance = posterior_covariance(gram + prior, prior)
    np.testing.assert_allclose(covariance, np.linalg.inv(every.T @ every), rtol=1e-9)
    np.testing.assert_array_equal(covariance, covariance_by_sizes(gram, SIZES))
    np.testing.assert_array_equal(covariance, covariance.T)
    both = posterior_mean(gram, np.stack([projection, 2.0 * projection], axis=1), prior)
    np.testing.assert_allclose(both, np.stack([mean, 2.0 * mean], axis=1), rtol=1e-9)
    several = posterior_means(gram[None], projection[None], SIZES[None] ** -2.0)
    np.testing.assert_allclose(several, mean[None], rtol=1e-9)


def test_what_is_given_stays_as_it_is():
    gram, projection, *_ = products_of(30)
    prior = np.diag(SIZES**-2.0)
    before = gram.copy(), projection.copy(), prior.copy()
    posterior_mean(gram, projection, prior)
    posterior_covariance(gram, prior)
    posterior_means(gram[None], projection[None], np.diag(prior)[None])
    for now, then in zip((gram, projection, prior), before, strict=True):
        np.testing.assert_array_equal(now, then)


@pytest.mark.parametrize("without_prior", [(), (1,)])
def test_no_direction_is_less_certain_than_by_the_prior_where_rounding_left_less(without_prior):
    """As by rows that were subtracted: alone these products would leave a negative variance."""
    prior, by_size = np.diag(SIZES**-2.0), np.outer(SIZES, SIZES)
    prior[without_prior, without_prior] = 0.0
    lost = np.zeros((4, 4))
    lost[0, 2] = lost[2, 0] = -3.0
    gram = np.diag([0.0, 2.0, 0.0, 0.0]) / by_size + lost / by_size
    assert np.linalg.eigvalsh((gram + prior) * by_size).min() < -1.0
    covariance = posterior_covariance(gram + prior, prior)
    certain = np.linalg.eigvalsh(covariance / by_size)
    assert certain.min() > 0.0
    assert certain.max() < 1.0 + 1e-9
    projection = gram @ np.ones(4)
    mean = posterior_mean(gram, projection, prior)
    np.testing.assert_allclose(mean, covariance @ projection, rtol=1e-9)
    if not without_prior:
        several = posterior_means(gram[None], projection[None], np.diag(prior)[None])
        np.testing.assert_allclose(several[0], mean, rtol=1e-9)


def test_an_unknown_without_rows_and_prior_is_refused():
    gram, prior = np.diag([2.0, 0.0]), np.diag([1.0, 0.0])
    with pytest.raises(np.linalg.LinAlgError, match="neither rows nor a prior"):
        posterior_mean(gram, np.ones(2), prior)
    with pytest.raises(np.linalg.LinAlgError, match="neither rows nor a prior"):
        posterior_covariance(gram + prior, prior)
    with pytest.raises(np.linalg.LinAlgError, match="neither rows nor a prior"):
        posterior_means(gram[None], np.ones((1, 2)), np.diag(prior)[None])
    none = np.zeros((0, 0))
    assert posterior_mean(none, np.zeros(0), none).shape == (0,)
    assert posterior_covariance(none, none).shape == (0, 0)
