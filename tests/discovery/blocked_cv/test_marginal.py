"""Bands found by marginal likelihood: exact derivatives, and the band that was drawn."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from pa10cal.discovery.blocked_cv import band_likelihood
from pa10cal.discovery.blocked_cv.band_likelihood import (
    Waves,
    minus_twice_log_likelihood,
    most_likely,
)
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import harmonic_orders
from pa10cal.terms.effects.joint_error_map import BandPrior

NOISE_RAD = 3e-5
TRUE = BandPrior(8e-5, 3e-5, 8e-5, 7.0, 20.0, 3.0, 3e-6)


def waves_of(bands, *, poses=3000, knots=81, seed=0, visited=1.0):
    """What is said of joints that turn a single axis together, an offset beside their waves."""
    rng = np.random.default_rng(seed)
    orders = harmonic_orders(knots)[1:]
    q_rad = rng.uniform(0.0, 2.0 * np.pi * visited, (poses, len(bands)))
    sine = np.arange(len(orders)) % 2 == 0
    columns = [np.ones((poses, 1))]
    amounts = [np.zeros(1)]
    for j, band in enumerate(bands):
        phase = q_rad[:, j, None] * orders
        columns.append(np.where(sine, np.sin(phase), np.cos(phase)) / NOISE_RAD)
        amounts.append(rng.standard_normal(len(orders)) * band.sizes_rad(orders))
    rows = np.hstack(columns)
    data = rows @ np.concatenate(amounts) + rng.standard_normal(poses)
    return Waves(Gaussian.of(rows, data), poses, 1, orders)


def test_derivatives_are_those_of_differences():
    waves = waves_of([TRUE] * 2, poses=400, knots=21)
    logs = np.log(np.tile(TRUE.sizes_rad(waves.orders), 2)) + 0.1
    _, by_sizes, by_scatter, _ = minus_twice_log_likelihood(waves, logs, 0.2)

    def value(logs, scatter):
        return minus_twice_log_likelihood(waves, logs, scatter)[0]

    for k in (0, 3, len(logs) - 1):
        step = np.zeros(len(logs))
        step[k] = 1e-4
        difference = (value(logs + step, 0.2) - value(logs - step, 0.2)) / 2e-4
        assert by_sizes[k] == pytest.approx(difference, abs=1e-5)
    difference = (value(logs, 0.2 + 1e-4) - value(logs, 0.2 - 1e-4)) / 2e-4
    assert by_scatter == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize("visited", [1.0, 0.6])
def test_the_band_drawn_is_found_within_its_uncertainty(visited):
    found = most_likely(waves_of([TRUE] * 4, seed=1, visited=visited))
    assert found.shared
    assert found.scatter == pytest.approx(1.0, abs=0.05)
    off = (np.log(astuple(found.bands[0])) - np.log(astuple(TRUE))) / found.log_std[0]
    assert np.abs(off).max() < 3.0
    assert found.log_std[0][2:5].max() < 0.25  # level and ends of the band are known


def test_joints_have_bands_of_their_own_where_the_data_say_so():
    small = BandPrior(8e-5, 1e-5, 2e-5, 7.0, 12.0, 3.0, 3e-6)
    found = most_likely(waves_of([TRUE, TRUE, small, small], seed=2))
    assert not found.shared
    sizes = [float(band.sizes_rad(np.array(12.0))) for band in found.bands]
    np.testing.assert_allclose(sizes[:2], TRUE.sizes_rad(np.array(12.0)), rtol=0.5)
    np.testing.assert_allclose(sizes[2:], small.sizes_rad(np.array(12.0)), rtol=0.5)
    alike = most_likely(waves_of([TRUE] * 3, seed=3))
    assert alike.shared
    assert len(set(alike.bands)) == 1


def test_a_search_that_has_not_settled_chooses_no_bands_by_joint(monkeypatch):
    small = BandPrior(8e-5, 1e-5, 2e-5, 7.0, 12.0, 3.0, 3e-6)
    waves = waves_of([TRUE, small], seed=2)
    found = most_likely(waves)
    assert found.settled
    assert not found.shared
    monkeypatch.setattr(band_likelihood, "COMPUTING", replace(COMPUTING, band_steps=3))
    assert most_likely(waves).shared
    monkeypatch.setattr(band_likelihood, "COMPUTING", replace(COMPUTING, band_steps=1))
    assert not most_likely(waves).settled


def climb(start, worse_at):
    """Climb to zero where the cost is x², but far more where it is computed at these calls."""
    calls = iter(range(1000))

    def cost(point):
        value = float(point @ point) + (1e3 if next(calls) in worse_at else 0.0)
        return band_likelihood._Point(point, value, 2.0 * point, 2.0 * np.eye(2), np.eye(2))

    return band_likelihood._most_likely_from(cost, np.array(start))


def test_a_damped_step_that_gains_little_settles_no_search():
    found, settled = climb([1.0, 0.5], worse_at=range(1, 6))
    assert settled
    assert found.value < 0.01
    found, settled = climb([1.0, 0.5], worse_at=range(1, 1000))
    assert not settled
    assert found.value > 1.0


def test_a_search_that_begins_at_its_end_stays_there():
    found, settled = climb([0.0, 0.0], worse_at=())
    assert settled
    assert not found.point.any()
