"""Least-squares spheres: exact recovery, covariance as predicted, planes noticed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.campaign.balls import fit_spheres, pooled_touch_sigma_mm, touch_sigma_mm

RADIUS_MM = 12.7
FIVE = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)


def all_there(p_mm):
    return np.ones(p_mm.shape[:2], dtype=bool)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), touches=st.integers(4, 9))
def test_finds_centres_from_any_exact_touches_off_a_plane(seed, touches):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-1000, 1000, (6, 3))
    normals = rng.normal(size=(6, touches, 3))
    normals[..., 2] = np.abs(normals[..., 2])  # a probe reaches the upper half only
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    p_mm = centres[:, None] + RADIUS_MM * normals
    valid = all_there(p_mm)
    fit = fit_spheres(p_mm, valid, RADIUS_MM)
    good = ~fit.coplanar
    np.testing.assert_allclose(fit.centre_mm[good], centres[good], atol=1e-7)
    np.testing.assert_allclose(fit.residual_mm[good], 0.0, atol=1e-7)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_padding_does_not_change_a_ball(seed):
    rng = np.random.default_rng(seed)
    p_mm = RADIUS_MM * FIVE + rng.normal(0, 0.01, (3, 5, 3))
    alone = fit_spheres(p_mm, all_there(p_mm), RADIUS_MM)
    padded = np.concatenate([rng.normal(0, 1e3, (3, 2, 3)), p_mm], axis=1)
    valid = np.arange(7) >= 2
    fit = fit_spheres(padded, np.tile(valid, (3, 1)), RADIUS_MM)
    np.testing.assert_allclose(fit.centre_mm, alone.centre_mm, atol=1e-9)
    np.testing.assert_allclose(fit.cofactor, alone.cofactor, rtol=1e-9)
    np.testing.assert_array_equal(fit.residual_mm[:, :2], 0.0)
    np.testing.assert_array_equal(fit.touches, 5)


def test_covariance_is_the_scatter_of_many_noisy_balls():
    rng = np.random.default_rng(5)
    noise_mm = 0.01
    p_mm = RADIUS_MM * FIVE + rng.normal(0, noise_mm, (20_000, 5, 3))
    fit = fit_spheres(p_mm, all_there(p_mm), RADIUS_MM)
    predicted = noise_mm**2 * fit.cofactor.mean(axis=0)
    np.testing.assert_allclose(np.cov(fit.centre_mm.T), predicted, atol=0.03 * noise_mm**2)
    every = np.ones(len(fit.touches), dtype=bool)
    assert pooled_touch_sigma_mm(fit, every) == pytest.approx(noise_mm, rel=0.02)


def test_touch_sigma_gives_the_stated_uncertainty_of_a_centre_on_average():
    p_mm = np.tile(RADIUS_MM * FIVE, (4, 1, 1))
    fit = fit_spheres(p_mm, all_there(p_mm), RADIUS_MM)
    variance = touch_sigma_mm(fit, 0.0121) ** 2 * np.trace(fit.cofactor[0]) / 3
    assert variance == pytest.approx(0.0121**2)


@pytest.mark.parametrize("rows", [[1, 2, 3, 4], [0, 1, 3], [0, 1], [0]])
def test_notices_touches_in_a_plane(rows):
    rng = np.random.default_rng(6)
    p_mm = (RADIUS_MM * FIVE[rows] + rng.normal(0, 0.01, (len(rows), 3)))[None]
    assert fit_spheres(p_mm, all_there(p_mm), RADIUS_MM).coplanar.all()


def test_four_touches_off_a_plane_suffice():
    p_mm = (RADIUS_MM * FIVE[:4])[None]
    fit = fit_spheres(p_mm, all_there(p_mm), RADIUS_MM)
    assert not fit.coplanar.any()
    np.testing.assert_allclose(fit.centre_mm, 0.0, atol=1e-9)
