"""One individual robot as built: mechanism, springs, tool and targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal_lab.cell.mechanism import Departures, Mechanism, SimulatedPayload

#: Three balls in front of four 0.31 m rods, 2.4 kg (Section II.B of the paper); points in the
#: flange frame.
APPARATUS_MASS_KG = 2.4
APPARATUS_COM_M = np.array([0.0, 0.0, 0.190])
LOAD_POINT_M = np.array([0.0, 0.0, 0.030])
BALL_NAMES = ("A", "B", "C")
BALLS_DESIGN_M = 1e-3 * np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
BALL_DIAMETER_M = 0.0254
#: Standard deviation of a manufactured ball's position, per axis.
_BALL_MAKING_M = 5e-5

#: Nominal reflectors: on a ring about the flange's axis, at two heights in turn.
RING_RADIUS_M = 0.100
RING_HEIGHTS_M = (0.100, 0.140)
TOOL_COM_M = np.array([0.0, 0.0, 0.060])


def apparatus_payload() -> SimulatedPayload:
    """Return the weight of the tooling-ball apparatus."""
    return SimulatedPayload(APPARATUS_MASS_KG, APPARATUS_COM_M, LOAD_POINT_M)


def draw_balls(measured_to_mm: float, rng: np.random.Generator) -> Targets:
    """Draw the balls of one apparatus; their stated positions are those of a measurement.

    Args:
        measured_to_mm: standard deviation of that measurement, per coordinate.
    """
    balls_m = BALLS_DESIGN_M + rng.normal(0.0, _BALL_MAKING_M, BALLS_DESIGN_M.shape)
    error_m = 1e-3 * measured_to_mm * rng.standard_normal(balls_m.shape)
    return Targets(BALL_NAMES, balls_m, balls_m + error_m)


def tool_payload(mass_kg: float) -> SimulatedPayload:
    """Return the weight of a tool with reflectors."""
    return SimulatedPayload(mass_kg, TOOL_COM_M, LOAD_POINT_M)


def ring_of_targets(count: int) -> Targets:
    """Return `count` nominal reflectors, with the same stated positions."""
    turn = 2.0 * np.pi * np.arange(count) / count
    points_m = np.column_stack(
        [
            RING_RADIUS_M * np.cos(turn),
            RING_RADIUS_M * np.sin(turn),
            np.resize(RING_HEIGHTS_M, count),
        ]
    ).round(6)
    return Targets(tuple(f"T{number}" for number in range(1, count + 1)), points_m, points_m)


@dataclass(frozen=True)
class Springs:
    """Cubic springs tau = k_lin delta + k_cub delta^3 between motor and link, equation (1)."""

    k_lin: Array  # (n,) [N m/rad]; infinite where the joint is rigid
    k_cub: Array  # (n,) [N m/rad^3]
    source: str  # origin of the values, for the record of the truth

    @property
    def flexible(self) -> NDArray[np.bool_]:
        """Return which joints are flexible, (n,)."""
        return np.isfinite(self.k_lin)

    def step(self, delta: Array, tau: Array) -> Array:
        """Return one Newton step of k_lin delta + k_cub delta^3 = tau in the flexible joints.

        Args:
            delta: (..., n) deflections so far; those of rigid joints stay.
            tau: (..., n) torques.
        """
        flexible = self.flexible
        k_lin, k_cub, d = self.k_lin[flexible], self.k_cub[flexible], delta[..., flexible]
        stepped = delta.copy()
        excess_Nm = k_lin * d + k_cub * d**3 - tau[..., flexible]
        stepped[..., flexible] = d - excess_Nm / (k_lin + 3.0 * k_cub * d**2)
        return stepped

    @classmethod
    def rigid(cls, n: int) -> Springs:
        """Return the springs of an arm with `n` rigid joints."""
        return cls(np.full(n, np.inf), np.zeros(n), "rigid")


@dataclass(frozen=True)
class Targets:
    """B targets (tooling balls, reflectors) on the flange; points in the end-effector frame."""

    names: tuple[str, ...]
    p_ee_m: Array  # (B, 3) true positions
    p_ee_stated_m: Array  # (B, 3) positions that the campaign states


@dataclass(frozen=True)
class Robot:
    """One individual robot with its tool, standing in front of the instrument."""

    arm: Arm  # the nominal arm
    mechanism: Mechanism  # true joints, links and payload
    springs: Springs
    T_instr_base: Array  # (4, 4) base in the instrument's frame [m]
    targets: Targets  # measured by instruments of positions and distances
    # (4, 4) target of a tracker of poses, in the end-effector frame [m]; the campaign states that
    # it is the end-effector frame itself
    T_ee_target: Array
    departures: Departures | None  # deviations of the rows; None where axes deviate in any way

    def T_instr_target(self, T_base_ee: Array) -> Array:
        """Return the target of a tracker of poses, (P, 4, 4), for end-effectors (P, 4, 4)."""
        return np.asarray(self.T_instr_base @ T_base_ee @ self.T_ee_target)

    def p_instr_targets_m(self, T_base_ee: Array, shift_m: Array | None = None) -> Array:
        """Return the positions of the targets in the instrument's frame, (P, B, 3).

        Args:
            T_base_ee: (P, 4, 4) end-effectors.
            shift_m: (P, 3) displacement of the tool, along the end-effector's axes.
        """
        T_instr_ee = self.T_instr_base @ T_base_ee
        p_ee_m = self.targets.p_ee_m[None]
        if shift_m is not None:
            p_ee_m = p_ee_m + shift_m[:, None, :]
        p_ee_m = np.broadcast_to(p_ee_m, (len(T_base_ee), *p_ee_m.shape[1:]))
        along = np.einsum("pij,pbj->pbi", T_instr_ee[:, :3, :3], p_ee_m)
        return np.asarray(along + T_instr_ee[:, None, :3, 3])
