"""Noise of poses that are nearly the same."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import measured_poses
from made_up_survey import ATTITUDE_RAD, POSITION_M, observe
from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.near_poses import nearly_same, noise_of_near_poses
from pa10cal.discovery.rules import NOISE
from pa10cal.fit.position_errors import mean_norm


@pytest.fixture(scope="module")
def with_neighbours():
    """Poses of which every other one is all but the one before."""
    poses = observe(poses=200, held_out=0).readings
    q_rad = np.repeat(poses.states.q_rad[::2], 2, axis=0)
    q_rad[1::2] += 1e-3 * np.random.default_rng(5).uniform(-1, 1, (100, 6))
    return replace(poses, states=replace(poses.states, q_rad=q_rad))


def test_nearly_equal_poses_are_paired_once(with_neighbours):
    first, second = nearly_same(with_neighbours)
    assert len(first) == 100
    np.testing.assert_array_equal(np.minimum(first, second) % 2, 0)
    np.testing.assert_array_equal(np.abs(first - second), 1)


def test_poses_under_different_loads_are_not_the_same(with_neighbours):
    load_N = np.tile([0.0, 22.0], 100)
    states = replace(with_neighbours.states, load_N=load_N)
    assert len(nearly_same(replace(with_neighbours, states=states))[0]) == 0


def test_noise_is_what_pairs_differ_by_and_not_what_they_share(with_neighbours):
    rng = np.random.default_rng(6)
    shared = np.repeat(rng.standard_normal((100, 6)), 2, axis=0)
    own = rng.standard_normal((200, 6)) * np.array([3e-5] * 3 + [2e-4] * 3)
    found = noise_of_near_poses(with_neighbours, shared + own)
    assert found.differences == 100
    sizes = np.sqrt(np.diagonal(found.cov[0]))
    np.testing.assert_allclose(sizes, [3e-5] * 3 + [2e-4] * 3, rtol=0.2)
    assert 1e3 * mean_norm(found.cov[:1, :3, :3])[0] == pytest.approx(
        1.596 * 1e3 * sizes[0], rel=0.05
    )


def test_along_a_path_noise_is_what_differences_go_to_at_the_same_pose():
    poses = observe(poses=400, held_out=0).readings
    along = 6e-3 * np.arange(400)[:, None] * np.array([1.0, 0.7, -0.8, 0.6, 0.9, -0.5])
    path = replace(poses, states=replace(poses.states, q_rad=along))
    rng = np.random.default_rng(7)
    sizes = np.array([3e-5] * 3 + [2e-4] * 3)
    # what the model lacks wanders along the path, by as much as the noise in 6 mrad
    lacking = np.cumsum(rng.standard_normal((400, 6)), axis=0) * sizes
    found = noise_of_near_poses(path, lacking + sizes * rng.standard_normal((400, 6)))
    assert found.differences >= 100
    assert "10 mrad" in found.origin
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.cov[0])), sizes, rtol=0.3)


def test_without_pairs_noise_is_what_the_instrument_states():
    poses = observe(poses=200, held_out=0).readings
    found = noise_of_near_poses(poses, np.zeros((200, 6)))
    assert found.differences == 0 < NOISE.least_differences
    np.testing.assert_allclose(
        np.diagonal(found.cov[0]), [POSITION_M**2] * 3 + [ATTITUDE_RAD**2] * 3
    )


STATED, NOISE_SIZE = 1e-5, 1e-4


def pairs_of_poses(count=60, apart=1e-3, seed=8, seen=None):
    """Return pairs of poses of two joints, 2 mrad apart at most, and residuals that are noise."""
    rng = np.random.default_rng(seed)
    q_rad = np.repeat(rng.uniform(-1.0, 1.0, (count, 2)), 2, axis=0)
    q_rad[1::2] += apart * rng.uniform(0.25, 1.0, (count, 2)) * rng.choice([-1, 1], (count, 2))
    rows = 2 * count
    states = PoseStates(
        q_rad=q_rad,
        tau_Nm=np.zeros((rows, 2)),
        arrival=np.zeros((rows, 2)),
        load_N=np.zeros(rows),
        temperature_C=np.full(rows, np.nan),
        time_s=np.arange(rows, dtype=float),
    )
    poses = measured_poses(
        pose=np.array([f"P{k}" for k in range(rows)]),
        states=states,
        T_instr_ee=np.tile(np.eye(4), (rows, 1, 1)),
        cov=np.tile(STATED**2 * np.eye(6), (rows, 1, 1)),
    )
    if seen is not None:

        class Partly(type(poses.measured)):
            components_seen = seen

        poses = replace(poses, measured=Partly(**vars(poses.measured)))
    return poses, NOISE_SIZE * rng.standard_normal((rows, 6))


def test_orientations_of_few_digits_leave_the_noise_of_positions():
    poses, residual = pairs_of_poses()
    whole = noise_of_near_poses(poses, residual)
    residual[:, 3:] = 0.0
    found = noise_of_near_poses(poses, residual)
    assert found.differences == 60
    np.testing.assert_array_equal(found.cov[:, :3, :3], whole.cov[:, :3, :3])
    np.testing.assert_allclose(found.cov[:, 3:, 3:], np.tile(STATED**2 * np.eye(3), (120, 1, 1)))
    assert found.origin.endswith("in every joint; attitude as stated")


def test_readings_that_were_copied_show_no_noise():
    poses, residual = pairs_of_poses()
    found = noise_of_near_poses(poses, np.zeros_like(residual))
    assert found.differences == 0
    assert found.origin.startswith("the instrument's stated uncertainty")


def test_pairs_without_a_component_in_common_do_not_count():
    seen = np.ones((120, 6), dtype=bool)
    seen[:60:2, :3] = seen[1:60:2, 3:] = False
    poses, residual = pairs_of_poses(seen=seen)
    found = noise_of_near_poses(poses, np.where(seen, residual, np.nan))
    assert found.differences == 30
    assert found.origin == "30 pairs of poses closer than 2 mrad in every joint"
    of_sliding = noise_of_near_poses(poses, np.where(seen, residual, np.nan), slides=True)
    assert of_sliding.origin == "30 pairs of poses closer than 2 mrad or 2 mm in every joint"


@pytest.mark.parametrize("apart", [1e-3, 9e-3])
def test_a_kind_that_no_pose_has_keeps_what_is_stated(apart):
    seen = np.ones((400, 6), dtype=bool)
    seen[:, 3:] = False
    poses, residual = pairs_of_poses(200, apart, seen=seen)
    found = noise_of_near_poses(poses, np.where(seen, residual, np.nan))
    assert np.isfinite(found.cov).all()
    assert np.sqrt(found.cov[0, 0, 0]) == pytest.approx(NOISE_SIZE, rel=0.3)


def test_a_smooth_error_of_the_model_leaves_the_noise_to_be_seen():
    """It differs between poses with their distance, in squares with the square of it."""
    sizes = []
    for seed in range(7):
        poses, residual = pairs_of_poses(400, 9.5e-3, seed)
        smooth = 0.04 * np.sin(poses.states.q_rad.sum(axis=1))[:, None]
        found = noise_of_near_poses(poses, residual + smooth)
        assert found.differences >= 100
        sizes.append(np.sqrt(np.diagonal(found.cov[0])))
    np.testing.assert_allclose(np.median(sizes, axis=0), NOISE_SIZE, rtol=0.3)
