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

    def before(self, i):
        """Motions of a row before its joint moves."""
        offset = Rz(self.arm.theta_rad[i] + self.departures.theta_rad[i])
        return offset if self.arm.convention == "standard" else self.skew(i) @ offset

    def after(self, i):
        """Motions of a row after its joint has moved."""
        along_z = motion(p=(0, 0, self.arm.d_m[i] + self.departures.d_m[i]))
        return along_z @ self.skew(i) if self.arm.convention == "standard" else along_z

    def skew(self, i):
        along_x = motion(p=(self.arm.a_m[i] + self.departures.a_m[i], 0, 0))
        twist = Rx(self.arm.alpha_rad[i] + self.departures.alpha_rad[i])
        hayati = Ry(self.arm.beta_rad[i] + self.departures.beta_rad[i])
        standard = self.arm.convention == "standard"
        return along_x @ twist @ hayati if standard else hayati @ twist @ along_x

    def row(self, i, q):
        moves = motion(p=(0, 0, q)) if self.arm.prismatic[i] else Rz(q)
        return self.before(i) @ moves @ self.after(i)

    def frames(self, q):
        """Frame that the first row starts from, and of every row, in the base."""
        T = [self.arm.T_base_row1]
        for i, q_i in enumerate(q):
            T.append(T[-1] @ self.row(i, q_i))
        return T

    def ends(self, q):
        """Where each link but the last ends: the frame from which the next joint moves."""
        return [T @ self.before(i) for i, T in enumerate(self.frames(q)[1:-1], start=1)]

    def flange(self, q):
        return self.frames(q)[-1] @ self.arm.T_row_n_ee

    def weights(self, q, load_N):
        """(n + 2) masses and their places: links, apparatus, load."""
        T, flange = self.frames(q), self.flange(q)
        places = [
            *((T[i + 1] @ np.append(com, 1.0))[:3] for i, com in enumerate(self.com_m)),
            (flange @ np.append(self.apparatus.com_m, 1.0))[:3],
            (flange @ np.append(self.apparatus.load_point_m, 1.0))[:3],
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
