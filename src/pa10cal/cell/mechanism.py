"""The arm as a pinocchio model: placements from its rows, gravity torques, moments in its links."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.built import Apparatus, BuiltRobot, Departures

Array = NDArray[np.float64]

#: Gravity along the axes of the robot base [m/s^2].
GRAVITY_M_S2 = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Strain:
    """How the structure has moved from its unloaded shape.

    A link's end is the frame in which the next joint turns (the flange, for the last link).

    Attributes:
        base_turn_rad: (3,) small rotation of the base about its origin, along base axes.
        base_shift_m: (3,) displacement of the base along base axes.
        turn_rad: (n, 3) rotation of each link's end, along the axes of that end.
        shift_m: (n, 3) displacement of each link's end, along the axes of that end.
        stretch: (n,) relative growth of each link.
    """

    base_turn_rad: Array
    base_shift_m: Array
    turn_rad: Array
    shift_m: Array
    stretch: Array

    @classmethod
    def none(cls, n: int) -> Strain:
        """Return the unloaded shape of an arm with `n` joints."""
        return cls(np.zeros(3), np.zeros(3), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n))

    def __add__(self, other: Strain) -> Strain:
        return Strain(
            self.base_turn_rad + other.base_turn_rad,
            self.base_shift_m + other.base_shift_m,
            self.turn_rad + other.turn_rad,
            self.shift_m + other.shift_m,
            self.stretch + other.stretch,
        )

    def distance(self, other: Strain) -> float:
        """Return the largest difference of any component [rad, m or 1]."""
        return max(
            float(np.abs(self.base_turn_rad - other.base_turn_rad).max()),
            float(np.abs(self.base_shift_m - other.base_shift_m).max()),
            float(np.abs(self.turn_rad - other.turn_rad).max()),
            float(np.abs(self.shift_m - other.shift_m).max()),
            float(np.abs(self.stretch - other.stretch).max()),
        )


@dataclass(frozen=True)
class Moments:
    """What weights bend the structure with, in the posture last asked for.

    Attributes:
        link_Nm: (n, 3) moment that each link carries at its far end, about and along the axes of
            the frame from which the next joint turns or slides (zero for the last link, whose
            apparatus is part of it).
        base_Nm: (3,) overturning moment about the base's origin, along base axes.
    """

    link_Nm: Array
    base_Nm: Array


class Mechanism:
    """A pinocchio model of one arm, whose shape and hanging load may change.

    Joint i turns (or slides) about its own z axis. The part of its row that follows the joint,
    and the part of the next row that precedes the next joint, make the placement of joint i + 1.
    """

    def __init__(
        self,
        arm: Arm,
        departures: Departures,
        mass_kg: Array,
        com_m: Array,
        apparatus: Apparatus,
    ) -> None:
        before, after = row_parts(arm, departures)
        self.n = arm.n
        self._placements = [pin.SE3(arm.T_base_row1) * before[0]]
        self._placements += [last * first for last, first in zip(after, before[1:], strict=False)]
        self._flange = after[-1] * pin.SE3(arm.T_row_n_ee)
        self._flange_strained = self._flange
        self._moved = np.zeros(self.n, dtype=bool)
        self._load_point_m = apparatus.load_point_m
        self._model = pin.Model()
        self._model.gravity.linear = GRAVITY_M_S2
        for joint, placement in enumerate(self._placements):
            turns = pin.JointModelPZ() if arm.prismatic[joint] else pin.JointModelRZ()
            self._model.addJoint(joint, turns, placement, f"joint {joint + 1}")
            self._model.inertias[joint + 1] = after[joint].act(_body(mass_kg[joint], com_m[joint]))
        self._last_inertia = self._model.inertias[self.n] + self._flange.act(
            _body(apparatus.mass_kg, apparatus.com_m)
        )
        self._model.inertias[self.n] = self._last_inertia
        self._data = self._model.createData()

    @classmethod
    def of(cls, robot: BuiltRobot) -> Mechanism:
        """Return the robot as built."""
        return cls(robot.arm, robot.departures, robot.mass_kg, robot.com_m, robot.apparatus)

    @classmethod
    def nominal(cls, robot: BuiltRobot) -> Mechanism:
        """Return the robot with the geometry its maker describes."""
        none = Departures.none(robot.arm.n)
        return cls(robot.arm, none, robot.mass_kg, robot.com_m, robot.apparatus)

    @property
    def spans_m(self) -> Array:
        """(n, 3) from each joint to the end of its link, along the axes of that end."""
        ends = [*self._placements[1:], self._flange]
        return np.array([end.rotation.T @ end.translation for end in ends])

    def hang(self, load_N: float) -> None:
        """Hang a weight of `load_N` at the load point, in place of what hung there."""
        mass_kg = load_N / float(np.linalg.norm(GRAVITY_M_S2))
        weight = self._flange.act(_body(mass_kg, self._load_point_m))
        self._model.inertias[self.n] = self._last_inertia + weight

    def take_shape(self, strain: Strain) -> None:
        """Move base and links from their unloaded places by `strain`."""
        base = pin.SE3(pin.exp3(strain.base_turn_rad), strain.base_shift_m)
        self._model.jointPlacements[1] = base * self._placements[0]
        moves = strain.turn_rad.any(axis=1) | strain.shift_m.any(axis=1) | (strain.stretch != 0.0)
        ends = [*self._placements[1:], self._flange]
        for link in np.flatnonzero(moves | self._moved).tolist():
            end = ends[link]
            grown = pin.SE3(end.rotation, end.translation * (1.0 + strain.stretch[link]))
            moved = pin.SE3(pin.exp3(strain.turn_rad[link]), strain.shift_m[link])
            if link + 1 < self.n:
                self._model.jointPlacements[link + 2] = grown * moved
            else:
                self._flange_strained = grown * moved
        self._moved = moves

    def torques_Nm(self, q: Array) -> Array:
        """Return the (n,) torques that hold the arm at rest with its links at `q` (n,)."""
        tau: Array = pin.computeGeneralizedGravity(self._model, self._data, q).copy()
        return tau

    def moments(self) -> Moments:
        """Return the moments that go with the last call of `torques_Nm`."""
        placements, moved, holds = self._model.jointPlacements, self._data.liMi, self._data.f
        link_Nm = np.zeros((self.n, 3))
        for joint in range(2, self.n + 1):
            # A joint that slides takes its frame along, but not the end of the link before it.
            T_end_joint = placements[joint].actInv(moved[joint])
            # What holds the next link up; the link itself carries the opposite.
            link_Nm[joint - 2] = -T_end_joint.act(holds[joint]).angular
        return Moments(link_Nm, -moved[1].act(holds[1]).angular)

    def T_base_ee(self, q: Array) -> Array:
        """Return the (4, 4) flange in the base frame [m] with the links at `q` (n,)."""
        T: Array = self._flange_in_base(q).homogeneous.copy()
        return T

    def log_error(self, q: Array, T_base_wanted: Array) -> tuple[Array, Array]:
        """Return how far the flange is from a wanted place, and how the joints move it.

        Returns:
            (6,) motion [m, rad] that brings the flange there, along its own axes; and the (6, n)
            Jacobian of the flange along the same axes.
        """
        T_base_ee = self._flange_in_base(q)
        error = pin.log6(T_base_ee.actInv(pin.SE3(T_base_wanted))).vector
        in_joint = pin.computeJointJacobian(self._model, self._data, q, self.n)
        return error, self._flange_strained.toActionMatrixInverse() @ in_joint

    def _flange_in_base(self, q: Array) -> Any:
        pin.forwardKinematics(self._model, self._data, q)
        return self._data.oMi[self.n] * self._flange_strained


def row_parts(arm: Arm, departures: Departures) -> tuple[list[Any], list[Any]]:
    """Return, for every row, the constant motions before and after its joint, as pinocchio.SE3.

    The frames before the first row and after the last are not in them.
    """
    before, after = [], []
    for i in range(arm.n):
        offset = _turn("z", arm.theta_rad[i] + departures.theta_rad[i])
        along_z = _slide("z", arm.d_m[i] + departures.d_m[i])
        along_x = _slide("x", arm.a_m[i] + departures.a_m[i])
        twist = _turn("x", arm.alpha_rad[i] + departures.alpha_rad[i])
        hayati = _turn("y", arm.beta_rad[i] + departures.beta_rad[i])
        if arm.convention == "standard":
            before.append(offset)
            after.append(along_z * along_x * twist * hayati)
        else:
            before.append(hayati * twist * along_x * offset)
            after.append(along_z)
    return before, after


def _turn(axis: str, angle_rad: float) -> Any:
    return pin.SE3(pin.rpy.rotate(axis, angle_rad), np.zeros(3))


def _slide(axis: str, distance_m: float) -> Any:
    return pin.SE3(np.eye(3), distance_m * np.eye(3)["xyz".index(axis)])


def _body(mass_kg: float, com_m: Array) -> Any:
    """Return a point mass: at rest nothing else of a body matters."""
    return pin.Inertia(float(mass_kg), np.asarray(com_m, dtype=float), np.zeros((3, 3)))
