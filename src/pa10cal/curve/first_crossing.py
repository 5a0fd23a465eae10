"""The first point of a curve at a distance from one of its points, never a later one.

Distance from a point cannot change faster than arc length grows, so a stretch of the curve whose
ends are near and whose length is short cannot get there. With a bound of the acceleration the
squared distance lies within a parabola of the straight line between its values at the ends, which
needs far fewer stretches where the curve runs along the sphere. The first stretch that may reach
the distance is cut again, until the squared distance provably only grows in it, and then bisected
(by Brent's method); or until only rounding remains, where the curve touches the sphere and
turns back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from pa10cal.arrays import Array
from pa10cal.curve.curve import Curve

#: Stretches searched at first, as a part of the link, and into how many the suspicious is cut.
_FIRST_STRETCH, _CUTS = 0.125, 16
#: The search looks this many links ahead, then twice as many, up to the most at once.
_FIRST_LOOK, _LONGEST_LOOK = 2.0, 2048.0
#: Where the tangent is within this of square to the link, the curve may be turning back.
_SLANT = 1e-5
#: Half the reach in which it is looked for where the curve turns back, as a part of the link.
_NEAR = 1e-4
_ROUNDING = 16.0 * float(np.finfo(float).eps)
_FINEST = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Crossing:
    """The first point of a curve at a distance."""

    t: float  # its parameter
    p_m: Array  # (3,) the point [m]
    touches: bool  # whether the curve only touches the sphere there, and turns back


def first_crossing(curve: Curve, t: float, p_m: Array, link_m: float) -> Crossing | None:
    """Find the first point of the curve after one of its points, at a distance from it.

    Args:
        curve: the curve.
        t: parameter of the point.
        p_m: (3,) the point [m].
        link_m: the distance.

    Returns:
        The first point, or None when all the rest of the curve is nearer.
    """
    bounds = curve.bounds
    same_m = float(bounds.same_length_m(np.array(t), p_m, link_m))
    search = _Search(curve, p_m, link_m, 2.0 * link_m * same_m)
    look = _FIRST_LOOK * link_m
    low = float(bounds.not_beyond(bounds.length_to(np.array(t)) + link_m))
    while low < bounds.end:
        high = float(bounds.not_beyond(bounds.length_to(np.array(low)) + look))
        found = search.between(bounds.stretches(low, high, _FIRST_STRETCH * link_m))
        if found is not None:
            return found
        low, look = high, min(2.0 * look, _LONGEST_LOOK * link_m)
    return None


@dataclass(frozen=True)
class _Search:
    """The squared distance from a point, less the link's: f [m^2]."""

    curve: Curve
    p_m: Array
    link_m: float
    same_m2: float

    def between(self, t: Array) -> Crossing | None:
        """Find the first crossing in stretches between parameters, each in one cell."""
        waiting = [t]
        while waiting:
            t = waiting.pop()
            r_m, v = self.curve.with_velocity(t)
            f = ((r_m - self.p_m) ** 2).sum(axis=1) - self.link_m**2
            slope = 2.0 * ((r_m - self.p_m) * v).sum(axis=1)
            most, grows = self._bound(t, f, slope)
            reaches = most >= -self.same_m2
            if not reaches.any():
                continue
            k = int(np.argmax(reaches))
            low, high = float(t[k]), float(t[k + 1])
            if f[k + 1] >= 0.0 and grows[k]:
                return self._crossing(low, high)
            if max(f[k], f[k + 1]) >= -self.same_m2 and most[k] <= 2.0 * self.same_m2:
                return self._touch(low, high)
            if k + 2 < len(t):
                waiting.append(t[k + 1 :])
            cut = np.unique(np.linspace(low, high, _CUTS + 1))
            if len(cut) > 2:
                waiting.append(cut)
            elif f[k + 1] >= 0.0:
                return self._crossing(low, high)
        return None

    def _bound(self, t: Array, f: Array, slope: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return what f nowhere exceeds in each stretch, and whether it crosses zero once only."""
        bounds = self.curve.bounds
        width = np.diff(t)
        cell = bounds.cells((t[:-1] + t[1:]) / 2.0)
        fastest, change = bounds.fastest[cell], bounds.acceleration[cell]
        distance = np.sqrt(f + self.link_m**2)
        farthest = (distance[:-1] + distance[1:] + fastest * width) / 2.0
        bent = 2.0 * (bounds.slowest[cell] ** 2 - farthest * change)  # f'' is nowhere less
        risen = 2.0 * (fastest**2 + farthest * change)  # and nowhere more
        above = np.maximum(f[:-1], f[1:]) + np.maximum(-bent, 0.0) * width**2 / 8.0
        most = np.minimum(farthest**2 - self.link_m**2, above)
        grows = (bent >= 0.0) | (slope[1:] >= risen * width) | (slope[:-1] + bent * width >= 0.0)
        return most, grows

    def _f(self, t: float) -> float:
        r_m = self.curve.at(np.array([t]))[0]
        return float(((r_m - self.p_m) ** 2).sum() - self.link_m**2)

    def _slope(self, t: float) -> float:
        r_m, v = self.curve.with_velocity(np.array([t]))
        return float(2.0 * (r_m[0] - self.p_m) @ v[0])

    def _crossing(self, low: float, high: float) -> Crossing:
        """Return where f crosses zero once between two parameters."""
        t = _bisect(self._f, low, high)
        r_m, v = self.curve.with_velocity(np.array([t]))
        away, speed = r_m[0] - self.p_m, float(np.linalg.norm(v[0]))
        if away @ v[0] < _SLANT * self.link_m * speed:
            return self._touch(low, high)
        distance = float(np.linalg.norm(away))
        # The last digits are beyond those of t, so that the point moves along the tangent.
        rest = (self.link_m - distance) * distance / float(away @ v[0])
        return Crossing(t + rest, r_m[0] + rest * v[0], touches=False)

    def _touch(self, low: float, high: float) -> Crossing:
        """Return where the curve turns back about here, or else crosses, all but tangent to it."""
        bounds = self.curve.bounds
        near = _NEAR * self.link_m / float(bounds.fastest[bounds.cells(np.array(high))])
        low, high = low - near, min(high + near, bounds.end)
        if self._slope(low) > 0.0 > self._slope(high):
            high = _bisect(self._slope, low, high)
            if self._f(high) <= 2.0 * self.same_m2:
                return Crossing(high, self.curve.at(np.array([high]))[0], touches=True)
        t = _bisect(self._f, low, high)
        return Crossing(t, self.curve.at(np.array([t]))[0], touches=False)


def _bisect(f: Callable[[float], float], low: float, high: float) -> float:
    """Return where f changes sign; the end nearer to zero where it does not."""
    f_low, f_high = f(low), f(high)
    if f_low * f_high >= 0.0:
        return low if abs(f_low) < abs(f_high) else high
    return float(brentq(f, low, high, xtol=_FINEST, rtol=_ROUNDING))
