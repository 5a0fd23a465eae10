"""Targets of one rigid tool: what their distances say of the readings."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.observe.points import Points, keep_their_distances


def measured(places, u_m=1e-5):
    """Return readings of targets at places (P, B, 3), with a stated uncertainty."""
    cov_m2 = np.broadcast_to(u_m**2 * np.eye(3), (*places.shape, 3))
    return Points(tuple(f"T{k}" for k in range(1, places.shape[1] + 1)), places, cov_m2, None)


def test_targets_that_keep_their_distances_acquit_what_was_read():
    rng = np.random.default_rng(2)
    body = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    R = Rotation.random(40, random_state=3).as_matrix()
    places = rng.uniform(-1.0, 1.0, (40, 1, 3)) + np.einsum("pij,bj->pbi", R, body)
    places += rng.normal(0.0, 1e-5, places.shape)
    places[4] += [0.0, 0.02, 0.0]  # all of them elsewhere: the arm is, or the instrument
    places[7, 1] += [0.0, 0.001, 0.001]  # one of them alone
    places[9, :2] = np.nan
    found = keep_their_distances(measured(places))
    assert found[4]
    assert not found[7]
    assert not found[9]
    assert found.sum() >= 36
    # Of one rigid body: what is stated is far more than the distances scatter.
    assert not keep_their_distances(measured(places, 0.1)).any()
    assert not keep_their_distances(measured(places[:, :1])).any()


@pytest.mark.filterwarnings("error")
def test_targets_that_are_never_seen_together_acquit_nothing():
    places = np.full((9, 3, 3), np.nan)
    for pose in range(9):
        places[pose, pose % 3] = float(pose)
    assert not keep_their_distances(measured(places)).any()
    # Nor do those that are seen together say anything of poses of the third.
    places[:6, 0], places[:6, 1], places[:6, 2] = [0.0, 0.0, 0.0], [0.1, 0.0, 0.0], np.nan
    places[:6, 1, 0] += 1e-5 * np.array([-2.0, -1.0, 0.0, 0.0, 1.0, 2.0])
    places[6:, :2] = np.nan
    assert keep_their_distances(measured(places)).tolist() == [True] * 6 + [False] * 3
