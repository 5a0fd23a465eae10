"""Laws of `Gaussian`, against dense algebra and scipy's normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from drawn_examples import examples
from pa10cal.numerics.gaussian import Gaussian, Gaussians

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
    close(found.residual_squares, squares[0])
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


@given(seed=seeds, weight=st.floats(1e-3, 1e3))
@examples(50)
def test_rows_that_count_more_often_and_squares_at_some_amounts(seed, weight):
    columns, data = rows(seed)
    found = Gaussian.of(columns, data)
    heavier = Gaussian.of(np.sqrt(weight) * columns, np.sqrt(weight) * data)
    close(found.times(weight).products, heavier.products, 1e-12)
    x = np.random.default_rng(seed).normal(size=5) / np.abs(columns).max(axis=0)
    close(found.squares_at(x), np.sum((data - columns @ x) ** 2), 1e-10)
    close(found.squares_at(found.mean) + found.mean @ found.mean, found.residual_squares, 1e-5)


def test_without_unknowns_is_the_data_alone():
    columns, data = rows(3)
    whole = Gaussian.of(columns, data)
    alone = whole.without(np.arange(5))
    assert alone.unknowns == 0
    assert alone.covariance.shape == (0, 0)
    assert alone.residual_squares == pytest.approx(whole.residual_squares)
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
    assert found.residual_squares == pytest.approx(whole.residual_squares, rel=1e-12)
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


def many(seed, count=4, unknowns=5):
    """Some models one by one, some unknowns integrated out of each; and all at once."""
    alone = [
        Gaussian.of(*rows(seed + k, unknowns=unknowns + 2)).without(np.array([0, 2]))
        for k in range(count)
    ]
    return alone, Gaussians.of(alone)


@given(seed=seeds)
@examples(50)
def test_many_at_once_are_each_alone(seed):
    alone, found = many(seed)
    close(found.mean, np.stack([one.mean for one in alone]), 1e-5)
    close(found.residual_squares, np.array([one.residual_squares for one in alone]), 1e-5)
    close(found.log_precision, np.array([one.log_precision for one in alone]))
    close(found.log_evidence, np.array([one.log_evidence for one in alone]))
    close(found[1:3].log_evidence, np.array([one.log_evidence for one in alone[1:3]]))
    close(found[2].log_evidence, alone[2].log_evidence)


@given(seed=seeds, sizes=st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=3))
@examples(50)
def test_many_at_once_in_several_sizes_along_some_unknowns_with_other_rows(seed, sizes):
    (alone, found), (others, more) = many(seed), many(seed + 7)
    at = np.array([4, 0, 1])
    close(
        (found + more).projection,
        np.stack([(a + b).projection for a, b in zip(alone, others, strict=True)]),
    )
    one = (found + more[1]).log_evidence  # the same further rows in all
    close(one, np.array([(each + others[1]).log_evidence for each in alone]))
    each = found.along(at).in_sizes(np.array(sizes)[:, None, None])
    wanted = [[a.along(at).in_sizes(np.full(3, s)).log_evidence for a in alone] for s in sizes]
    close(each.log_evidence, np.array(wanted), 1e-5)
    np.testing.assert_array_equal(found.across(at, at[:2]), found.gram[:, at][:, :, at[:2]])
    np.testing.assert_array_equal(found.across(at, at[:2]), found.along(at).gram[:, :, :2])


def test_of_unknowns_that_no_rows_show_nothing_is_said():
    alone, found = many(3)
    at = np.array([6, 1, 3, 0, 4])
    wider = found.among(at, 8)
    close(wider.log_evidence, found.log_evidence, 1e-12)
    close(wider.mean[:, at], found.mean, 1e-9)
    assert np.all(wider.mean[:, [2, 5, 7]] == 0.0)
    assert np.all(wider.log_det == np.array([one.log_det for one in alone]))


@given(seed=seeds)
@examples(50)
def test_each_set_of_further_unknowns_is_one_of_them_alone(seed):
    rng = np.random.default_rng(seed)
    columns, data = rows(seed)
    here = Gaussian.of(columns, data)
    sets = rng.normal(size=(12, 3, 2)) * 10.0 ** rng.uniform(-2, 2, (3, 2))
    across = np.einsum("rk,rmj->kmj", columns, sets)
    gram, projection = np.einsum("rmi,rmj->mij", sets, sets), np.einsum("rmj,r->mj", sets, data)
    found = here.of_each_further(across, gram, projection)
    wanted = [here.of_further(across[:, m], gram[m], projection[m]) for m in range(3)]
    close(found.gram, np.stack([one.gram for one in wanted]))
    close(found.mean, np.stack([one.mean for one in wanted]), 1e-5)
    close(found.log_evidence, np.array([one.log_evidence for one in wanted]))
    # The same of several models at once, here the rows counting once and twice.
    both = Gaussians.of([here, here + here])
    twice = np.array([1.0, 2.0])
    every = both.of_each_further(
        twice[:, None, None, None] * across,
        twice[:, None, None, None] * gram,
        twice[:, None, None] * projection,
    )
    close(every[0].log_evidence, found.log_evidence)
    second = [
        (here + here).of_further(*(2.0 * a for a in (across[:, m], gram[m], projection[m])))
        for m in range(3)
    ]
    close(every[1].log_evidence, np.array([one.log_evidence for one in second]))


@given(seed=seeds, scatter=st.floats(0.1, 10.0))
@examples(50)
def test_gains_are_of_evidence_at_the_scatter_that_makes_rows_likeliest(seed, scatter):
    rng = np.random.default_rng(seed)
    columns, data = rng.normal(size=(12, 3)), scatter * rng.normal(size=12)
    gains, share = Gaussians.of([Gaussian.of(columns, data)]).gains(len(data))
    # Unknowns have their sizes in that scatter: so the covariance of the rows is one times it.
    cov = np.eye(12) + columns @ columns.T
    square = float(data @ np.linalg.solve(cov, data))

    def log_likelihood(cov, square):
        scale = square / 12
        return multivariate_normal(cov=scale * cov).logpdf(data)

    wanted = log_likelihood(cov, square) - log_likelihood(np.eye(12), float(data @ data))
    close(gains, np.array([wanted]))
    close(share, np.array([square / float(data @ data)]))
    _, least = Gaussians.of([Gaussian.of(columns, data)]).gains(len(data), 2.0)
    assert least[0] == 2.0


def test_products_that_rounding_left_below_nothing_count_as_nothing():
    gram = np.array([[[1e18, 1e18], [1e18, 1e18 * (1.0 - 1e-15)]], np.eye(2)])
    found = Gaussians(gram, np.ones((2, 2)), np.zeros(2), np.zeros(2))
    assert np.all(found.residual_squares < 0.0)
    assert np.all(np.isfinite(found.log_precision))
    assert found.residual_squares[1] == pytest.approx(-1.0)
