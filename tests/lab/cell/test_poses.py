"""Where the cell measures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_robot import nominal_of, rebuilt
from pa10cal.errors import SimulationError
from pa10cal.lab.cell.options import CellPosesOptions
from pa10cal.lab.cell.poses import place_poses
from pa10cal.lab.cell.robot import Departures

LAYOUT = CellPosesOptions()


@pytest.fixture(scope="module")
def poses(arm, robot):
    return place_poses(arm, nominal_of(robot), LAYOUT, 10)


@pytest.fixture(scope="module")
def flanges(robot, plain, poses):
    """Flanges of all poses by products of matrices, (P, 4, 4) a kind."""
    described = plain(rebuilt(robot, departures=Departures.none(6)))

    def of(kind):
        return np.array([described.frames(q)[-1] for q in getattr(poses, kind)])

    return of


@pytest.fixture(scope="module")
def middle(robot, plain):
    described = plain(rebuilt(robot, departures=Departures.none(6)))
    return described.frames(np.radians(LAYOUT.centre_deg))[-1]


def test_grid_is_three_by_three_by_three_about_the_middle(flanges, middle):
    steps = (flanges("grid")[:, :3, 3] - middle[:3, 3]) / LAYOUT.spacing_m
    assert steps == pytest.approx(steps.round(), abs=1e-9)
    assert {tuple(step) for step in steps.round().astype(int)} == {
        (x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)
    }


def test_the_path_through_the_grid_goes_from_neighbour_to_neighbour(flanges):
    steps = np.diff(flanges("grid")[:, :3, 3], axis=0) / LAYOUT.spacing_m
    assert np.linalg.norm(steps, axis=1) == pytest.approx(np.ones(26), abs=1e-9)


def test_tool_attitudes_vary_as_asked(flanges, middle):
    for kind in ("grid", "holdout"):
        tilts = Rotation.from_matrix(middle[:3, :3].T @ flanges(kind)[:, :3, :3]).as_rotvec()
        assert np.all(np.abs(tilts) <= np.array(LAYOUT.tilt_rad) + 1e-9)
        assert np.all(np.ptp(tilts, axis=0) > np.array(LAYOUT.tilt_rad))


def test_held_out_points_lie_outside_by_up_to_100_mm(flanges, middle):
    offset = np.abs(flanges("holdout")[:, :3, 3] - middle[:3, 3]) - LAYOUT.spacing_m
    distance = np.linalg.norm(np.maximum(offset, 0.0), axis=1)
    assert len(distance) == 10
    assert np.all((distance > 0.0) & (distance <= 0.1))


def test_straight_moves_run_along_the_base_axes_with_the_tool_still(flanges, middle):
    for axis, kind in enumerate(("line_x", "line_y")):
        T = flanges(kind)
        steps = T[1:, :3, 3] - T[:-1, :3, 3]
        assert len(T) == 11
        assert steps == pytest.approx(np.tile(0.02 * np.eye(3)[axis], (10, 1)), abs=1e-11)
        assert T[:, :3, :3] == pytest.approx(np.tile(middle[:3, :3], (11, 1, 1)), abs=1e-11)


def test_all_poses_keep_the_joint_limits_and_a_typical_reach(arm, poses, flanges):
    for kind in ("line_x", "line_y", "grid", "holdout"):
        q = getattr(poses, kind)
        assert np.all((q >= arm.limits_rad[:, 0]) & (q <= arm.limits_rad[:, 1]))
    reach = np.linalg.norm(flanges("grid")[:, :3, 3], axis=1)
    assert reach.min() > 0.5
    assert reach.max() < 1.1
    assert np.mean((reach > 0.5) & (reach < 0.9)) > 0.5


def test_the_same_layout_comes_out_again_and_another_seed_changes_it(arm, robot, poses):
    described = nominal_of(robot)
    again = place_poses(arm, described, LAYOUT, 10)
    other = place_poses(arm, described, CellPosesOptions(tilt_seed=2), 10)
    assert np.array_equal(again.grid, poses.grid)
    assert not np.array_equal(other.grid, poses.grid)
    assert not np.array_equal(other.holdout, poses.holdout)


@pytest.mark.parametrize("layout", ["grid", "wide"])
def test_further_poses_come_after_those_of_the_layout(arm, robot, layout):
    described = nominal_of(robot)
    extra = ((10.0, 20.0, 80.0, 100.0, -45.0, 30.0), (-60.0, 0.0, 100.0, 0.0, 60.0, 200.0))
    plain = place_poses(arm, described, CellPosesOptions(layout=layout), 10)
    more = place_poses(arm, described, CellPosesOptions(layout=layout, extra_deg=extra), 10)
    assert np.array_equal(more.grid[:-2], plain.grid)
    assert np.degrees(more.grid[-2:]) == pytest.approx(np.array(extra))
    assert np.array_equal(more.holdout, plain.holdout)


BAD = [
    ({"centre_deg": (0, 0, 0, 0, 0, 0)}, "short"),
    ({"spacing_m": (0.6, 0.6, 0.6)}, "short"),
    ({"centre_deg": (170.0, 15, 90, 0, 45, -90)}, "joint 1 at"),
]


@pytest.mark.parametrize(("change", "value"), BAD)
def test_refuses_poses_out_of_reach_or_beyond_a_limit(arm, robot, change, value):
    with pytest.raises(SimulationError, match=value) as refusal:
        place_poses(arm, nominal_of(robot), CellPosesOptions(**change), 10)
    assert "pose " in str(refusal.value)
    assert "poses.spacing_m" in str(refusal.value)


@pytest.mark.parametrize(
    ("pose_deg", "value"),
    [((0.0, 0.0), "2 joint positions for 6"), ((0.0, 125.0, 0.0, 0.0, 0.0, 0.0), "joint 2 beyond")],
)
def test_refuses_further_poses_that_the_arm_cannot_take(arm, robot, pose_deg, value):
    extra = ((0.0,) * 6, pose_deg)
    with pytest.raises(SimulationError, match=value) as refusal:
        place_poses(arm, nominal_of(robot), CellPosesOptions(extra_deg=extra), 10)
    assert "poses.extra_deg[1]" in str(refusal.value)


def test_the_poses_tell_34_of_the_36_unknowns(robot, poses):
    """Jacobian of flange poses by finite differences of the cell's own chain and springs."""
    from pa10cal.lab.cell.instruments.instrument import rest_poses

    q = np.concatenate([poses.grid, poses.grid])
    load_N = np.repeat([0.0, 44.0], len(poses.grid))
    zero = np.zeros(len(q))

    def flange(built):
        return rest_poses(built, (), q, load_N, zero, zero).T_base_ee

    def change(T, h):
        turn = T[:, :3, :3] @ reference[:, :3, :3].transpose(0, 2, 1)
        vector = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        return np.concatenate([T[:, :3, 3] - reference[:, :3, 3], vector], axis=1).ravel() / h

    reference, columns, h = flange(robot), [], 1e-6
    for name in ("a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad"):
        for i in range(6):
            if (name == "beta_rad") <= (i == 1) and not (name == "d_m" and i == 1):
                stepped = getattr(robot.departures, name).copy()
                stepped[i] += h
                built = rebuilt(robot, departures=replace(robot.departures, **{name: stepped}))
                columns.append(change(flange(built), h))
    for name in ("k_lin", "k_cub"):
        for i in (1, 2, 4):
            stepped = getattr(robot.springs, name).copy()
            stepped[i] *= 1.01
            built = replace(robot, springs=replace(robot.springs, **{name: stepped}))
            columns.append(change(flange(built), 1.0))
    for i in range(6):
        base = np.eye(4)
        base[:3, 3] = h * np.eye(6)[i, :3]
        base[:3, :3] = Rotation.from_rotvec(h * np.eye(6)[i, 3:]).as_matrix()
        columns.append(change(base @ reference, h))
    J = np.array(columns).T
    assert J.shape[1] == 36
    singular = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    assert singular[33] > 1e-4
    assert singular[34] < 1e-6
