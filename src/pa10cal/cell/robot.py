"""One individual robot as it was built: what a campaign's truth is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

if TYPE_CHECKING:
    from pa10cal.cell.mechanism import Mechanism


# What a robot carries on its flange: the tooling-ball apparatus of the paper, or reflectors.

#: Three balls in front of four 0.31 m rods, 2.4 kg (Section II.B of the paper); points in the
#: flange frame.
APPARATUS_MASS_KG = 2.4
APPARATUS_COM_M = np.array([0.0, 0.0, 0.190])
LOAD_POINT_M = np.array([0.0, 0.0, 0.030])
BALL_NAMES = ("A", "B", "C")
BALLS_DESIGN_M = 1e-3 * np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
BALL_DIAMETER_M = 0.0254
_BALL_MAKING_M = 5e-5

#: Reflectors as designed: on a ring around the flange's axis, every other one further out.
RING_RADIUS_M = 0.100
RING_HEIGHTS_M = (0.100, 0.140)
TOOL_COM_M = np.array([0.0, 0.0, 0.060])


def apparatus_payload() -> Payload:
    """Return the weight of the tooling-ball apparatus."""
    return Payload(APPARATUS_MASS_KG, APPARATUS_COM_M, LOAD_POINT_M)


def make_balls(measured_to_mm: float, rng: np.random.Generator) -> Targets:
    """Make the balls of one apparatus, and measure them.

    Args:
        measured_to_mm: standard deviation of the separate measurement, each coordinate.
        rng: draws how the balls came out, then the error of their measurement.
    """
    balls_m = BALLS_DESIGN_M + rng.normal(0.0, _BALL_MAKING_M, BALLS_DESIGN_M.shape)
    error_m = 1e-3 * measured_to_mm * rng.standard_normal(balls_m.shape)
    return Targets(BALL_NAMES, balls_m, balls_m + error_m)


def tool_payload(mass_kg: float) -> Payload:
    """Return the weight of a tool with reflectors."""
    return Payload(mass_kg, TOOL_COM_M, LOAD_POINT_M)


def ring_of_targets(count: int) -> Targets:
    """Return `count` reflectors that are where the campaign says."""
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
class Departures:
    """What every row of the arm departs by from its nominal figure; all (n,)."""

    a_m: Array  # lengths along x
    alpha_rad: Array  # twists
    d_m: Array  # offsets along z
    theta_rad: Array  # joint offsets
    beta_rad: Array  # Hayati angles

    @classmethod
    def none(cls, n: int) -> Departures:
        """Return no departure at all, for an arm of `n` joints."""
        return cls(*(np.zeros(n) for _ in range(5)))


@dataclass(frozen=True)
class Springs:
    """Cubic springs tau = k_lin delta + k_cub delta^3 between motor and link, equation (1)."""

    k_lin: Array  # (n,) [N m/rad]; infinite where the joint is rigid
    k_cub: Array  # (n,) [N m/rad^3]
    source: str  # where the figures come from, for the record of the truth

    @property
    def flexible(self) -> NDArray[np.bool_]:
        """(n,) which joints yield."""
        return np.isfinite(self.k_lin)

    def step(self, delta: Array, tau: Array) -> Array:
        """Return one Newton step of k_lin delta + k_cub delta^3 = tau in the flexible joints.

        Args:
            delta: (..., n) deflections so far; those of rigid joints stay.
            tau: (..., n) torques.
        """
        soft = self.flexible
        k_lin, k_cub, d = self.k_lin[soft], self.k_cub[soft], delta[..., soft]
        stepped = delta.copy()
        excess = k_lin * d + k_cub * d**3 - tau[..., soft]
        stepped[..., soft] = d - excess / (k_lin + 3.0 * k_cub * d**2)
        return stepped

    @classmethod
    def rigid(cls, n: int) -> Springs:
        """Return no spring at all, for an arm of `n` joints."""
        return cls(np.full(n, np.inf), np.zeros(n), "rigid")


@dataclass(frozen=True)
class Payload:
    """What an arm carries; points in the end-effector frame."""

    mass_kg: float  # mass of the tool
    com_m: Array  # (3,) its centre of mass
    load_point_m: Array  # (3,) where an external load hangs


@dataclass(frozen=True)
class Targets:
    """B targets (tooling balls, reflectors) on the flange; points in the end-effector frame."""

    names: tuple[str, ...]  # B names
    p_ee_m: Array  # (B, 3) where they are
    p_ee_stated_m: Array  # (B, 3) where the campaign says they are


@dataclass(frozen=True)
class Robot:
    """One individual robot with its tool, standing in front of the instrument."""

    arm: Arm  # the arm as its maker describes it
    mechanism: Mechanism  # its joints, links and payload as they are
    springs: Springs  # its joint springs
    T_instr_base: Array  # (4, 4) its base in the instrument's frame [m]
    targets: Targets  # what the instrument measures
    # (4, 4) the target of a tracker of poses, in the end-effector frame [m]; the campaign says
    # that it is the end-effector frame itself
    T_ee_target: Array
    departures: Departures | None  # by what its rows depart; None where its axes depart in any way

    def T_instr_target(self, T_base_ee: Array) -> Array:
        """Return where the target of a tracker of poses is, for end-effectors (P, 4, 4)."""
        T: Array = self.T_instr_base @ T_base_ee @ self.T_ee_target
        return T

    def p_instr_targets_m(self, T_base_ee: Array, shift_m: Array | None = None) -> Array:
        """Return where the targets are in the instrument's frame, (P, B, 3).

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
        points: Array = along + T_instr_ee[:, None, :3, 3]
        return points
