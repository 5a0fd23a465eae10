"""A fixed point and a target from distances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.arm.chain import Chain
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.frame.hand_eye import ranging


def poses(rng, count, robot="ur10"):
    arm = load_arm(robot)
    return Chain.of(arm).forward(rng.uniform(-1.5, 1.5, (count, arm.n)))


def distances(T_base_ee, p_ee_m, point_m):
    place = T_base_ee[:, :3, :3] @ p_ee_m + T_base_ee[:, :3, 3]
    return np.linalg.norm(place - point_m, axis=1)


def modelled(found, T_base_ee):
    return np.linalg.norm(found.targets(T_base_ee)[:, 0, :3, 3], axis=1)


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
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


def test_turns_about_one_axis_leave_the_height_of_the_target_open():
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


def test_weights_leave_a_gross_error_without_effect():
    rng = np.random.default_rng(5)
    T_base_ee, point_m = poses(rng, 30), np.array([1.0, 1.0, 1.0])
    d_m = distances(T_base_ee, np.zeros(3), point_m)
    d_m[7] += 0.4
    found = ranging(T_base_ee, d_m, weights=(np.arange(30) != 7).astype(float))
    np.testing.assert_allclose(-found.T_instr_base[:3, 3], point_m, atol=1e-7)
    assert (d_m - modelled(found, T_base_ee))[7] == pytest.approx(0.4)
