"""Robots that several tests look at; none of them changes one."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_robot import Plain
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.individual import build_robot
from pa10cal_lab.cell.mechanism import Departures
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.robot import Springs


@pytest.fixture(scope="session")
def arm():
    return load_arm("pa10_6ce")


@pytest.fixture(scope="session")
def odd_arm(arm):
    """An arm in modified rows, two joints of which slide, on a pillar that leans, with a tool."""
    leaning, tool = np.eye(4), np.eye(4)
    leaning[:3] = [[1.0, 0.0, 0.0, 0.3], [0.0, 0.6, -0.8, -0.1], [0.0, 0.8, 0.6, 0.5]]
    tool[:3] = [[0.0, 0.0, 1.0, 0.05], [1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2]]
    prismatic = np.array([False, False, True, False, False, True])
    limits_rad = arm.limits_rad.copy()
    limits_rad[prismatic] = [-0.2, 0.4]
    return replace(
        arm,
        name="odd",
        convention="modified",
        prismatic=prismatic,
        limits_rad=limits_rad,
        beta_rad=np.array([0.0, 0.0, 0.3, 0.0, 0.0, -0.2]),
        T_base_row1=leaning,
        T_row_n_ee=tool,
    )


@pytest.fixture(scope="session", params=["pa10_6ce", "odd"])
def any_arm(arm, odd_arm, request):
    """One arm of the usual kind, and one of all others."""
    return arm if request.param == "pa10_6ce" else odd_arm


@pytest.fixture(scope="session")
def robot(arm):
    """The paper's robot."""
    return build_robot(arm, SimulateOptions(), "text_e7", np.random.default_rng(1))


@pytest.fixture(scope="session")
def rigid(robot):
    """The paper's robot with stiff joints."""
    return replace(robot, springs=Springs.rigid(robot.arm.n))


@pytest.fixture(scope="session")
def plain():
    """Make the plain counterpart of a robot as built."""

    def make(robot):
        mechanism = robot.mechanism
        departures = robot.departures or Departures.none(robot.arm.n)
        return Plain(robot.arm, departures, mechanism.mass_kg, robot.arm.com_m, mechanism.payload)

    return make


@pytest.fixture(scope="session")
def short():
    """Settings of a campaign that takes no time."""
    return SimulateOptions(repeats=1, loads_N=(0.0, 44.0), holdout_repeats=1)
