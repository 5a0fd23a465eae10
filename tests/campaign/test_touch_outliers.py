"""Stray touches: the one that was moved is blamed, or none; never another."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.campaign.balls import find_outliers

RADIUS_MM, SIGMA_MM = 12.7, 0.01
LIMIT_MM = 6 * SIGMA_MM
BALLS_MM = np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)


def touches(rng, count):
    R = Rotation.random(count, random_state=rng).as_matrix()
    centres = BALLS_MM @ np.swapaxes(R, 1, 2) + rng.uniform(-500, 500, (count, 1, 3))
    exact = centres[:, :, None, :] + RADIUS_MM * NORMALS
    return exact + rng.normal(0, SIGMA_MM, exact.shape)


def found_in(p_mm, valid=None):
    valid = np.ones(p_mm.shape[:3], dtype=bool) if valid is None else valid
    return find_outliers(p_mm, valid, BALLS_MM, RADIUS_MM, LIMIT_MM, SIGMA_MM)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_clean_touches_are_left_alone(seed):
    outliers, undecided = found_in(touches(np.random.default_rng(seed), 20))
    assert not outliers.any()
    assert not undecided.any()


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    ball=st.integers(0, 2),
    touch=st.integers(0, 4),
    size_mm=st.sampled_from([0.3, 1.0, 10.0, 300.0]),
)
def test_blames_the_moved_touch_or_none(seed, ball, touch, size_mm):
    p_mm = touches(np.random.default_rng(seed), 6)
    p_mm[2, ball, touch] += size_mm * NORMALS[touch]
    outliers, undecided = found_in(p_mm)
    blamed = np.argwhere(outliers).tolist()
    assert blamed in ([[2, ball, touch]], [])
    assert not undecided[[0, 1, 3, 4, 5]].any()
    if touch:  # the one touch along its direction may shift its ball unseen, across the tool
        assert undecided[2] == (not blamed)


def test_two_opposite_touches_of_one_ball_are_told_apart_by_the_other_balls():
    p_mm = touches(np.random.default_rng(1), 40)
    # Moved along the line to another ball, the distance of the two says which touch is an outlier.
    R = Rotation.align_vectors((BALLS_MM[1] - BALLS_MM[0])[None], [[1.0, 0.0, 0.0]])[0]
    normals = NORMALS @ R.as_matrix().T
    p_mm = BALLS_MM[None, :, None] + RADIUS_MM * normals + 0 * p_mm
    p_mm[:, 0, 1] += 0.5 * normals[1]
    outliers, _ = found_in(p_mm)
    np.testing.assert_array_equal(np.argwhere(outliers), [[c, 0, 1] for c in range(40)])


def test_two_outliers_in_one_configuration_are_undecided():
    p_mm = touches(np.random.default_rng(3), 6)
    p_mm[4, 0, 1] += [0.8, 0.0, 0.0]
    p_mm[4, 1, 2] += [0.0, 0.9, 0.0]
    outliers, undecided = found_in(p_mm)
    assert not outliers.any()
    np.testing.assert_array_equal(np.flatnonzero(undecided), [4])
