"""The drawn sums: right against drawing again by hand, and the same however they are worked out."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from pa10cal.montecarlo.plane import (
    BLOCK_CYCLES,
    joint_screws,
    plan_displacement,
    sample_errors,
    stream,
)

SIGMA = np.radians(0.011)
PLACES = 6


@pytest.fixture(scope="module")
def q_rad(pa10):
    low, high = pa10.limits_rad.T
    return np.random.default_rng(5).uniform(low, high, (PLACES, pa10.n))


def sums_of(chain, q_rad, positions, counts):
    plan = plan_displacement(joint_screws(chain, q_rad[positions]), SIGMA)
    return sample_errors(plan, [stream(7, 500, k) for k in positions], np.array(counts))


@pytest.mark.parametrize("cycles", [2, 100, BLOCK_CYCLES, BLOCK_CYCLES + 1, 2 * BLOCK_CYCLES + 77])
def test_sums_are_those_of_the_drawn_cycles(pa10, pa10_chain, flange, q_rad, cycles):
    counts = np.unique([1, cycles // 2, min(cycles, BLOCK_CYCLES), cycles])
    sums = sums_of(pa10_chain, q_rad, [0, 1], counts)
    for position in (0, 1):
        source, parts = stream(7, 500, position), []
        for start in range(0, cycles, BLOCK_CYCLES):
            parts.append(source.standard_normal((pa10.n, min(BLOCK_CYCLES, cycles - start))))
        delta_rad = SIGMA * np.concatenate(parts, axis=1).T
        q = q_rad[position]
        moved = (flange(pa10, q + delta_rad) - flange(pa10, q[None])).astype(float)
        error_m = np.linalg.norm(moved, axis=1)
        first = np.cumsum(error_m)[counts - 1]
        np.testing.assert_allclose(sums.error_m[position], first, rtol=1e-9)
        squared = np.cumsum(error_m**2)[counts - 1]
        np.testing.assert_allclose(sums.squared_m2[position], squared, rtol=1e-9)


def test_same_numbers_whatever_the_order_the_jobs_and_the_threads(pa10_chain, q_rad):
    counts = [10, 3000, BLOCK_CYCLES + 500]
    together = sums_of(pa10_chain, q_rad, list(range(PLACES)), counts)
    backwards = sums_of(pa10_chain, q_rad, list(range(PLACES))[::-1], counts)
    np.testing.assert_array_equal(backwards.error_m[::-1], together.error_m)
    with ThreadPoolExecutor(3) as pool:
        jobs = pool.map(lambda k: sums_of(pa10_chain, q_rad, [k], counts), range(PLACES))
        for position, alone in enumerate(jobs):
            np.testing.assert_array_equal(alone.error_m[0], together.error_m[position])
            np.testing.assert_array_equal(alone.squared_m2[0], together.squared_m2[position])


def test_more_cycles_begin_with_the_same_draws(pa10_chain, q_rad):
    fewer = sums_of(pa10_chain, q_rad, [0], [BLOCK_CYCLES])
    more = sums_of(pa10_chain, q_rad, [0], [BLOCK_CYCLES, 2 * BLOCK_CYCLES])
    np.testing.assert_array_equal(more.error_m[:, 0], fewer.error_m[:, 0])


def test_every_position_plane_and_seed_has_its_own_stream():
    keys = [(1, 500, 0), (1, 500, 1), (1, 500, None), (1, 600, 0), (1, -500, 0), (2, 500, 0)]
    draws = {stream(*key).standard_normal() for key in keys}
    assert len(draws) == len(keys)
    assert stream(-3, 500, 0).standard_normal() == stream(-3, 500, 0).standard_normal()


def test_progress_is_told(pa10_chain, q_rad):
    told = []
    plan = plan_displacement(joint_screws(pa10_chain, q_rad[:2]), SIGMA)
    sources = [stream(7, 500, k) for k in (0, 1)]
    sample_errors(plan, sources, np.array([50]), lambda *now: told.append(now))
    assert told == [(0, 2), (1, 2), (2, 2)]
