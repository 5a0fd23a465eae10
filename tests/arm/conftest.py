"""Arms of any shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.arrays import homogeneous
from pa10cal.files.arms import load_arm


def anywhere(rng):
    """Return a random pose (4, 4)."""
    return homogeneous(
        Rotation.from_rotvec(rng.uniform(-2, 2, 3)).as_matrix(), rng.uniform(-0.5, 0.5, 3)
    )


@pytest.fixture(scope="session")
def random_arm():
    """Draw an arm of n joints, some of which slide, with masses, and often with frames around."""

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
            beta_rad=rng.choice([0.0, 0.2], n),
            T_base_row1=anywhere(rng) if seed % 3 else np.eye(4),
            T_row_n_ee=anywhere(rng) if seed % 2 else np.eye(4),
        )

    return draw
