"""Laws of `Gaussian`, against dense algebra and scipy's normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from drawn_examples import examples
from pa10cal.numerics.gaussian import Gaussian, taken_by_each

pytestmark = pytest.mark.digits
seeds = st.integers(0, 2**32 - 1)


def rows(seed, count=12, unknowns=5):
    rng = np.random.default_rng(seed)
    # Sizes from what rows do not show to what they determine; one column nearly another's.
    columns = rng.normal(size=(count, unknowns)) * 10.0 ** rng.uniform(-4, 3, unknowns)
    columns[:, -1] = columns[:, 0] * (1.0 + 1e-6 * rng.normal(size=count))
    return columns, rng.normal(size=count)


def close(found, wanted, rtol=1e-6):
    scale = max(float(np.abs(wanted).max(initial=0.0)), 1.0)
    np.testing.assert_allclose(found, wanted, rtol=rtol, atol=rtol * scale)


@given(seed=seeds)
@examples(50)
def test_joining_is_addition_and_holding_out_is_subtraction(seed):
    columns, data = rows(seed)
    whole = Gaussian.of(columns, data)
    parts = [Gaussian.of(columns[k::3], data[k::3]) for k in range(3)]
    close(sum(parts, Gaussian.none(5)).products, whole.products, 1e-12)
    others = Gaussian.of(np.delete(columns, np.s_[::3], 0), np.delete(data, np.s_[::3]))
    close((whole - parts[0]).products, others.products, 1e-9)


@given(seed=seeds, order=st.permutations(range(5)))
@examples(50)
def test_integrating_out_in_any_order_is_the_same(seed, order):
    whole = Gaussian.of(*rows(seed))
    at_once = whole.without(np.array(order[:3]))
    there, one_by_one = list(range(5)), whole
    for unknown in order[:3]:
        one_by_one = one_by_one.without(np.array([there.index(unknown)]))
        there.remove(unknown)
    close(one_by_one.mean, at_once.mean, 1e-5)
    close(one_by_one.log_evidence, at_once.log_evidence)
    close(at_once.log_evidence, whole.log_evidence)
    # In `without` the order of those that stay is kept.
    close(at_once.mean, whole.mean[sorted(order[3:])], 1e-5)


@given(seed=seeds)
@examples(50)
def test_evidence_is_the_density_of_the_data(seed):
    columns, data = rows(seed)
    columns = np.clip(columns, -30.0, 30.0)
    found = Gaussian.of(columns, data)
    density = multivariate_normal(cov=np.eye(len(data)) + columns @ columns.T)
    constant = 0.5 * len(data) * np.log(2.0 * np.pi)
    close(found.log_evidence - constant, density.logpdf(data))


@given(seed=seeds)
@examples(50)
def test_mean_and_covariance_are_those_of_rows_beside_the_prior(seed):
    columns, data = rows(seed)
    found = Gaussian.of(columns, data)
    beside = np.vstack([columns, np.eye(5)])
    wanted, squares, *_ = np.linalg.lstsq(beside, np.append(data, np.zeros(5)), rcond=None)
    close(found.mean, wanted, 1e-5)
    close(found.left, squares[0])
    triangle = np.linalg.qr(beside, mode="r")
    close(found.covariance, np.linalg.inv(triangle.T @ triangle), 1e-5)
    asked = np.random.default_rng(seed).normal(size=(4, 2, 5))
    wanted = np.einsum("abk,kl,abl->ab", asked, found.covariance, asked)
    close(found.variances(asked), wanted, 1e-4)


@given(seed=seeds)
@examples(50)
def test_about_a_mean_unknowns_are_expected_there(seed):
    columns, data = rows(seed)
    mean = np.random.default_rng(seed).normal(size=5)
    found = Gaussian.of(columns, data).about(mean)
    wanted = Gaussian.of(columns, data - columns @ mean)
    # Rounding is a part of the terms that are added, which may cancel.
    every = np.abs(np.column_stack([columns, data]))
    every[:, -1] += np.abs(columns) @ np.abs(mean)
    size = every.T @ every
    assert np.all(np.abs(found.products - wanted.products) <= 1e-13 * size)


@given(seed=seeds)
@examples(50)
def test_some_unknowns_alone_and_in_other_sizes(seed):
    columns, data = rows(seed)
    at, sizes = np.array([3, 1]), np.array([0.5, 20.0])
    found = Gaussian.of(columns, data).along(at).in_sizes(sizes)
    close(found.products, Gaussian.of(columns[:, at] * sizes, data).products, 1e-12)


def test_without_unknowns_is_the_data_alone():
    columns, data = rows(3)
    whole = Gaussian.of(columns, data)
    alone = whole.without(np.arange(5))
    assert alone.unknowns == 0
    assert alone.left == pytest.approx(whole.left)
    assert alone.log_evidence == pytest.approx(whole.log_evidence)
    assert whole.without(np.zeros(0, int)) is whole


def test_columns_that_are_nearly_the_same_far_over_the_noise():
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(40, 1)) * 1e9 * np.ones(6) + rng.normal(size=(40, 6))
    found = Gaussian.of(columns, columns.sum(axis=1))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(found.gram + np.eye(6))
    assert np.all(np.linalg.eigvalsh(found.covariance) > -1e-9)
    assert np.all(np.diag(found.covariance) <= 1.0 + 1e-9)
    # Products of 1e18 beside 1: which digits are left goes with the kernels of the processor.
    assert found.mean.sum() == pytest.approx(6.0, rel=1e-3)
    assert np.isfinite(found.log_evidence)


def test_further_unknowns_with_those_here_integrated_out():
    columns, data = rows(4)
    here, more = columns[:, :3], columns[:, 3:]
    found = Gaussian.of(here, data).of_further(here.T @ more, more.T @ more, more.T @ data)
    whole = Gaussian.of(columns, data)
    close(found.products, whole.without(np.arange(3)).products, 1e-12)
    assert found.left == pytest.approx(whole.left, rel=1e-12)
    assert found.log_evidence == pytest.approx(whole.log_evidence, rel=1e-12)
    precision = np.linalg.slogdet(found.gram + np.eye(found.unknowns))[1]
    assert found.log_precision == pytest.approx(precision, rel=1e-12)


def test_amounts_along_directions_are_those_of_columns_along_them():
    columns, data = rows(5)
    basis = np.random.default_rng(5).normal(size=(columns.shape[1], 2))
    found = Gaussian.of(columns, data).in_terms_of(basis)
    close(found.products, Gaussian.of(columns @ basis, data).products, 1e-12)
    again = Gaussian.of_products(found.gram, found.projection, found.squares)
    close(again.products, found.products, 0.0)


@given(st.integers(0, 10_000))
def test_unknowns_found_in_turn_are_those_of_two_fits(seed):
    rng = np.random.default_rng(seed)
    columns, data = rng.standard_normal((9, 5)), rng.standard_normal(9)
    first, then = np.array([0, 3]), np.array([1, 2, 4])
    alone, beside, mean = Gaussian.of(columns, data).in_turn(first, then)
    one = Gaussian.of(columns[:, first], data)
    np.testing.assert_allclose(mean[first], one.mean, atol=1e-9)
    other = Gaussian.of(columns[:, then], data - columns[:, first] @ one.mean)
    np.testing.assert_allclose(mean[then], other.mean, atol=1e-9)
    np.testing.assert_allclose(alone.covariance, one.covariance, atol=1e-9)
    np.testing.assert_allclose(beside.covariance, other.covariance, atol=1e-9)


@given(seed=seeds)
@examples(50)
def test_many_at_once_are_each_alone(seed):
    alone = [Gaussian.of(*rows(seed + k)) for k in range(4)]
    taken, log_det = taken_by_each(
        *(np.stack([getattr(one, of) for one in alone]) for of in ("gram", "projection"))
    )
    close(taken, np.array([one.squares - one.left for one in alone]), 1e-5)
    close(log_det, np.array([one.log_precision for one in alone]))


def test_products_that_rounding_left_below_nothing_count_as_nothing():
    gram = np.array([[[1e18, 1e18], [1e18, 1e18 * (1.0 - 1e-15)]], np.eye(2)])
    taken, log_det = taken_by_each(gram, np.ones((2, 2)))
    assert np.all(taken > 0.0)
    assert np.all(np.isfinite(log_det))
    assert taken[1] == pytest.approx(1.0)
