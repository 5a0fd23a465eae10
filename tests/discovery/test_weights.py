"""What each pose counts, and what the noise is."""

import numpy as np
import pytest

from pa10cal.discovery.pose_scatter import pose_weights, unweighted
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
