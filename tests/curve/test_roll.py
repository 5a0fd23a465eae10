"""The best roll of all, and the feasible ones, against a scan of them."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.errors import CurveError
from pa10cal_curve.angles import first_axes, joint_angles
from pa10cal_curve.roll import (
    RollMap,
    feasible_rolls,
    joint_limits,
    most_room,
    roll_for_last,
    room_at,
    smallest_move,
)

ROLLS = np.linspace(0.0, 2.0 * np.pi, 2881)
EXAMPLES = examples(40)
SEEDS = st.integers(0, 2**32 - 1)
ORDERS = st.sampled_from(["zy", "yz"])
BENDS = st.sampled_from([0.4, 1.5, 3.0])


def largest(chain, rolls, a0=0.0, b0=0.0):
    a_rad, b_rad = chain.angles(np.atleast_1d(rolls))
    return np.maximum(np.abs(a_rad - a0), np.abs(b_rad - b0)).max(axis=1)


def room(chain, rolls, limits):
    turns = np.stack(chain.angles(np.atleast_1d(rolls)), axis=1)
    return np.minimum(turns - limits[:, 0], limits[:, 1] - turns).min(axis=(1, 2))


@given(seed=SEEDS, order=ORDERS, bend=BENDS, n=st.integers(2, 12))
@EXAMPLES
def test_no_roll_has_a_smaller_largest_angle(random_directions, seed, order, bend, n):
    chain = RollMap.of(random_directions(seed, n, bend), order)
    best = smallest_move(chain)
    assert best.level_rad <= largest(chain, ROLLS).min() + 1e-9
    assert largest(chain, best.roll_rad)[0] == pytest.approx(best.level_rad, abs=1e-7)


def test_on_an_arc_the_smallest_largest_angle_shares_the_bend_between_both_axes():
    """One bend of 0.6: cos a cos b = cos 0.6, and a and b alike in size at their best."""
    u = np.array([[1.0, 0, 0], [np.cos(0.6), np.sin(0.6), 0]])
    best = smallest_move(RollMap.of(u))
    a_rad, b_rad = RollMap.of(u).angles(np.array([best.roll_rad]))
    assert abs(a_rad[0, 0]) == pytest.approx(abs(b_rad[0, 0]), abs=1e-9)
    assert np.cos(a_rad[0, 0]) * np.cos(b_rad[0, 0]) == pytest.approx(np.cos(0.6))


@given(seed=SEEDS, order=ORDERS, bend=BENDS, n=st.integers(2, 10), aside=st.floats(-0.5, 0.5))
@EXAMPLES
def test_no_roll_leaves_more_room(random_directions, seed, order, bend, n, aside):
    chain = RollMap.of(random_directions(seed, n, bend), order)
    limits = joint_limits(*[[aside - 3.5, aside + 3.7]] * 2, n - 1)
    best = most_room(chain, limits)
    assert best.level_rad >= room(chain, ROLLS, limits).max() - 1e-9
    assert room(chain, best.roll_rad, limits)[0] == pytest.approx(best.level_rad, abs=1e-7)
    assert room_at(chain, best.roll_rad, limits).level_rad == pytest.approx(
        best.level_rad, abs=1e-7
    )


@pytest.mark.slow
@given(seed=SEEDS, order=ORDERS, n=st.integers(2, 10), limit=st.floats(0.05, 0.6))
@EXAMPLES
def test_limits_that_no_roll_keeps_name_the_joint_and_by_how_much(
    random_directions, seed, order, n, limit
):
    chain = RollMap.of(random_directions(seed, n, 1.4), order)
    limits = joint_limits(*[[-limit, limit]] * 2, n - 1)
    beyond = largest(chain, ROLLS).min() - limit
    assume(beyond > 1e-3)
    with pytest.raises(CurveError, match=r"^joint \d+: no roll keeps .* degrees beyond") as caught:
        most_room(chain, limits)
    with pytest.raises(CurveError, match="no roll keeps"):
        smallest_move(chain, limits=limits)
    said = float(str(caught.value).split(" is ")[1].split()[0])
    assert said == pytest.approx(np.degrees(beyond), rel=0.1, abs=0.3)
    assert not len(feasible_rolls(chain, limits))


def test_limits_kept_at_single_rolls_only_are_kept():
    heading = np.array([0.0, 0.3, 0.1, 0.6])
    u = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    limits = joint_limits([-1.0, 1.0], [0.0, 0.0], 3)
    best = smallest_move(RollMap.of(u), limits=limits)
    assert np.sin(best.roll_rad) == pytest.approx(0.0, abs=1e-8)
    assert best.level_rad == pytest.approx(0.5, abs=1e-8)


def test_a_roll_given_that_does_not_keep_the_limits_is_refused():
    u = np.array([[1.0, 0, 0], [np.cos(0.6), np.sin(0.6), 0]])
    limits = joint_limits([-0.5, 0.5], [-0.5, 0.5], 1)
    assert room_at(RollMap.of(u), 0.8, limits).level_rad > 0.0
    with pytest.raises(CurveError, match=r"joint 1: this roll does not keep .*: a is 5.73 degrees"):
        room_at(RollMap.of(u), 0.0, limits)


@pytest.mark.slow
@given(seed=SEEDS, order=ORDERS, bend=st.sampled_from([0.4, 1.3]), n=st.integers(2, 10))
@EXAMPLES
def test_no_roll_moves_less_from_the_last_shape(random_directions, seed, order, bend, n):
    random = np.random.default_rng(seed)
    u = random_directions(seed, n, bend)
    last = joint_angles(u, first_axes(u, random.uniform(0, 6)), order)
    moved = u + random.normal(scale=0.05, size=u.shape)
    chain = RollMap.of(moved / np.linalg.norm(moved, axis=1)[:, None], order)
    best = smallest_move(chain, last.turns_rad)
    moves = largest(chain, ROLLS, last.a_rad, last.b_rad)
    assert best.level_rad <= moves.min() + 1e-9
    far = best.level_rad + 0.2
    near = smallest_move(chain, last.turns_rad, move_rad=far)
    assert largest(chain, near.roll_rad, last.a_rad, last.b_rad)[0] <= far + 1e-9
    assert near.level_rad <= largest(chain, ROLLS)[moves <= far].min(initial=9.0) + 1e-9
    stays = smallest_move(chain, last.turns_rad, move_rad=best.level_rad / 2.0)
    assert stays == best


@given(seed=SEEDS, order=ORDERS, n=st.integers(1, 8))
@EXAMPLES
def test_the_last_link_has_the_roll_wanted(random_directions, seed, order, n):
    u = random_directions(seed, n, 0.8)
    wanted = np.random.default_rng(seed + 1).normal(size=3)
    found = roll_for_last(RollMap.of(u, order), wanted)
    z = joint_angles(u, first_axes(u, found.roll_rad), order).axes[-1, :, 2]
    off = wanted - (wanted @ u[-1]) * u[-1]
    np.testing.assert_allclose(z, off / np.linalg.norm(off), atol=1e-8)
    assert np.cos(found.level_rad) == pytest.approx(z @ wanted / np.linalg.norm(wanted))


@pytest.mark.parametrize("wanted", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
def test_a_direction_along_the_last_link_is_none(wanted):
    chain = RollMap.of(np.array([[0.0, 1, 0], [1, 0, 0]]))
    with pytest.raises(CurveError, match="parallel to the link"):
        roll_for_last(chain, np.array(wanted))


# Joint angles as a function of roll, against the frames carried link by link.


@given(seed=SEEDS, order=ORDERS, bend=st.sampled_from([1e-7, 0.5, 1.5, 3.1]), n=st.integers(1, 40))
@examples(60)
def test_all_rolls_at_once_are_each_carried_along(random_directions, seed, order, bend, n):
    u = random_directions(seed, n, bend)
    chain = RollMap.of(u, order)
    rolls = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    a_rad, b_rad = chain.angles(rolls)
    for k, roll in enumerate(rolls):
        joints = joint_angles(u, first_axes(u, roll), order)
        # Where sharp bends forget the roll, rounding of it is forgotten too, but for a few rolls.
        np.testing.assert_allclose(np.sin(a_rad[k]), np.sin(joints.a_rad), atol=1e-6)
        np.testing.assert_allclose(np.sin(b_rad[k]), np.sin(joints.b_rad), atol=1e-6)


def test_a_bent_chain_forgets_the_roll_by_the_cosine_of_each_bend():
    """In a plane: the tangent of the angle from its normal shrinks by the cosine, link by link."""
    heading = 0.4 * np.arange(12)
    u = np.stack([np.cos(heading), np.sin(heading), np.zeros(12)], axis=1)
    joints = joint_angles(u, first_axes(u, 0.9))
    tilt = np.tan(np.arccos(joints.axes[:, 2, 2]))
    np.testing.assert_allclose(tilt, np.tan(0.9) * np.cos(0.4) ** np.arange(12), rtol=1e-9)
    singular = np.linalg.svd(RollMap.of(u).maps[-1])[1]
    assert singular[1] / singular[0] == pytest.approx(np.cos(0.4) ** 11)


# Feasible intervals of roll against a scan of all rolls.


SCAN = np.linspace(0.0, 2.0 * np.pi, 1441)[:-1] + 1e-4


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
@examples(250)
def test_exactly_the_rolls_that_keep_the_limits(random_directions, seed, order, bend, n, width):
    random = np.random.default_rng(seed)
    chain = RollMap.of(random_directions(seed, n, bend), order)
    # Limits about zero, aside of it and beyond half a turn.
    centre = random.uniform(-1.0, 1.0, (2, n - 1)) * random.choice([0.0, 0.3, 2.0])
    limits = np.stack([centre - width, centre + width], axis=1)
    a_rad, b_rad = chain.angles(SCAN)
    turns = np.stack([a_rad, b_rad], axis=1)
    room = np.minimum(turns - limits[:, 0], limits[:, 1] - turns).min(axis=(1, 2), initial=9)
    intervals = feasible_rolls(chain, limits)
    clear = np.abs(room) > 1e-9
    np.testing.assert_array_equal(within(intervals, SCAN)[clear], (room > 0)[clear])
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
            r"limits: the limits of a are invalid \(got '5.7\d* to -5.7\d* degrees'\)",
        ),
        (lambda: joint_limits([0, 0], [0, np.nan], 1), "the limits of b"),
    ],
)
def test_limits_that_are_none_are_refused(limits, message):
    with pytest.raises(CurveError, match=message):
        limits()
