"""Base frame from a rigid fit of the nominal model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import seed_from_nominal


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
