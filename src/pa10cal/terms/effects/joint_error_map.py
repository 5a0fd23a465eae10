"""An error that depends on a joint's angle, of which only the place is known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pa10cal.arm.state import PoseStates
from pa10cal.terms.effects.effect import JointEffect
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

KNOTS = 12
_PLAUSIBLE_RAD = 3e-4
#: Angle over which neighbouring knots are expected to go together [rad].
_SMOOTH_OVER_RAD = 0.7
#: Share of the variance that no neighbour foretells; keeps the covariance well conditioned.
_JITTER = 1e-6


@dataclass(frozen=True)
class JointErrorMap(JointEffect):
    """A smooth periodic error of a joint's angle: a cubic spline through 12 knots a turn.

    Solved in the error at each knot [rad]; knot k stands at 30° k. Two knots at a distance d are
    expected to go together as exp(-2 sin²(d/2) / l²), l = 0.7 rad: the lower an order of the
    joint, the more of it is expected; harmonics of the motor are out of reach.
    """

    id: ClassVar[str] = "joint_error_map"

    @property
    def known(self) -> tuple[Parameter, ...]:
        """Return the error at each knot."""
        return tuple(
            Parameter(f"knot_{k:02d}", "rad", 1e-5, plausible=_PLAUSIBLE_RAD) for k in range(KNOTS)
        )

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return what each knot contributes at q_j, (P, 1, 12)."""
        del x
        q_rad = states.q_rad[:, self.joint - 1]
        contributions = _spline_of_knots()(q_rad)
        return np.asarray(contributions, dtype=np.float64)[:, None, :]

    @property
    def prior_factor(self) -> Array:
        """Return L (12, 12) of smooth knots: neighbours go together."""
        knots_rad = _knots_rad()[:-1]
        half_distance = 0.5 * (knots_rad[:, None] - knots_rad)
        correlation = np.exp(-2.0 * (np.sin(half_distance) / _SMOOTH_OVER_RAD) ** 2)
        factor = np.linalg.cholesky(correlation + _JITTER * np.eye(KNOTS))
        return np.asarray(_PLAUSIBLE_RAD * factor, dtype=np.float64)


def _knots_rad() -> Array:
    """Return the knots of a whole turn, the first one again at its end, (13,)."""
    return np.linspace(0.0, 2.0 * np.pi, KNOTS + 1)


@cache
def _spline_of_knots() -> CubicSpline[np.float64]:
    """Return the periodic spline of every knot alone, all in one."""
    alone = np.eye(KNOTS)
    return CubicSpline(_knots_rad(), np.vstack([alone, alone[:1]]), bc_type="periodic")
