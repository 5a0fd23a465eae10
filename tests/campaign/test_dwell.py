"""Dwells: found between approaches, averaged, with each joint's last real movement."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.campaign.dwells import (
    Samples,
    best_clock_offset,
    find_dwells,
    offset_ranges,
    stations_of,
    while_loaded,
)
from pa10cal.campaign.streams import reading_dwells

STILL = 0.02


def log(time_s, q_deg, tau_Nm=None, temperature_C=None):
    time_s, q_deg = np.asarray(time_s, float), np.asarray(q_deg, float)
    count = len(time_s)
    return Samples(
        line=np.arange(count) + 2,
        time_s=time_s,
        q_deg=q_deg,
        tau_Nm=np.zeros_like(q_deg) if tau_Nm is None else tau_Nm,
        temperature_C=np.full(count, 21.0) if temperature_C is None else temperature_C,
    )


def stops(rate_s, seed=0, noise_deg=2e-4, stays=4):
    """Two joints that go on by a degree and stay for 10 s, again and again; logged throughout."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, stays * 15.0, rate_s)
    within = time_s % 15.0
    done = np.minimum(within / 5.0, 1.0) + time_s // 15.0
    q_deg = np.column_stack([done, -2.0 * done]) + rng.normal(0, noise_deg, (len(time_s), 2))
    return log(time_s, q_deg)


@examples(25)
@given(
    rate_s=st.sampled_from([0.01, 0.05, 0.3, 1.0]),
    noise_deg=st.sampled_from([0.0, 1e-5, 2e-4, 5e-4]),
    seed=st.integers(0, 1000),
)
def test_finds_every_dwell_at_any_rate_and_noise(rate_s, noise_deg, seed):
    dwells = find_dwells(stops(rate_s, seed, noise_deg), STILL)
    assert len(dwells) == 4
    slack = 0.35 + rate_s
    np.testing.assert_allclose(dwells.start_s, 15.0 * np.arange(4) + 5.0, atol=slack)
    np.testing.assert_allclose(dwells.end_s, 15.0 * np.arange(4) + 15.0, atol=slack)
    inside = dwells.at(15.0 * np.arange(4) + 10.0)
    np.testing.assert_array_equal(inside, np.arange(4))
    np.testing.assert_array_equal(dwells.at(np.array([-5.0, 2.0, 17.0, 1e9])), -1)


def test_a_pause_of_the_log_ends_a_dwell_when_the_arm_moved_ever_so_little():
    time_s = np.array([0, 2, 4, 6, 30, 30.4, 30.8, 32, 34, 36])
    q_deg = np.array([0, 0, 0, 0, 0.015, 0.5, 1, 1, 1, 1])[:, None]
    dwells = find_dwells(log(time_s, q_deg), STILL)
    np.testing.assert_array_equal(dwells.end_s, [6, 36])


def test_readings_are_means_with_the_standard_uncertainty_of_the_mean():
    rng = np.random.default_rng(1)
    samples = stops(0.2)
    tau_Nm = rng.normal(5.0, 0.3, samples.q_deg.shape)
    temperature_C = np.linspace(20.0, 22.0, len(samples))
    samples = log(samples.time_s, samples.q_deg, tau_Nm, temperature_C)
    readings = find_dwells(samples, STILL)
    for d in range(len(readings)):
        rows = readings.of_sample == d
        count = readings.samples[d]
        np.testing.assert_allclose(readings.q_deg[d], samples.q_deg[rows].mean(axis=0), rtol=1e-12)
        u = tau_Nm[rows].std(axis=0, ddof=1) / np.sqrt(count)
        np.testing.assert_allclose(readings.tau_u_Nm[d], u, rtol=1e-9)
        np.testing.assert_allclose(readings.temperature_C[d], temperature_C[rows].mean())


def test_a_load_changed_while_the_arm_stands_has_torques_of_its_own():
    """Loads of 0, 22 and 44 N at each place, 4 s each, with 2 s between them."""
    q_deg = np.repeat([[0.0, 0.0], [1.0, -2.0], [2.0, -4.0]], 20, axis=0)
    time_s = np.arange(len(q_deg), dtype=float)
    time_s[20:] += 5.0
    time_s[40:] += 5.0
    within = np.tile(np.arange(20), 3)
    load_N = np.array([0.0, 22.0, 44.0])[np.minimum(within // 6, 2)]
    tau_Nm = -50.0 - np.column_stack([load_N, 0.5 * load_N])
    tau_Nm[within % 6 >= 4] = 1e3  # while the weight is hung on
    samples = log(time_s, q_deg, tau_Nm)
    dwells = find_dwells(samples, STILL)
    assert len(dwells) == 3
    begin_s = (dwells.start_s[:2, None] + [0.0, 6.0, 12.0]).ravel()
    of = np.array([0, 0, 0, 1, 1, 1, 2])  # the last place at one load, twice as long
    begin_s, end_s = np.append(begin_s, dwells.start_s[2]), np.append(begin_s, 1e9) + 3.0
    load_N = np.append(np.tile([0.0, 22.0, 44.0], 2), 0.0)
    stood = while_loaded(samples, dwells, of, load_N, begin_s, end_s)
    np.testing.assert_allclose(stood.tau_Nm[:6, 0], -50.0 - load_N[:6])
    np.testing.assert_array_equal(stood.samples, [4, 4, 4, 4, 4, 4, 20])
    np.testing.assert_allclose(stood.q_deg[:, 0], [0, 0, 0, 1, 1, 1, 2])
    np.testing.assert_array_equal(stood.arrival, dwells.arrival[of])
    np.testing.assert_array_equal(stood.tau_Nm[6], dwells.tau_Nm[2])
    np.testing.assert_allclose(stood.start_s, begin_s)
    np.testing.assert_allclose(stood.end_s[:6], end_s[:6])
    np.testing.assert_allclose(samples.time_s[stood.first], begin_s)
    briefly = while_loaded(samples, dwells, of, load_N, begin_s, begin_s)
    np.testing.assert_array_equal(briefly.samples, [2, 3, 3, 2, 3, 3, 20])  # the nearest ones


@pytest.mark.parametrize(
    ("approach_deg", "arrival"),
    [
        ([[-3.0, 3.0], [-1.0, 1.0]], [1, -1]),
        ([[3.0, 0.0], [-1.0, 0.0]], [1, 0]),  # turned back: the last movement counts
        ([[-1.0, 0.0005], [-0.5, -0.0005]], [1, 0]),  # noise is no movement
        ([[-1.0, 0.01], [-0.5, 0.0]], [1, -1]),  # small but real, and then still
    ],
)
def test_arrival_is_the_sign_of_the_last_real_movement(approach_deg, arrival):
    q_deg = np.vstack([approach_deg, np.zeros((6, 2))])
    time_s = np.concatenate([[-0.8, -0.4], 2.0 * np.arange(6)])
    samples = log(time_s, q_deg)
    readings = find_dwells(samples, STILL)
    np.testing.assert_array_equal(readings.arrival, [arrival])


def test_a_joint_that_came_within_one_interval_of_the_log_arrived_from_there():
    q_deg = np.repeat([0.0, 3.0, 6.0, 10.0, 5.0, 9.0], [10, 1, 1, 10, 10, 10])
    samples = log(np.arange(len(q_deg)), np.column_stack([q_deg, np.full(len(q_deg), 2.0)]))
    dwells = find_dwells(samples, STILL)
    np.testing.assert_array_equal(dwells.arrival.T, [[0, 1, -1, 1], [0, 0, 0, 0]])


def test_without_an_approach_the_arrival_is_zero():
    samples = log(np.arange(5.0), np.zeros((5, 2)))
    readings = find_dwells(samples, STILL)
    np.testing.assert_array_equal(readings.arrival, [[0, 0]])


@examples(25)
@given(offset=st.one_of(st.floats(-3000, 3000), st.floats(1e9, 2e9)))
def test_finds_a_clock_offset_to_within_the_slack_of_the_dwells(offset):
    rng = np.random.default_rng(2)
    samples = stops(0.2, stays=12)
    dwells = find_dwells(samples, STILL)
    gaps = rng.permutation(12)[:9]
    touches = np.sort(np.concatenate([15.0 * gaps + 7.0 + k for k in range(6)]))
    offset_s, inside = best_clock_offset(touches - offset, dwells)
    assert offset_s == pytest.approx(offset, abs=2.5)
    assert inside == 1.0


def six_stands(rate_s, ways, noise, seed=0):
    """Times and positions: six stands of 10 s, after 5 s each on the way, in every column."""
    time_s = np.arange(0.0, 90.0, rate_s)
    done = np.minimum(time_s % 15.0 / 5.0, 1.0) + time_s // 15.0
    rng = np.random.default_rng(seed)
    return time_s, done[:, None] * ways + rng.normal(0, noise, (len(time_s), len(ways)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise_mm", [0.05, 0.2])
def test_a_distance_that_scatters_stays_within_its_stand(noise_mm, seed):
    time_s, p_mm = six_stands(0.05, [50.0], noise_mm, seed)
    assert len(reading_dwells(time_s, p_mm)) == 6


@pytest.mark.parametrize(
    ("rate_s", "noise_deg"),
    [(0.1, [0.002]), (0.1, [0.01]), (0.1, [1e-5, 1e-5, 1e-5, 0.01]), (0.002, [0.002])],
)
def test_the_joint_that_scatters_most_does_not_part_a_stand(rate_s, noise_deg):
    time_s, q_deg = six_stands(rate_s, np.full(len(noise_deg), 10.0), noise_deg)
    assert len(stations_of(log(time_s, q_deg), 6, STILL)) == 6


def test_samples_seconds_apart_scatter_as_much_as_others():
    time_s, q_deg = six_stands(0.1, np.full(3, 10.0), 0.01)
    assert len(stations_of(log(50.0 * time_s, q_deg), 6, STILL)) == 6


@pytest.mark.parametrize("rate_s", [0.1, 0.01, 0.002])
@pytest.mark.parametrize("step_deg", [0.005, 0.01, 0.05])
@pytest.mark.parametrize("noise_deg", [0.001, 0.005])
def test_a_last_digit_that_goes_there_and_back_is_no_movement(rate_s, step_deg, noise_deg):
    time_s, q_deg = six_stands(rate_s, np.array([10.0, 0.0, -7.0]), noise_deg)
    q_deg[:, 1] += 5.0035
    samples = log(time_s, step_deg * np.round(q_deg / step_deg))
    stations = stations_of(samples, 6, STILL)
    assert len(stations) == 6
    np.testing.assert_array_equal(stations.arrival[1:], np.tile([1.0, 0.0, -1.0], (5, 1)))


def test_poses_in_turn_are_no_rounding():
    """Two joints on a grid of commands, without noise, logged three times a pose."""
    q_deg = np.repeat([[a, b] for a in (0.0, 45.0, 90.0) for b in (0.0, 45.0) * 2], 3, axis=0)
    assert len(stations_of(log(np.arange(len(q_deg)), q_deg), 12, STILL)) == 12


def test_without_samples_or_times_there_is_nothing():
    none = stations_of(log(np.zeros(0), np.zeros((0, 2))), 0, STILL)
    assert len(none) == 0
    assert offset_ranges(none, np.arange(3.0)) == []
    assert offset_ranges(find_dwells(stops(0.2), STILL), np.zeros(0)) == []
