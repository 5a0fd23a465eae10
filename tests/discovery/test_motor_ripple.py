"""The motor's ripple says whether a joint's sensor or its gear errs."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from pa10cal.discovery.blocked_cv.map_causes import agreement
from pa10cal.discovery.motor_ripple import JointSeries, common_ratio, lines, witnesses

NOISE_RAD = 40e-6
ERROR_RAD = 280e-6
RIPPLE_RAD = 25e-6


def series(
    cause="sensor",
    seed=0,
    *,
    ratio=101.0,
    orders=(10, 20),
    poses=2000,
    ripple_rad=RIPPLE_RAD,
    beta_rad_Nm=0.0,
    still=0.3,
):
    """Return a joint whose sensor or gear errs, read in random poses; to some it did not move."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, 0.8 * np.pi, poses)
    bands = np.arange(6, 27)
    sine, cosine = rng.normal(0.0, ERROR_RAD / np.sqrt(len(bands)), (2, len(bands)))
    error = np.sin(np.outer(q, bands)) @ sine + np.cos(np.outer(q, bands)) @ cosine
    share = {"sensor": 1.0, "gear": 0.0, "both": 0.5, "none": 0.0}[cause]
    torque = rng.normal(0.0, 40.0, poses)
    motor = q + share * error + beta_rad_Nm * torque
    moved = rng.random(poses) > still
    left = rng.normal(0.0, NOISE_RAD, poses)
    for order in orders:
        left += moved * ripple_rad * np.cos(ratio * order * motor + rng.uniform(0.0, 6.0))
    weight = np.full(poses, NOISE_RAD**-2)
    return JointSeries(q, left, weight, error, torque if beta_rad_Nm else 0.0 * q, moved)


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("cause", ["sensor", "gear"])
@pytest.mark.parametrize("ratio", [50.0, 100.0, 121.333, 160.0])
def test_the_ripple_says_who_errs(cause, ratio):
    (found,) = witnesses([[series(cause, ratio=ratio, orders=(8, 20))]], np.array([ratio]))
    assert found.cause == cause
    low, high = found.interval95
    assert low - 0.1 < (cause == "sensor") < high + 0.1
    assert found.orders == (8, 20)
    assert found.ratio == ratio


def test_a_stated_ratio_beyond_all_orders_shows_nothing():
    """As that of a cycloidal drive behind a spur gear."""
    assert witnesses([[series(orders=())]], np.array([5000.0])) == (None,)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    inside = 0
    for seed in range(30):
        (found,) = witnesses([[series("sensor", seed)]], np.array([101.0]))
        inside += found.interval95[0] <= 1.0 <= found.interval95[1]
    assert 25 <= inside <= 30


def test_where_both_err_none_is_named():
    (found,) = witnesses([[series("both", poses=4000)]], np.array([101.0]))
    assert found.cause is None
    assert found.likely is not None
    assert found.excludes_gear
    assert found.excludes_sensor


def test_a_motor_that_follows_far_more_than_the_error_names_no_cause():
    joint = series("sensor", poses=4000)
    (found,) = witnesses([[replace(joint, error_rad=0.6 * joint.error_rad)]], np.array([101.0]))
    assert found.alpha == pytest.approx(1.0 / 0.6, abs=0.1)
    assert found.excludes_gear
    assert (found.cause, found.likely) == (None, None)


def test_without_ripple_there_is_no_witness():
    quiet = [[series("sensor", seed, ripple_rad=0.0)] for seed in range(20)]
    found = [each for joint in quiet for each in witnesses([joint], np.array([101.0]))]
    assert sum(each is not None for each in found) <= 1


def test_what_the_torque_turns_the_motor_by_is_found_beside_it():
    joint = series("sensor", beta_rad_Nm=-12e-6, poses=4000)
    (found,) = witnesses([[joint]], np.array([101.0]))
    assert found.beta_rad_Nm == pytest.approx(-12e-6, abs=3e-6)
    assert found.interval95[0] < 1.0 < found.interval95[1]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("cause", "stated"), [("sensor", np.nan), ("gear", 80.0)])
def test_the_ratio_is_found_by_the_lines_alone_whatever_is_stated(cause, stated):
    joints = [[series(cause, 3, orders=(4, 10))], [series(cause, 4, orders=(10, 21))]]
    found = witnesses(joints, np.full(2, stated))
    assert [each.ratio for each in found] == [101.0, 101.0]
    assert [each.orders for each in found] == [(4, 10), (10, 21)]
    assert [each.cause for each in found] == [cause, cause]


def test_campaigns_of_one_joint_are_one_witness():
    few = [series("sensor", seed, poses=500, ripple_rad=15e-6) for seed in range(4)]
    (together,) = witnesses([few], np.array([101.0]))
    assert together.cause == "sensor"
    alone = [witnesses([[each]], np.array([101.0]))[0] for each in few]
    widths = [np.diff(each.interval95)[0] for each in alone if each is not None]
    assert all(np.diff(together.interval95)[0] < width for width in widths)


def test_a_line_that_shows_where_the_joint_stood_still_is_none_of_the_motor():
    joint = series("none", ripple_rad=0.0, poses=4000)
    every = [100.0 * order for order in (3, 7, 11)]
    left = joint.residual_rad + 30e-6 * np.cos(np.outer(joint.q_rad, every)).sum(axis=1)
    divided = replace(joint, residual_rad=left, torque_Nm=0 * left)
    for stated in (np.nan, 100.0):
        assert witnesses([[divided]], np.array([stated])) == (None,)


def test_lines_of_chance_have_no_common_divisor():
    found = lines([series("sensor", orders=(10, 20))], None, 1)
    assert {round(line.order) for line in found} == {1010, 2020}
    assert common_ratio(found[:1]) is None
    assert common_ratio([]) is None
    # Too few poses say nothing.
    assert witnesses([[series(poses=120)], []], np.array([101.0, 101.0])) == (None, None)


# Campaigns and turns that agree on a joint's error, or do not.

ARC_NOISE_RAD = 1e-4


def turning(low, high, factor=1.0, seed=0, poses=4000):
    rng = np.random.default_rng(seed)
    q = rng.uniform(low, high, poses)
    error = 3e-4 * factor * np.sin(11.0 * q + 0.3)
    left = rng.normal(0.0, ARC_NOISE_RAD, poses)
    weight = np.full(poses, ARC_NOISE_RAD**-2)
    return JointSeries(q, left, weight, error, 0.0 * q, np.ones(poses, dtype=bool))


def test_turns_agree_whatever_noise_takes_of_their_correlation():
    found = agreement([turning(-2.0 * np.pi, 2.0 * np.pi, poses=1500)])
    assert found.arcs > 100
    assert found.correlation == pytest.approx(1.0, abs=0.05)
    assert found.slope == pytest.approx(1.0, abs=0.1)
    assert found.holds


def test_campaigns_are_compared_where_both_were():
    found = agreement([turning(0.0, 2.0, seed=1), turning(1.0, 3.0, 0.8, seed=2)])
    assert 18 <= found.arcs <= 21
    assert found.correlation > 0.9
    assert found.slope == pytest.approx(0.8, abs=0.1)


def test_another_error_does_not_agree():
    one = turning(0.0, 6.0, seed=3)
    other = turning(0.0, 6.0, seed=4)
    shifted = replace(other, error_rad=3e-4 * np.sin(13.0 * other.q_rad))
    assert not agreement([one, shifted]).holds


def test_campaigns_agree_alike_in_any_order_and_less_where_their_errors_differ_in_size():
    three = [turning(0.0, 6.0, factor, seed) for seed, factor in enumerate((0.6, 1.0, 1.5))]
    found = [agreement(order).correlation for order in permutations(three)]
    np.testing.assert_allclose(found, found[0], rtol=1e-9)
    assert found[0] < 0.95
    assert not agreement([turning(0.0, 6.0), turning(0.0, 6.0, 0.4, seed=1)]).holds


def test_one_turn_of_one_campaign_says_nothing():
    assert agreement([turning(0.0, 6.0)]) is None
    assert agreement([]) is None


def test_noise_agrees_on_nothing():
    def noise(seed):
        only_noise = turning(0.0, 3.0, factor=0.0, seed=seed, poses=200)
        return replace(only_noise, error_rad=0.0 * only_noise.q_rad)

    found = [agreement([noise(seed), noise(seed + 1000)]) for seed in range(400)]
    assert sum(each is not None and each.holds for each in found) <= 1
    # Nor does one that shows an error agree with noise, by which its correlation is unsure.
    assert agreement([turning(0.0, 3.0), noise(0)]) is None
