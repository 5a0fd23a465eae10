"""Campaigns that several tests of the search look at; none of them changes one."""

import numpy as np
import pytest

from built_once import built_once
from made_up_arm import Measured, Missing, at_joint, harmonic, measure
from made_up_survey import Hidden, Surveyed, observe, rough


@pytest.fixture(scope="session")
def searched(tmp_path_factory):
    """Measure what hides something, and search it; built once a session under a name."""

    def once(name, measuring, *hidden):
        def build(folder):
            measured = measuring(*hidden)
            _ = measured.discovery
            return measured

        return built_once(tmp_path_factory, name, build)

    return once


@pytest.fixture(scope="session")
def null(searched) -> Measured:
    """A campaign that lacks nothing."""
    return searched("null", measure)


@pytest.fixture(scope="session")
def wave(searched) -> Measured:
    """A transmission error at joint 2, sin(100 q + 1) of 2e-4 rad."""
    return searched("wave", measure, Missing(turn=harmonic(2, 100.0, 2e-4, 1.0)))


@pytest.fixture(scope="session")
def rubbing(searched) -> Measured:
    """Friction of 3 N m in the flexible joint 3."""

    def log(states):
        return at_joint(3, 3.0 * states.arrival[:, 2])

    return searched("rubbing", measure, Missing(log=log))


@pytest.fixture(scope="session")
def bowed(searched) -> Measured:
    """The instrument's x reads a bow along y, with more of it at one end."""

    def bow(p_instr_m):
        along = (p_instr_m[..., 1] - p_instr_m[..., 1].mean()) / 0.3
        return 1e-4 * (along**2 + 0.2 * along**3)[..., None] * np.array([1.0, 0.0, 0.0])

    return searched("bowed", measure, Missing(read=bow))


@pytest.fixture(scope="session")
def soft_wrist(searched) -> Measured:
    """Joint 4 yields to its torque, with 3000 N m/rad; no spring is in the model."""

    def turn(states):
        return at_joint(4, -states.tau_Nm[:, 3] / 3000.0)

    return searched("soft_wrist", measure, Missing(turn=turn))


@pytest.fixture(scope="session")
def nothing_hidden(searched) -> Surveyed:
    """A survey that lacks nothing."""
    return searched("nothing_hidden", observe)


@pytest.fixture(scope="session")
def mapped(searched) -> Surveyed:
    """An error of joint 3 that only a map can follow."""
    return searched("mapped", observe, Hidden(turn=rough(3)))


@pytest.fixture(scope="session")
def eccentric(searched) -> Surveyed:
    """An encoder disk off its centre at joint 2, 1e-4 sin(q + 0.7) rad."""

    def turn(states):
        return at_joint(2, 1e-4 * np.sin(states.q_rad[:, 1] + 0.7))

    return searched("eccentric", observe, Hidden(turn=turn))


@pytest.fixture(scope="session")
def entangled(searched) -> Surveyed:
    """Joint 2 errs by where joints 1 and 3 are together, as no effect of one joint does."""

    def turn(states):
        return at_joint(2, 3e-4 * np.sin(states.q_rad[:, 0] + states.q_rad[:, 2]))

    return searched("entangled", observe, Hidden(turn=turn))


@pytest.fixture(scope="session")
def worn(searched) -> Surveyed:
    """Joint 3 has lost motion of 4e-4 rad in two fifths of its angles, where its gear is worn."""

    def turn(states):
        q_rad = states.q_rad[:, 2]
        low, high = np.quantile(q_rad, [0.3, 0.7])
        return at_joint(3, -4e-4 * states.arrival[:, 2] * ((low < q_rad) & (q_rad < high)))

    return searched("worn", observe, Hidden(turn=turn))


@pytest.fixture(scope="session")
def twisted(searched) -> Surveyed:
    """The orientation alone turns about joint 5, by the side from which that came."""

    def twist(states, axes):
        return 1.5e-4 * states.arrival[:, 4:5] * axes[:, :, 4]

    return searched("twisted", observe, Hidden(twist=twist))
