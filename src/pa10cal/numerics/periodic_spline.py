"""Periodic functions of an angle by K values at knots, and the covariance of what they move.

Knot k of K stands at 2 pi k / K. K values define a cubic spline with period 2 pi, or amplitudes of
harmonics. The same splines are spanned by K B-splines, of which at any angle only four are not
zero, so that design matrices in these are sparse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index

_DEGREE = 3
#: B-splines that are not zero at an angle (format).
_SUPPORT = _DEGREE + 1
#: Number of positions whose covariances are computed at once (computing).
_BLOCK = 1000


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
    if not len(q_rad):  # the design matrix needs some
        return csr_array((0, knots))
    stops = 2.0 * np.pi * np.arange(-_DEGREE, knots + _DEGREE + 1) / knots
    # Rounding may take an angle just below 0 to 2 pi itself, which is in the last interval then.
    inside = np.minimum(np.mod(q_rad, 2.0 * np.pi), stops[knots + _DEGREE])
    unwrapped = BSpline.design_matrix(inside, stops, _DEGREE)
    # The design matrix numbers B-splines from the one centred on knot -1.
    columns = (unwrapped.indices - 1) % knots
    return csr_array((unwrapped.data, columns, unwrapped.indptr), shape=(len(q_rad), knots))


@cache
def b_splines_by_knots(knots: int) -> Array:
    """Return C (K, K): coefficients of the B-splines are C times the values at the knots."""
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


def spline_columns(
    by_angle: Array, q_rad: Array, knots: Sequence[int], touched: Sequence[Index] = ()
) -> csr_array:
    """Return the derivative of rows by the B-splines of maps, sparse (b P, K1 + K2 + …), by pose.

    Args:
        by_angle: (P, b, j) derivative of the rows by the angle of each joint that has a map.
        q_rad: (P, j) these angles.
        knots: knots a turn of each map.
        touched: the B-splines of each map that are columns, see `touched_splines`; none for all.
            All others have to be zero at the angles.
    """
    count, components, joints = by_angle.shape
    rows = count * components
    if not joints:
        return csr_array((rows, 0))
    splines = [b_splines(each, q_rad[:, j]) for j, each in enumerate(knots)]
    first = np.cumsum([0, *knots])
    # Each pose has a fixed number of B-splines of every map that are not zero.
    values = np.stack([each.data.reshape(count, _SUPPORT) for each in splines], axis=1)
    columns = np.stack(
        [each.indices.reshape(count, _SUPPORT) + first[j] for j, each in enumerate(splines)],
        axis=1,
    )
    data = by_angle[:, :, :, None] * values[:, None]
    width = int(first[-1])
    if touched:
        chosen = np.concatenate([at + first[j] for j, at in enumerate(touched)])
        number = np.full(width, -1, dtype=columns.dtype)
        number[chosen] = np.arange(len(chosen))
        columns, width = number[columns], len(chosen)
        assert columns.min(initial=0) >= 0
    indices = np.broadcast_to(columns[:, None], data.shape)
    starts = np.arange(rows + 1) * _SUPPORT * joints
    return csr_array((data.ravel(), indices.ravel(), starts), shape=(rows, width))


def touched_splines(q_rad: Array, knots: int) -> Index:
    """Return the B-splines of a map (v,) that are not zero at some of the angles (P,).

    A joint is seldom seen all around, and the prior alone determines the others.
    """
    return np.unique(b_splines(knots, q_rad).indices).astype(np.intp)


@dataclass(frozen=True, eq=False)
class MapMotion:
    """Motion of N positions by a map: a spline of an angle, whose parameters are K knots."""

    columns: Index  # (K,) the knots among all parameters
    q_rad: Array  # (N,) the angle
    moved: Array  # (N, 3) derivative of the position by the value of the map


def position_covariance(
    covariance: Array, dense: Index, moved: Array, maps: Sequence[MapMotion]
) -> Array:
    """Return the covariance of N positions, (N, 3, 3).

    A map has hundreds of knots, each of which moves every position a little; of its B-splines only
    four do. No matrix of positions by knots is made, and 10 000 positions take a second.

    Args:
        covariance: (k, k) of the parameters.
        dense: (d,) parameters that are no knots.
        moved: (N, 3, d) derivative of the positions by these.
        maps: the other parameters.
    """
    d, first = len(dense), len(dense)
    order = np.concatenate([dense, *(motion.columns for motion in maps)])
    by_splines = covariance[np.ix_(order, order)]  # of `dense`, then coefficients of the B-splines
    touched: list[Index] = []  # (N, 4) B-splines that are not zero at each angle
    by_touched: list[Array] = []  # (N, 3, 4) derivative of the positions by their coefficients
    for motion in maps:
        knots = len(motion.columns)
        rows, to_splines = slice(first, first + knots), b_splines_by_knots(knots)
        by_splines[rows] = to_splines @ by_splines[rows]
        by_splines[:, rows] = by_splines[:, rows] @ to_splines.T
        splines = b_splines(knots, motion.q_rad)
        touched.append(first - d + splines.indices.astype(np.intp).reshape(-1, 4))
        by_touched.append(motion.moved[:, :, None] * splines.data.reshape(-1, 1, 4))
        first += knots
    of_positions = np.empty((len(moved), 3, 3))
    for start in range(0, len(moved), _BLOCK):
        block = slice(start, start + _BLOCK)
        by_dense = moved[block] @ by_splines[:d]  # (B, 3, k)
        of_positions[block] = by_dense[:, :, :d] @ np.swapaxes(moved[block], 1, 2)
        if maps:
            at = np.concatenate([each[block] for each in touched], axis=1)
            velocity = np.concatenate([each[block] for each in by_touched], axis=2)
            across = np.take_along_axis(by_dense[:, :, d:], at[:, None, :], axis=2)
            between = across @ np.swapaxes(velocity, 1, 2)
            of_touched = by_splines[d + at[:, :, None], d + at[:, None, :]]
            of_maps = velocity @ of_touched @ np.swapaxes(velocity, 1, 2)
            of_positions[block] += between + np.swapaxes(between, 1, 2) + of_maps
    return of_positions
