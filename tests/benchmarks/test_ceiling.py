"""What is held out of the comparison with learners, and what counts as the ceiling."""

import numpy as np
import pytest
from benchmarks.ceiling.__main__ import Ceiling, held_out_clusters


def test_whole_clusters_of_configurations_are_held_out():
    rng = np.random.default_rng(2)
    places = rng.uniform(-1.5, 1.5, (24, 6))
    q_rad = np.repeat(places, 10, axis=0) + rng.normal(0.0, 0.01, (240, 6))
    out = held_out_clusters(q_rad, 1)
    assert 0.25 <= out.mean() <= 0.4
    # The nearest of any pose is held out with it, but where one place has two clusters.
    apart = np.linalg.norm(q_rad[:, None] - q_rad, axis=2) + 9.0 * np.eye(240)
    assert np.mean(out[apart.argmin(axis=1)] == out) > 0.95
    assert (out != held_out_clusters(q_rad, 2)).any()


def test_a_learner_that_is_worse_than_geometry_is_no_ceiling():
    found = Ceiling("made-up", 40, 0.2, 0.15, {"trees": 0.3, "boosted": 0.25})
    assert found.ratio == pytest.approx(0.75)
    assert Ceiling("made-up", 40, 0.2, 0.15, {"trees": 0.1}).ratio == pytest.approx(1.5)
