"""Periodic functions of an angle by K values: splines through evenly spaced knots, and harmonics.

Knot k of K stands at 2 pi k / K. K values define a cubic spline with period 2 pi; the same
functions are spanned by K B-splines, of which four are not zero at any angle, so that design
matrices in these are sparse.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.sparse import csr_array

from pa10cal.arrays import Array

_DEGREE = 3


def knots_rad(knots: int) -> Array:
    """Return the angles of the knots, (K,)."""
    return _stops_rad(knots)[:-1]


@cache
def unit_splines(knots: int) -> CubicSpline[np.float64]:
    """Return the K periodic splines that are 1 at one knot and 0 at the others, as one function."""
    unit = np.eye(knots)
    return CubicSpline(_stops_rad(knots), np.vstack([unit, unit[:1]]), bc_type="periodic")


def b_splines(knots: int, q_rad: Array) -> csr_array:
    """Return the K periodic cubic B-splines at angles (P,): (P, K) sparse, B-spline k at knot k."""
    stops = 2.0 * np.pi * np.arange(-_DEGREE, knots + _DEGREE + 1) / knots
    # Rounding may take an angle just below 0 to 2 pi itself, where the last interval must hold it.
    inside = np.minimum(np.mod(q_rad, 2.0 * np.pi), stops[knots + _DEGREE])
    unwrapped = BSpline.design_matrix(inside, stops, _DEGREE)
    # B-spline k of the unwrapped ones is centred on knot k - 1.
    columns = (unwrapped.indices - 1) % knots
    return csr_array((unwrapped.data, columns, unwrapped.indptr), shape=(len(q_rad), knots))


def b_splines_by_knots(knots: int) -> Array:
    """Return C (K, K) that takes values at the knots to coefficients of the B-splines."""
    by_coefficients = b_splines(knots, knots_rad(knots)).toarray()
    return np.asarray(np.linalg.inv(by_coefficients), dtype=np.float64)


def harmonic_orders(knots: int) -> Array:
    """Return the cycles a turn, (K,), of the columns of `harmonics_at_knots`: 0, 1, 1, 2, 2, …"""
    return np.asarray((np.arange(knots) + 1) // 2, dtype=np.float64)


def harmonics_at_knots(knots: int) -> Array:
    """Return the constant, then sine and cosine of every order that K knots resolve, (K, K).

    An even K resolves only the cosine of its highest order: the sine is zero at all knots.
    """
    phase = knots_rad(knots)[:, None] * harmonic_orders(knots)
    cosine = np.arange(knots) % 2 == 0
    if knots % 2 == 0:
        cosine[-1] = True
    return np.asarray(np.where(cosine, np.cos(phase), np.sin(phase)), dtype=np.float64)


def _stops_rad(knots: int) -> Array:
    """Return the knots and the end of the turn, (K + 1,)."""
    return np.linspace(0.0, 2.0 * np.pi, knots + 1)
