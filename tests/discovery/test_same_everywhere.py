"""Campaigns and turns that agree on a joint's error, or do not."""

import numpy as np
import pytest

from pa10cal.discovery.motor_ripple import JointSeries, agreement

NOISE_RAD = 1e-4


def series(low, high, factor=1.0, seed=0, poses=4000):
    rng = np.random.default_rng(seed)
    q = rng.uniform(low, high, poses)
    error = 3e-4 * factor * np.sin(11.0 * q + 0.3)
    left = rng.normal(0.0, NOISE_RAD, poses)
    weight = np.full(poses, NOISE_RAD**-2)
    return JointSeries(q, left, weight, error, 0.0 * q, np.ones(poses, dtype=bool))


def test_turns_agree_whatever_noise_takes_of_their_correlation():
    found = agreement([series(-2.0 * np.pi, 2.0 * np.pi, poses=1500)])
    assert found.arcs > 100
    assert found.correlation == pytest.approx(1.0, abs=0.05)
    assert found.slope == pytest.approx(1.0, abs=0.1)
    assert found.holds


def test_campaigns_are_compared_where_both_were():
    found = agreement([series(0.0, 2.0, seed=1), series(1.0, 3.0, 0.8, seed=2)])
    assert 18 <= found.arcs <= 21
    assert found.correlation > 0.9
    assert found.slope == pytest.approx(0.8, abs=0.1)


def test_another_error_does_not_agree():
    one = series(0.0, 6.0, seed=3)
    other = series(0.0, 6.0, seed=4)
    shifted = JointSeries(
        other.q_rad,
        other.left_rad,
        other.weight,
        3e-4 * np.sin(13.0 * other.q_rad),
        other.torque_Nm,
        other.moved,
    )
    assert not agreement([one, shifted]).holds


def test_one_turn_of_one_campaign_says_nothing():
    assert agreement([series(0.0, 6.0)]) is None
    assert agreement([]) is None
