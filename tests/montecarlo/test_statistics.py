"""Statistics from sums against statistics of the draws themselves."""

import numpy as np
import pytest

from pa10cal.montecarlo.plane import ErrorSums, counts_of, drawn_keys, moments

CYCLES, PLACES = 4000, 30


@pytest.fixture(scope="module")
def drawn():
    source = np.random.default_rng(1)
    level = source.uniform(100.0, 300.0, (PLACES, 1))  # m: rounded far below
    return level * source.chisquare(3, (PLACES, CYCLES))


@pytest.fixture(scope="module")
def sums(drawn):
    counts = counts_of(CYCLES)
    running = np.cumsum(drawn, axis=1)[:, counts - 1], np.cumsum(drawn**2, axis=1)[:, counts - 1]
    return ErrorSums(counts, *running)


def test_moments(drawn, sums):
    found = drawn_keys(sums)
    deviations = drawn.std(axis=1, ddof=1)
    mean, variance = (each[:, -1] for each in moments(sums))
    np.testing.assert_allclose(mean, drawn.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(variance), deviations, rtol=1e-10)
    assert found["mean_mm"] == pytest.approx(1e3 * drawn.mean(), rel=1e-12)
    assert found["std_mm"] == pytest.approx(1e3 * np.sqrt((deviations**2).mean()), rel=1e-10)
    assert found["std_between_mm"] == pytest.approx(1e3 * drawn.mean(axis=1).std(ddof=1), rel=1e-10)
    assert found["std_total_mm"] == pytest.approx(1e3 * drawn.std(), rel=1e-10)


def test_half_width_covers_the_mean_of_these_places_and_shrinks(drawn, sums):
    found = drawn_keys(sums)
    trace, all_cycles_mm = found["convergence"], found["half_width95_cycles_mm"]
    assert trace.mean_mm[-1] == pytest.approx(1e3 * drawn.mean(), rel=1e-12)
    assert trace.half_width95_mm[-1] == pytest.approx(all_cycles_mm, rel=1e-12)
    expected = 1.96e3 * drawn.std(axis=1).mean() / np.sqrt(PLACES * trace.cycles)
    np.testing.assert_allclose(trace.half_width95_mm[8:], expected[8:], rtol=0.2)
    inside = np.abs(trace.mean_mm - trace.mean_mm[-1]) < 2 * trace.half_width95_mm
    assert inside.all()


@pytest.mark.parametrize("cycles", [2, 3, 9, 25, 100_000])
def test_counts_increase_to_all_cycles(cycles):
    counts = counts_of(cycles)
    assert counts[-1] == cycles
    assert counts[0] >= min(10, cycles)
    assert (np.diff(counts) > 0).all()
    assert len(counts) <= 20
