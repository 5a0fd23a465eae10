"""Arms of any shape."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.files.arms import load_arm


@pytest.fixture(scope="session")
def random_arm():
    """Draw an arm of n joints, some of which slide, with masses."""

    def draw(seed, n, convention="standard"):
        rng = np.random.default_rng(seed)
        return replace(
            load_arm("pa10_6ce"),
            convention=convention,
            theta_rad=rng.uniform(-3, 3, n),
            d_m=rng.uniform(-0.6, 0.6, n),
            a_m=rng.uniform(-0.6, 0.6, n),
            alpha_rad=rng.choice([0.0, np.pi / 2, -np.pi / 2, 0.3, 1e-7], n),
            hayati=np.zeros(n, bool),
            prismatic=rng.random(n) < 0.25,
            limits_rad=np.tile([-3.0, 3.0], (n, 1)),
            gear_ratio=np.ones(n),
            torque_limit_Nm=np.ones(n),
            mass_kg=rng.uniform(0.5, 15.0, n),
            com_m=rng.uniform(-0.3, 0.3, (n, 3)),
        )

    return draw
