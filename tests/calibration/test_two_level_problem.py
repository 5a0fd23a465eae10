"""The inner level is a minimum with an exact derivative; so are the rows through both levels."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from pa10cal.calibration.two_level_problem import TwoLevel, fit_base_frame, rows_of, spread_poses
from pa10cal.errors import CalibrationError
from pa10cal.frame.point_fits import pose_error


def random_poses(rng, count):
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-1, 1, (count, 3))
    return T


def moved(T, twist):
    """Turn and shift poses: translation, then a small left rotation."""
    out = T.copy()
    out[:, :3, 3] += twist[:, :3]
    out[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ T[:, :3, :3]
    return out


@examples(30)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 12))
def test_recovers_the_frame_of_exact_poses(seed, count):
    rng = np.random.default_rng(seed)
    T_instr_base, T_base_ee = random_poses(rng, 1)[0], random_poses(rng, count)
    found = fit_base_frame(T_base_ee, T_instr_base @ T_base_ee, attitude_weight_m2=1.0)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-12)


@examples(20)
@given(seed=st.integers(0, 10_000), weight=st.sampled_from([0.0, 0.3, 1.0]))
def test_is_a_minimum_and_moves_with_the_instrument(seed, weight):
    rng = np.random.default_rng(seed)
    T_base_ee = random_poses(rng, 8)
    T_instr_ee = moved(T_base_ee, rng.normal(scale=0.02, size=(8, 6)))

    def cost(T):
        error = pose_error(T @ T_base_ee, T_instr_ee)
        return np.sum(error.position_m**2) + weight * np.sum(error.chord**2)

    T = fit_base_frame(T_base_ee, T_instr_ee, attitude_weight_m2=weight).T_instr_base
    for _ in range(10):
        assert cost(T) <= cost(moved(T[None], rng.normal(scale=1e-4, size=(1, 6)))[0]) + 1e-15
    elsewhere = random_poses(rng, 1)[0]
    again = fit_base_frame(T_base_ee, elsewhere @ T_instr_ee, attitude_weight_m2=weight)
    np.testing.assert_allclose(again.T_instr_base, elsewhere @ T, atol=1e-11)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_derivative_of_the_minimum_equals_finite_differences(weight):
    rng = np.random.default_rng(4)
    T_base_ee = random_poses(rng, 8)
    T_instr_ee = moved(T_base_ee, rng.normal(scale=0.05, size=(8, 6)))
    jacobian = rng.normal(size=(8, 6, 3))
    found = fit_base_frame(T_base_ee, T_instr_ee, attitude_weight_m2=weight, jacobian=jacobian)
    step = 1e-5

    def at(twist):
        there = moved(T_base_ee, twist)
        return fit_base_frame(there, T_instr_ee, attitude_weight_m2=weight).T_instr_base

    for k in range(3):
        ahead, back = (at(sign * step * jacobian[:, :, k]) for sign in (1, -1))
        translation = (ahead[:3, 3] - back[:3, 3]) / (2 * step)
        R = found.T_instr_base[:3, :3]
        turn = Rotation.from_matrix(R.T @ ahead[:3, :3] @ (R.T @ back[:3, :3]).T).as_rotvec()
        np.testing.assert_allclose(found.jacobian[:3, k], translation, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.jacobian[3:, k], turn / (2 * step), rtol=1e-6, atol=1e-8)


def test_positions_on_one_line_do_not_fix_a_frame():
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 0, 3] = np.arange(5.0)
    with pytest.raises(CalibrationError, match="poses that are not collinear"):
        fit_base_frame(T, T, attitude_weight_m2=0.0)
    fit_base_frame(T, T, attitude_weight_m2=1.0)  # orientations do


@examples(30)
@given(angle=st.floats(0, 3.0), seed=st.integers(0, 1000))
def test_chord_is_twice_the_sine_of_half_the_angle(angle, seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    T = random_poses(rng, 1)
    turned = moved(T, np.r_[0, 0, 0, angle * axis / np.linalg.norm(axis)][None])
    error = pose_error(turned, T)
    assert np.linalg.norm(error.chord) == pytest.approx(2 * np.sin(angle / 2), abs=1e-14)


# Rows through both levels.


@pytest.fixture
def level(model, observe):
    observations = observe(noise=1.0)
    return TwoLevel(model, observations, rows_of(observations, spread_poses(observations, 8)))


def assert_exact(level, x):
    """Fourth-order differences, so that their own error stays below 1e-6."""
    at = level.rows(x)
    scale = np.array([parameter.scale for parameter in level.parameters])
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = 1e-2 * scale[k]
        near = level.rows(x + step).residual - level.rows(x - step).residual
        far = level.rows(x + 2 * step).residual - level.rows(x - 2 * step).residual
        difference = (8 * near - far) / (12 * step[k])
        rounding = 1e-14 / step[k]
        error = np.abs(difference - at.jacobian[:, :, k]).max()
        assert error < 1e-6 * np.abs(at.jacobian[:, :, k]).max() + rounding, k


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("inner", [8, 27])
def test_derivative_through_the_inner_level_is_exact(level, truth, inner):
    rows = rows_of(level.observations, spread_poses(level.observations, inner))
    # Far from the solution, where residuals are not small and their curvature counts.
    x = truth + level.model.scale * np.random.default_rng(0).normal(scale=4.0, size=30)
    assert_exact(replace(level, inner_rows=rows), x)


def test_derivative_on_one_level_is_exact(level, truth, T_instr_base):
    whole = level.one_level(T_instr_base)
    x = np.concatenate([truth, np.random.default_rng(1).normal(scale=3e-3, size=6)])
    assert_exact(whole, x)


def test_residuals_do_not_depend_on_where_the_instrument_stands(level, truth):
    T, observations = random_poses(np.random.default_rng(2), 1)[0], level.observations
    T_instr_target = T @ observations.measured.T_instr_target
    elsewhere = replace(
        level, observations=observations.with_measured(T_instr_target=T_instr_target)
    )
    first, second = (
        np.linalg.norm(each.rows(truth + 2 * level.model.scale).residual[:, :3], axis=1)
        for each in (level, elsewhere)
    )
    np.testing.assert_allclose(first, second, atol=1e-12)


def test_spread_poses_are_distinct_and_far_apart(level):
    chosen = spread_poses(level.observations, 8)
    assert len(set(chosen)) == 8
    assert len(rows_of(level.observations, chosen)) == 24
    assert spread_poses(level.observations, "all") == spread_poses(level.observations, 27)


def test_more_inner_poses_than_measured_are_refused(level):
    with pytest.raises(CalibrationError, match=r"inner_poses.*28.*1 to 27"):
        spread_poses(level.observations, 28)
