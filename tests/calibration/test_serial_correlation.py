"""Errors that are alike from pose to pose: when they are told, and what they make less certain."""

import numpy as np
import pytest

from pa10cal.calibration.serial_correlation import SerialCorrelation, serial_correlation


def errors(rows, rho=0.0, share=1.0, seed=1, components=6):
    """Unit errors (rows, components) of which a part lasts."""
    rng = np.random.default_rng(seed)
    lasting = rng.standard_normal((rows, components))
    for k in range(1, rows):
        lasting[k] = rho * lasting[k - 1] + np.sqrt(1.0 - rho**2) * lasting[k]
    other = rng.standard_normal((rows, components))
    return np.sqrt(share) * lasting + np.sqrt(1.0 - share) * other


@pytest.mark.parametrize(("rho", "share"), [(0.98, 1.0), (0.9, 1.0), (0.9, 0.5), (0.6, 1.0)])
def test_how_many_rows_count_as_one_is_found(rho, share):
    found = serial_correlation(errors(300, rho, share))
    by_hand = 1.0 + 2.0 * share * rho / (1.0 - rho)
    assert 0.5 * by_hand < found.rows_for_one < 2.0 * by_hand


@pytest.mark.parametrize("seed", range(20))
def test_errors_of_their_own_are_not_alike_however_components_of_a_row_depend(seed):
    white = errors(120, seed=seed)
    assert serial_correlation(white @ errors(6, seed=seed + 99)) is None


def test_nothing_is_told_of_few_rows_or_of_exact_ones():
    assert serial_correlation(errors(39, 0.98)) is None
    assert serial_correlation(np.zeros((60, 3))) is None


def test_what_is_added_is_the_sum_over_all_pairs_of_rows():
    rows, alike = errors(40, components=12).reshape(40, 3, 4), SerialCorrelation(0.7, 5.0)
    apart = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    correlation = 0.7 * np.exp(-apart / 5.0) - 0.7 * np.eye(40)
    by_hand = np.einsum("pbk,pq,qbl->kl", rows, correlation, rows)
    np.testing.assert_allclose(alike.beside_independent(rows), by_hand, rtol=1e-9)
