"""Curves that are polynomials piece by piece: splines through points, and polylines.

Their bounds are exact in kind: a polynomial in Bernstein form lies between its smallest and its
largest coefficient, so speed, acceleration and turning are bounded by coefficients of r'^2, r'' and
r' x r'', cell by cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly, CubicSpline, PPoly

from pa10cal.arrays import Array
from pa10cal.curve.curve import Bounds
from pa10cal.errors import CurveError

#: Cells a piece, and parts of a cell that is cut again: bounds get tighter with more of them.
_CELLS_A_PIECE = 4
#: Cells are cut again where the squared speed varies by more than this; so often are they cut.
_TIGHT, _TIMES_CUT = 0.2, 5
#: Components of a cross product, as differences of products.
_CROSS = ((1, 2), (2, 0), (0, 1))


@dataclass(frozen=True)
class PiecewisePolynomial:
    """A curve given by a polynomial in each piece of its parameter."""

    place: PPoly  # scipy's piecewise polynomial, of three components [m]
    bounds: Bounds = field(init=False)  # what holds on it
    _velocity: PPoly = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_velocity", self.place.derivative())
        object.__setattr__(self, "bounds", _bounds(self.place))

    def at(self, t: Array) -> Array:
        """Return the places (N, 3) at parameters (N,) [m]."""
        return np.asarray(self.place(t))

    def with_velocity(self, t: Array) -> tuple[Array, Array]:
        """Return places and their derivatives by t, both (N, 3)."""
        return np.asarray(self.place(t)), np.asarray(self._velocity(t))


def spline_through(points_m: Array, closed: bool = False) -> PiecewisePolynomial:
    """Return the cubic spline through points, its parameter the sum of the distances between them.

    Args:
        points_m: (N, 3) points [m]; where closed, the first follows the last once more.
        closed: whether the curve returns to its first point without a kink.

    Raises:
        CurveError: with fewer than two points, points that are not finite or repeat the one before.
    """
    points_m = checked_points(points_m)
    if closed:
        points_m = np.vstack([points_m, points_m[:1]])
    t = _along(points_m)
    spline = CubicSpline(t, points_m, bc_type="periodic" if closed else "not-a-knot")
    return PiecewisePolynomial(PPoly(spline.c, spline.x))


def polyline(points_m: Array) -> PiecewisePolynomial:
    """Return the straight lines between points; their parameter is arc length [m].

    Args:
        points_m: (N, 3) points [m].

    Raises:
        CurveError: as `spline_through`.
    """
    points_m = checked_points(points_m)
    t = _along(points_m)
    slopes = np.diff(points_m, axis=0) / np.diff(t)[:, None]
    return PiecewisePolynomial(PPoly(np.stack([slopes, points_m[:-1]]), t))


def checked_points(points_m: Array) -> Array:
    """Return points (N, 3) that a curve can go through.

    Raises:
        CurveError: with fewer than two points, points that are not finite or repeat the one before.
    """
    if points_m.ndim != 2 or points_m.shape[1] != 3 or len(points_m) < 2:
        raise CurveError(
            "there are too few points for a curve",
            where="points",
            value=points_m.shape,
            allowed="two points or more, each x, y, z",
            remedy="give more points",
        )
    bad = np.flatnonzero(~np.isfinite(points_m).all(axis=1))
    if len(bad):
        raise CurveError(
            "a point is not finite",
            where=f"point {bad[0] + 1}",
            value=points_m[bad[0]].tolist(),
            allowed="finite coordinates",
            remedy="remove the point",
        )
    repeated = np.flatnonzero((np.diff(points_m, axis=0) == 0.0).all(axis=1))
    if len(repeated):
        raise CurveError(
            "a point repeats the one before",
            where=f"point {repeated[0] + 2}",
            value=points_m[repeated[0]].tolist(),
            allowed="neighbouring points that differ",
            remedy=f"remove repeated points ({len(repeated)} in all)",
        )
    return points_m


def _along(points_m: Array) -> Array:
    """Return how far along the straight lines between them points are, (N,) [m]."""
    steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _bounds(place: PPoly) -> Bounds:
    """Bound speed, acceleration and turning in every cell by Bernstein coefficients.

    Where the speed is not bounded well, near cusps, cells are cut again.
    """
    parts = np.arange(_CELLS_A_PIECE) / _CELLS_A_PIECE
    widths = np.diff(place.x)
    starts, loose = place.x[:-1], np.ones(len(widths), dtype=bool)
    for _ in range(_TIMES_CUT):
        within = starts[loose, None] + widths[loose, None] * parts[1:]
        starts = np.sort(np.concatenate([starts, within.ravel()]))
        edges = np.append(starts, place.x[-1])
        widths, cut = np.diff(edges), _expanded(place, edges)
        velocity, change = cut.derivative().c, cut.derivative(2).c
        speed2 = _bernstein(_product(velocity, velocity).trace(axis1=2, axis2=3), edges)
        loose = speed2.min(axis=0) < _TIGHT * speed2.max(axis=0)
        if not loose.any():
            break
    slowest = np.sqrt(speed2.min(axis=0).clip(0.0))
    outer = _product(velocity, change)
    across = np.stack([outer[..., i, j] - outer[..., j, i] for i, j in _CROSS], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = _longest(_bernstein(across, edges)) / slowest**2
    return Bounds(
        edges=edges,
        slowest=slowest,
        fastest=np.sqrt(speed2.max(axis=0)),
        acceleration=_longest(_bernstein(change, edges)),
        turning=np.where(slowest > 0.0, turning, np.inf),
        kinks_rad=_kinks(velocity, widths),
    )


def _expanded(place: PPoly, edges: Array) -> PPoly:
    """Return the same polynomials, each about the beginning of one of more cells."""
    orders = reversed(range(len(place.c)))
    powers = [place(edges[:-1], nu=order) / math.factorial(order) for order in orders]
    return PPoly(np.stack(powers), edges)


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


def _longest(coefficients: Array) -> Array:
    """Return the longest of the (k, m, 3) coefficients in every cell (m,)."""
    return np.asarray(np.linalg.norm(coefficients, axis=2).max(axis=0))


def _kinks(velocity: Array, widths: Array) -> Array:
    """Return by how much the tangent jumps between cells, (m - 1,) [rad]."""
    before = np.zeros_like(velocity[0])
    for coefficients in velocity:
        before = before * widths[:, None] + coefficients
    before, after = before[:-1], velocity[-1, 1:]
    across = np.linalg.norm(np.cross(before, after), axis=1)
    return np.asarray(np.arctan2(across, (before * after).sum(axis=1)))
