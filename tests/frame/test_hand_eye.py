"""Base frame, targets and fixed points: exact for exact data, near for wrong geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_poses import frames
from pa10cal.arm.chain import Chain, end_pose
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.frame.hand_eye import (
    hand_eye_from_points,
    hand_eye_from_poses,
    ranging,
    target_on_base,
)

seeds = st.integers(0, 2**32 - 1)
counts = st.integers(6, 30)


def frame(rng, size_m):
    return frames(rng, 1, size_m)[0]


def poses(rng, count, robot="ur10"):
    arm = load_arm(robot)
    return Chain.of(arm).forward(rng.uniform(-1.5, 1.5, (count, arm.n)))


def seen(T_instr_base, T_base_ee, p_ee_m):
    homogeneous = np.column_stack([p_ee_m, np.ones(len(p_ee_m))])
    return np.einsum("ij,pjk,bk->pbi", T_instr_base, T_base_ee, homogeneous)[..., :3]


def turns_about_z(rng, count):
    T = np.tile(np.eye(4), (count, 1, 1))
    angles = np.outer(rng.uniform(-2, 2, count), [0, 0, 1])
    T[:, :3, :3] = Rotation.from_rotvec(angles).as_matrix()
    T[:, :3, 3] = rng.uniform(-0.5, 0.5, (count, 3))
    return T


def apart(T, other):
    angle = Rotation.from_matrix(T[:3, :3].T @ other[:3, :3]).magnitude()
    return angle, np.linalg.norm(T[:3, 3] - other[:3, 3])


@examples(30)
@given(seeds, counts, st.sampled_from(["ur10", "pa10_6ce", "iiwa14"]))
def test_any_base_and_any_tool_are_recovered_from_poses(seed, count, robot):
    rng = np.random.default_rng(seed)
    T_base_ee, T_instr_base, T_ee_target = (
        poses(rng, count, robot),
        frame(rng, 3.0),
        frame(rng, 0.4),
    )
    found = hand_eye_from_poses(T_base_ee, T_instr_base @ T_base_ee @ T_ee_target)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-8)
    np.testing.assert_allclose(found.T_ee_targets, T_ee_target[None], atol=1e-8)
    assert found.scatter_m < 1e-9
    assert found.scatter_rad < 1e-9
    assert found.held == ()


@examples(30)
@given(seeds, counts, st.integers(1, 3))
def test_any_base_and_any_places_are_recovered_from_points(seed, count, targets):
    rng = np.random.default_rng(seed)
    T_base_ee, T_instr_base = poses(rng, count), frame(rng, 3.0)
    p_ee_m = rng.uniform(-0.4, 0.4, (targets, 3))
    p_instr_m = seen(T_instr_base, T_base_ee, p_ee_m)
    if targets > 1:
        p_instr_m[rng.random(p_instr_m.shape[:2]) < 0.2] = np.nan
        p_instr_m[:3] = seen(T_instr_base, T_base_ee[:3], p_ee_m)
    found = hand_eye_from_points(T_base_ee, p_instr_m)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-8)
    np.testing.assert_allclose(found.T_ee_targets[:, :3, 3], p_ee_m, atol=1e-8)
    np.testing.assert_allclose(
        found.targets(T_base_ee)[..., :3, 3], seen(T_instr_base, T_base_ee, p_ee_m), atol=1e-8
    )


@examples(15)
@given(seeds)
def test_residuals_are_those_of_the_frames_returned(seed):
    rng = np.random.default_rng(seed)
    T_base_ee = poses(rng, 20)
    T = frame(rng, 1.0) @ T_base_ee @ frame(rng, 0.2)
    T[:, :3, 3] += rng.normal(0, 1e-3, (20, 3))
    found = hand_eye_from_poses(T_base_ee, T)
    modelled = found.targets(T_base_ee)[:, 0]
    off = np.linalg.norm(T[:, :3, 3] - modelled[:, :3, 3], axis=1)
    assert found.scatter_m == pytest.approx(np.sqrt(np.mean(off**2)))
    turn = Rotation.from_matrix(T[:, :3, :3] @ np.swapaxes(modelled[:, :3, :3], 1, 2)).magnitude()
    assert found.scatter_rad == pytest.approx(np.sqrt(np.mean(turn**2)), abs=1e-12)


@pytest.mark.parametrize("count", [8, 30, 1000])
def test_geometry_that_is_a_little_wrong_is_averaged_over(count):
    rng = np.random.default_rng(count)
    chain = Chain.of(load_arm("ur10"))
    turns = np.array([motion.turns for motion in chain.motions])
    q = rng.uniform(-1.5, 1.5, (count, 6))
    real = chain.coordinates(q)
    real[:, 6:-6] += (np.where(turns, np.radians(0.5), 3e-3) * rng.normal(size=len(turns)))[6:-6]
    T_instr_base, T_ee_target = frame(rng, 3.0), frame(rng, 0.4)
    T = T_instr_base @ end_pose(chain, real) @ T_ee_target
    for found in (
        hand_eye_from_poses(chain.forward(q), T),
        hand_eye_from_points(chain.forward(q), T[:, None, :3, 3]),
    ):
        angle, distance = apart(T_instr_base, found.T_instr_base)
        assert angle < np.radians(4.0)
        assert distance < 0.05
        assert np.linalg.norm(found.T_ee_targets[0, :3, 3] - T_ee_target[:3, 3]) < 0.06
        assert found.scatter_m < 0.03


def test_directions_scatter_as_much_as_they_are_said_to():
    rng = np.random.default_rng(11)
    T_base_ee, T_instr_base, T_ee_target = poses(rng, 25), frame(rng, 1.0), frame(rng, 0.2)
    errors, stated = [], []
    for _ in range(120):
        p = seen(T_instr_base, T_base_ee, T_ee_target[None, :3, 3]) + rng.normal(
            0, 1e-3, (25, 1, 3)
        )
        found = hand_eye_from_points(T_base_ee, p)
        turn = Rotation.from_matrix(T_instr_base[:3, :3].T @ found.T_instr_base[:3, :3]).as_rotvec()
        errors.append([turn[1] ** 2 + turn[2] ** 2, turn[0] ** 2 + turn[2] ** 2])
        stated.append(found.axis_u_rad[:2] ** 2)
    np.testing.assert_allclose(np.mean(errors, axis=0) / 2, np.mean(stated, axis=0), rtol=0.25)


def test_turns_about_one_axis_leave_the_height_of_the_target_open():
    rng = np.random.default_rng(2)
    T_base_ee, T_instr_base = turns_about_z(rng, 25), frame(rng, 1.0)
    T_ee_target = frame(rng, 0.2)
    T = T_instr_base @ T_base_ee @ T_ee_target
    found = hand_eye_from_poses(T_base_ee, T)
    assert found.held == ("the target along (0.00, 0.00, 1.00)",)
    assert found.scatter_m < 1e-9
    np.testing.assert_allclose(found.T_instr_base[:3, :3], T_instr_base[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found.T_ee_targets[0, 2, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.T_ee_targets[0, :2], T_ee_target[:2], atol=1e-9)
    p_instr_m, stated_m = T[:, None, :3, 3], np.array([[0.0, 0.0, T_ee_target[2, 3]]])
    again = hand_eye_from_points(T_base_ee, p_instr_m, stated_m)
    np.testing.assert_allclose(again.T_instr_base, T_instr_base, atol=1e-9)

    p_ee_m = rng.uniform(-0.2, 0.2, (2, 3))
    of_two = hand_eye_from_points(T_base_ee, seen(T_instr_base, T_base_ee, p_ee_m))
    assert of_two.held == ("all targets along (0.00, 0.00, 1.00)",)
    heights = of_two.T_ee_targets[:, 2, 3]
    assert heights[1] - heights[0] == pytest.approx(p_ee_m[1, 2] - p_ee_m[0, 2])


def test_attitudes_all_alike_leave_the_place_of_the_target_open():
    rng = np.random.default_rng(3)
    T_base_ee, T_instr_base = turns_about_z(rng, 10), frame(rng, 1.0)
    T_base_ee[:, :3, :3] = np.eye(3)
    found = hand_eye_from_points(
        T_base_ee, seen(T_instr_base, T_base_ee, np.array([[0.1, 0.2, 0.3]])), names=["T7"]
    )
    assert sorted(found.held) == [
        "target T7 along (0.00, 0.00, 1.00)",
        "target T7 along (0.00, 1.00, 0.00)",
        "target T7 along (1.00, 0.00, 0.00)",
    ]
    np.testing.assert_allclose(found.T_instr_base[:3, :3], T_instr_base[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found.T_ee_targets[0, :3, 3], 0.0, atol=1e-12)


def test_poses_about_one_point_need_attitudes():
    rng = np.random.default_rng(4)
    T_instr_base, T_ee_target = frame(rng, 1.0), frame(rng, 0.2)
    T_base_ee = np.tile(np.eye(4), (12, 1, 1))
    T_base_ee[:, :3, :3] = Rotation.random(12, random_state=rng).as_matrix()
    T_base_ee[:, :3, 3] = 0.3 - T_base_ee[:, :3, :3] @ T_ee_target[:3, 3]
    T = T_instr_base @ T_base_ee @ T_ee_target
    found = hand_eye_from_poses(T_base_ee, T)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-9)
    np.testing.assert_allclose(found.T_ee_targets[0], T_ee_target, atol=1e-9)
    of_points = hand_eye_from_points(T_base_ee, T[:, None, :3, 3])
    np.testing.assert_allclose(of_points.T_ee_targets[0, :3, 3], T_ee_target[:3, 3], atol=1e-9)
    assert of_points.scatter_m < 1e-9
    assert len(of_points.held) == 3
    assert (of_points.axis_u_rad > 1.8).all()


def test_about_one_line_the_turn_of_the_base_is_any():
    """A ball is touched in two sockets, by an arm in many positions."""
    rng = np.random.default_rng(5)
    T_instr_base, p_ee_m = frame(rng, 1.0), rng.uniform(-0.2, 0.2, 3)
    T_base_ee = np.tile(np.eye(4), (12, 1, 1))
    T_base_ee[:, :3, :3] = Rotation.random(12, random_state=rng).as_matrix()
    sockets_m = np.where(np.arange(12)[:, None] < 6, [0.4, 0.1, 0.2], [0.4, 0.15, 0.2])
    T_base_ee[:, :3, 3] = sockets_m - T_base_ee[:, :3, :3] @ p_ee_m
    found = hand_eye_from_points(T_base_ee, seen(T_instr_base, T_base_ee, p_ee_m[None]))
    np.testing.assert_allclose(found.T_ee_targets[0, :3, 3], p_ee_m, atol=1e-9)
    assert found.scatter_m < 1e-9
    assert len(found.held) == 1
    assert found.held[0] in (
        "the base about (0.00, 1.00, 0.00)",
        "the base about (0.00, -1.00, 0.00)",
    )
    # The line itself keeps its direction; the other axes turn about it.
    np.testing.assert_allclose(found.T_instr_base[:3, 1], T_instr_base[:3, 1], atol=1e-9)
    assert found.axis_u_rad[1] < 1e-6
    assert found.axis_u_rad[[0, 2]] == pytest.approx(np.pi / np.sqrt(6.0), rel=1e-3)


def test_two_poses_and_a_target_never_seen_are_refused():
    rng = np.random.default_rng(6)
    T_base_ee = poses(rng, 8)
    with pytest.raises(CalibrationError, match=r"too few poses .*got 2.*at least 3"):
        hand_eye_from_poses(T_base_ee[:2], T_base_ee[:2])
    p_instr_m = seen(np.eye(4), T_base_ee, np.zeros((2, 3)))
    p_instr_m[:, 1] = np.nan
    with pytest.raises(CalibrationError, match="target B was not observed in any pose"):
        hand_eye_from_points(T_base_ee, p_instr_m, names=["A", "B"])


def test_weights_leave_a_gross_error_without_effect():
    rng = np.random.default_rng(7)
    T_base_ee, T_instr_base = poses(rng, 15), frame(rng, 1.0)
    p_instr_m = seen(T_instr_base, T_base_ee, np.array([[0.1, 0.0, 0.2]]))
    p_instr_m[4] += 0.5
    weights = np.ones(15)
    weights[4] = 0.0
    found = hand_eye_from_points(T_base_ee, p_instr_m, weights=weights)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-9)
    assert found.scatter_m < 1e-9


def test_the_mean_target_on_a_known_base():
    rng = np.random.default_rng(8)
    T_base_ee, T_instr_base, T_ee_target = poses(rng, 9), frame(rng, 1.0), frame(rng, 0.2)
    found = target_on_base(T_instr_base, T_base_ee, T_instr_base @ T_base_ee @ T_ee_target)
    np.testing.assert_allclose(found, T_ee_target, atol=1e-12)


# A fixed point and a target from distances.


def distances(T_base_ee, p_ee_m, point_m):
    place = T_base_ee[:, :3, :3] @ p_ee_m + T_base_ee[:, :3, 3]
    return np.linalg.norm(place - point_m, axis=1)


def modelled(found, T_base_ee):
    return np.linalg.norm(found.targets(T_base_ee)[:, 0, :3, 3], axis=1)


@pytest.mark.slow
@examples(30)
@given(
    st.integers(0, 2**32 - 1), st.integers(10, 40), st.sampled_from(["ur10", "pa10_6ce", "iiwa14"])
)
def test_any_point_and_any_target_are_recovered(seed, count, robot):
    rng = np.random.default_rng(seed)
    T_base_ee = poses(rng, count, robot)
    point_m, p_ee_m = rng.uniform(-2, 2, 3), rng.uniform(-0.3, 0.3, 3)
    d_m = distances(T_base_ee, p_ee_m, point_m)
    found = ranging(T_base_ee, d_m)
    np.testing.assert_allclose(-found.T_instr_base[:3, 3], point_m, atol=1e-7)
    np.testing.assert_allclose(found.p_ee_targets_m[0], p_ee_m, atol=1e-7)
    np.testing.assert_allclose(modelled(found, T_base_ee), d_m, atol=1e-9)
    assert found.scatter_m < 1e-9
    assert found.held == ()


def test_distances_that_are_a_little_wrong_are_averaged_over():
    rng = np.random.default_rng(1)
    T_base_ee = poses(rng, 2000)
    point_m, p_ee_m = np.array([1.5, -0.8, 0.4]), np.array([0.05, 0.0, 0.15])
    d_m = distances(T_base_ee, p_ee_m, point_m) + rng.normal(0, 3e-3, 2000)
    found = ranging(T_base_ee, d_m)
    assert np.linalg.norm(-found.T_instr_base[:3, 3] - point_m) < 1e-3
    assert np.linalg.norm(found.p_ee_targets_m[0] - p_ee_m) < 1e-3
    assert found.scatter_m == pytest.approx(3e-3, rel=0.05)


def test_distances_of_turns_about_one_axis_leave_the_height_open():
    rng = np.random.default_rng(2)
    arm = load_arm("gx4_351s")
    low, high = arm.limits_rad.T
    T_base_ee = Chain.of(arm).forward(rng.uniform(low / 2, high / 2, (40, arm.n)))
    p_ee_m, point_m = np.array([0.03, -0.05, 0.1]), np.array([0.8, 0.3, 0.5])
    d_m = distances(T_base_ee, p_ee_m, point_m)
    found = ranging(T_base_ee, d_m)
    assert found.held == ("the target along (0.00, 0.00, 1.00)",)
    np.testing.assert_allclose(found.p_ee_targets_m[0], [0.03, -0.05, 0.0], atol=1e-7)
    np.testing.assert_allclose(-found.T_instr_base[:3, 3], [0.8, 0.3, 0.4], atol=1e-7)
    stated = ranging(T_base_ee, d_m, np.array([0.0, 0.0, 0.1]))
    np.testing.assert_allclose(-stated.T_instr_base[:3, 3], point_m, atol=1e-7)


def test_poses_in_the_plane_of_the_point_leave_it_open():
    rng = np.random.default_rng(3)
    T_base_ee = np.tile(np.eye(4), (30, 1, 1))
    T_base_ee[:, :2, 3] = rng.uniform(-0.5, 0.5, (30, 2))
    d_m = distances(T_base_ee, np.zeros(3), np.array([1.0, 0.5, 0.0]))
    with pytest.raises(
        CalibrationError, match=r"do not identify the fixed point.*along \(0.00, 0.00, 1.00\)"
    ):
        ranging(T_base_ee, d_m)


def test_three_distances_are_refused():
    T_base_ee = poses(np.random.default_rng(4), 3)
    with pytest.raises(CalibrationError, match=r"too few distances.*got 3.*at least 4"):
        ranging(T_base_ee, np.ones(3))


def test_weights_leave_a_wrong_distance_without_effect():
    rng = np.random.default_rng(5)
    T_base_ee, point_m = poses(rng, 30), np.array([1.0, 1.0, 1.0])
    d_m = distances(T_base_ee, np.zeros(3), point_m)
    d_m[7] += 0.4
    found = ranging(T_base_ee, d_m, weights=(np.arange(30) != 7).astype(float))
    np.testing.assert_allclose(-found.T_instr_base[:3, 3], point_m, atol=1e-7)
    assert (d_m - modelled(found, T_base_ee))[7] == pytest.approx(0.4)
