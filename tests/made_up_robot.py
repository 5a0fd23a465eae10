"""Robots of the virtual cell, and a second, plain way to compute what their mechanism does."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.mechanism import Departures, Mechanism
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.robot import Robot, Springs, ring_of_targets, tool_payload

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


def pinocchio_of(arm):
    """Return the same rows as a model of joint placements, with masses, and its end on the last."""
    model = pin.Model()
    parent, placement = 0, pin.SE3(arm.T_base_row1)
    for k in range(arm.n):
        turned, raised = pin.SE3(Rz(arm.theta_rad[k])), pin.SE3(motion(p=(0, 0, arm.d_m[k])))
        shifted, twisted = pin.SE3(motion(p=(arm.a_m[k], 0, 0))), pin.SE3(Rx(arm.alpha_rad[k]))
        tilted = pin.SE3(Ry(arm.beta_rad[k]))
        joint = pin.JointModelPZ() if arm.prismatic[k] else pin.JointModelRZ()
        if arm.convention == "modified":
            before, after = tilted * twisted * shifted * turned, raised
        else:
            before, after = turned, raised * shifted * twisted * tilted
        parent = model.addJoint(parent, joint, placement * before, f"j{k}")
        body = pin.Inertia(arm.mass_kg[k], arm.com_m[k], np.zeros((3, 3)))
        model.appendBodyToJoint(parent, body, after)
        placement = after
    return model, placement * pin.SE3(arm.T_row_n_ee)


def robot_from_departures(arm, departures, T_instr_base=None, springs=None, targets=None):
    """A robot that departs by named parameters of its rows, and of `base` and `tool`.

    `base_x` to `base_rz`: shifts along x, y and z, then turns about the moved x, y and z, outside
    the arm's constant frame before its first row; those of `tool` behind the constant one.
    """

    def moved(frame):
        x, y, z, rx, ry, rz = (
            departures.get(f"{frame}_{each}", 0.0) for each in ("x", "y", "z", "rx", "ry", "rz")
        )
        return motion(p=(x, y, z)) @ Rx(rx) @ Ry(ry) @ Rz(rz)

    links = {name: value for name, value in departures.items() if name.startswith("delta_")}
    rows = Departures.named(arm.n, links)
    mechanism = Mechanism.of(arm, rows, tool_payload(1.0))
    return Robot(
        arm=arm,
        mechanism=replace(mechanism, T_last_ee=mechanism.T_last_ee @ moved("tool")),
        springs=springs or Springs.rigid(arm.n),
        T_instr_base=(np.eye(4) if T_instr_base is None else T_instr_base) @ moved("base"),
        targets=ring_of_targets(1) if targets is None else targets,
        T_ee_target=np.eye(4),
        departures=rows,
    )


def rebuilt(robot, arm=None, departures=None):
    """The same robot from another description, or with other departures of its rows."""
    arm = robot.arm if arm is None else arm
    departures = robot.departures if departures is None else departures
    mechanism = Mechanism.of(arm, departures, robot.mechanism.payload, robot.mechanism.mass_kg)
    return replace(robot, arm=arm, departures=departures, mechanism=mechanism)


def nominal_of(robot):
    """The mechanism that the maker describes."""
    return rebuilt(robot, departures=Departures.none(robot.arm.n)).mechanism


@dataclass
class Plain:
    """An arm as a product of matrices, with point masses."""

    arm: object
    departures: Departures
    mass_kg: np.ndarray
    com_m: np.ndarray
    payload: object

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

    def flange(self, q):
        return self.frames(q)[-1] @ self.arm.T_row_n_ee

    def weights(self, q, load_N):
        """(n + 2) masses and their places: links, apparatus, load."""
        T, flange = self.frames(q), self.flange(q)
        places = [
            *((T[i + 1] @ np.append(com, 1.0))[:3] for i, com in enumerate(self.com_m)),
            (flange @ np.append(self.payload.com_m, 1.0))[:3],
            (flange @ np.append(self.payload.load_point_m, 1.0))[:3],
        ]
        masses = [*self.mass_kg, self.payload.mass_kg, load_N / 9.80665]
        return np.array(masses), np.array(places)

    def energy(self, q, load_N):
        masses, places = self.weights(q, load_N)
        return -float(masses @ places @ GRAVITY)

    def moment(self, q, load_N, links, about):
        """Moment of the weights of all links from index `links` on, about a point of the world."""
        masses, places = self.weights(q, load_N)
        forces = masses[links:, None] * GRAVITY
        return np.cross(places[links:] - about, forces).sum(axis=0)


def track(arm, plan=None, seed=1, **settings):
    """Measure a drawn robot with a tracker; `settings` are those that any instrument has."""
    asked = SimulateOptions(random_seed=seed, without_touches=plan or TrackerOptions(), **settings)
    return simulate_campaign("tracked", arm, asked)


def logged_q(campaign):
    """Joint positions as logged (C, n) [rad, or m of a sliding joint]."""
    table, slides = campaign.tables["poses"], campaign.truth.robot.arm.prismatic
    return np.column_stack(
        [
            1e-3 * table[f"q{k}_mm"] if slide else np.radians(table[f"q{k}_deg"])
            for k, slide in enumerate(slides, start=1)
        ]
    )


def seen_m(campaign, *names):
    """Columns of what was read, in metres (unit quaternions stay what they are)."""
    table = campaign.tables["poses"]
    return np.column_stack([table[name] * (1e-3 if "mm" in name else 1.0) for name in names])


def seen_T(campaign):
    """Poses that a tracker of poses read, (C, 4, 4)."""
    T = np.tile(np.eye(4), (len(campaign.tables["poses"]), 1, 1))
    T[:, :3, 3] = seen_m(campaign, "x_mm", "y_mm", "z_mm")
    quaternion = seen_m(campaign, "qw", "qx", "qy", "qz")
    T[:, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return T


def seen_p(campaign):
    """Targets that a tracker of points read, (C, B, 3)."""
    names = campaign.truth.robot.targets.names
    columns = [f"{name}_{axis}_mm" for name in names for axis in "xyz"]
    return seen_m(campaign, *columns).reshape(-1, len(names), 3)
