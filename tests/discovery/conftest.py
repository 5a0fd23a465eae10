"""Campaigns that several tests of the search look at; none of them changes one."""

import numpy as np
import pytest

import made_up_survey
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


@pytest.fixture(scope="session")
def nothing_hidden() -> made_up_survey.Surveyed:
    """A survey that lacks nothing."""
    return made_up_survey.observe()


@pytest.fixture(scope="session")
def mapped() -> made_up_survey.Surveyed:
    """An error of joint 3 that only a map can follow."""
    return made_up_survey.observe(made_up_survey.Hidden(turn=made_up_survey.rough(3)))


@pytest.fixture(scope="session")
def eccentric() -> made_up_survey.Surveyed:
    """An encoder disk off its centre at joint 2, 1e-4 sin(q + 0.7) rad."""
    return made_up_survey.observe(
        made_up_survey.Hidden(
            turn=lambda states: at_joint(2, 1e-4 * np.sin(states.q_rad[:, 1] + 0.7))
        )
    )


@pytest.fixture(scope="session")
def twisted() -> made_up_survey.Surveyed:
    """The attitude alone turns about joint 5, by the side from which that came."""

    def twist(states, axes):
        return 1.5e-4 * states.arrival[:, 4:5] * axes[:, :, 4]

    return made_up_survey.observe(made_up_survey.Hidden(twist=twist))
