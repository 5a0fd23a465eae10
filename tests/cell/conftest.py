"""A robot, and a second, plain way to compute what the cell asks pinocchio for."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from pa10cal.cell.built import Departures, Springs
from pa10cal.cell.individual import build_robot
from pa10cal.files.arms import load_arm
from pa10cal.settings import SimulateSettings

GRAVITY = np.array([0.0, 0.0, -9.80665])


def rotation(axis, angle):
    """Rodrigues, axis a unit vector."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def motion(R=None, p=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = np.eye(3) if R is None else R
    T[:3, 3] = p
    return T


def Rx(angle):
    return motion(rotation((1, 0, 0), angle))


def Ry(angle):
    return motion(rotation((0, 1, 0), angle))


def Rz(angle):
    return motion(rotation((0, 0, 1), angle))


@dataclass
class Plain:
    """An arm as a product of matrices, with point masses; no pinocchio."""

    arm: object
    departures: Departures
    mass_kg: np.ndarray
    com_m: np.ndarray
    apparatus: object

    def row(self, i, q):
        theta = self.arm.theta_rad[i] + self.departures.theta_rad[i]
        d = self.arm.d_m[i] + self.departures.d_m[i]
        if self.arm.prismatic[i]:
            d = d + q
        else:
            theta = theta + q
        a = self.arm.a_m[i] + self.departures.a_m[i]
        alpha = self.arm.alpha_rad[i] + self.departures.alpha_rad[i]
        along_z, along_x = motion(p=(0, 0, d)), motion(p=(a, 0, 0))
        hayati = Ry(self.departures.beta_rad[i])
        if self.arm.convention == "standard":
            return Rz(theta) @ along_z @ along_x @ Rx(alpha) @ hayati
        return Rx(alpha) @ along_x @ Rz(theta) @ along_z @ hayati

    def frames(self, q, base=None):
        """Frame of the base and of every row, in the world."""
        T = [np.eye(4) if base is None else base]
        for i, q_i in enumerate(q):
            T.append(T[-1] @ self.row(i, q_i))
        return T

    def weights(self, q, load_N, base=None):
        """(n + 2) masses and their places: links, apparatus, load."""
        T = self.frames(q, base)
        places = [
            *((T[i + 1] @ np.append(com, 1.0))[:3] for i, com in enumerate(self.com_m)),
            (T[-1] @ np.append(self.apparatus.com_m, 1.0))[:3],
            (T[-1] @ np.append(self.apparatus.load_point_m, 1.0))[:3],
        ]
        masses = [*self.mass_kg, self.apparatus.mass_kg, load_N / 9.80665]
        return np.array(masses), np.array(places)

    def energy(self, q, load_N):
        masses, places = self.weights(q, load_N)
        return -float(masses @ places @ GRAVITY)

    def moment(self, q, load_N, links, about):
        """Moment of the weights of all links from index `links` on, about a point of the world."""
        masses, places = self.weights(q, load_N)
        forces = masses[links:, None] * GRAVITY
        return np.cross(places[links:] - about, forces).sum(axis=0)


@pytest.fixture(scope="session")
def arm():
    return load_arm("pa10_6ce")


@pytest.fixture(scope="session")
def robot(arm):
    """The paper's robot."""
    return build_robot(arm, SimulateSettings(), "text_e7", np.random.default_rng(1))


@pytest.fixture(scope="session")
def rigid(robot):
    """The paper's robot with stiff joints."""
    return replace(robot, springs=Springs.rigid(robot.arm.n))


@pytest.fixture(scope="session")
def plain():
    """Make the plain counterpart of a robot as built."""

    def make(robot):
        return Plain(robot.arm, robot.departures, robot.mass_kg, robot.com_m, robot.apparatus)

    return make


@pytest.fixture(scope="session")
def short():
    """Settings of a campaign that takes no time."""
    return SimulateSettings(repeats=1, loads_N=(0.0, 44.0), holdout_repeats=1)
