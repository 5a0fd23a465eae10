"""Curves, and what must be known of one so that no crossing on it is missed (docs/curve.md)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly, CubicSpline, PPoly
from scipy.special import jv

from pa10cal.arrays import Array
from pa10cal.errors import CurveError

#: Bounds are taken a little wider than computed, against rounding.
_WIDER = 1e-9
#: A tangent that jumps by less does so by rounding.
_ROUNDED_KINK_RAD = 1e-9
#: Lengths that differ by less than this part count as equal.
_SAME_LENGTH = 5e-13
_ROUNDING = 16.0 * float(np.finfo(float).eps)
#: Gauss's rule for arc length: nodes from -1 to 1, and the least number of parts of a curve.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_PARTS = 16
#: Points closer than this, as a part of the largest coordinate, are the same but for rounding: it
#: would decide in which direction the curve runs there.
_SAME_POINT = 4096.0 * float(np.finfo(float).eps)
#: Squares, cubes and fourth powers of lengths between these neither overflow nor vanish [m].
_LEAST_M, _MOST_M = 1e-50, 1e50


@dataclass(frozen=True)
class Curve:
    """A finite curve in space: by name, through points, or of any callable with its bounds."""

    place: Callable[[Array], Array]  # places (N, 3) at parameters (N,) [m]
    velocity: Callable[[Array], Array]  # derivative (N, 3) of the place by the parameter
    bounds: CurveBounds  # what holds on it, cell by cell; its edges begin and end the curve

    def at(self, t: Array) -> Array:
        """Return the places (N, 3) at parameters (N,) [m]."""
        return np.asarray(self.place(t))

    def with_velocity(self, t: Array) -> tuple[Array, Array]:
        """Return places and their derivatives by t, both (N, 3); at a kink, of what follows."""
        return self.at(t), np.asarray(self.velocity(t))

    def length_between_m(self, low: Array, high: Array) -> Array:
        """Return the arc lengths (k,) between parameters (k,) of one cell each, by Gauss's rule."""
        half = (high - low)[:, None] / 2.0
        at = low[:, None] + half * (1.0 + _NODES)
        _, v = self.with_velocity(at.ravel())
        speed = np.linalg.norm(v, axis=1).reshape(at.shape)
        return np.asarray((half * speed * _WEIGHTS).sum(axis=1))

    @cached_property
    def length_left_m(self) -> tuple[Array, Array]:
        """Parameters (k,) along the curve, and the arc length from each to its end (k,) [m]."""
        bounds = self.bounds
        t = bounds.stretches(bounds.start, bounds.end, bounds.length_m[-1] / _PARTS)
        parts_m = self.length_between_m(t[:-1], t[1:])
        return t, np.append(np.cumsum(parts_m[::-1])[::-1], 0.0)


@dataclass(frozen=True)
class CurveBounds:
    """What holds of a curve within cells of its parameter t."""

    edges: Array  # (m + 1,) parameters between the cells, increasing
    slowest: Array  # (m,) the speed |r'| is nowhere lower [m per unit of t]; 0 where not known
    fastest: Array  # (m,) and nowhere higher
    acceleration: Array  # (m,) |r''| is nowhere higher; inf where not known
    turning: Array  # (m,) the tangent nowhere turns faster [rad per unit of t]; inf where not known
    kinks_rad: Array  # (m - 1,) by how much the tangent jumps at the inner edges
    length_m: Array = field(init=False)  # (m + 1,) the curve up to the edges is no longer
    # (m,) the curvature is nowhere higher [1/m]; inf where not known
    curvature: Array = field(init=False)
    top_speed: float = field(init=False)  # the speed is nowhere on the curve higher
    _rate: Array = field(init=False, repr=False)
    _turned_rad: Array = field(init=False, repr=False)
    _unknown: NDArray[np.intp] = field(init=False, repr=False)
    _kinks: NDArray[np.intp] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        widths = np.diff(self.edges)
        known = np.isfinite(self.turning)
        rate = np.where(known, self.turning, 0.0) * (1.0 + _WIDER)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = np.where(known, rate / self.slowest, np.inf)
        derived = {
            "slowest": self.slowest * (1.0 - _WIDER),
            "fastest": self.fastest * (1.0 + _WIDER),
            "acceleration": self.acceleration * (1.0 + _WIDER),
            "length_m": _sum_from_zero(self.fastest * widths * (1.0 + _WIDER)),
            "curvature": curvature,
            "top_speed": float(self.fastest.max() * (1.0 + _WIDER)),
            "_rate": rate,
            "_turned_rad": _sum_from_zero(rate * widths + np.append(self.kinks_rad, 0.0)),
            "_unknown": _sum_from_zero(~known).astype(np.intp),
            "_kinks": np.append(0, np.cumsum(self.kinks_rad > _ROUNDED_KINK_RAD)),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    @property
    def start(self) -> float:
        """Parameter at which the curve begins."""
        return float(self.edges[0])

    @property
    def end(self) -> float:
        """Parameter at which the curve ends."""
        return float(self.edges[-1])

    def cells(self, t: Array) -> NDArray[np.intp]:
        """Return the cells that parameters lie in; on an edge, the one that follows."""
        found = np.searchsorted(self.edges, t, side="right") - 1
        return np.asarray(found.clip(0, len(self.fastest) - 1), dtype=np.intp)

    def length_to(self, t: Array) -> Array:
        """Return what the curve up to parameters is no longer than [m]."""
        return np.asarray(np.interp(t, self.edges, self.length_m))

    def not_beyond(self, length_m: Array) -> Array:
        """Return parameters up to which the curve is no longer than given lengths [m]."""
        return np.asarray(np.interp(length_m, self.length_m, self.edges))

    def turning_between(self, t: Array) -> Array:
        """Return what the tangent turns no further than between neighbouring parameters [rad].

        Args:
            t: (k + 1,) increasing parameters.

        Returns:
            (k,) bounds of the total turning, inf where none is known.
        """
        cell = self.cells(t)
        turned = np.diff(self._turned_rad[cell] + self._rate[cell] * (t - self.edges[cell]))
        unknown = self._unknown[cell[1:] + 1] > self._unknown[cell[:-1]]
        return np.where(unknown, np.inf, turned)

    def curvature_between(self, t: Array) -> Array:
        """Return what the curvature nowhere exceeds between neighbouring parameters [1/m].

        Args:
            t: (k + 1,) increasing parameters.

        Returns:
            (k,) bounds, inf where none is known or a kink lies between.
        """
        cell = self.cells(t)
        sharpest = np.maximum.reduceat(self.curvature[: cell[-1] + 1], cell[:-1])
        sharpest = np.maximum(sharpest, self.curvature[cell[1:]])
        return np.where(np.diff(self._kinks[cell]) > 0, np.inf, sharpest)

    def stretches(self, low: float, high: float, longest_m: float) -> Array:
        """Cut a span into stretches that lie each in one cell and are no longer than so much.

        Returns:
            (k + 1,) parameters between them.
        """
        inner = self.edges[
            np.searchsorted(self.edges, low, "right") : np.searchsorted(self.edges, high, "left")
        ]
        ends = np.concatenate([[low], inner, [high]])
        count = np.ceil(np.diff(self.length_to(ends)) / longest_m).clip(1).astype(np.intp)
        part = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        starts = np.repeat(ends[:-1], count) + part * np.repeat(np.diff(ends) / count, count)
        return np.append(starts, high)

    def same_length_m(self, t: Array, p_m: Array, link_m: float) -> Array:
        """Return below what difference [m] lengths of links at points of the curve are equal.

        That of rounding, where the place or the parameter are large against the link.

        Args:
            t: (N,) parameters.
            p_m: (N, 3) points.
        """
        rounded = _ROUNDING * (np.abs(p_m).max(axis=-1) + self.top_speed * np.abs(t))
        return np.asarray(np.maximum(_SAME_LENGTH * link_m, rounded))


def uniform_bounds(
    start: float, end: float, slowest: float, fastest: float, acceleration: float = np.inf
) -> CurveBounds:
    """Return bounds that are the same all along a curve without kinks.

    The first point at a distance is found with `fastest` alone; the others, 0 and inf where they
    are not known, make it quicker. The tangent turns no faster than acceleration over speed.

    Raises:
        CurveError: when they cannot all hold.
    """
    if not (start < end and 0.0 <= slowest <= fastest and fastest > 0.0 and acceleration >= 0.0):
        raise CurveError(
            "the bounds of the curve cannot all hold",
            where="start, end, slowest, fastest, acceleration",
            value=[start, end, slowest, fastest, acceleration],
            allowed="start below end, 0 <= slowest <= fastest, fastest above 0, acceleration >= 0",
            remedy="correct them",
        )
    turning = acceleration / slowest if slowest > 0.0 else np.inf
    return CurveBounds(
        edges=np.array([start, end]),
        slowest=np.array([slowest]),
        fastest=np.array([fastest]),
        acceleration=np.array([acceleration]),
        turning=np.array([turning]),
        kinks_rad=np.zeros(0),
    )


def _sum_from_zero(parts: NDArray[np.generic]) -> Array:
    return np.concatenate([[0.0], np.cumsum(parts)])


# Curves by name, given by formulas.

#: Bessel functions of orders this much above their argument are below rounding.
_ORDERS_BEYOND = 30


def line(length_m: float) -> Curve:
    """Return a straight line along x."""
    _check({"length_m": length_m})
    return polyline(np.array([[0.0, 0.0, 0.0], [length_m, 0.0, 0.0]]))


def circle(radius_m: float, angle_rad: float = 2.0 * np.pi) -> Curve:
    """Return an arc in the xy plane about the origin, from the x axis on; t is the angle."""
    return helix(radius_m, 0.0, angle_rad / (2.0 * np.pi))


def helix(radius_m: float, pitch_m: float, turns: float, phase_rad: float = 0.0) -> Curve:
    """Return a helix about z, rising by the pitch each turn; t is the angle, from 0.

    Args:
        pitch_m: rise a turn; negative for a left-handed one.
        phase_rad: azimuth at which it begins.
    """
    _check({"radius_m": radius_m, "turns": turns}, {"pitch_m": pitch_m, "phase_rad": phase_rad})
    rise = pitch_m / (2.0 * np.pi)
    speed = float(np.hypot(radius_m, rise))

    def place(t: Array) -> Array:
        azimuth = t + phase_rad
        return np.stack([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), rise * t], axis=1)

    def velocity(t: Array) -> Array:
        x, y = -radius_m * np.sin(t + phase_rad), radius_m * np.cos(t + phase_rad)
        return np.stack([x, y, np.full_like(t, rise)], axis=1)

    return Curve(place, velocity, uniform_bounds(0.0, 2.0 * np.pi * turns, speed, speed, radius_m))


def serpenoid(length_m: float, waves: float, amplitude_rad: float, phase_rad: float = 0.0) -> Curve:
    """Return Hirose's serpenoid curve in the xy plane; t is arc length [m].

    Its heading is amplitude cos(2 pi waves t / length + phase). Cosine and sine of a cosine are
    series of Bessel functions (Jacobi and Anger), whose integrals are the curve, to the last digit.

    Args:
        waves: waves along it.
        amplitude_rad: largest heading, from the mean one.
        phase_rad: phase of the wave at its beginning; growing with time, the wave travels.
    """
    measures = {"length_m": length_m, "waves": waves, "amplitude_rad": amplitude_rad}
    _check(measures, {"phase_rad": phase_rad})
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

    return Curve(place, velocity, uniform_bounds(0.0, length_m, 1.0, 1.0, amplitude_rad * rate))


def _check(positive: dict[str, float], finite: dict[str, float] | None = None) -> None:
    """Refuse measures that are not finite, and of the first ones those not above zero."""
    for name, value in {**positive, **(finite or {})}.items():
        above = name in positive
        if not abs(value) <= _MOST_M or (above and value < _LEAST_M):
            kind = "positive" if above else "finite"
            least = _LEAST_M if above else -_MOST_M
            raise CurveError(
                f"a measure of the shape is not {kind}",
                where=name,
                value=value,
                allowed=f"{least:g} to {_MOST_M:g}",
                remedy="correct it",
            )


# Curves that are polynomials piece by piece: splines through points, and polylines. A polynomial in
# Bernstein form lies between its smallest and its largest coefficient.

#: Cells a piece, and parts of a cell that is cut again: bounds get tighter with more of them.
_CELLS_A_PIECE = 4
#: A spline so many times as long as the lines between its points goes elsewhere: one through random
#: points is 1.2 times as long, 2.5 at most of thousands.
_DETOUR = 5.0
#: Cells are cut again where the squared speed varies by more than this; so often are they cut.
_TIGHT, _TIMES_CUT = 0.2, 5
#: Components of a cross product, as differences of products.
_CROSS = ((1, 2), (2, 0), (0, 1))


def spline_through(points_m: Array, closed: bool = False) -> Curve:
    """Return the cubic spline through points, its parameter the sum of the distances between them.

    Args:
        points_m: (N, 3) points [m]; where closed, the first follows the last once more.
        closed: whether the curve returns to its first point without a kink.

    Raises:
        CurveError: with fewer than two points, points that are not finite or repeat the one before,
            or where closed a last point that repeats the first; where the spline is so much longer
            than the distances that it does not follow the points.
    """
    points_m, t = _along(points_m, closed)
    spline = CubicSpline(t, points_m, bc_type="periodic" if closed else "not-a-knot")
    curve = _piecewise(PPoly(spline.c, spline.x))
    # No more than the length of each cell, so that no spline is refused for a wide bound.
    lengths_m = curve.bounds.slowest * np.diff(curve.bounds.edges)
    if lengths_m.sum() > _DETOUR * t[-1]:
        after = int(np.searchsorted(t, curve.bounds.edges[np.argmax(lengths_m)], "right"))
        raise CurveError(
            "the spline strays from its points",
            where=f"points {after} and {after % len(points_m) + 1}",
            value=f"{lengths_m.sum():.3g} m of spline along {t[-1]:.3g} m",
            allowed=f"at most {_DETOUR:g} times the distances between the points",
            remedy="remove points that are close together beside a long gap, or set through: "
            "straight",
        )
    return curve


def polyline(points_m: Array) -> Curve:
    """Return the straight lines between points; their parameter is arc length [m].

    Args:
        points_m: (N, 3) points [m].

    Raises:
        CurveError: as `spline_through`.
    """
    points_m, t = _along(points_m)
    slopes = np.diff(points_m, axis=0) / np.diff(t)[:, None]
    return _piecewise(PPoly(np.stack([slopes, points_m[:-1]]), t))


def _along(points_m: Array, closed: bool = False) -> tuple[Array, Array]:
    """Return points (N, 3), where closed the first once more, and how far along they are [m].

    Raises:
        CurveError: see `spline_through`.
    """
    if points_m.ndim != 2 or points_m.shape[1] != 3 or len(points_m) < 2:
        raise CurveError(
            "there are too few points for a curve",
            where="points",
            value=points_m.shape,
            allowed="two points or more, each x, y, z",
            remedy="give more points",
        )
    bad = np.flatnonzero(~(np.abs(points_m) <= _MOST_M).all(axis=1))
    if len(bad):
        raise CurveError(
            "a point is not finite, or too far away",
            where=f"point {bad[0] + 1}",
            value=points_m[bad[0]].tolist(),
            allowed=f"coordinates up to {_MOST_M:g} m",
            remedy="remove the point",
        )
    steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    same_m = max(_SAME_POINT * np.abs(points_m).max(), _LEAST_M)
    repeated = np.flatnonzero(steps <= same_m)
    if len(repeated):
        raise CurveError(
            "a point repeats the one before",
            where=f"point {repeated[0] + 2}",
            value=points_m[repeated[0] + 1].tolist(),
            allowed=f"neighbouring points that are more than {same_m:.2g} m apart",
            remedy=f"remove repeated points ({len(repeated)} in all)",
        )
    if closed:
        back_m = float(np.linalg.norm(points_m[0] - points_m[-1]))
        if back_m <= same_m:
            raise CurveError(
                "the last point of a closed curve repeats the first",
                where=f"point {len(points_m)}",
                value=points_m[-1].tolist(),
                allowed="a last point other than the first, to which the curve returns by itself",
                remedy="remove the last point",
            )
        points_m, steps = np.vstack([points_m, points_m[:1]]), np.append(steps, back_m)
    return points_m, _sum_from_zero(steps)


def _piecewise(place: PPoly) -> Curve:
    """Return the curve of a polynomial in each piece of its parameter [m], with its bounds.

    Speed, acceleration and turning are bounded in every cell by Bernstein coefficients. Where the
    speed is not bounded well, near cusps, cells are cut again.
    """
    parts = np.arange(_CELLS_A_PIECE) / _CELLS_A_PIECE
    widths = np.diff(place.x)
    starts, loose = place.x[:-1], np.ones(len(widths), dtype=bool)
    for _ in range(_TIMES_CUT):
        within = starts[loose, None] + widths[loose, None] * parts[1:]
        starts = np.sort(np.concatenate([starts, within.ravel()]))
        edges = np.append(starts, place.x[-1])
        widths = np.diff(edges)
        # The same polynomials, each about the beginning of one of more cells.
        orders = reversed(range(len(place.c)))
        powers = [place(edges[:-1], nu=order) / math.factorial(order) for order in orders]
        cut = PPoly(np.stack(powers), edges)
        velocity, change = cut.derivative().c, cut.derivative(2).c
        speed2 = _bernstein(_product(velocity, velocity).trace(axis1=2, axis2=3), edges)
        loose = speed2.min(axis=0) < _TIGHT * speed2.max(axis=0)
        if not loose.any():
            break
    slowest = np.sqrt(speed2.min(axis=0).clip(0.0))
    outer = _product(velocity, change)
    across = np.stack([outer[..., i, j] - outer[..., j, i] for i, j in _CROSS], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = _longest(across, edges) / slowest**2
    # By how much the tangent jumps between cells: from the velocity at the end of each.
    before = np.zeros_like(velocity[0])
    for coefficients in velocity:
        before = before * widths[:, None] + coefficients
    before, after = before[:-1], velocity[-1, 1:]
    jump = np.linalg.norm(np.cross(before, after), axis=1)
    bounds = CurveBounds(
        edges=edges,
        slowest=slowest,
        fastest=np.sqrt(speed2.max(axis=0)),
        acceleration=_longest(change, edges),
        turning=np.where(slowest > 0.0, turning, np.inf),
        kinks_rad=np.arctan2(jump, (before * after).sum(axis=1)),
    )
    return Curve(place, place.derivative(), bounds)


def _product(first: Array, second: Array) -> Array:
    """Return all products of components of two polynomials, power by power: (k, m, 3, 3)."""
    terms, others = len(first), len(second)
    product = np.zeros((terms + others - 1, first.shape[1], 3, 3))
    for power in range(terms):
        product[power : power + others] += first[power, :, :, None] * second[:, :, None, :]
    return product


def _bernstein(powers: Array, edges: Array) -> Array:
    """Return the Bernstein coefficients of polynomials given by powers, highest first."""
    return np.asarray(BPoly.from_power_basis(PPoly(powers, edges)).c)


def _longest(powers: Array, edges: Array) -> Array:
    """Return what polynomials of vectors (k, m, 3) are nowhere longer than in every cell (m,)."""
    return np.asarray(np.linalg.norm(_bernstein(powers, edges), axis=2).max(axis=0))
