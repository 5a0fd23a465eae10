import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.calibration.levels import fit_base_frame
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import pose_error


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


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 12))
def test_recovers_the_frame_of_exact_poses(seed, count):
    rng = np.random.default_rng(seed)
    T_instr_base, T_base_ee = random_poses(rng, 1)[0], random_poses(rng, count)
    found = fit_base_frame(T_base_ee, T_instr_base @ T_base_ee, attitude_weight_m2=1.0)
    np.testing.assert_allclose(found.T_instr_base, T_instr_base, atol=1e-12)


@settings(deadline=None, max_examples=20)
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
    again = fit_base_frame(
        T_base_ee, elsewhere @ T_instr_ee, attitude_weight_m2=weight
    ).T_instr_base
    np.testing.assert_allclose(again, elsewhere @ T, atol=1e-11)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_derivative_of_the_minimum_equals_finite_differences(weight):
    rng = np.random.default_rng(4)
    T_base_ee = random_poses(rng, 8)
    T_instr_ee = moved(T_base_ee, rng.normal(scale=0.05, size=(8, 6)))
    jacobian = rng.normal(size=(8, 6, 3))
    found = fit_base_frame(T_base_ee, T_instr_ee, attitude_weight_m2=weight, jacobian=jacobian)
    step = 1e-5
    for k in range(3):
        ahead, back = (
            fit_base_frame(
                moved(T_base_ee, sign * step * jacobian[:, :, k]),
                T_instr_ee,
                attitude_weight_m2=weight,
            ).T_instr_base
            for sign in (1, -1)
        )
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


@settings(deadline=None, max_examples=30)
@given(angle=st.floats(0, 3.0), seed=st.integers(0, 1000))
def test_chord_is_twice_the_sine_of_half_the_angle(angle, seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    T = random_poses(rng, 1)
    turned = moved(T, np.r_[0, 0, 0, angle * axis / np.linalg.norm(axis)][None])
    error = pose_error(turned, T)
    assert np.linalg.norm(error.chord) == pytest.approx(2 * np.sin(angle / 2), abs=1e-14)
