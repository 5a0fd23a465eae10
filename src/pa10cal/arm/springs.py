"""The torsional spring of a joint, paper equation (1), solved in closed form.

In units of a reference torque and of the deflection there, equation (1) reads
(1 - s) x + s x^3 = t: s is the share of the cubic part at the reference. Every s from 0 (linear) to
below 1 (cubic alone) is an ordinary point, and x has one real root.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array

#: Below this s t^2 the root is t + s (t - t^3) to the last digit.
_SERIES_SUFFICES = 1e-9


#: The stiffness that readers know, by the parameter that is solved in its place.
_REPORTED = {"windup": "K_lin", "cubic_share": "K_cub"}


def reported_name(name: str) -> str:
    """Return what readers call a solved parameter: `K_cub_3` for `cubic_share_3`; others as is."""
    kind, _, joint = name.rpartition("_")
    return f"{_REPORTED[kind]}_{joint}" if kind in _REPORTED else name


@dataclass(frozen=True)
class UnitDeflection:
    """Deflection of a spring over that at the reference torque."""

    x: Array  # (P,) the root
    by_share: Array  # (P,) its derivative by the cubic share


def unit_deflection(t: Array, share: float) -> UnitDeflection:
    """Solve (1 - s) x + s x^3 = t.

    Args:
        t: (P,) torque over the reference torque.
        share: s, 0 <= s < 1.
    """
    if share * max(1.0, float(np.max(t**2, initial=0.0))) <= _SERIES_SUFFICES:
        x = t + share * (t - t**3)
    else:
        # Cardano in its hyperbolic form: no cancellation. One Newton step takes off the rounding.
        reach = np.sqrt(3.0 * share / (1.0 - share))
        x = 2.0 / reach * np.sinh(np.arcsinh(1.5 * reach * t / (1.0 - share)) / 3.0)
        x = x - ((1.0 - share) * x + share * x**3 - t) / ((1.0 - share) + 3.0 * share * x**2)
    slope = (1.0 - share) + 3.0 * share * x**2
    return UnitDeflection(x, (x - x**3) / slope)


def deflection_rad(tau_Nm: Array, k_lin: float, k_cub: float) -> Array:
    """Solve tau = K_lin delta + K_cub delta^3 for delta, (P,).

    Args:
        tau_Nm: (P,) torques.
        k_lin: K_lin > 0 [N m/rad].
        k_cub: K_cub >= 0 [N m/rad^3].
    """
    linear = tau_Nm / k_lin
    if k_cub * np.max(linear**2, initial=0.0) <= 1e-18 * k_lin:  # no digit of it shows
        return linear
    unit_rad = np.sqrt(k_lin / k_cub)
    # In this unit linear and cubic part are equal at x = 1: s = 1/2, t = tau / (2 K_lin unit).
    found: Array = unit_rad * unit_deflection(tau_Nm / (2.0 * k_lin * unit_rad), 0.5).x
    return found
