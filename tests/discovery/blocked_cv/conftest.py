"""Surveys that several tests look at; none of them changes one."""

import numpy as np
import pytest

from made_up_survey import Hidden, Surveyed, at_joint, observe, rough


@pytest.fixture(scope="session")
def nothing_hidden() -> Surveyed:
    """A survey that lacks nothing."""
    return observe()


@pytest.fixture(scope="session")
def mapped() -> Surveyed:
    """An error of joint 3 that only a map can follow."""
    return observe(Hidden(turn=rough(3)))


@pytest.fixture(scope="session")
def eccentric() -> Surveyed:
    """An encoder disk off its centre at joint 2, 1e-4 sin(q + 0.7) rad."""
    return observe(Hidden(turn=lambda states: at_joint(2, 1e-4 * np.sin(states.q_rad[:, 1] + 0.7))))


@pytest.fixture(scope="session")
def twisted() -> Surveyed:
    """The attitude alone turns about joint 5, by the side from which that came."""

    def twist(states, axes):
        return 1.5e-4 * states.arrival[:, 4:5] * axes[:, :, 4]

    return observe(Hidden(twist=twist))
