"""Rigid fits: exact recovery, never a reflection, covariance that is the scatter it predicts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import fit_rigid, fit_rigid_weighted

BALLS_EE_MM = np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
seeds = st.integers(0, 2**32 - 1)


def random_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-1000, 1000, (count, 3))
    return T


def carried(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]


@settings(deadline=None, max_examples=40)
@given(seed=seeds, k=st.integers(3, 8), flatness=st.floats(0, 1))
def test_recovers_the_motion_for_any_points_that_span_a_plane(seed, k, flatness):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(k, 3)) * [100, 100, 100 * flatness]
    T = random_poses(rng, 5)
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


@settings(deadline=None, max_examples=30)
@given(seed=seeds)
def test_weighted_fit_is_stationary_and_agrees_with_the_closed_form_for_equal_covariances(seed):
    rng = np.random.default_rng(seed)
    target = carried(random_poses(rng, 4), BALLS_EE_MM) + rng.normal(size=(4, 3, 3))
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
    T = np.repeat(random_poses(rng, 1), 20_000, axis=0)
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
