"""Variances of sources, and covariances where components are missing."""

import numpy as np
import pytest

from pa10cal.numerics.covariances import likelier_variances


def test_joints_are_not_all_of_the_noise_where_something_else_moved():
    """A step of 0.2 mm between repeats: two joints seem to make it, and leave four directions."""
    rng = np.random.default_rng(5)
    count, stated = 60, 1e-5
    screws = rng.normal(0.0, 0.5, (count, 6, 2))
    step = 1e-4 * rng.choice([0.0, 1.0], (count, 1)) * np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    difference = step + rng.normal(0.0, stated, (count, 6))
    of_joints = np.einsum("pik,pjk->pkij", screws, screws)
    of_instrument = np.tile(stated**2 * np.eye(6), (count, 1, 1, 1))
    sources = np.concatenate([of_joints, of_instrument], axis=1)
    seen = np.ones((count, 6), dtype=bool)
    joints_alone = np.array([1e-8, 1e-8, 1e-6])
    found = likelier_variances(joints_alone, np.array([0.0, 0.0, 1.0]), difference, sources, seen)
    assert found[:2].tolist() == [0.0, 0.0]
    mean_square = np.mean(difference**2)
    assert found[2] * stated**2 == pytest.approx(mean_square)
    right = np.array([0.0, 0.0, 1.0])
    noise = rng.normal(0.0, stated, (count, 6)) + 1e-3 * np.einsum(
        "pik,pk->pi", screws, rng.normal(0.0, 1.0, (count, 2))
    )
    both = likelier_variances(np.array([1e-6, 1e-6, 1.0]), right, noise, sources, seen)
    assert both[0] == pytest.approx(1e-6, rel=0.3)
