"""Feasible intervals of roll against a scan of all rolls."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.curve.roll import RollMap, feasible_rolls, joint_limits
from pa10cal.errors import CurveError

ROLLS = np.linspace(0.0, 2.0 * np.pi, 1441)[:-1] + 1e-4


def within(intervals, rolls):
    inside = np.zeros(len(rolls), dtype=bool)
    for begin, end in intervals:
        for turn in (0.0, 2.0 * np.pi):
            inside |= (begin < rolls + turn) & (rolls + turn < end)
    return inside


@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.sampled_from(["zy", "yz"]),
    bend=st.sampled_from([1e-8, 0.5, 1.5, 3.1]),
    n=st.integers(1, 8),
    width=st.floats(0.2, 3.2),
)
@settings(max_examples=250, deadline=None)
def test_exactly_the_rolls_that_keep_the_limits(random_directions, seed, order, bend, n, width):
    random = np.random.default_rng(seed)
    chain = RollMap.of(random_directions(seed, n, bend), order)
    # Limits about zero, aside of it and beyond half a turn.
    centre = random.uniform(-1.0, 1.0, (2, n - 1)) * random.choice([0.0, 0.3, 2.0])
    limits = joint_limits(*(np.stack([c - width, c + width], axis=1) for c in centre), n - 1)
    a_rad, b_rad = chain.angles(ROLLS)
    turns = np.stack([a_rad, b_rad], axis=1)
    room = np.minimum(turns - limits[:, 0], limits[:, 1] - turns).min(axis=(1, 2), initial=9)
    intervals = feasible_rolls(chain, limits)
    clear = np.abs(room) > 1e-9
    np.testing.assert_array_equal(within(intervals, ROLLS)[clear], (room > 0)[clear])
    assert (intervals[:, 0] >= 0.0).all()
    assert (intervals[:, 0] < 2.0 * np.pi).all()
    assert (intervals[:, 1] > intervals[:, 0]).all()


def test_one_bend_in_closed_form():
    """A bend of 1 with the second turn within 0.5: sin(0.5) > sin(1) |sin(roll)|."""
    u = np.array([[1.0, 0, 0], [np.cos(1.0), np.sin(1.0), 0.0]])
    limits = joint_limits([-2.0, 2.0], [-0.5, 0.5], 1)
    edge = np.arcsin(np.sin(0.5) / np.sin(1.0))
    found = feasible_rolls(RollMap.of(u), limits)
    expected = [[np.pi - edge, np.pi + edge], [2 * np.pi - edge, 2 * np.pi + edge]]
    np.testing.assert_allclose(found[np.argsort(found[:, 0])], expected, atol=1e-14)


def test_a_straight_chain_may_roll_to_anywhere_within_limits_about_zero():
    chain = RollMap.of(np.tile([0.0, 0.0, 1.0], (5, 1)))
    assert feasible_rolls(chain, joint_limits([0.0, 0.0], [0.0, 0.0], 4)).tolist() == [
        [0.0, 2 * np.pi]
    ]
    assert not len(feasible_rolls(chain, joint_limits([0.1, 0.2], [0.1, 0.2], 4)))


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            lambda: joint_limits([0.1, -0.1], [0.1, -0.1], 2),
            r"joint 1: the limits of a are invalid .*0.1, -0.1",
        ),
        (lambda: joint_limits([0, 0], [0, np.nan], 1), "the limits of b"),
        (
            lambda: joint_limits(*np.zeros((2, 5, 2)), 2),
            "limits: the limits are of another chain .*5 of a, 5 of b.*; allowed: 2 each",
        ),
    ],
)
def test_limits_that_are_none_are_refused(limits, message):
    with pytest.raises(CurveError, match=message):
        limits()
