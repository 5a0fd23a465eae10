"""Where the links of a loaded arm come to rest: springs and structure against gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.cell.effects.effect import (
    CarriedTorqueEffect,
    Effect,
    Loading,
    LostMotionEffect,
    StructureEffect,
    WindupEffect,
)
from pa10cal.cell.mechanism import Strain
from pa10cal.cell.robot import Robot
from pa10cal.errors import SimulationError

#: The iteration stops when no joint and no link moves by more than this [rad, m].
TOLERANCE = 1e-13
MAX_ITERATIONS = 200


@dataclass(frozen=True)
class Rest:
    """P configurations of an arm at rest."""

    q: Array  # (P, n) positions of the links [rad, or m of a prismatic joint]
    tau_Nm: Array  # (P, n) torques that the motors exert (forces [N] of prismatic joints)
    T_base_ee: Array  # (P, 4, 4) flange in the robot base frame [m]


def rest_poses(
    robot: Robot,
    effects: Sequence[Effect],
    drive: Array,
    load_N: Array,
    time_s: Array,
    warming_K: Array,
    arrival: Array | None = None,
) -> Rest:
    """Find where the robot comes to rest.

    The torque is that of the deflected posture: tau(q) = k_lin (drive - q) + k_cub (drive - q)^3,
    equation (1) of the paper. Torque and strain are taken from the last posture, the springs
    follow by a Newton step; since gravity changes little over a deflection, each round gains about
    two digits.

    Args:
        robot: the robot as built.
        effects: what else moves it; only those that torques or weights bring about matter here.
        drive: (P, n) motor positions with what the transmissions add to them [rad, or m].
        load_N: (P,) hanging weights.
        time_s: (P,) times since the start of the campaign.
        warming_K: (P,) temperatures above the reference.
        arrival: (P, n) direction in which each joint arrived; None where no joint did.

    Raises:
        SimulationError: where no equilibrium is found.
    """
    mechanism, springs = robot.mechanism, robot.springs
    rated_Nm = robot.arm.torque_limit_Nm
    arrived = np.zeros_like(drive) if arrival is None else arrival
    structures = [effect for effect in effects if isinstance(effect, StructureEffect)]
    strain = Strain.none(*drive.shape) if structures else None
    q, delta = drive, np.zeros_like(drive)
    for _ in range(MAX_ITERATIONS):
        held = mechanism.statics(q, load_N, strain)
        tau = held.torque_Nm
        moved = 0.0
        if strain is not None:
            loading = Loading(mechanism, held, time_s, warming_K)
            before, strain = strain, Strain.none(*drive.shape)
            for structure in structures:
                strain = strain + structure.strain(loading)
            moved = strain.distance(before)
        for effect in effects:
            if isinstance(effect, CarriedTorqueEffect):
                tau = tau + effect.carried_Nm(q)
        delta = springs.step(delta, tau)
        q_next = drive - delta
        for effect in effects:
            if isinstance(effect, WindupEffect):
                q_next = q_next - effect.deflection_rad(tau, q)
            elif isinstance(effect, LostMotionEffect):
                q_next = q_next + effect.lost_rad(tau, arrived, rated_Nm)
        moved = max(moved, float(np.abs(q_next - q).max(initial=0.0)))
        q = q_next
        if moved <= TOLERANCE:
            return Rest(q, tau, mechanism.T_base_ee(q, strain))
    raise SimulationError(
        "the arm finds no rest under its weight",
        where="the virtual cell",
        value=f"still moving by {moved:.1e} rad or m after {MAX_ITERATIONS} rounds",
        allowed="springs and links much stiffer than gravity changes over their deflection",
        remedy="stiffen the springs or shrink the hidden compliance",
    )
