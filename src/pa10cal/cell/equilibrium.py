"""Where the links of a loaded arm come to rest: springs and structure against gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.cell.built import BuiltRobot
from pa10cal.cell.effects.kinds import (
    CarriedTorqueEffect,
    Effect,
    Loading,
    LostMotionEffect,
    Shape,
    StructureEffect,
    WindupEffect,
)
from pa10cal.cell.mechanism import Mechanism, Strain
from pa10cal.errors import SimulationError

Array = NDArray[np.float64]

#: The iteration stops when no joint and no link moves by more than this [rad, m].
TOLERANCE = 1e-13
MAX_ITERATIONS = 200


@dataclass(frozen=True)
class RestPoses:
    """P configurations of an arm at rest.

    Attributes:
        q_rad: (P, n) link angles.
        tau_Nm: (P, n) torques that the motors exert.
        T_base_ee: (P, 4, 4) flange in the robot base frame [m].
    """

    q_rad: Array
    tau_Nm: Array
    T_base_ee: Array


def rest_poses(
    robot: BuiltRobot,
    effects: Sequence[Effect],
    drive_rad: Array,
    load_N: Array,
    time_s: Array,
    warming_K: Array,
    arrival: Array | None = None,
) -> RestPoses:
    """Find where the robot comes to rest.

    The torque is that of the deflected posture: tau(q) = k_lin (drive - q) + k_cub (drive - q)^3,
    equation (1) of the paper.

    Args:
        robot: the robot as built.
        effects: what else moves it; only those that torques or weights bring about matter here.
        drive_rad: (P, n) motor angles with what the transmissions add to them.
        load_N: (P,) hanging weights.
        time_s: (P,) times since the start of the campaign.
        warming_K: (P,) temperatures above the reference.
        arrival: (P, n) direction in which each joint arrived; None where no joint did.

    Raises:
        SimulationError: where no equilibrium is found.
    """
    arm = _YieldingArm(robot, effects)
    poses, n = drive_rad.shape
    arrived = np.zeros((poses, n)) if arrival is None else arrival
    rest = RestPoses(np.empty((poses, n)), np.empty((poses, n)), np.empty((poses, 4, 4)))
    for i in range(poses):
        arm.mechanism.hang(load_N[i])
        q, tau = arm.settle(drive_rad[i], arrived[i], time_s[i], warming_K[i])
        rest.q_rad[i], rest.tau_Nm[i] = q, tau
        rest.T_base_ee[i] = arm.mechanism.T_base_ee(q)
    return rest


def refuse_unrest(moved: float) -> SimulationError:
    """Return the refusal of an arm whose links or joints still move by `moved` [rad or m]."""
    return SimulationError(
        "the arm finds no rest under its weight",
        where="the virtual cell",
        value=f"still moving by {moved:.1e} rad or m after {MAX_ITERATIONS} rounds",
        allowed="springs and links much stiffer than gravity changes over their deflection",
        remedy="stiffen the springs or shrink the hidden compliance",
    )


class _YieldingArm:
    """A mechanism with everything in it that gives way under weights."""

    def __init__(self, robot: BuiltRobot, effects: Sequence[Effect]) -> None:
        self.mechanism = Mechanism.of(robot)
        self._shape = Shape.of(self.mechanism)
        self._carried = [effect for effect in effects if isinstance(effect, CarriedTorqueEffect)]
        self._windups = [effect for effect in effects if isinstance(effect, WindupEffect)]
        self._lost = [effect for effect in effects if isinstance(effect, LostMotionEffect)]
        self._structures = [effect for effect in effects if isinstance(effect, StructureEffect)]
        self._rated_Nm = robot.arm.torque_limit_Nm
        self._springs = robot.springs

    def settle(
        self, drive: Array, arrival: Array, time_s: float, warming_K: float
    ) -> tuple[Array, Array]:
        """Return link angles and torques at rest, and leave the mechanism in that shape.

        Torque and strain are taken from the last posture, the springs follow by a Newton step;
        since gravity changes little over a deflection, each round gains about two digits.
        """
        q, delta = drive.copy(), np.zeros_like(drive)
        strain = Strain.none(self.mechanism.n)
        for _ in range(MAX_ITERATIONS):
            tau = self.mechanism.torques_Nm(q)
            strain_next = self._strain(strain, time_s, warming_K)
            for pull in self._carried:
                tau += pull.carried_Nm(q)
            delta = self._springs.step(delta, tau)
            q_next = drive - delta - sum(effect.deflection_rad(tau) for effect in self._windups)
            for lost in self._lost:
                q_next += lost.lost_rad(tau, arrival, self._rated_Nm)
            moved = max(float(np.abs(q_next - q).max()), strain_next.distance(strain))
            q, strain = q_next, strain_next
            if moved <= TOLERANCE:
                return q, tau
        raise refuse_unrest(moved)

    def _strain(self, strain: Strain, time_s: float, warming_K: float) -> Strain:
        """Give the mechanism the shape that its moments ask for; return that strain."""
        if not self._structures:
            return strain
        loading = Loading(self._shape, self.mechanism.moments(), time_s, warming_K)
        total = Strain.none(self.mechanism.n)
        for effect in self._structures:
            total = total + effect.strain(loading)
        self.mechanism.take_shape(total)
        return total
