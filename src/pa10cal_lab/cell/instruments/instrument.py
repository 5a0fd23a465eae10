"""Interface of simulated instruments, and the truth of the configurations that they measure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.effects.effect import JointState, Loading, SimulatedEffect, with_added
from pa10cal_lab.cell.mechanism import Strain
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import Poses
from pa10cal_lab.cell.robot import Robot
from pa10cal_lab.cell.schedule import Schedule

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
    effects: Sequence[SimulatedEffect],
    drive: Array,
    load_N: Array,
    time_s: Array,
    warming_K: Array,
    arrival: Array | None = None,
) -> Rest:
    """Return the equilibrium of springs and structure with gravity.

    The torque is that of the deflected posture: tau(q) = k_lin (drive - q) + k_cub (drive - q)^3,
    equation (1) of the paper. Torque and strain are those of the last posture, and the springs
    follow by a Newton step; since gravity changes little over a deflection, each iteration gains
    about two digits.

    Args:
        effects: of the robot; only those by torques or weights matter here.
        drive: (P, n) motor positions with what the transmissions add to them [rad, or m].
        load_N: (P,) hanging weights.
        time_s: (P,) times since the start of the campaign.
        warming_K: (P,) temperatures above the reference.
        arrival: (P, n) direction in which each joint arrived; None where no joint did.

    Raises:
        SimulationError: where no equilibrium is found.
    """
    mechanism, springs = robot.mechanism, robot.springs
    gear_ratio, rated_Nm = robot.arm.gear_ratio, robot.arm.torque_limit_Nm
    bars = robot.arm.coupling
    arrived = np.zeros_like(drive) if arrival is None else arrival
    structures = [effect for effect in effects if effect.strains]
    strain = Strain.none(*drive.shape) if structures else None
    q, delta = drive, np.zeros_like(drive)
    for _ in range(MAX_ITERATIONS):
        held = mechanism.statics(q, load_N, strain)
        tau = bars.at_drives(held.torque_Nm)
        moved = 0.0
        if strain is not None:
            loading = Loading(mechanism, held, q, time_s, warming_K)
            before, strain = strain, Strain.none(*drive.shape)
            for structure in structures:
                strain = strain + structure.strain(loading)
            moved = strain.distance(before)
        motion = JointState(q, arrived, gear_ratio)
        tau = with_added(tau, "carried", effects, motion)
        delta = springs.step(delta, tau)
        under_load = replace(motion, tau_Nm=tau, rated_Nm=rated_Nm)
        q_next = with_added(drive - delta, "windup", effects, under_load)
        if not bars.none:  # as a drive winds up, it moves all joints that it drives
            q_next = drive + bars.with_drives(q_next - drive)
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


Streams = Mapping[str, np.random.Generator]

#: Decimals of logged positions.
DEG_DECIMALS = 5
MM_DECIMALS = 4


@dataclass(frozen=True)
class Truth:
    """Everything that a campaign hides."""

    robot: Robot  # the robot as built
    effects: tuple[SimulatedEffect, ...]  # what it does beyond the paper's model
    # commanded joint positions by purpose; None where they were drawn one by one
    poses: Poses | None
    schedule: Schedule  # the C configurations in the order of time
    q_motor: Array  # (C, n) motor positions at rest [rad, or m of a prismatic joint]
    rest: Rest  # where the links came to rest
    temperature_C: Array  # (C,) temperatures at rest

    @property
    def tool_shift_m(self) -> Array:
        """(C, 3) displacements of the tool along flange axes."""
        shift = np.zeros((len(self.schedule), 3))
        for effect in self.effects:
            if (own := effect.shift_m(self.rest.T_base_ee[:, :3, :3])) is not None:
                shift = shift + own
        return shift

    @property
    def p_instr_targets_m(self) -> Array:
        """(C, B, 3) where the targets are, in the instrument's frame."""
        return self.robot.p_instr_targets_m(self.rest.T_base_ee, self.tool_shift_m)

    def as_read(self, p_instr_m: Array) -> Array:
        """Return points (..., 3) as the instrument reads them, without noise."""
        read = p_instr_m.copy()
        for effect in self.effects:
            if (extra := effect.read_too_much_m(p_instr_m)) is not None:
                read += extra
        return read

    def as_logged(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return torques (P, n) with errors of the log."""
        motion = JointState(np.zeros_like(tau_Nm), arrival, self.robot.arm.gear_ratio, tau_Nm)
        return with_added(tau_Nm, "log", self.effects, motion)


class SimulatedInstrument(ABC):
    """An instrument and the way a robot is moved to its poses and measured."""

    kind: ClassVar[str]  # the word of `instrument.kind` in campaign.yaml
    files: ClassVar[Mapping[str, str]]  # names of the raw files by their key in campaign.yaml
    # purposes of the streams of random numbers; a new one goes to the end, so that the others stay
    # as they are
    streams: ClassVar[tuple[str, ...]]
    # number of decimals of a column in its file, by the end of its name; others are not rounded
    decimals: ClassVar[Mapping[str, int]]

    def __init__(self, settings: SimulateOptions) -> None:
        self.settings = settings

    @abstractmethod
    def schedule(self, robot: Robot, streams: Streams) -> tuple[Schedule, Poses | None]:
        """Return the configurations of a campaign, and their poses by purpose."""

    @property
    @abstractmethod
    def at_rest_s(self) -> float:
        """Return the time from the start of a move to a configuration until its reading."""

    @abstractmethod
    def motors(self, schedule: Schedule, streams: Streams) -> tuple[Array, Array]:
        """Return motor positions (C, n), and the true ones of the links' drives, not logged."""

    @abstractmethod
    def measure(self, truth: Truth, streams: Streams) -> dict[str, pd.DataFrame]:
        """Return the raw tables by the keys of `files`."""

    @abstractmethod
    def description(self, robot: Robot) -> dict[str, Any]:
        """Return the description in campaign.yaml of instrument and tool."""


def as_written(arm: Arm, q: Array) -> Array:
    """Return joint positions (N, n) [rad, or m of a prismatic joint], rounded as in a file."""
    mm, deg = (1e3 * q).round(MM_DECIMALS), np.degrees(q).round(DEG_DECIMALS)
    return np.asarray(np.where(arm.prismatic, 1e-3 * mm, np.radians(deg)))


def position_columns(arm: Arm, q: Array) -> dict[str, Array]:
    """Return the columns of joint positions (N, n) [rad, or m if prismatic], as in a file."""
    axes = zip(arm.axes_slide, arm.coupling.to_axes(q).T, strict=True)
    return {
        f"q{joint}_mm" if slides else f"q{joint}_deg": (
            (1e3 * column).round(MM_DECIMALS) if slides else np.degrees(column).round(DEG_DECIMALS)
        )
        for joint, (slides, column) in enumerate(axes, start=1)
    }


def tool_of(robot: Robot, *, weighed: bool = True, measured: bool = True) -> dict[str, Any]:
    """Return `tool` of campaign.yaml.

    Args:
        weighed: whether its mass is stated; a mass of 0 means not stated.
        measured: whether positions of targets are stated.
    """
    payload, targets, known = robot.mechanism.payload, robot.targets, 1.0 if weighed else 0.0
    places_mm = (1e3 * targets.p_ee_stated_m).round(MM_DECIMALS).tolist()
    stated = {"balls_mm": dict(zip(targets.names, places_mm, strict=True))}
    return {
        "mass_kg": known * payload.mass_kg,
        "com_mm": (1e3 * known * payload.com_m).round(MM_DECIMALS).tolist(),
        "load_point_mm": (1e3 * payload.load_point_m).round(MM_DECIMALS).tolist(),
        **(stated if measured else {}),
    }
