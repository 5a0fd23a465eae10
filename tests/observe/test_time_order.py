"""Rows are not time where they follow a joint, a rail or the load."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from made_up_poses import at_rest
from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm
from pa10cal.observe.arrivals import end_travel, move_shares, reversed_joints, with_arrivals
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Distance
from pa10cal.observe.time_order import (
    Covariate,
    at_one_end,
    confounded_with_time,
    covariates,
    like_a_scan,
    may_show_changes,
    measured_again,
    slow_joints,
    sorted_rows,
    step_thresholds,
    with_place_labels,
    with_time_validity,
)

ROWS, JOINTS = 120, 4
NONE_SLIDES = np.zeros(JOINTS, dtype=bool)


class Unmeasured:
    """Readings of nothing: the order of rows is all that counts."""

    campaigns = ()

    def take(self, rows):
        del rows
        return self


@pytest.fixture
def random_order():
    """Poses in random order under three loads, each pose read once."""
    rng = np.random.default_rng(7)
    states = at_rest(
        rng.uniform(-2.0, 2.0, (ROWS, JOINTS)),
        load_N=rng.choice([0.0, 20.0, 44.0], ROWS),
        temperature_C=np.full(ROWS, 20.0),
        time_s=10.0 * np.arange(ROWS),
    )
    labels = np.array([f"P{k:03d}" for k in range(ROWS)])
    return Observations.single(labels, states, Unmeasured())


def in_order_of(every, key):
    """Return the same rows, measured in the order of a key."""
    order = np.argsort(key, kind="stable")
    q_rad, load_N = every.states.q_rad[order], every.states.load_N[order]
    return every.with_states(replace(every.states, q_rad=q_rad, load_N=load_N))


def ordered(every, by):
    key = {
        "joint": every.states.q_rad[:, 2],
        "joint backwards": -every.states.q_rad[:, 2],
        "load": every.states.load_N,
        "nearly the joint": every.states.q_rad[:, 2]
        + np.random.default_rng(1).normal(0.0, 0.2, len(every)),
    }[by]
    return in_order_of(every, key)


@pytest.mark.parametrize(
    ("by", "driver"),
    [
        ("joint", "joint 3"),
        ("joint backwards", "joint 3"),
        ("nearly the joint", "joint 3"),
        ("load", "the load"),
    ],
)
def test_rows_that_follow_a_joint_or_the_load_give_no_time(random_order, by, driver):
    every = ordered(random_order, by)
    assert [str(found) for found, _ in confounded_with_time(every)] == [driver]
    marked, (why,) = with_time_validity(every, NONE_SLIDES, recorded=True)
    assert driver in why
    assert not marked.states.tells_time


def test_rows_in_random_order_give_time_where_it_was_recorded(random_order):
    assert confounded_with_time(random_order) == ()
    same, why = with_time_validity(random_order, NONE_SLIDES, recorded=True)
    assert same is random_order
    assert why == ()
    marked, (why,) = with_time_validity(random_order, NONE_SLIDES, recorded=False)
    assert "not recorded" in why
    assert not marked.states.tells_time
    assert not marked.take(np.arange(5)).states.tells_time


@pytest.mark.parametrize("share", [0.5, 0.51, 0.6])
def test_a_rail_that_goes_once_from_one_station_to_the_other_is_followed(random_order, share):
    q = random_order.states.q_rad.copy()
    q[:, 0] = np.arange(ROWS) >= share * ROWS
    every = random_order.with_states(replace(random_order.states, q_rad=q))
    assert [str(found) for found, _ in confounded_with_time(every)] == ["joint 1"]
    assert slow_joints(every.states).tolist() == [True, False, False, False]
    # In random order it goes with nothing.
    q[:, 0] = np.random.default_rng(3).permutation(q[:, 0])
    every = random_order.with_states(replace(random_order.states, q_rad=q))
    assert not confounded_with_time(every)
    assert not slow_joints(every.states).any()


def test_readings_repeated_at_each_pose_make_no_joint_slow(random_order):
    rows = np.repeat(np.arange(ROWS), 3)
    states = random_order.states.take(rows)
    states = replace(states, time_s=np.arange(3.0 * ROWS))
    assert not slow_joints(states).any()
    q = states.q_rad.copy()
    q[:, 1] = np.sin(1e-2 * rows)
    assert slow_joints(replace(states, q_rad=q)).tolist() == [False, True, False, False]
    # An arm that creeps stands nowhere.
    q = np.linspace(0.0, 1e-3, 3 * ROWS)[:, None] * np.ones(JOINTS)
    assert slow_joints(replace(states, q_rad=q)).all()


def test_a_few_rows_at_another_station_are_no_order(random_order):
    q = random_order.states.q_rad.copy()
    q[:, 0] = np.arange(ROWS) >= ROWS - 10
    assert not confounded_with_time(random_order.with_states(replace(random_order.states, q_rad=q)))


def test_a_joint_that_creeps_by_a_microradian_stands_still(random_order):
    q = random_order.states.q_rad.copy()
    q[:, 0] = np.linspace(0.0, 1e-6, ROWS)
    states = replace(random_order.states, q_rad=q)
    assert not confounded_with_time(random_order.with_states(states))
    assert [each.joint for each in covariates(states)] == [2, 3, 4, None]


def test_a_joint_that_slides_is_called_so(random_order):
    slides = np.array([False, False, True, False])
    (found, _), *_ = confounded_with_time(ordered(random_order, "joint"), slides)
    assert str(found) == "joint 3 (sliding)"


def test_poses_that_are_measured_again_give_time_in_any_order(random_order):
    half = ordered(random_order.take(np.arange(ROWS // 2)), "joint")
    twice = half.take(np.tile(np.arange(ROWS // 2), 2))
    later = replace(twice.states, time_s=10.0 * np.arange(ROWS))
    assert confounded_with_time(twice.with_states(later)) == ()
    # Read again at once they are no other time.
    at_once = half.take(np.repeat(np.arange(ROWS // 2), 2))
    same = replace(at_once.states, time_s=10.0 * np.arange(ROWS))
    assert confounded_with_time(at_once.with_states(same)) != ()


def test_a_scan_shows_changes_once_it_is_gone_through_again(random_order):
    """As of one joint at a time, there and back."""
    half = random_order.take(np.arange(ROWS // 2))
    once = at_rest(np.arange(ROWS // 2)[:, None] * np.full(JOINTS, 0.02))
    half = half.with_states(replace(once, time_s=10.0 * np.arange(ROWS // 2)))
    there_and_back = half.take(np.r_[np.arange(ROWS // 2), np.arange(ROWS // 2)[::-1]])
    states = replace(there_and_back.states, time_s=10.0 * np.arange(ROWS))
    there_and_back = there_and_back.with_states(states)
    assert like_a_scan(half)
    assert like_a_scan(there_and_back)
    assert not may_show_changes(half)
    assert may_show_changes(there_and_back)


def test_places_that_are_visited_again_give_time_whatever_their_labels(random_order):
    q_rad = random_order.states.q_rad.copy()
    q_rad[ROWS // 2 :] = q_rad[: ROWS // 2] + 1e-4
    states = replace(random_order.states, q_rad=q_rad)
    every = random_order.with_states(replace(states, load_N=np.zeros(ROWS)))
    assert len(np.unique(with_place_labels(every).pose)) == ROWS // 2
    assert measured_again(every)
    assert not measured_again(random_order)
    # Rows that creep along are no places visited again, however near neighbours are.
    creeping = np.linspace(0.0, 0.05, ROWS)[:, None] * np.ones(JOINTS)
    assert not measured_again(every.with_states(replace(every.states, q_rad=creeping)))


def test_places_that_are_visited_fifty_times_are_places(random_order):
    """A robot's repeatability is measured at five places, in many cycles."""
    rng, count = np.random.default_rng(2), 250
    q = np.resize(random_order.states.q_rad[:5], (count, JOINTS))
    states = at_rest(q + 1e-5 * rng.standard_normal(q.shape), time_s=10.0 * np.arange(count))
    labels = np.array([f"P{k:03d}" for k in range(count)])
    cycles = Observations.single(labels, states, Unmeasured())
    assert len(np.unique(with_place_labels(cycles).pose)) == 5
    assert measured_again(cycles)
    # A robot that stands still at one place after the other does not come back.
    stays = cycles.with_states(replace(states, q_rad=np.repeat(q[:5], 50, axis=0)))
    assert not measured_again(stays)


def test_a_joint_that_goes_to_the_other_side_parts_the_rows(random_order):
    q_rad, middle = random_order.states.q_rad.copy(), 50
    q_rad[:, 1] = np.abs(q_rad[:, 1]) * np.where(np.arange(ROWS) < middle, 1.0, -1.0)
    states = replace(random_order.states, q_rad=q_rad)
    found = list(step_thresholds(states, states.time_s[middle] - 5.0))
    assert [each.covariate for each in found] == [Covariate(2)]
    assert abs(found[0].value) < 0.2
    assert not list(step_thresholds(states, states.time_s[80] - 5.0))


def test_a_rail_out_and_back_parts_the_rows_near_every_time(random_order):
    there = np.linspace(0.0, 6.0, ROWS // 2)
    q = random_order.states.q_rad.copy()
    q[:, 0] = np.concatenate([there, there[::-1]])
    states = replace(random_order.states, q_rad=q)
    slides = np.array([True, False, False, False])
    assert not confounded_with_time(
        random_order.with_states(states)
    )  # no correlation over all rows
    assert slow_joints(states).tolist() == [True, False, False, False]
    for row in (20, 40, 80, 100):
        found = [
            each.covariate for each in step_thresholds(states, states.time_s[row] - 5.0, slides)
        ]
        assert found == [Covariate(1, slides=True)]


def test_random_order_is_hardly_ever_parted(random_order):
    time_s = random_order.states.time_s
    parted = [
        row for row in range(5, ROWS - 5) if any(step_thresholds(random_order.states, time_s[row]))
    ]
    assert len(parted) <= 2


def test_one_time_of_all_rows_is_no_time(random_order):
    states = replace(random_order.states, time_s=np.full(len(random_order), 7.0))
    found, notes = with_time_validity(
        random_order.with_states(states), np.zeros(states.n, bool), recorded=True
    )
    assert not found.states.timed.any()
    assert "all rows have the same time" in notes[0]


# Directions of arrival that the order of poses gives.


def observed(q1, q2, s1=0.0):
    """Return readings of an arm of two joints, ten seconds apart."""
    count = len(q1)
    zeros = np.zeros(count)
    states = at_rest(
        np.column_stack([q1, q2]),
        tau_Nm=np.zeros((count, 2)),
        arrival=np.column_stack([np.broadcast_to(s1, count), zeros]).astype(float),
        time_s=10.0 * np.arange(count),
    )
    labels = np.array([f"P{k}" for k in range(count)], dtype=str)
    return Observations.single(labels, states, Distance(zeros, zeros))


def test_a_joint_arrives_from_where_it_stood_before():
    found, from_order = with_arrivals(observed([0.0, 0.5, 0.3, 0.7], [0.1, 0.0, 0.2, 0.1]))
    assert from_order
    assert found.states.arrival.T.tolist() == [[0, 1, -1, 1], [0, -1, 1, -1]]


def test_moves_are_shares_of_that_of_the_joint_that_went_furthest():
    found, _ = with_arrivals(observed([0.0, 0.5, 0.3, 0.3001], [0.0, -0.25, 0.15, 0.15]))
    expected = [[0.0, 0.0], [1.0, -0.5], [-0.5, 1.0], [0.0, 0.0]]
    np.testing.assert_allclose(found.states.move_share, expected, atol=1e-12)


@pytest.mark.parametrize("name", ["irb120", "gx4_351s"])
def test_the_end_goes_along_a_move_as_far_as_two_poses_show(name):
    arm, rng = load_arm(name), np.random.default_rng(5)
    low, high = (np.nan_to_num(each, nan=0.1, neginf=-1.0, posinf=1.0) for each in arm.limits_rad.T)
    q = rng.uniform(low, high, (20, arm.n))
    share = move_shares(rng.uniform(low, high, q.shape) - q)
    chain, step = Chain.of(arm), 1e-6
    ahead, behind = (chain.forward(q + side * step * share)[:, :3, 3] for side in (1.0, -1.0))
    by_differences_m = np.linalg.norm(ahead - behind, axis=1) / (2.0 * step)
    np.testing.assert_allclose(end_travel(arm, q, share), by_differences_m, atol=1e-8)


def test_one_that_stays_keeps_its_last_direction():
    found, _ = with_arrivals(observed([0.0, 0.5, 0.50001, 0.5, 0.2], [0.0] * 5))
    assert found.states.arrival.T.tolist() == [[0, 1, 1, 1, -1], [0] * 5]


def test_which_joints_moved_is_told_apart():
    found, _ = with_arrivals(observed([0.0, 0.5, 0.5005, 0.3, 0.2], [0.0] * 5))
    assert found.states.arrival[:, 0].tolist() == [0, 1, 1, -1, -1]
    assert found.states.moved.T.tolist() == [[0, 1, 0, -1, -1], [0] * 5]
    assert found.states.move_from_previous is found.states.moved


def test_readings_repeated_at_standstill_are_of_the_move_before_them():
    q1, q2 = [0.0, 0.5, 0.5, 0.5, 0.5, 0.2], [0.1, 0.1, 0.1, 0.1, 0.4, 0.4]
    found, _ = with_arrivals(observed(q1, q2))
    assert found.states.moved.T.tolist() == [[0, 1, 1, 1, 0, -1], [0, 0, 0, 0, 1, 0]]


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
    assert found.states.arrival is logged.states.arrival
    assert found.states.moved is None


def test_no_readings_stay_as_they_are():
    assert with_arrivals(observed([], []))[1] is False


def test_times_that_readings_share_give_no_order():
    rows = observed([0.0, 0.5, 0.3, 0.7], [0.0] * 4)
    timeless = rows.with_states(replace(rows.states, time_s=np.zeros(4)))
    found, from_order = with_arrivals(timeless)
    assert not from_order
    assert not found.states.arrival.any()


def untimed(q):
    """Return rows of three joints (P, 3) without times."""
    rows = observed(q[:, 0], q[:, 1])
    states = replace(rows.states, q_rad=q, tau_Nm=np.zeros_like(q), arrival=np.zeros_like(q))
    return rows.with_states(replace(states, timed=np.zeros(len(q), dtype=bool)))


def test_rows_that_a_joint_sorts_give_no_order():
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (70, 3))
    drawn = untimed(q)
    assert with_arrivals(drawn)[1]
    q[:40] = q[:40][np.argsort(q[:40, 1])]  # a table of 40 rows, and others below it
    table = untimed(q)
    found, from_order = with_arrivals(table)
    assert not from_order
    assert not found.states.arrival.any()
    assert str(sorted_rows(table.states)) == "rows 1 to 40 are sorted by joint 2, as a table is"
    _, notes = with_time_validity(table, np.zeros(3, dtype=bool), recorded=False)
    assert "rows 1 to 40 are sorted by joint 2" in notes[0]
    thrice = untimed(np.repeat(q, 3, axis=0))  # of readings of a standing arm one counts
    assert str(sorted_rows(thrice.states)) == "rows 1 to 120 are sorted by joint 2, as a table is"
    # Where times say so the rows were measured in that order.
    timed = table.with_states(replace(table.states, timed=None))
    assert with_arrivals(timed)[1]
    # Beside another campaign of a group these rows alone have no order.
    pair = untimed(np.concatenate([q, np.random.default_rng(4).uniform(-1.0, 1.0, (70, 3))]))
    pair = pair.with_states(replace(pair.states, campaign=np.repeat([0, 1], 70)))
    found, from_order = with_arrivals(pair)
    assert from_order
    assert not found.states.arrival[:70].any()
    assert found.states.arrival[71:].all()


def test_a_sweep_of_one_joint_is_an_order_of_measurement():
    q = np.zeros((40, 3))
    q[:, 1] = np.linspace(-1.0, 1.0, 40)
    assert sorted_rows(untimed(q).states) is None
    q[:, 0], q[:, 2] = np.sin(q[:, 1]), np.cos(2.0 * q[:, 1])  # along a path
    assert sorted_rows(untimed(q).states) is None
    assert with_arrivals(untimed(q))[1]


@pytest.mark.parametrize("seed", [3, 5, 6, 10])
def test_a_path_through_places_drawn_at_random_is_an_order_of_measurement(seed):
    """Some joint goes one way for three stretches while most others go to and fro by them."""
    rng, step = np.random.default_rng(seed), np.linspace(0.0, 1.0, 10)[:-1, None]
    places = rng.uniform(-1.0, 1.0, (30, 6))
    ways = [a + (b - a) * step**2 * (3.0 - 2.0 * step) for a, b in pairwise(places)]
    q = np.concatenate(ways)
    assert sorted_rows(untimed(q).states) is None
    assert with_arrivals(untimed(q))[1]
    table = q[np.argsort(q[:, 0])]
    assert str(sorted_rows(untimed(table).states)).endswith("are sorted by joint 1, as a table is")


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


def test_campaigns_of_a_group_have_clocks_of_their_own(random_order):
    q_rad = random_order.states.q_rad.copy()
    q_rad[ROWS // 2 :] = q_rad[: ROWS // 2]
    campaign = np.repeat([0, 1], ROWS // 2)
    states = replace(random_order.states, q_rad=q_rad, load_N=np.zeros(ROWS), campaign=campaign)
    # The same places on another day say nothing of time, there or here.
    assert not measured_again(random_order.with_states(states))
    # Paths that two campaigns follow at the same times are paths.
    path = np.linspace(0.0, 1.0, ROWS // 2)[:, None] * np.ones(JOINTS)
    both = replace(states, q_rad=np.concatenate([path, path[::-1]]))
    times_s = np.tile(np.arange(ROWS // 2, dtype=float), 2)
    assert like_a_scan(random_order.with_states(replace(both, time_s=times_s)))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([0, 1, 2, 4, 5, 70], "5 of 6 are among the first 6 of 120 poses, the first 50 s of"),
        ([60, 116, 117, 118, 119], "4 of 5 are among the last 4 of 120 poses, the last 30 s of"),
        ([3, 30, 61, 90, 110], ""),  # anywhere
        ([50, 51, 52, 53, 54], ""),  # together, in the middle
        ([0, 1], ""),  # two, which chance may put there
    ],
)
def test_rows_that_lie_at_one_end_in_time_are_told(random_order, rows, told):
    chosen = np.isin(np.arange(ROWS), rows)
    states, backwards = random_order.states, np.arange(ROWS)[::-1]
    said = at_one_end(states, chosen)
    assert said.startswith(told)
    assert bool(said) == bool(told)
    assert at_one_end(states.take(backwards), chosen[backwards]) == said
    assert not at_one_end(replace(states, timed=np.zeros(ROWS, dtype=bool)), chosen)


def test_poses_at_one_end_at_other_joint_positions_are_to_be_kept(random_order):
    states, chosen = random_order.states, np.arange(ROWS) >= ROWS - 8
    assert "leave them out" in at_one_end(states, chosen)
    q_rad = states.q_rad.copy()
    q_rad[chosen, 1] += np.ptp(q_rad[:, 1])
    said = at_one_end(replace(states, q_rad=q_rad), chosen)
    assert "outside those of all others" in said
    assert "leave" not in said


def test_hours_are_told_as_hours(random_order):
    chosen = np.isin(np.arange(ROWS), [*range(20, 32), 70])
    slow = replace(random_order.states, time_s=36.0 * random_order.states.time_s)
    assert "the first 3.1 h of 12 h" in at_one_end(slow, chosen)
