"""Rigid fits: exact recovery, never a reflection, covariance that is the scatter it predicts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_poses import frames
from pa10cal.arm.chain import Chain
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.frame.hand_eye import seed_from_nominal
from pa10cal.frame.point_fits import fit_rigid, fit_rigid_weighted
from pa10cal.frame.target_problem import scale_of_distances, scale_of_points

BALLS_EE_MM = np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
seeds = st.integers(0, 2**32 - 1)


def carried(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]


@examples(40)
@given(seed=seeds, k=st.integers(3, 8), flatness=st.floats(0, 1))
def test_recovers_the_motion_for_any_points_that_span_a_plane(seed, k, flatness):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(k, 3)) * [100, 100, 100 * flatness]
    T = frames(rng, 5, 1000.0)
    fit = fit_rigid(source, carried(T, source))
    assert np.linalg.det(fit.T[:, :3, :3]) == pytest.approx(np.ones(5))
    np.testing.assert_allclose(fit.T, T, atol=2e-6)
    assert fit.rms == pytest.approx(np.zeros(5), abs=1e-8)


def test_a_mirrored_set_gives_a_rotation_with_residuals_not_a_reflection():
    source = np.random.default_rng(1).normal(size=(6, 3))
    fit = fit_rigid(source, source * [1, 1, -1])
    assert np.linalg.det(fit.T[:3, :3]) == pytest.approx(1.0)
    assert fit.rms > 0.1


@pytest.mark.parametrize(
    ("source", "rank"),
    [
        (np.outer([0.0, 1.0, 3.0], [1.0, 2.0, 2.0]), 1),
        (np.tile([1.0, 2.0, 3.0], (3, 1)), 0),
        (BALLS_EE_MM[:2], 1),
        (BALLS_EE_MM[:1], 0),
    ],
)
def test_refuses_points_without_a_plane_and_names_the_rank(source, rank):
    with pytest.raises(CalibrationError, match=f"rank {rank}"):
        fit_rigid(source, source + 1.0)


def test_refuses_a_single_degenerate_set_in_a_batch():
    target = np.stack([BALLS_EE_MM, np.outer([0.0, 1.0, 2.0], [1.0, 0.0, 0.0])])
    with pytest.raises(CalibrationError, match="target points"):
        fit_rigid(BALLS_EE_MM, target)


@examples(30)
@given(seed=seeds)
def test_weighted_fit_is_stationary_and_agrees_with_the_closed_form_for_equal_covariances(seed):
    rng = np.random.default_rng(seed)
    target = carried(frames(rng, 4, 1000.0), BALLS_EE_MM) + rng.normal(size=(4, 3, 3))
    equal = np.tile(0.3 * np.eye(3), (4, 3, 1, 1))
    weighted = fit_rigid_weighted(BALLS_EE_MM, target, equal)
    np.testing.assert_allclose(weighted.T, fit_rigid(BALLS_EE_MM, target).T, atol=1e-8)
    roots = rng.normal(size=(4, 3, 3, 3))
    covariances = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(3)
    fit = fit_rigid_weighted(BALLS_EE_MM, target, covariances)
    least = chi_square_after(fit, target, covariances, 0, 0.0)
    for index in range(6):
        for sign in (-1, 1):
            moved = chi_square_after(fit, target, covariances, index, sign * 1e-4)
            assert np.all(moved > least)


def chi_square_after(fit, target, covariances, index, step):
    """Chi-square of the pose moved by one component of (dp, w), w about its own origin."""
    motion = np.zeros(6)
    motion[index] = step
    R, p = fit.T[:, :3, :3], fit.T[:, :3, 3]
    turned = Rotation.from_rotvec(motion[3:]).as_matrix() @ R
    moved = np.array(fit.T)
    moved[:, :3, :3], moved[:, :3, 3] = turned, p + motion[:3]
    residuals = target - carried(moved, BALLS_EE_MM)
    return np.einsum("bki,bkij,bkj->b", residuals, np.linalg.inv(covariances), residuals)


def test_covariance_is_the_scatter_of_many_noisy_fits():
    rng = np.random.default_rng(3)
    T = np.repeat(frames(rng, 1, 1000.0), 20_000, axis=0)
    sigmas = np.array([[0.01, 0.02, 0.03], [0.02, 0.01, 0.01], [0.03, 0.03, 0.01]])
    target = carried(T, BALLS_EE_MM) + sigmas * rng.normal(size=(20_000, 3, 3))
    covariances = np.tile(np.eye(3) * sigmas[:, None, :] ** 2, (20_000, 1, 1, 1))
    fit = fit_rigid_weighted(BALLS_EE_MM, target, covariances)
    w = Rotation.from_matrix(fit.T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)).as_rotvec()
    errors = np.hstack([fit.T[:, :3, 3] - T[:, :3, 3], w])
    predicted = fit.covariance[0]
    whitened = np.linalg.solve(np.linalg.cholesky(predicted), errors.T)
    assert np.cov(whitened) == pytest.approx(np.eye(6), abs=0.05)
    chi_square = chi_square_after(fit, target, covariances, 0, 0.0)
    assert chi_square.mean() == pytest.approx(3 * 3 - 6, rel=0.05)


# Base frame from a rigid fit of the nominal model.


def cell(rng, noise_m, poses=27):
    R = Rotation.random(random_state=rng).as_matrix()
    p_base_m = np.array([0.6, 0.0, 0.4]) + rng.uniform(-0.15, 0.15, (poses, 3))
    p_instr_m = p_base_m @ R.T + [0.3, -0.2, 0.1] + rng.normal(0, noise_m, (poses, 3))
    return R, p_instr_m, p_base_m


def test_exact_positions_give_the_frame_exactly():
    R, p_instr_m, p_base_m = cell(np.random.default_rng(1), 0.0)
    found = seed_from_nominal(p_instr_m, p_base_m)
    np.testing.assert_allclose(found.T_instr_base[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(found.T_instr_base[:3, 3], [0.3, -0.2, 0.1], atol=1e-12)
    assert found.poses == 27
    np.testing.assert_allclose(found.axis_u_rad, 0.0, atol=1e-9)


def test_uncertainty_of_the_axes_is_their_scatter_over_many_fits():
    rng = np.random.default_rng(2)
    stated, turned = [], []
    for _ in range(400):
        R, p_instr_m, p_base_m = cell(rng, 5e-4)
        found = seed_from_nominal(p_instr_m, p_base_m)
        stated.append(found.axis_u_rad**2)
        x = R.T @ found.T_instr_base[:3, 0]
        turned.append((x[1] ** 2 + x[2] ** 2) / 2)
        assert found.scatter_m == pytest.approx(5e-4 * 3**0.5, rel=0.4)
    assert np.mean(stated, axis=0)[0] ** 0.5 == pytest.approx(np.mean(turned) ** 0.5, rel=0.08)


def test_refuses_too_few_poses_and_poses_on_a_line():
    _, p_instr_m, p_base_m = cell(np.random.default_rng(3), 1e-4)
    with pytest.raises(CalibrationError, match=r"unloaded poses: too few.*got 2"):
        seed_from_nominal(p_instr_m[:2], p_base_m[:2])
    line = np.outer(np.linspace(0, 1, 5), [1.0, 2.0, 3.0])
    with pytest.raises(CalibrationError, match="rank 1"):
        seed_from_nominal(line, line)


# The scale of measured lengths, whatever instrument and target.

units = st.sampled_from([1.0, 1e-3, 0.1, 1 / 25.4, 1e3])


def measured(rng, robot, count=60):
    """Return nominal poses, places of a target somewhere in any frame [m], and distances [m]."""
    arm = load_arm(robot)
    low, high = np.clip(arm.limits_rad.T / 2, -1.5, 1.5)
    T_base_ee = Chain.of(arm).forward(rng.uniform(low, high, (count, arm.n)))
    R, p_ee_m = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.2, 0.2, 3)
    p_base_m = T_base_ee[:, :3, :3] @ p_ee_m + T_base_ee[:, :3, 3]
    p_m = p_base_m @ R.T + rng.uniform(-2, 2, 3) + rng.normal(0, 3e-3, (count, 3))
    point_m = rng.uniform(0.7, 1.5, 3)
    d_m = np.linalg.norm(p_base_m - point_m, axis=1) + rng.normal(0, 3e-3, count)
    return T_base_ee, p_m, d_m


@examples(40)
@given(seeds, units, st.sampled_from(["ur10", "pa10_6ce", "gx4_351s"]))
def test_the_scale_is_that_of_the_unit(seed, unit, robot):
    T_base_ee, p_m, d_m = measured(np.random.default_rng(seed), robot)
    assert scale_of_points(unit * p_m, T_base_ee) == pytest.approx(1 / unit, rel=0.2)
    scale = scale_of_distances(unit * d_m, T_base_ee)
    assert scale is None or scale == pytest.approx(1 / unit, rel=0.6)


def test_a_target_that_only_the_wrist_moves_does_not_tell():
    rng = np.random.default_rng(1)
    q = np.zeros((40, 6))
    q[:, 3:] = rng.uniform(-1, 1, (40, 3))
    T_base_ee = Chain.of(load_arm("pa10_6ce")).forward(q)
    p_m = T_base_ee[:, :3, :3] @ [0.0, 0.0, 0.4] + T_base_ee[:, :3, 3]
    assert scale_of_points(p_m, T_base_ee) is None


def test_what_does_not_follow_the_joints_does_not_tell():
    rng = np.random.default_rng(2)
    T_base_ee, p_m, d_m = measured(rng, "ur10")
    assert scale_of_points(rng.permutation(p_m), T_base_ee) is None
    assert scale_of_distances(rng.permutation(d_m), T_base_ee) is None
    assert scale_of_points(p_m[:7], T_base_ee[:7]) is None
    assert scale_of_distances(d_m[:7], T_base_ee[:7]) is None


def test_positions_along_one_line_do_not_tell():
    rng = np.random.default_rng(3)
    T_base_ee, p_m, _ = measured(rng, "ur10")
    along = p_m[:, :1] * [0.6, 0.0, 0.8] + rng.normal(0, 3e-3, p_m.shape)
    T_base_ee[:, :3, 3] = along
    assert scale_of_points(along, T_base_ee) is None
    assert scale_of_points(p_m, measured(np.random.default_rng(3), "ur10")[0]) is not None
