"""Campaigns that several tests of the search look at; none of them changes one."""

import numpy as np
import pytest

from made_up_arm import Measured, Missing, at_joint, harmonic, measure


@pytest.fixture(scope="session")
def null() -> Measured:
    """A campaign that lacks nothing."""
    return measure()


@pytest.fixture(scope="session")
def wave() -> Measured:
    """A transmission error at joint 2, sin(100 q + 1) of 2e-4 rad."""
    return measure(Missing(turn=harmonic(2, 100.0, 2e-4, 1.0)))


@pytest.fixture(scope="session")
def rubbing() -> Measured:
    """Friction of 3 N m in the flexible joint 3."""
    return measure(Missing(log=lambda states: at_joint(3, 3.0 * states.arrival[:, 2])))


@pytest.fixture(scope="session")
def bowed() -> Measured:
    """The instrument's x reads a bow along y, with more of it at one end."""

    def bow(p_instr_m):
        along = (p_instr_m[..., 1] - p_instr_m[..., 1].mean()) / 0.3
        return 1e-4 * (along**2 + 0.2 * along**3)[..., None] * np.array([1.0, 0.0, 0.0])

    return measure(Missing(read=bow))


@pytest.fixture(scope="session")
def soft_wrist() -> Measured:
    """Joint 4 yields to its torque, with 3000 N m/rad; no spring is in the model."""
    return measure(Missing(turn=lambda states: at_joint(4, -states.tau_Nm[:, 3] / 3000.0)))
