"""Periodic errors of a joint's angle, of unknown cause, of sensor or gear, and their priors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
from scipy.interpolate import PPoly

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.numerics.periodic_spline import (
    harmonic_orders,
    harmonics_at_knots,
    knots_rad,
    unit_splines,
)
from pa10cal.terms.effects.effect import JointEffect
from pa10cal.terms.term import Term, TermParameter

#: Exponent of order over first order in `BandPrior`: how steeply a band begins.
_STEEP = 8
#: Highest order that an axis off its centre or an oval ring makes.
_SLOW = 2
#: Knots a turn of a map that is sought, and standard deviation expected of its errors there [rad].
KNOTS = 12
_PLAUSIBLE_RAD = 3e-4
#: Angle over which the errors of such a map are correlated [rad].
_SMOOTH_OVER_RAD = 0.7
#: Part of the variance that is independent at each knot; it keeps the covariance well conditioned.
_JITTER = 1e-6
#: Factor on the size expected of a map's mean over the turn: a constant is no error that depends
#: on the angle, and belongs to the joint's offset.
_CONSTANT = 1e-3
#: Distance of the angles at which a map is looked at, at most [rad] (computing).
_LOOKED_AT_RAD = float(np.radians(0.5))
#: Part of the expected variance of a map that orders up to `finest_order` hold.
_MOST = 0.9
#: Knots a turn of sensor and gear: enough for every order in which such errors were ever found.
FINE = 360


@dataclass(frozen=True)
class FadingPrior:
    """Gaussian prior on a map's harmonics that decreases with their order.

    Sine and cosine amplitude of m cycles a turn are independent, with the standard deviation
    size / (1 + (m / half_order)²).
    """

    size_rad: float  # limit at order 0
    half_order: float  # order [cycles a turn] at which the standard deviation is half of it

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        return np.asarray(self.size_rad / (1.0 + (orders / self.half_order) ** 2))


@dataclass(frozen=True)
class BandPrior:
    """Gaussian prior on a map's harmonics with most of the variance in a band of orders.

    Sine and cosine amplitude of m cycles a turn are independent, with the variance
    (below² + (level² - below²) / (1 + (first / m)⁸)) / (1 + (m / last)^(2 decay)) + floor²;
    for m = 1 and 2, which a ring off its axis or an oval ring makes, it is slow² + floor².
    """

    # standard deviations of each amplitude
    slow_rad: float  # of one and of two cycles a turn
    below_rad: float  # of orders between these and the band
    level_rad: float  # in the band
    # first_order and last_order: where the band begins and ends [cycles a turn]
    first_order: float
    last_order: float
    decay: float  # exponent with which the standard deviation falls above the band
    floor_rad: float  # lower bound of the standard deviation of all orders

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        inside = orders**_STEEP / (orders**_STEEP + self.first_order**_STEEP)
        level = self.below_rad**2 + (self.level_rad**2 - self.below_rad**2) * inside
        above = 1.0 + (orders / self.last_order) ** (2.0 * self.decay)
        variance = np.where(orders <= _SLOW, self.slow_rad**2, level / above)
        return np.asarray(np.sqrt(variance + self.floor_rad**2))


Spectrum = FadingPrior | BandPrior


@dataclass(frozen=True)
class JointErrorMap(JointEffect):
    """A smooth periodic error of a revolute joint's angle: a cubic spline through knots.

    Its parameters are the errors at the knots [rad]; knot k of K stands at 2 pi k / K. It does not
    apply to prismatic joints, whose errors have no period.
    """

    knots: int = KNOTS  # K, knots a turn
    # prior on the harmonics. None: errors at knots an angle d apart have the correlation
    # exp(-2 sin²(d/2) / l²), l = 0.7 rad, about the resolution of 12 knots.
    spectrum: Spectrum | None = None
    id = "joint_error_map"
    nouns = ("error by the angle", "errors by the angle")
    clauses = (
        "{at} turns wrongly by an amount that depends on its angle",
        "{at} turn wrongly by amounts that depend on their angles",
    )
    at_knots = True
    curve_of = "joint"
    words = (
        "theta_{0.joint} += periodic cubic spline of q_{0.joint} through the knots, "
        "knot k at 2 pi k / {0.knots}"
    )

    @property
    def highest_order(self) -> int:
        """Return the number of cycles a turn from which on its knots are too far apart."""
        return self.knots // 2

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
        """Return the order [cycles a turn] up to which most of the expected variance lies."""
        if self.spectrum is None:
            return 0.5 * self.knots
        orders = harmonic_orders(self.knots)[1:]
        below = np.cumsum(self.spectrum.sizes_rad(orders) ** 2)
        return float(orders[np.searchsorted(below, _MOST * below[-1])])

    def shift(self, states: PoseStates, x: Array) -> Array:
        q_rad = states.q_rad[:, self.joint - 1]
        unit = unit_splines(self.knots)  # the spline is linear in the errors at the knots
        spline = PPoly.construct_fast(unit.c @ x, unit.x, extrapolate="periodic")
        return np.asarray(spline(q_rad), dtype=np.float64)[:, None]

    def most_change(self, x: Array, seen: Array, apart_rad: Array) -> Array:
        """Return the most that errors change over distances (N,) where seen, (N,) [rad].

        It is their modulus of continuity. Beyond the angles seen an error may be neither periodic
        nor smooth: it then differs by so much from that at the nearest angle seen.

        Args:
            x: (K,) errors at the knots.
            seen: (m, 2) first and last angle of the intervals that were seen [rad].
        """
        unit, most_rad = unit_splines(self.knots), np.zeros(len(apart_rad))
        for first, last in seen:
            count = int((last - first) / _LOOKED_AT_RAD) + 2
            angle_rad = np.linspace(first, last, count)
            error_rad = unit(angle_rad) @ x
            changes = [
                np.abs(error_rad[k:] - error_rad[:-k]).max() for k in range(1, len(angle_rad))
            ]
            modulus_rad = np.maximum.accumulate([0.0, *changes])
            of_interval = np.interp(apart_rad, angle_rad - first, modulus_rad)
            most_rad = np.maximum(most_rad, of_interval)
        return most_rad

    def per_unit(self, states: PoseStates) -> Array:
        splines = unit_splines(self.knots)
        return np.asarray(splines(states.q_rad[:, self.joint - 1]), dtype=np.float64)

    @property
    def prior_factor(self) -> Array:
        """Return L (K, K) with L L^T the prior covariance of the errors at the knots.

        With a `spectrum` its columns are the constant, then sine and cosine of each harmonic.
        """
        if self.spectrum is not None:
            sizes = self.spectrum.sizes_rad(harmonic_orders(self.knots))
            sizes[0] *= _CONSTANT
            return harmonics_at_knots(self.knots) * sizes
        at_rad = knots_rad(self.knots)
        half_distance = 0.5 * (at_rad[:, None] - at_rad)
        correlation = np.exp(-2.0 * (np.sin(half_distance) / _SMOOTH_OVER_RAD) ** 2)
        factor = np.linalg.cholesky(correlation + _JITTER * np.eye(self.knots))
        return np.asarray(_PLAUSIBLE_RAD * factor, dtype=np.float64)

    def size(self, x: Array) -> float:
        """Return the root mean square of the errors at the knots over 0.3 mrad, for any spectrum.

        Not the largest, as of other effects: of hundreds of harmonics, some always exceed their
        expected size many times.
        """
        return float(np.sqrt(np.mean(x**2))) / _PLAUSIBLE_RAD


def is_error_map(term: Term) -> TypeGuard[JointErrorMap]:
    """Return whether a term is a spline of its joint's angle, solved in the errors at its knots."""
    return term.at_knots


# Errors of sensor and gear have one form, and poses alone cannot distinguish them: ripple of the
# motor decides (`discovery/motor_ripple.py`). A search finds a map and names it afterwards.

#: Prior as found on a measured arm (a UR10 in two campaigns); a search replaces it by its own.
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
    curve_of = ""
    sits = "driven joint"
    nouns = ("sensor", "sensors")
    clauses = (
        "the position sensor of {at} errs with its angle",
        "the position sensors of {at} err with their angles",
    )
    role_in_search = "proposed"
    advice = "; calibrate the joint's sensor against the map"


@dataclass(frozen=True)
class GearError(JointErrorMap):
    """An error of the gear, periodic in the angle of the joint's output."""

    knots: int = FINE
    spectrum: Spectrum | None = TYPICAL
    id = "gear_error"
    curve_of = ""
    sits = "driven joint"
    nouns = ("gear", "gears")
    clauses = ("the gear of {at} is uneven", "the gears of {at} are uneven")
    role_in_search = "proposed"
    advice = "; look at the joint's gear"
