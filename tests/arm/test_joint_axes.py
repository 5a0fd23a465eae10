"""Rows laid through axes anywhere in space, parallel, meeting and near-parallel ones too."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.arm.imported import rows_through
from pa10cal.arrays import homogeneous

angles = st.sampled_from([0.0, np.pi, np.pi / 2, -np.pi / 2, 1e-12, 3e-8, 1e-3, 0.08, 0.09, 0.7])
lengths = st.sampled_from([0.0, 1e-11, 1e-6, 0.1, -0.4])
twists = st.tuples(angles, lengths, lengths, angles, angles)


def along(frames):
    """Return origins and z axes of frames."""
    return frames[:, :3, 3], frames[:, :3, 2]


def screw(turns, shifts):
    """Return a frame turned about z, shifted along z and x, turned about x and y."""
    return homogeneous(
        Rotation.from_euler("ZXY", turns).as_matrix(),
        Rotation.from_euler("z", turns[0]).apply([shifts[1], 0.0, shifts[0]]),
    )


@pytest.mark.slow
@settings(deadline=None, max_examples=300)
@given(steps=st.lists(twists, min_size=1, max_size=7), seed=st.integers(0, 1000))
def test_rows_end_on_the_axes_and_at_the_end_effector(steps, seed):
    rng = np.random.default_rng(seed)
    T = screw(rng.uniform(-3, 3, 3), rng.uniform(-0.5, 0.5, 2)) if seed % 3 else np.eye(4)
    frames = []
    for theta, d, a, alpha, beta in steps:
        frames.append(T)
        T = T @ screw((theta, alpha, beta), (d, a))
    p_base_m, axes = along(np.array(frames))
    p_base_m = p_base_m + axes * rng.uniform(-0.3, 0.3, (len(steps), 1))  # any point of each
    rows = rows_through(p_base_m, axes, T)
    starts = np.array([rows.T_base_row1, *rows.T_base_rows[:-1]])
    origins, found = along(starts)
    np.testing.assert_allclose(found, axes, atol=1e-12)
    off = np.linalg.norm(np.cross(origins - p_base_m, axes), axis=1)
    assert off.max() < 1e-9
    np.testing.assert_allclose(rows.T_base_rows[-1] @ rows.T_row_n_ee, T, atol=1e-12)
    # No row is thrown far out by axes that are all but parallel.
    assert np.abs(rows.parameters[:, 1:3]).max() < 20.0
    assert np.all(np.abs(rows.parameters[:-1, 0]) <= np.pi / 2 + 1e-9)


def test_a_small_tilt_of_parallel_axes_is_a_small_beta():
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1e-6, -2e-6, 1.0]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    p_base_m = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 5.0], [0.7, 0.0, -3.0]])
    _, d_m, a_m, alpha_rad, beta_rad = rows_through(p_base_m, axes, np.eye(4)).parameters.T
    np.testing.assert_allclose(a_m[:2], [0.4, 0.3], atol=1e-5)
    np.testing.assert_allclose(d_m[:2], 0.0, atol=1e-12)
    assert alpha_rad[1] == pytest.approx(2e-6, rel=1e-3)
    assert beta_rad[1] == pytest.approx(1e-6, rel=1e-3)
