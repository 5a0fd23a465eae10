"""Chains of links to turn."""

import numpy as np
import pytest


def _random_directions(seed, n, bend_rad):
    """Return unit vectors, each bent from the last by at most so much, to any side."""
    random = np.random.default_rng(seed)
    x = random.normal(size=3)
    directions = [x / np.linalg.norm(x)]
    for bend in random.uniform(0.0, bend_rad, n - 1):
        aside = np.cross(directions[-1], random.normal(size=3))
        aside /= np.linalg.norm(aside)
        u = np.cos(bend) * directions[-1] + np.sin(bend) * aside
        directions.append(u / np.linalg.norm(u))
    return np.array(directions)


@pytest.fixture(scope="session")
def random_directions():
    return _random_directions
