"""Readings far from a model: what speaks for them."""

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.fit.tails import keep_their_distances


def test_targets_that_keep_their_distances_acquit_what_was_read():
    rng = np.random.default_rng(2)
    body = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    R = Rotation.random(40, random_state=3).as_matrix()
    places = rng.uniform(-1.0, 1.0, (40, 1, 3)) + np.einsum("pij,bj->pbi", R, body)
    places += rng.normal(0.0, 1e-5, places.shape)
    places[4] += [0.0, 0.02, 0.0]  # all of them elsewhere: the arm is, or the instrument
    places[7, 1] += [0.0, 0.001, 0.001]  # one of them alone
    places[9, :2] = np.nan
    found = keep_their_distances(places)
    assert found[4]
    assert not found[7]
    assert not found[9]
    assert found.sum() >= 36
    assert not keep_their_distances(places[:, :1]).any()
