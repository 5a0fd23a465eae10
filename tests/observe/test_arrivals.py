"""Directions of arrival that the order of poses gives."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.arm.statics import PoseStates
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import reversed_joints, with_arrivals
from pa10cal.observe.points import Distance


def observed(q1, q2, s1=0.0):
    """Return readings of an arm of two joints, ten seconds apart."""
    count = len(q1)
    zeros = np.zeros(count)
    states = PoseStates(
        q_rad=np.column_stack([q1, q2]),
        tau_Nm=np.zeros((count, 2)),
        arrival=np.column_stack([np.broadcast_to(s1, count), zeros]).astype(float),
        load_N=zeros,
        temperature_C=zeros,
        time_s=10.0 * np.arange(count),
    )
    labels = np.array([f"P{k}" for k in range(count)], dtype=str)
    return Observations.single(labels, states, Distance(zeros, zeros))


def test_a_joint_arrives_from_where_it_stood_before():
    found, from_order = with_arrivals(observed([0.0, 0.5, 0.3, 0.7], [0.1, 0.0, 0.2, 0.1]))
    assert from_order
    assert found.states.arrival.T.tolist() == [[0, 1, -1, 1], [0, -1, 1, -1]]


def test_one_that_stays_keeps_its_last_direction():
    found, _ = with_arrivals(observed([0.0, 0.5, 0.50001, 0.5, 0.2], [0.0] * 5))
    assert found.states.arrival.T.tolist() == [[0, 1, 1, 1, -1], [0] * 5]


def test_which_joints_moved_is_told_apart():
    found, _ = with_arrivals(observed([0.0, 0.5, 0.5005, 0.3, 0.2], [0.0] * 5))
    assert found.states.arrival[:, 0].tolist() == [0, 1, 1, -1, -1]
    assert found.states.moved.T.tolist() == [[0, 1, 0, -1, -1], [0] * 5]
    assert found.states.since_before is found.states.moved


def test_campaigns_of_a_group_begin_anew_and_their_directions_are_kept():
    q = [0.0, 0.5, 0.5005, 0.3]
    alone, _ = with_arrivals(observed(q, [0.0] * 4))
    twice = observed(q + q, [0.0] * 8)
    campaign = np.repeat([0, 1], 4)
    told = np.concatenate([alone.states.arrival] * 2)
    grouped = twice.with_states(replace(twice.states, campaign=campaign, arrival=told))
    found, from_order = with_arrivals(grouped)
    assert not from_order
    assert found.states.arrival is told
    assert found.states.moved[:, 0].tolist() == [0, 1, 0, -1] * 2


def test_time_decides_whatever_the_order_of_rows():
    rows = observed([0.0, 0.5, 0.3, 0.7], [0.0] * 4).take(np.array([2, 0, 3, 1]))
    found, _ = with_arrivals(rows)
    assert found.pose.tolist() == rows.pose.tolist()
    assert found.states.arrival[[1, 3, 0, 2], 0].tolist() == [0, 1, -1, 1]


def test_what_was_logged_is_left_alone():
    logged = observed([0.0, 0.5, 0.3], [0.0] * 3, s1=[0, -1, 0])
    found, from_order = with_arrivals(logged)
    assert not from_order
    assert found is logged


def test_no_readings_stay_as_they_are():
    assert with_arrivals(observed([], []))[1] is False


def test_times_that_readings_share_give_no_order():
    rows = observed([0.0, 0.5, 0.3, 0.7], [0.0] * 4)
    timeless = rows.with_states(replace(rows.states, time_s=np.zeros(4)))
    found, from_order = with_arrivals(timeless)
    assert not from_order
    assert not found.states.arrival.any()


def many_arrivals(*, wrong):
    """Three joints that come from where they stood; of those given, all are logged reversed."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 3))
    rows = observed(q[:, 0], q[:, 1])
    states = replace(rows.states, q_rad=q, tau_Nm=np.zeros_like(q), arrival=np.zeros_like(q))
    right = with_arrivals(rows.with_states(states))[0].states.arrival
    side = np.where(np.isin(np.arange(3), wrong), -1.0, 1.0)
    return rows.with_states(replace(states, arrival=right * side)), right


def test_a_joint_that_is_always_logged_from_the_other_side_is_put_right():
    logged, right = many_arrivals(wrong=[1])
    assert reversed_joints(logged).tolist() == [False, True, False]
    found, from_order = with_arrivals(logged)
    assert not from_order
    np.testing.assert_array_equal(found.states.arrival, right)


@pytest.mark.parametrize("wrong", [[], [0, 1], [0, 1, 2]])
def test_most_joints_must_arrive_from_where_they_stood(wrong):
    logged, _ = many_arrivals(wrong=wrong)
    assert not reversed_joints(logged).any()
