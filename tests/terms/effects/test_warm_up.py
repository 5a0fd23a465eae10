"""Joints and links that warm up: their course in time, and what holds in the warm arm."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.effects.warm_up import warm_ups

ARM = load_arm("pa10_6ce")
START_S, TAU_S, AMOUNT = 50.0, 800.0, 2e-4
X = np.array([AMOUNT, TAU_S])


@pytest.fixture
def effects():
    return warm_ups(context_of(ARM, time_span_s=(START_S, 1e4)))


def at_times(times_s):
    states = states_of(ARM)
    return replace(states, time_s=np.resize(times_s, len(states)))


def test_every_joint_and_long_link_may_warm_up_and_none_is_sought(effects):
    joints = [f"joint {joint}" for joint in range(1, 7)]
    assert [effect.of for effect in effects] == [*joints, "upper_arm", "forearm"]
    assert not {"warm_up", "link_warm_up"} & {each.id for each in candidates(context_of(ARM))}
    assert warm_ups(context_of(ARM, time_span_s=(7.0, 7.0))) == ()


def test_what_is_missing_yet_vanishes_by_a_lag_of_first_order(effects):
    times_s = np.array([START_S, START_S + TAU_S, START_S + 50 * TAU_S, START_S - 9.0, np.nan])
    missing = np.array([1.0, np.exp(-1.0), 0.0, 1.0, 0.0])  # a pose without a time is warm
    for effect in effects:
        size = np.linalg.norm(effect.shift(at_times(times_s), X), axis=1)
        np.testing.assert_allclose(size, AMOUNT * np.resize(missing, len(size)), atol=1e-15)


def test_derivatives_are_those_of_the_shift(effects):
    states = at_times(np.linspace(START_S, 5 * TAU_S, 7))
    for effect in effects:
        found = effect.derivative(states, X)
        for k, step in enumerate((1e-6, 1.0)):
            ahead, behind = X.copy(), X.copy()
            ahead[k], behind[k] = X[k] + step, X[k] - step
            wanted = (effect.shift(states, ahead) - effect.shift(states, behind)) / (2 * step)
            np.testing.assert_allclose(found[:, :, k], wanted, atol=1e-12)


def test_it_is_not_known_where_rows_tell_no_time(effects):
    untimed = replace(at_times([0.0]), timed=np.zeros(len(states_of(ARM)), dtype=bool))
    with pytest.raises(CalibrationError, match="time was not recorded"):
        effects[0].shift(untimed, X)


def test_a_formula_has_unix_times_in_full():
    """With six digits it would be off by an hour."""
    span_s = (1764774322.5, 1764784322.25)
    context = context_of(ARM, time_span_s=span_s)
    for effect in (*warm_ups(context), BaseDrift("base", *span_s, waves=2)):
        assert "(time_s - 1764774322.5)" in effect.formula
    assert effect.formula.endswith("9999.75), time_s held at 1764774322.5 and 1764784322.25")


def test_the_shortest_time_constant_sought_is_within_the_bounds_of_its_fit():
    """As in a campaign of a week."""
    span_s = 6e5
    for effect in warm_ups(context_of(ARM, time_span_s=(0.0, span_s))):
        sought = replace(effect, tau_s=300.0)
        assert sought.varies_with == "time"
        assert sought.tau.lower <= 300.0
        assert effect.tau.lower == pytest.approx(1e-3 * span_s)
