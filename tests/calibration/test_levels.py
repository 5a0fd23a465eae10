from dataclasses import replace

import numpy as np
import pytest

from pa10cal.calibration.levels import TwoLevel, rows_of, spread_poses
from pa10cal.errors import CalibrationError


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
    moved = np.eye(4)
    moved[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    moved[:3, 3] = [1.0, -2.0, 0.5]
    elsewhere = replace(
        level,
        observations=level.observations.with_measured(
            T_instr_target=moved @ level.observations.measured.T_instr_target
        ),
    )
    x = truth + 2 * level.model.scale
    first, second = level.rows(x).residual, elsewhere.rows(x).residual
    np.testing.assert_allclose(
        np.linalg.norm(first[:, :3], axis=1), np.linalg.norm(second[:, :3], axis=1), atol=1e-12
    )


def test_spread_poses_are_distinct_and_far_apart(level):
    chosen = spread_poses(level.observations, 8)
    assert len(set(chosen)) == 8
    assert len(rows_of(level.observations, chosen)) == 24
    assert spread_poses(level.observations, "all") == spread_poses(level.observations, 27)


def test_more_inner_poses_than_measured_are_refused(level):
    with pytest.raises(CalibrationError, match=r"inner_poses.*28.*1 to 27"):
        spread_poses(level.observations, 28)
