"""Shares of trials with exact intervals, and curves of power."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from drawn_examples import examples
from pa10cal_lab.trial_power import power
from pa10cal_lab.trial_quantities import share_of


@given(st.integers(1, 200), st.data())
@examples(40)
def test_the_interval_is_where_so_many_are_no_longer_plausible(of, data):
    count = data.draw(st.integers(0, of))
    found = share_of([True] * count + [False] * (of - count))
    assert (found["count"], found["reached"]) == (count, count / of)
    assert found["low"] <= count / of <= found["high"]
    if count:
        assert binom.sf(count - 1, of, found["low"]) == pytest.approx(0.025, rel=1e-6)
    if count < of:
        assert binom.cdf(count, of, found["high"]) == pytest.approx(0.025, rel=1e-6)


def test_no_trial_says_nothing():
    assert share_of([]) == {"count": 0, "reached": None, "low": 0.0, "high": 1.0}


def test_two_hundred_without_a_wrong_name_still_leave_almost_two_percent():
    assert 0.015 < share_of([False] * 200)["high"] < 0.02


def test_a_power_curve_is_found_again():
    rng = np.random.default_rng(1)
    size = np.exp(rng.uniform(np.log(0.1), np.log(3.0), 4000))
    chance = 1.0 / (1.0 + np.exp(-(2.0 + 3.0 * np.log(size))))
    curve = power(size, rng.random(len(size)) < chance)
    assert curve.slope == pytest.approx(3.0, rel=0.1)
    assert curve.half == pytest.approx(np.exp(-2.0 / 3.0), rel=0.1)
    assert curve.most == pytest.approx(np.exp((np.log(19.0) - 2.0) / 3.0), rel=0.1)
    assert curve.at(np.array([curve.half]))[0] == pytest.approx(0.5)


def test_a_power_curve_needs_both_outcomes_and_claims_nothing_outside_the_sizes_tried():
    size = np.geomspace(0.1, 3.0, 20)
    assert power(size, np.ones(20, dtype=bool)) is None
    assert power(size, np.zeros(20, dtype=bool)) is None
    assert power(np.zeros(0), np.zeros(0, dtype=bool)) is None
    curve = power(size, size > 2.5)
    assert 1.0 < curve.half < 3.0
    assert curve.most is None
