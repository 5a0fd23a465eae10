"""Where the cell measures, in what order, and the direction of every arrival."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_robot import nominal_of, rebuilt
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.mechanism import Departures
from pa10cal_lab.cell.options import CellPosesOptions, SimulateOptions
from pa10cal_lab.cell.poses import Poses, draw_wide, neighbours_path, place_poses
from pa10cal_lab.cell.schedule import sweeps

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


@pytest.mark.slow_but_one_in(2)
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
    from pa10cal_lab.cell.instruments.instrument import rest_poses

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


# Poses over large joint sweeps.


WIDE = CellPosesOptions(layout="wide")
BALLS_M = np.array([[0, 0, 0], [0.095, 0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])


@pytest.fixture(scope="module")
def wide_poses(arm, robot):
    return place_poses(arm, nominal_of(robot), WIDE, 10)


def test_sixty_poses_and_other_held_out_ones(wide_poses):
    assert wide_poses.grid.shape == (60, 6)
    assert wide_poses.holdout.shape == (10, 6)
    assert len(np.unique(np.vstack([wide_poses.grid, wide_poses.holdout]), axis=0)) == 70


def test_joints_sweep_widely_within_80_percent_of_their_limits_and_150_deg(arm, wide_poses):
    low, high = np.degrees(arm.limits_rad).T
    middle, half = (low + high) / 2, 0.4 * (high - low)
    for q in (wide_poses.grid, wide_poses.holdout):
        assert np.all(np.abs(np.degrees(q) - middle) <= half + 1e-9)
        assert np.abs(np.degrees(q)).max() <= 150.0
    assert np.all(np.ptp(np.degrees(wide_poses.grid), axis=0) > 120.0)
    for order in (1, 2):  # far enough to tell orders 1 and 2 of joints 1, 4 and 6 apart
        waves = np.exp(1j * order * wide_poses.grid[:, [0, 3, 5]])
        assert np.abs(waves.mean(axis=0)).max() < 0.6


def test_flange_and_balls_stay_clear_of_floor_and_column(robot, plain, wide_poses):
    described = plain(rebuilt(robot, departures=Departures.none(6)))
    for q in np.vstack([wide_poses.grid, wide_poses.holdout]):
        T = described.frames(q)[-1]
        points = BALLS_M @ T[:3, :3].T + T[:3, 3]
        assert points[:, 2].min() > 0.15
        assert np.hypot(points[:, 0], points[:, 1]).min() >= 0.25


def test_the_tool_takes_all_attitudes(robot, plain, wide_poses):
    described = plain(rebuilt(robot, departures=Departures.none(6)))
    R = np.array([described.frames(q)[-1][:3, :3] for q in wide_poses.grid])
    turns = Rotation.from_matrix(R @ R[0].T).magnitude()
    assert np.degrees(turns).max() > 120.0


def test_the_straight_moves_stay_those_of_the_grid(arm, robot, wide_poses):
    grid = place_poses(arm, nominal_of(robot), CellPosesOptions(), 10)
    assert np.array_equal(wide_poses.line_x, grid.line_x)
    assert np.array_equal(wide_poses.line_y, grid.line_y)


def test_the_same_seed_gives_the_same_poses_on_every_robot(arm, robot, wide_poses):
    other = rebuilt(robot, departures=Departures.none(6))
    again = place_poses(arm, nominal_of(other), WIDE, 10)
    assert np.array_equal(again.grid, wide_poses.grid)
    assert np.array_equal(again.holdout, wide_poses.holdout)
    seed_2 = WIDE.model_copy(update={"tilt_seed": 2})
    assert not np.array_equal(place_poses(arm, nominal_of(robot), seed_2, 10).grid, wide_poses.grid)


def test_the_path_goes_on_to_the_nearest_pose_left():
    line = np.array([[0.0], [5.0], [1.0], [-1.5], [2.5]])
    assert neighbours_path(line).ravel().tolist() == [0.0, 1.0, 2.5, 5.0, -1.5]


def test_the_path_visits_every_pose_once_and_is_shorter(wide_poses, arm, robot):
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
    wide_poses = place_poses(arm, nominal_of(robot), few, 0)
    assert wide_poses.grid.shape == (3, 6)
    assert wide_poses.holdout.shape == (0, 6)


def test_refuses_an_arm_that_cannot_lift_its_tool(arm, robot):
    low = replace(arm, d_m=arm.d_m - np.array([5.0, 0, 0, 0, 0, 0]))
    lowered = nominal_of(rebuilt(robot, arm=low))
    with pytest.raises(SimulationError, match="clear of floor") as refusal:
        draw_wide(low, lowered, 2, np.random.default_rng(0))
    assert "poses.layout" in str(refusal.value)


# The order of a campaign and the direction of every arrival.


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
