"""Arms to try the Monte Carlo on."""

from collections.abc import Callable

import numpy as np
import pytest

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.files.arms import load_arm


@pytest.fixture(scope="session")
def pa10() -> Arm:
    return load_arm("pa10_6ce")


@pytest.fixture(scope="session")
def pa10_chain(pa10: Arm) -> Chain:
    return Chain.of(pa10)


@pytest.fixture(scope="session")
def make_arm() -> Callable[..., Arm]:
    """Build an arm from rows (d, a, alpha_deg)."""

    def build(
        rows: list[tuple[float, float, float]],
        convention: str = "standard",
        limit_rad: float = 3.0,
        prismatic: tuple[bool, ...] | None = None,
    ) -> Arm:
        n = len(rows)
        d, a, alpha = np.array(rows).T
        return Arm(
            name="trial",
            title="trial",
            convention=convention,
            theta_rad=np.linspace(-0.4, 0.7, n),
            d_m=d,
            a_m=a,
            alpha_rad=np.radians(alpha),
            hayati=np.zeros(n, dtype=bool),
            prismatic=np.array(prismatic or (False,) * n),
            limits_rad=np.tile([-limit_rad, limit_rad], (n, 1)),
            gear_ratio=np.ones(n),
            torque_limit_Nm=np.ones(n),
            mass_kg=None,
            com_m=None,
        )

    return build
