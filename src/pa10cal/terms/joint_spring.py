"""Torsional spring of a joint, paper equation (1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.springs import Deflection, deflect
from pa10cal.arm.state import PoseStates
from pa10cal.terms.term import Parameter, Report

Array = NDArray[np.float64]

#: Sizes of c and h that harmonic drives of this class show; they scale the solver's steps only.
_COMPLIANCE_SCALE = 1e-6
_HARDENING_SCALE = 300.0

#: Ends of the physical range: a joint that counts as rigid and one too soft to carry an arm
#: [rad/(N m)]; hardening that would double the stiffness within 0.6 mrad [1/rad^2].
_RIGID = 1e-9
_SOFTEST = 2e-3
_HARDEST = 1e6


@dataclass(frozen=True)
class JointSpring:
    """A spring between motor and link of one joint, under the measured torque.

    Solved in compliance c = 1/K_lin and hardening h = K_cub/K_lin, in which the pose is nearly
    linear and a rigid joint is an ordinary point; reported as K_lin and K_cub. Stiffness is
    positive, as the paper asks.

    Attributes:
        joint: 1 … n.
        cubic: whether K_cub is an unknown; a linear spring has K_cub = 0.
    """

    joint: int
    cubic: bool = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return compliance and, for a cubic spring, hardening."""
        compliance = Parameter(
            f"compliance_{self.joint}",
            "rad/(N m)",
            _COMPLIANCE_SCALE,
            lower=_RIGID,
            upper=_SOFTEST,
        )
        hardening = Parameter(
            f"hardening_{self.joint}", "1/rad^2", _HARDENING_SCALE, lower=0.0, upper=_HARDEST
        )
        return (compliance, hardening) if self.cubic else (compliance,)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the joint's angle."""
        return (f"theta_{self.joint}",)

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return minus the deflection, (P, 1)."""
        return -self._deflect(states, x).delta_rad[:, None]

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift`, (P, 1, k), by the implicit-function theorem."""
        deflection = self._deflect(states, x)
        slopes = [-deflection.by_compliance, -deflection.by_hardening]
        return np.stack(slopes[: len(x)], axis=-1)[:, None, :]

    def report(self, x: Array) -> Report:
        """Return K_lin = 1/c and K_cub = h/c."""
        compliance = x[0]
        hardening = x[1] if self.cubic else 0.0
        names = (
            Parameter(f"K_lin_{self.joint}", "N m/rad", 1e3),
            Parameter(f"K_cub_{self.joint}", "N m/rad^3", 1e7),
        )
        values = np.array([1.0 / compliance, hardening / compliance])
        jacobian = np.array(
            [
                [-1.0 / compliance**2, 0.0],
                [-hardening / compliance**2, 1.0 / compliance],
            ]
        )
        return Report(names, values, jacobian[:, : len(x)])

    def solved(self, k_lin: float, k_cub: float) -> Array:
        """Return the solved parameters of a spring of known stiffness."""
        return np.array([1.0 / k_lin, k_cub / k_lin][: 2 if self.cubic else 1])

    def _deflect(self, states: PoseStates, x: Array) -> Deflection:
        return deflect(
            states.tau_Nm[:, self.joint - 1], float(x[0]), float(x[1]) if self.cubic else 0.0
        )
