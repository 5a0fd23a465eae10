"""Curves given by formulas: any callable with bounds stated for it, and a few by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import jv

from pa10cal.arrays import Array
from pa10cal.curve.curve import Bounds, uniform_bounds
from pa10cal.curve.polynomial import PiecewisePolynomial, polyline
from pa10cal.errors import CurveError

#: Parameters at which the stated bounds of a callable are checked.
_CHECKED = 257
#: Rounding that a stated bound is allowed.
_ROUNDED = 1e-9
#: Bessel functions of orders this much above their argument are below rounding.
_ORDERS_BEYOND = 30


@dataclass(frozen=True)
class Parametric:
    """A curve given by a callable; build it with `parametric` or by name."""

    place: Callable[[Array], Array]  # places (N, 3) at parameters (N,) [m]
    velocity: Callable[[Array], Array]  # derivative (N, 3) of the place by the parameter
    bounds: Bounds  # what holds on it

    def at(self, t: Array) -> Array:
        """Return the places (N, 3) at parameters (N,) [m]."""
        return self.place(t)

    def with_velocity(self, t: Array) -> tuple[Array, Array]:
        """Return places and their derivatives by t, both (N, 3)."""
        return self.place(t), self.velocity(t)


def parametric(
    place: Callable[[Array], Array],
    velocity: Callable[[Array], Array],
    span: tuple[float, float],
    fastest: float,
    slowest: float = 0.0,
    acceleration: float = np.inf,
) -> Parametric:
    """Return a curve given by a callable of any parameter, without kinks.

    The first point at a distance is found with `fastest` alone; the others make it quicker.

    Args:
        place: places (N, 3) at parameters (N,) [m].
        velocity: their derivative by the parameter.
        span: parameters at which the curve begins and ends.
        fastest: bound of the speed |velocity| from above [m per unit of the parameter].
        slowest: bound of it from below, 0 where not known.
        acceleration: bound of the second derivative's length, inf where not known.

    Raises:
        CurveError: when the span is empty, a place is not finite, or the speed is seen to leave
            its bounds.
    """
    if not (np.isfinite(span).all() and span[0] < span[1]):
        raise _refusal("the curve has no span", span, "two finite parameters, the smaller first")
    if not (0.0 <= slowest <= fastest < np.inf and fastest > 0.0):
        raise _refusal(
            "the bounds of the speed are invalid", (slowest, fastest), "0 <= low <= high"
        )
    t = np.linspace(*span, _CHECKED)
    places, speeds = place(t), np.linalg.norm(velocity(t), axis=1)
    bad = ~(np.isfinite(places).all(axis=1) & np.isfinite(speeds))
    if bad.any():
        raise _refusal(
            "a position of the curve is not finite", t[bad][0], "finite positions and speeds"
        )
    off = (speeds > fastest * (1 + _ROUNDED)) | (speeds < slowest * (1 - _ROUNDED))
    if off.any():
        raise _refusal(
            f"the speed at parameter {t[off][0]:g} is outside its bounds",
            speeds[off][0],
            f"{slowest:g} to {fastest:g}, as stated",
        )
    return Parametric(place, velocity, uniform_bounds(*span, slowest, fastest, acceleration))


def line(length_m: float) -> PiecewisePolynomial:
    """Return a straight line along x."""
    return polyline(np.array([[0.0, 0.0, 0.0], [_positive("length_m", length_m), 0.0, 0.0]]))


def circle(radius_m: float, angle_rad: float = 2.0 * np.pi) -> Parametric:
    """Return an arc in the xy plane about the origin, from the x axis on; t is the angle."""
    return helix(radius_m, 0.0, angle_rad / (2.0 * np.pi))


def helix(radius_m: float, pitch_m: float, turns: float, phase_rad: float = 0.0) -> Parametric:
    """Return a helix about z, rising by the pitch each turn; t is the angle, from 0.

    Args:
        radius_m: its radius.
        pitch_m: rise a turn; negative for a left-handed one.
        turns: how many.
        phase_rad: azimuth at which it begins.
    """
    radius_m, turns = _positive("radius_m", radius_m), _positive("turns", turns)
    rise = _finite("pitch_m", pitch_m) / (2.0 * np.pi)
    phase_rad = _finite("phase_rad", phase_rad)
    speed = float(np.hypot(radius_m, rise))

    def place(t: Array) -> Array:
        azimuth = t + phase_rad
        return np.stack([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), rise * t], axis=1)

    def velocity(t: Array) -> Array:
        x, y = -radius_m * np.sin(t + phase_rad), radius_m * np.cos(t + phase_rad)
        return np.stack([x, y, np.full_like(t, rise)], axis=1)

    return Parametric(
        place, velocity, uniform_bounds(0.0, 2.0 * np.pi * turns, speed, speed, radius_m)
    )


def serpenoid(
    length_m: float, waves: float, amplitude_rad: float, phase_rad: float = 0.0
) -> Parametric:
    """Return Hirose's serpenoid curve in the xy plane; t is arc length [m].

    Its heading is amplitude cos(2 pi waves t / length + phase). Cosine and sine of a cosine are
    series of Bessel functions (Jacobi and Anger), whose integrals are the curve, to the last digit.

    Args:
        length_m: arc length.
        waves: waves along it.
        amplitude_rad: largest heading, from the mean one.
        phase_rad: phase of the wave at its beginning; growing with time, the wave travels.
    """
    length_m, waves = _positive("length_m", length_m), _positive("waves", waves)
    amplitude_rad = _positive("amplitude_rad", amplitude_rad)
    phase_rad = _finite("phase_rad", phase_rad)
    rate = 2.0 * np.pi * waves / length_m
    order = np.arange(1, int(amplitude_rad) + _ORDERS_BEYOND)
    # 2 J_k Re i^k goes into the cosine of the heading (even k), 2 J_k Im i^k into its sine.
    parts = 2.0 * jv(order, amplitude_rad) / (rate * order)
    along = parts * np.array([0.0, -1.0, 0.0, 1.0])[(order - 1) % 4]
    aside = parts * np.array([1.0, 0.0, -1.0, 0.0])[(order - 1) % 4]
    mean = float(jv(0, amplitude_rad))

    def place(t: Array) -> Array:
        waved = np.sin(np.outer(rate * t + phase_rad, order)) - np.sin(phase_rad * order)
        return np.stack([mean * t + waved @ along, waved @ aside, np.zeros_like(t)], axis=1)

    def velocity(t: Array) -> Array:
        heading = amplitude_rad * np.cos(rate * t + phase_rad)
        return np.stack([np.cos(heading), np.sin(heading), np.zeros_like(t)], axis=1)

    return Parametric(
        place, velocity, uniform_bounds(0.0, length_m, 1.0, 1.0, amplitude_rad * rate)
    )


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise CurveError(
            "a measure of the shape is not positive",
            where=name,
            value=value,
            allowed="a finite number above 0",
            remedy="correct it",
        )
    return value


def _finite(name: str, value: float) -> float:
    if not np.isfinite(value):
        raise CurveError(
            "a measure of the shape is not finite",
            where=name,
            value=value,
            allowed="a finite number",
            remedy="correct it",
        )
    return value


def _refusal(what: str, value: object, allowed: str) -> CurveError:
    return CurveError(
        what, where="curve", value=value, allowed=allowed, remedy="correct the stated bounds"
    )
