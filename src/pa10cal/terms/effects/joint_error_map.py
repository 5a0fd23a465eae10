"""An error that depends on a joint's angle, of which only the place is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TypeGuard

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, PPoly
from scipy.sparse import csr_array

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import JointEffect
from pa10cal.terms.term import Term, TermParameter

# How large the harmonics of a joint's error are expected to be: its spectrum, a Gaussian prior.

#: How steeply a band begins: the power of the order in its step.
_STEEP = 8
#: Highest order that an axis off its centre or an oval ring makes.
_SLOW = 2


@dataclass(frozen=True)
class FadingPrior:
    """Sizes expected of a map's harmonics: the finer, the less.

    Sine and cosine part of m cycles a turn have the standard deviation
    size / (1 + (m / half_order)²), each for itself.
    """

    size_rad: float  # of the coarsest
    half_order: float  # cycles a turn of which half as much is expected

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        sizes: Array = self.size_rad / (1.0 + (orders / self.half_order) ** 2)
        return sizes


@dataclass(frozen=True)
class BandPrior:
    """Sizes expected of a map's harmonics: a band of orders, less above it, down to a floor.

    Sine and cosine part of m cycles a turn have the variance
    (below² + (level² - below²) / (1 + (first / m)⁸)) / (1 + (m / last)^(2 decay)) + floor²;
    those of one and of two cycles, which a ring off its axis or oval makes, slow² + floor².
    """

    slow_rad: float  # of one and of two cycles a turn
    below_rad: float  # level of the orders between them and the band
    level_rad: float  # level in the band
    # first_order and last_order: where the band begins and ends, in cycles a turn
    first_order: float
    last_order: float
    decay: float  # power of the order by which sizes fall above the band
    floor_rad: float  # that no order falls below

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        inside = orders**_STEEP / (orders**_STEEP + self.first_order**_STEEP)
        level = self.below_rad**2 + (self.level_rad**2 - self.below_rad**2) * inside
        above = 1.0 + (orders / self.last_order) ** (2.0 * self.decay)
        variance = np.where(orders <= _SLOW, self.slow_rad**2, level / above)
        sizes: Array = np.sqrt(variance + self.floor_rad**2)
        return sizes


Spectrum = FadingPrior | BandPrior


KNOTS = 12
_PLAUSIBLE_RAD = 3e-4
#: Angle over which neighbouring knots are expected to go together [rad].
_SMOOTH_OVER_RAD = 0.7
#: Share of the variance that no neighbour foretells; keeps the covariance well conditioned.
_JITTER = 1e-6
#: Size of a map's mean over the turn, in that of its first harmonic: a constant is no error that
#: depends on the angle, and belongs to the joint's offset.
_CONSTANT = 1e-3
#: Part of the variance expected of a map that the orders up to its finest hold.
_MOST = 0.9
_DEGREE = 3


@dataclass(frozen=True)
class JointErrorMap(JointEffect):
    """A smooth periodic error of a revolute joint's angle: a cubic spline through knots.

    Solved in the error at each knot [rad]; knot k of K stands at 2 pi k / K. A prismatic joint has
    no turn after which its error would come again, and gets none.
    """

    knots: int = KNOTS  # K, knots a turn
    # sizes expected of the harmonics. Where None, knots at a distance d are expected to go
    # together as exp(-2 sin²(d/2) / l²), l = 0.7 rad: what 12 knots can follow and little more.
    spectrum: Spectrum | None = None
    id = "joint_error_map"
    nouns = ("error by the angle", "errors by the angle")
    clauses = (
        "{at} turns wrongly by an amount that depends on its angle",
        "{at} turn wrongly by amounts that depend on their angles",
    )
    at_knots = True
    words = (
        "theta_{0.joint} += periodic cubic spline of q_{0.joint} through the knots, "
        "knot k at 2 pi k / {0.knots}"
    )

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        width = max(2, len(str(self.knots - 1)))
        plausible = _PLAUSIBLE_RAD
        if self.spectrum is not None:
            plausible = float(np.linalg.norm(self.prior_factor[0]))
        parameter = TermParameter("", "rad", 1e-5, plausible=plausible)
        return tuple(replace(parameter, name=f"knot_{k:0{width}d}") for k in range(self.knots))

    @property
    def finest_order(self) -> float:
        """Return the order [cycles a turn] up to which most of what is expected of it lies."""
        if self.spectrum is None:
            return 0.5 * self.knots
        orders = harmonic_orders(self.knots)[1:]
        below = np.cumsum(self.spectrum.sizes_rad(orders) ** 2)
        return float(orders[np.searchsorted(below, _MOST * below[-1])])

    def shift(self, states: PoseStates, x: Array) -> Array:
        q_rad = states.q_rad[:, self.joint - 1]
        alone = _spline_of_knots(self.knots)  # the spline is proportional to its knots
        spline = PPoly.construct_fast(alone.c @ x, alone.x, extrapolate="periodic")
        return np.asarray(spline(q_rad), dtype=np.float64)[:, None]

    def per_unit(self, states: PoseStates) -> Array:
        spline = _spline_of_knots(self.knots)
        return np.asarray(spline(states.q_rad[:, self.joint - 1]), dtype=np.float64)

    @property
    def prior_factor(self) -> Array:
        """Return L (K, K) of smooth knots: neighbours go together.

        With a `spectrum`, column by column: the constant, then sine and cosine of each harmonic.
        """
        if self.spectrum is not None:
            sizes = self.spectrum.sizes_rad(harmonic_orders(self.knots))
            sizes[0] *= _CONSTANT
            return harmonics_at_knots(self.knots) * sizes
        knots_rad = _knots_rad(self.knots)[:-1]
        half_distance = 0.5 * (knots_rad[:, None] - knots_rad)
        correlation = np.exp(-2.0 * (np.sin(half_distance) / _SMOOTH_OVER_RAD) ** 2)
        factor = np.linalg.cholesky(correlation + _JITTER * np.eye(self.knots))
        return np.asarray(_PLAUSIBLE_RAD * factor, dtype=np.float64)

    def size(self, x: Array) -> float:
        """Return the root mean square of the errors at the knots, in what is plausible.

        Of hundreds of waves some are always many times as large as was expected of them.
        """
        return float(np.sqrt(np.mean(x**2))) / _PLAUSIBLE_RAD


def is_error_map(term: Term) -> TypeGuard[JointErrorMap]:
    """Return whether a term is a spline of its joint's angle, solved in the errors at its knots."""
    return term.at_knots


def harmonic_orders(knots: int) -> Array:
    """Return the cycles a turn, (K,), of the columns of `harmonics_at_knots`: 0, 1, 1, 2, 2, …"""
    return np.asarray((np.arange(knots) + 1) // 2, dtype=np.float64)


def harmonics_at_knots(knots: int) -> Array:
    """Return constant, then sine and cosine of every order that K knots can resolve, (K, K).

    Of the highest order of an even K only the cosine is there.
    """
    orders = harmonic_orders(knots)
    phase = _knots_rad(knots)[:-1, None] * orders
    cosine = np.arange(knots) % 2 == 0
    if knots % 2 == 0:
        cosine[-1] = True
    return np.asarray(np.where(cosine, np.cos(phase), np.sin(phase)), dtype=np.float64)


def b_splines(knots: int, q_rad: Array) -> csr_array:
    """Return the K periodic cubic B-splines at angles (P,), four of them not zero: (P, K) sparse.

    B-spline k is centred on knot k. They span the same functions as the spline through the knots.
    """
    stops = 2.0 * np.pi * np.arange(-_DEGREE, knots + _DEGREE + 1) / knots
    inside = np.minimum(np.mod(q_rad, 2.0 * np.pi), stops[knots + _DEGREE])
    unwrapped = BSpline.design_matrix(inside, stops, _DEGREE)
    columns = (unwrapped.indices - 1) % knots
    return csr_array((unwrapped.data, columns, unwrapped.indptr), shape=(len(q_rad), knots))


def b_splines_by_knots(knots: int) -> Array:
    """Return C (K, K) by which coefficients of B-splines follow from the errors at the knots."""
    at_knots = b_splines(knots, _knots_rad(knots)[:-1]).toarray()
    return np.asarray(np.linalg.inv(at_knots), dtype=np.float64)


def _knots_rad(knots: int) -> Array:
    """Return the knots of a whole turn, the first one again at its end, (K + 1,)."""
    return np.linspace(0.0, 2.0 * np.pi, knots + 1)


@cache
def _spline_of_knots(knots: int) -> CubicSpline[np.float64]:
    """Return the periodic spline of every knot alone, all in one."""
    alone = np.eye(knots)
    return CubicSpline(_knots_rad(knots), np.vstack([alone, alone[:1]]), bc_type="periodic")


# A broad band of waves in a joint's angle: made by its sensor, or by its gear.
#
# Both have the same form, and poses alone cannot tell them apart: which name is given is decided
# by a witness outside the map (`discovery/motor_ripple.py`). Neither is sought beside the map
# whose place it takes.

#: Knots a turn that follow every order in which such errors were ever found.
FINE = 360
#: Sizes found on a measured arm (a UR10 in two campaigns): where a search finds its own, those.
TYPICAL = BandPrior(
    slow_rad=1.2e-4,
    below_rad=4.5e-5,
    level_rad=7.5e-5,
    first_order=7.0,
    last_order=23.0,
    decay=3.4,
    floor_rad=4.5e-6,
)


@dataclass(frozen=True)
class SensorError(JointErrorMap):
    """An error of the sensor at the joint's output, periodic in the joint's angle."""

    knots: int = FINE
    spectrum: Spectrum | None = TYPICAL
    id = "sensor_error"
    nouns = ("sensor", "sensors")
    clauses = (
        "the position sensor of {at} errs with its angle",
        "the position sensors of {at} err with their angles",
    )
    sought = False
    advice = "; calibrate the joint's sensor against the map"


@dataclass(frozen=True)
class GearError(JointErrorMap):
    """An error of the gear, periodic in the angle of the joint's output."""

    knots: int = FINE
    spectrum: Spectrum | None = TYPICAL
    id = "gear_error"
    nouns = ("gear", "gears")
    clauses = ("the gear of {at} is uneven", "the gears of {at} are uneven")
    sought = False
    advice = "; look at the joint's gear"
