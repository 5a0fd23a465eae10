"""Statistics from sums against statistics of the draws themselves."""

import numpy as np
import pytest

from pa10cal.montecarlo.plane import ErrorSums, convergence, counts_of, summarise

CYCLES, PLACES = 4000, 30


@pytest.fixture(scope="module")
def drawn():
    source = np.random.default_rng(1)
    level = source.uniform(1e-4, 3e-4, (PLACES, 1))
    return level * source.chisquare(3, (PLACES, CYCLES))


@pytest.fixture(scope="module")
def sums(drawn):
    counts = counts_of(CYCLES)
    running = np.cumsum(drawn, axis=1)[:, counts - 1], np.cumsum(drawn**2, axis=1)[:, counts - 1]
    return ErrorSums(counts, *running)


def test_moments(drawn, sums):
    statistics = summarise(sums)
    deviations = drawn.std(axis=1, ddof=1)
    np.testing.assert_allclose(statistics.place_mean_m, drawn.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(statistics.place_std_m, deviations, rtol=1e-10)
    assert statistics.mean_m == pytest.approx(drawn.mean(), rel=1e-12)
    assert statistics.std_within_m == pytest.approx(np.sqrt((deviations**2).mean()), rel=1e-10)
    assert statistics.std_between_m == pytest.approx(drawn.mean(axis=1).std(ddof=1), rel=1e-10)
    assert statistics.std_total_m == pytest.approx(drawn.std(), rel=1e-10)


def test_half_width_covers_the_mean_of_these_places_and_shrinks(drawn, sums):
    trace = convergence(sums)
    assert trace.mean_m[-1] == pytest.approx(drawn.mean(), rel=1e-12)
    assert trace.half_width_m[-1] == pytest.approx(summarise(sums).half_width_m, rel=1e-12)
    expected = 1.96 * drawn.std(axis=1).mean() / np.sqrt(PLACES * trace.cycles)
    np.testing.assert_allclose(trace.half_width_m[8:], expected[8:], rtol=0.2)
    inside = np.abs(trace.mean_m - trace.mean_m[-1]) < 2 * trace.half_width_m
    assert inside.all()


@pytest.mark.parametrize("cycles", [2, 3, 9, 25, 100_000])
def test_counts_increase_to_all_cycles(cycles):
    counts = counts_of(cycles)
    assert counts[-1] == cycles
    assert counts[0] >= min(10, cycles)
    assert (np.diff(counts) > 0).all()
    assert len(counts) <= 20
