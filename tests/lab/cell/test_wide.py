"""Poses over large joint sweeps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_robot import nominal_of, rebuilt
from pa10cal.errors import SimulationError
from pa10cal.lab.cell.campaign import simulate_campaign
from pa10cal.lab.cell.options import CellPosesOptions, SimulateOptions
from pa10cal.lab.cell.poses import draw_wide, neighbours_path, place_poses
from pa10cal.lab.cell.robot import Departures

WIDE = CellPosesOptions(layout="wide")
BALLS_M = np.array([[0, 0, 0], [0.095, 0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])


@pytest.fixture(scope="module")
def poses(arm, robot):
    return place_poses(arm, nominal_of(robot), WIDE, 10)


def test_sixty_poses_and_other_held_out_ones(poses):
    assert poses.grid.shape == (60, 6)
    assert poses.holdout.shape == (10, 6)
    assert len(np.unique(np.vstack([poses.grid, poses.holdout]), axis=0)) == 70


def test_joints_sweep_widely_within_80_percent_of_their_limits_and_150_deg(arm, poses):
    low, high = np.degrees(arm.limits_rad).T
    middle, half = (low + high) / 2, 0.4 * (high - low)
    for q in (poses.grid, poses.holdout):
        assert np.all(np.abs(np.degrees(q) - middle) <= half + 1e-9)
        assert np.abs(np.degrees(q)).max() <= 150.0
    assert np.all(np.ptp(np.degrees(poses.grid), axis=0) > 120.0)
    for order in (1, 2):  # far enough to tell orders 1 and 2 of joints 1, 4 and 6 apart
        waves = np.exp(1j * order * poses.grid[:, [0, 3, 5]])
        assert np.abs(waves.mean(axis=0)).max() < 0.6


def test_flange_and_balls_stay_clear_of_floor_and_column(robot, plain, poses):
    described = plain(rebuilt(robot, departures=Departures.none(6)))
    for q in np.vstack([poses.grid, poses.holdout]):
        T = described.frames(q)[-1]
        points = BALLS_M @ T[:3, :3].T + T[:3, 3]
        assert points[:, 2].min() > 0.15
        assert np.hypot(points[:, 0], points[:, 1]).min() >= 0.25


def test_the_tool_takes_all_attitudes(robot, plain, poses):
    described = plain(rebuilt(robot, departures=Departures.none(6)))
    R = np.array([described.frames(q)[-1][:3, :3] for q in poses.grid])
    turns = Rotation.from_matrix(R @ R[0].T).magnitude()
    assert np.degrees(turns).max() > 120.0


def test_the_straight_moves_stay_those_of_the_grid(arm, robot, poses):
    grid = place_poses(arm, nominal_of(robot), CellPosesOptions(), 10)
    assert np.array_equal(poses.line_x, grid.line_x)
    assert np.array_equal(poses.line_y, grid.line_y)


def test_the_same_seed_gives_the_same_poses_on_every_robot(arm, robot, poses):
    other = rebuilt(robot, departures=Departures.none(6))
    again = place_poses(arm, nominal_of(other), WIDE, 10)
    assert np.array_equal(again.grid, poses.grid)
    assert np.array_equal(again.holdout, poses.holdout)
    seed_2 = WIDE.model_copy(update={"tilt_seed": 2})
    assert not np.array_equal(place_poses(arm, nominal_of(robot), seed_2, 10).grid, poses.grid)


def test_the_path_goes_on_to_the_nearest_pose_left():
    line = np.array([[0.0], [5.0], [1.0], [-1.5], [2.5]])
    assert neighbours_path(line).ravel().tolist() == [0.0, 1.0, 2.5, 5.0, -1.5]


def test_the_path_visits_every_pose_once_and_is_shorter(poses, arm, robot):
    rng = np.random.default_rng(3)
    drawn = draw_wide(arm, nominal_of(robot), 40, rng)
    path = neighbours_path(drawn)
    assert np.array_equal(np.unique(path, axis=0), np.unique(drawn, axis=0))
    length = [np.linalg.norm(np.diff(q, axis=0), axis=1).sum() for q in (path, drawn)]
    assert length[0] < 0.8 * length[1]


@pytest.mark.parametrize("path", ["same", "alternating"])
def test_joints_arrive_both_ways(arm, path):
    settings = SimulateOptions(
        poses=WIDE, path=path, repeats=2, loads_N=(0.0,), holdout_repeats=1, built="drawn"
    )
    schedule = simulate_campaign("x", arm, settings).truth.schedule
    arrival = schedule.arrival[schedule.kind == "grid"].reshape(2, 60, 6)
    assert np.all((arrival > 0).mean(axis=(0, 1)) > 0.3)
    assert np.all((arrival < 0).mean(axis=(0, 1)) > 0.3)
    by_pose = [arrival[0], arrival[1] if path == "same" else arrival[1, ::-1]]
    assert np.array_equal(*by_pose) == (path == "same")


def test_the_number_of_poses_can_be_chosen(arm, robot):
    few = WIDE.model_copy(update={"wide_poses": 3})
    poses = place_poses(arm, nominal_of(robot), few, 0)
    assert poses.grid.shape == (3, 6)
    assert poses.holdout.shape == (0, 6)


def test_refuses_an_arm_that_cannot_lift_its_tool(arm, robot):
    low = replace(arm, d_m=arm.d_m - np.array([5.0, 0, 0, 0, 0, 0]))
    lowered = nominal_of(rebuilt(robot, arm=low))
    with pytest.raises(SimulationError, match="clear of floor") as refusal:
        draw_wide(low, lowered, 2, np.random.default_rng(0))
    assert "poses.layout" in str(refusal.value)
