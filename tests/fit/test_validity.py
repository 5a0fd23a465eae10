"""Angles that the poses of a fit have seen, by laws, and poses that would show others."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.fit.validity import angles_seen
from pa10cal.rules import ANGLES

TURN = 2.0 * np.pi


def counted(angle, around):
    """How many angles lie close by, on the circle."""
    apart = np.abs(np.mod(around - angle + np.pi, TURN) - np.pi)
    return int(np.sum(apart <= ANGLES.within_rad))


@examples(60)
@given(
    st.lists(st.floats(-7.0, 7.0), min_size=6, max_size=60),
    st.lists(st.floats(-7.0, 7.0), min_size=1, max_size=20),
)
def test_an_angle_is_seen_where_enough_poses_lie_close_by(poses, asked):
    # Gathered, so that some angles are seen at all.
    around = np.concatenate([np.array(poses) / 10.0, np.array(poses)])
    seen = angles_seen(around[:, None], np.array([ANGLES.fine_order]))
    for angle in asked:
        wanted = counted(angle, around) >= ANGLES.least_poses
        edge = any(
            counted(angle + nudge, around) != counted(angle, around) for nudge in (-1e-9, 1e-9)
        )
        if not edge:
            assert seen.inside(np.array([[angle]]))[0] == wanted


@examples(30)
@given(st.integers(-3, 3), st.floats(-3.0, 3.0))
def test_whole_turns_make_no_difference(turns, angle):
    around = np.linspace(-0.1, 0.4, 200)
    seen = angles_seen(around[:, None], np.array([ANGLES.fine_order]))
    here, there = (seen.inside(np.array([[a]]))[0] for a in (angle, angle + turns * TURN))
    assert here == there or counted(angle, around) == ANGLES.least_poses


def test_all_joints_must_keep_to_what_was_seen():
    q_rad = np.column_stack([np.linspace(0.0, 1.0, 300), np.linspace(-0.1, 0.1, 300)])
    seen = angles_seen(q_rad, np.full(2, ANGLES.fine_order))
    asked = np.array([[0.5, 0.0], [0.5, 0.5], [1.5, 0.0], [0.5 + TURN, -TURN]])
    assert seen.inside(asked).tolist() == [True, False, False, True]
    assert seen.covers(asked)[1].tolist() == [True, False]


def test_a_sliding_joint_has_seen_its_span():
    q = np.array([[0.2], [0.5]])
    seen = angles_seen(q, np.zeros(1))
    assert seen.inside(np.array([[0.1], [0.2], [0.4], [0.6]])).tolist() == [
        False,
        True,
        True,
        False,
    ]


def test_too_few_poses_have_seen_nothing():
    seen = angles_seen(np.zeros((ANGLES.least_poses - 1, 1)), np.array([ANGLES.fine_order]))
    assert not seen.inside(np.zeros((1, 1)))[0]


def test_coarser_maps_have_learnt_from_poses_farther_apart_and_no_map_from_the_span():
    q_rad = np.tile(np.radians(np.arange(0.0, 60.0, 2.0))[:, None], (1, 3))
    seen = angles_seen(q_rad, np.array([ANGLES.fine_order, 5.0, 0.0]))
    between = np.radians([[30.5, 30.5, 30.5], [30.5, 62.0, 30.5], [30.5, 30.5, 62.0]])
    assert seen.covers(between).tolist() == [
        [False, True, True],
        [False, False, True],
        [False, True, False],
    ]
