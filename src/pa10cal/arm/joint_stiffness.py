"""The torsional spring of a joint, paper equation (1): deflection in closed form, reported names.

tau = K_lin delta + K_cub delta^3. In units of a reference torque and the deflection x under it the
equation reads (1 - s) x + s x^3 = t, s the share of the cubic part at the reference. For every s
from 0 (linear) to below 1 (purely cubic) it has one real root x, smooth in s and t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array

#: Below this s t^2 the root is t + s (t - t^3) to rounding.
_SERIES_SUFFICES = 1e-9
#: Below this ratio of cubic to linear part a spring is linear to rounding.
_LINEAR = 1e-18
#: Reported stiffness by the parameter that is solved in its place.
_REPORTED = {"windup": "K_lin", "cubic_share": "K_cub"}


def reported_name(name: str) -> str:
    """Return what readers call a solved parameter: `K_cub_3` for `cubic_share_3`; others as is."""
    kind, _, joint = name.rpartition("_")
    return f"{_REPORTED[kind]}_{joint}" if kind in _REPORTED else name


@dataclass(frozen=True)
class UnitDeflection:
    """Deflection of a spring in units of that under the reference torque."""

    x: Array  # (P,) the root
    by_share: Array  # (P,) its derivative by the cubic share


def unit_deflection(t: Array, share: float) -> UnitDeflection:
    """Solve (1 - s) x + s x^3 = t for x; 0 <= s < 1 the share, t (P,) the torques."""
    if share * max(1.0, float(np.max(t**2, initial=0.0))) <= _SERIES_SUFFICES:
        x = t + share * (t - t**3)
    else:
        # Cardano in its hyperbolic form has no cancellation; one Newton step removes rounding.
        reach = np.sqrt(3.0 * share / (1.0 - share))
        x = 2.0 / reach * np.sinh(np.arcsinh(1.5 * reach * t / (1.0 - share)) / 3.0)
        x = x - ((1.0 - share) * x + share * x**3 - t) / ((1.0 - share) + 3.0 * share * x**2)
    slope = (1.0 - share) + 3.0 * share * x**2
    return UnitDeflection(x, (x - x**3) / slope)


def deflection_rad(tau_Nm: Array, k_lin: float, k_cub: float) -> Array:
    """Solve tau = K_lin delta + K_cub delta^3 for delta, (P,) [rad].

    K_lin > 0 in N m/rad, K_cub >= 0 in N m/rad^3.
    """
    linear = tau_Nm / k_lin
    if k_cub * np.max(linear**2, initial=0.0) <= _LINEAR * k_lin:
        return linear
    unit_rad = np.sqrt(k_lin / k_cub)
    # In this unit linear and cubic part are equal at x = 1: s = 1/2, t = tau / (2 K_lin unit).
    deflection: Array = unit_rad * unit_deflection(tau_Nm / (2.0 * k_lin * unit_rad), 0.5).x
    return deflection
