"""The torsional spring of a joint, paper equation (1), solved in closed form.

With compliance c = 1 / K_lin and hardening h = K_cub / K_lin the equation
tau = K_lin delta + K_cub delta^3 reads delta + h delta^3 = c tau, which has one real root for the
positive stiffness that the paper asks for. Below h = 0 the cubic would fold over and lose its
root; a solver on its way may step there, so the root's tangent in h continues it smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Below this h (c tau)^2 the root is c tau - h (c tau)^3 to the last digit; so it is continued for
#: negative h, where the cubic has lost its root.
_SERIES_SUFFICES = 1e-9


@dataclass(frozen=True)
class Deflection:
    """Deflection of a spring and its derivatives.

    Attributes:
        delta_rad: (P,) motor position minus link position.
        by_compliance: (P,) derivative by c [N m].
        by_hardening: (P,) derivative by h [rad^3].
    """

    delta_rad: Array
    by_compliance: Array
    by_hardening: Array


def deflect(tau_Nm: Array, compliance: float, hardening: float) -> Deflection:
    """Solve delta + h delta^3 = c tau.

    Args:
        tau_Nm: (P,) torque the spring carries.
        compliance: c = 1 / K_lin [rad/(N m)]; zero is a rigid joint.
        hardening: h = K_cub / K_lin [1/rad^2]; negative values are the continuation above.
    """
    linear = compliance * tau_Nm
    if hardening * np.max(linear**2, initial=0.0) <= _SERIES_SUFFICES:
        cube = linear**3
        slope = 1.0 - 3.0 * hardening * linear**2
        return Deflection(linear - hardening * cube, tau_Nm * slope, -cube)
    # Cardano in its hyperbolic form: no cancellation, down to the smallest h.
    reach = np.sqrt(3.0 * hardening)
    delta = 2.0 / reach * np.sinh(np.arcsinh(1.5 * reach * linear) / 3.0)
    # One Newton step takes off the rounding of the two transcendental functions.
    delta = delta - (delta + hardening * delta**3 - linear) / (1.0 + 3.0 * hardening * delta**2)
    slope = 1.0 + 3.0 * hardening * delta**2
    return Deflection(delta, tau_Nm / slope, -(delta**3) / slope)
