"""The order of a campaign and the direction of every arrival."""

import numpy as np
import pytest

from pa10cal.lab.cell.options import SimulateOptions
from pa10cal.lab.cell.poses import Poses, sweeps

RNG = np.random.default_rng(0)
POSES = Poses(*(RNG.uniform(-1, 1, (count, 6)) for count in (11, 11, 27, 10)))


def schedule(seed=0, **settings):
    return sweeps(POSES, SimulateOptions(**settings), np.random.default_rng(seed))


def rows(plan, kind):
    return np.flatnonzero(plan.kind == kind)


def test_counts_are_those_of_the_experiment():
    plan = schedule()
    assert [len(rows(plan, kind)) for kind in ("line_x", "line_y", "grid", "holdout")] == [
        11,
        11,
        27 * 10 * 3,
        10 * 4 * 3,
    ]
    for load_N in (0.0, 22.0, 44.0):
        grid = (plan.kind == "grid") & (plan.load_N == load_N)
        assert sorted(zip(plan.pose[grid], plan.repeat[grid], strict=True)) == [
            (f"P{pose:02d}", repeat) for pose in range(1, 28) for repeat in range(1, 11)
        ]
    assert set(plan.load_N[plan.kind == "holdout"]) == {22.0, 44.0, 66.0, 90.0}


def test_the_same_label_is_the_same_command():
    plan = schedule()
    for label in np.unique(plan.pose):
        assert len(np.unique(plan.q[plan.pose == label], axis=0)) == 1


def test_time_runs_forward_and_a_change_of_weight_takes_longer():
    plan = schedule()
    steps = np.diff(plan.start_s)
    assert steps.min() == 45.0
    first_22 = np.flatnonzero(plan.load_N == 22.0)[0]
    assert steps[first_22 - 1] == 345.0


def test_on_one_path_every_repeat_arrives_alike():
    plan = schedule()
    for label in ("P01", "P14", "P27"):
        arrivals = plan.arrival[plan.pose == label]
        assert len(arrivals) == 30
        assert len(np.unique(arrivals, axis=0)) == 1


def test_on_alternating_paths_poses_are_met_from_both_neighbours():
    plan = schedule(path="alternating")
    label = plan.pose == "P14"
    from_poses = {tuple(q) for q in plan.q_from[label]}
    assert from_poses == {tuple(POSES.grid[12]), tuple(POSES.grid[14])}


def test_every_joint_arrives_both_ways_over_the_grid():
    plan = schedule()
    arrivals = plan.arrival[plan.kind == "grid"]
    assert np.all((arrivals > 0).mean(axis=0) > 0.2)
    assert np.all((arrivals < 0).mean(axis=0) > 0.2)


def test_a_joint_that_hardly_moves_does_not_arrive():
    line = np.zeros((11, 6))
    line[:, 0] = np.linspace(0, 1e-4, 11)
    line[:, 1] = np.linspace(1, 0, 11)
    plan = sweeps(
        Poses(line, line, POSES.grid, POSES.holdout), SimulateOptions(), np.random.default_rng(0)
    )
    assert plan.arrival[5, :3].tolist() == [0.0, -1.0, 0.0]


def test_held_out_points_come_shuffled_and_always_from_somewhere_else():
    plan = schedule()
    held = rows(plan, "holdout")
    assert len(np.unique(plan.q_from[held] - plan.q[held], axis=0)) > 30
    assert np.abs(plan.q_from[held] - plan.q[held]).max(axis=1).min() > 0.0
    in_order = sorted(zip(plan.pose[held], plan.load_N[held], plan.repeat[held], strict=True))
    assert in_order != list(zip(plan.pose[held], plan.load_N[held], plan.repeat[held], strict=True))
    again, other = schedule(), schedule(seed=1)
    assert np.array_equal(again.pose, plan.pose)
    assert not np.array_equal(other.pose, plan.pose)


def test_no_held_out_points_where_none_are_asked_for():
    empty = Poses(POSES.line_x, POSES.line_y, POSES.grid, np.empty((0, 6)))
    plan = sweeps(empty, SimulateOptions(), np.random.default_rng(0))
    assert len(rows(plan, "holdout")) == 0
    assert len(rows(schedule(holdout_loads_N=()), "holdout")) == 0


@pytest.mark.parametrize("count", [1, 2])
def test_a_single_held_out_point_is_left_in_between(count):
    few = Poses(POSES.line_x, POSES.line_y, POSES.grid, POSES.holdout[:count])
    plan = sweeps(few, SimulateOptions(), np.random.default_rng(0))
    held = rows(plan, "holdout")
    assert np.abs(plan.q_from[held] - plan.q[held]).max(axis=1).min() > 0.0
