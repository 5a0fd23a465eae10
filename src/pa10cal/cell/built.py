"""The robot and the apparatus as they were built: what a campaign's truth is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Departures:
    """What every row of the arm departs by from its nominal figure; all (n,).

    Attributes:
        a_m: lengths along x.
        alpha_rad: twists.
        d_m: offsets along z.
        theta_rad: joint offsets.
        beta_rad: Hayati angles.
    """

    a_m: Array
    alpha_rad: Array
    d_m: Array
    theta_rad: Array
    beta_rad: Array

    @classmethod
    def none(cls, n: int) -> Departures:
        """Return no departure at all, for an arm of `n` joints."""
        return cls(*(np.zeros(n) for _ in range(5)))


@dataclass(frozen=True)
class Springs:
    """Cubic springs tau = k_lin delta + k_cub delta^3 between motor and link, equation (1).

    Attributes:
        k_lin: (n,) [N m/rad]; infinite where the joint is rigid.
        k_cub: (n,) [N m/rad^3].
        source: where the figures come from, for the record of the truth.
    """

    k_lin: Array
    k_cub: Array
    source: str

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
class Apparatus:
    """The tooling-ball apparatus on the flange; all places in the flange frame.

    Attributes:
        mass_kg: its mass.
        com_m: (3,) its centre of mass.
        load_point_m: (3,) where the external load hangs.
        ball_names: B names.
        balls_m: (B, 3) ball centres as they are.
        balls_measured_m: (B, 3) ball centres as the separate measurement found them.
        ball_diameter_m: diameter of every ball.
    """

    mass_kg: float
    com_m: Array
    load_point_m: Array
    ball_names: tuple[str, ...]
    balls_m: Array
    balls_measured_m: Array
    ball_diameter_m: float


@dataclass(frozen=True)
class BuiltRobot:
    """One individual robot with its apparatus, standing in front of the instrument.

    Attributes:
        arm: the arm as its maker describes it.
        departures: what its geometry departs by.
        springs: its joint springs.
        mass_kg: (n,) masses of its links.
        com_m: (n, 3) their centres of mass in the frame of the link's own row.
        apparatus: what it carries.
        T_instr_base: (4, 4) its base in the instrument's frame [m].
    """

    arm: Arm
    departures: Departures
    springs: Springs
    mass_kg: Array
    com_m: Array
    apparatus: Apparatus
    T_instr_base: Array
