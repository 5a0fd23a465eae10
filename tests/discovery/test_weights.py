"""What each pose counts, and what the noise is."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import ATTITUDE_RAD, POSITION_M, observe
from pa10cal.discovery.near_poses import nearly_same, noise_of_near_poses
from pa10cal.discovery.pose_scatter import pose_weights, unweighted
from pa10cal.discovery.position_errors import mean_norm
from pa10cal.discovery.rules import NOISE
from pa10cal.observe.pose import Pose

POSES = 2000


def stated(position=1.0, attitude=1.0):
    cov = np.tile(np.diag([position**2] * 3 + [attitude**2] * 3), (POSES, 1, 1))
    return Pose.of(np.tile(np.eye(4), (POSES, 1, 1)), cov)


@pytest.mark.parametrize("said", [0.1, 10.0], ids=["too small", "too large"])
def test_poses_are_weighed_by_the_scatter_that_is_left(said):
    rng = np.random.default_rng(1)
    residual = rng.standard_normal((POSES, 6)) * [2.0, 2.0, 2.0, 6.0, 6.0, 6.0]
    found = pose_weights(residual, 0.0, stated(said, said))
    sizes = 1.0 / np.diagonal(found.whitener, axis1=1, axis2=2)[0]
    np.testing.assert_allclose(sizes, [2.0] * 3 + [6.0] * 3, rtol=0.05)
    assert np.mean(found.weight < 1.0) < 0.01


def test_a_pose_far_outside_weighs_less_and_is_not_left_out():
    rng = np.random.default_rng(2)
    residual = rng.standard_normal((POSES, 6))
    residual[7] *= 100.0
    found = pose_weights(residual, 0.0, stated())
    assert 0.0 < found.weight[7] < 0.1
    assert np.median(found.weight) == 1.0


def test_parameters_that_the_data_determine_make_the_scatter_larger():
    residual = np.random.default_rng(3).standard_normal((POSES, 6))
    plain, shrunk = (
        pose_weights(residual, used, stated(0.01, 0.01)) for used in (0.0, 3.0 * POSES)
    )
    ratio = plain.whitener[0, 0, 0] / shrunk.whitener[0, 0, 0]
    assert ratio == pytest.approx(np.sqrt(2.0), rel=0.01)


def test_poses_that_a_more_certain_reading_shows_weigh_more():
    rng = np.random.default_rng(4)
    measured = stated()
    measured.cov[:100] *= 9.0
    residual = rng.standard_normal((POSES, 6))
    residual[:100] *= 3.0
    found = pose_weights(residual, 0.0, measured)
    assert found.whitener[200, 0, 0] > 2.0 * found.whitener[0, 0, 0]


def test_readings_without_scatter_are_weighed_all_the_same():
    found = pose_weights(np.zeros((POSES, 6)), 0.0, stated())
    assert np.isfinite(found.whitener).all()
    np.testing.assert_allclose(unweighted(stated()).weight, 1.0)


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
