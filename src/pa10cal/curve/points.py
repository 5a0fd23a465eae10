"""The points of a curve at which links of equal length join, from its beginning to its end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from pa10cal.arrays import Array
from pa10cal.curve.ahead import points_ahead
from pa10cal.curve.curve import Curve
from pa10cal.curve.first_crossing import first_crossing
from pa10cal.errors import CurveError

#: Points sought together at least and at most, and how much more than were found before.
_FIRST_BLOCK, _LARGEST_BLOCK, _GROWTH = 32, 4096, 4
_MOST_LINKS = 10_000_000
#: Gauss's rule for arc length: nodes from -1 to 1, and the least number of parts of a curve.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_PARTS = 16
#: The search for a length goes on in steps of this factor, to so much shorter links at most.
_TIMES, _MOST_TIMES = 1.1, 1e3
_FINEST = 4.0 * float(np.finfo(float).eps)
#: Shortening by rounding, so that the last link just reaches the end.
_SHORTER = tuple(ulps * float(np.finfo(float).eps) for ulps in (0, 1, 2, 4, 8, 16, 32, 64))


class Ending(Enum):
    """How the points of a curve end."""

    COMPLETE = "all links requested are placed"
    EXACT = "the last link ends at the curve's end"
    USED_UP = "the rest of the curve is shorter than a link"
    INSIDE = "the rest of the curve stays within a link's length"


@dataclass(frozen=True)
class Points:
    """Points on a curve, each the first of the curve at the link's length from the one before."""

    link_m: float  # length of the n links
    t: Array  # (n + 1,) parameters of the points; the first is the curve's beginning
    p_m: Array  # (n + 1, 3) the points [m]
    # (n,) where the curve only touches the sphere about a link's beginning at its end
    touches: NDArray[np.bool_]
    ending: Ending
    left_m: float  # arc length of the curve after the last point [m]
    gap_m: float  # distance of the curve's end from the last point [m]

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.touches)

    @property
    def directions(self) -> Array:
        """Unit vectors along the links, (n, 3)."""
        chords = np.diff(self.p_m, axis=0)
        return np.asarray(chords / np.linalg.norm(chords, axis=1)[:, None])


def lay_points(curve: Curve, link_m: float, most: int | None = None) -> Points:
    """Lay points along a curve, each the first of it at the link's length from the one before.

    Args:
        curve: the curve.
        link_m: length of a link.
        most: how many links at most; None for as many as there is room for.

    Raises:
        CurveError: when the length is not positive or longer than the curve, or there would be
            millions of links.
    """
    _refuse_length(curve, link_m, most)
    points = _lay(curve, link_m, _MOST_LINKS if most is None else most)
    if points.ending is Ending.USED_UP and not points.n:
        raise CurveError(
            "the link is longer than the curve",
            where="link_m",
            value=link_m,
            allowed=f"less than the curve's length, {points.left_m:g} m",
            remedy="take shorter links",
        )
    return points


def equal_links(curve: Curve, n: int) -> Points:
    """Lay n links along a curve, as long as they must be for the last to end where it ends.

    The links that a curve has room for, and what they leave over in links, are all but linear in
    one over their length; they jump where a link just fails to reach past a bend, and may jump over
    the number requested.

    Raises:
        CurveError: when no length is found.
    """
    if n < 1:
        raise CurveError(
            "there is no link",
            where="links",
            value=n,
            allowed="one or more",
            remedy="request more links",
        )
    bounds = curve.bounds
    longest_m = arc_length_m(curve, bounds.start, bounds.end) / n

    def left_over(shorter: float) -> float:
        points = _lay(curve, longest_m / shorter, _MOST_LINKS)
        return points.n + points.gap_m / points.link_m - n

    low = high = 1.0 / _TIMES  # arcs of links are no shorter than links: this leaves too little
    while left_over(high) < 0.0 and high < _MOST_TIMES:
        low, high = high, _TIMES * high
    found = brentq(left_over, low, high, xtol=_FINEST, rtol=_FINEST)
    points = _just_reaching(curve, longest_m / found, n)
    if points.ending is Ending.EXACT and points.n == n:
        return points
    raise CurveError(
        f"no {n} equal links end where the curve ends",
        where="links",
        value=f"{points.n} links of {points.link_m:g} m leave {points.left_m:g} m",
        allowed="a number at which links a little longer do not reach past a bend",
        remedy="request another number of links",
    )


def _just_reaching(curve: Curve, link_m: float, n: int) -> Points:
    """Lay n links of about a length at which the last one ends with the curve but for rounding."""
    for shorter in _SHORTER:
        points = _lay(curve, link_m * (1.0 - shorter), n)
        if points.ending is Ending.EXACT:
            break
    return points


def arc_length_m(curve: Curve, low: float, high: float) -> float:
    """Return the length of a curve between two parameters [m], by Gauss's rule in each cell."""
    bounds = curve.bounds
    ends = bounds.stretches(low, high, bounds.length_m[-1] / _PARTS)
    half = np.diff(ends)[:, None] / 2.0
    at = ends[:-1, None] + half * (1.0 + _NODES)
    _, v = curve.with_velocity(at.ravel())
    speed = np.linalg.norm(v, axis=1).reshape(at.shape)
    return float((half * speed * _WEIGHTS).sum())


@dataclass(frozen=True)
class _Laid:
    """Some points in a row: t (k,), p_m (k, 3), touches."""

    t: Array
    p_m: Array
    touches: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: list[_Laid]) -> _Laid:
        return cls(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.p_m for part in parts]),
            np.concatenate([part.touches for part in parts]),
        )


def _lay(curve: Curve, link_m: float, wanted: int) -> Points:
    """Lay points, many at once where they can be proved, else one by one."""
    begun = np.array([curve.bounds.start])
    laid = [_Laid(begun, curve.at(begun), np.zeros(0, dtype=bool))]
    count, block = 0, _FIRST_BLOCK
    while count < wanted:
        t, p_m = float(laid[-1].t[-1]), laid[-1].p_m[-1]
        ahead = points_ahead(curve, t, p_m, link_m, min(block, wanted - count))
        if len(ahead):
            laid.append(_Laid(ahead.t, ahead.p_m, np.zeros(len(ahead), dtype=bool)))
            block = min(_LARGEST_BLOCK, max(_FIRST_BLOCK, _GROWTH * len(ahead)))
        else:
            block = _FIRST_BLOCK
            crossing = first_crossing(curve, t, p_m, link_m)
            if crossing is None:
                break
            touches = np.array([crossing.touches])
            laid.append(_Laid(np.array([crossing.t]), crossing.p_m[None], touches))
        count += len(laid[-1].touches)
    return _fit_summary(curve, link_m, _Laid.joined(laid), wanted)


def _fit_summary(curve: Curve, link_m: float, laid: _Laid, wanted: int) -> Points:
    """Return how points end."""
    t, end = float(laid.t[-1]), curve.bounds.end
    gap_m = float(np.linalg.norm(curve.at(np.array([end]))[0] - laid.p_m[-1]))
    left_m = arc_length_m(curve, t, end) if t < end else 0.0
    same_m = float(curve.bounds.same_length_m(laid.t[-1], laid.p_m[-1], link_m))
    if max(left_m, gap_m) <= len(laid.t) * same_m:
        ending = Ending.EXACT
    elif len(laid.touches) == wanted:
        ending = Ending.COMPLETE
    else:
        ending = Ending.USED_UP if left_m < link_m else Ending.INSIDE
    return Points(link_m, laid.t, laid.p_m, laid.touches, ending, left_m, gap_m)


def _refuse_length(curve: Curve, link_m: float, most: int | None) -> None:
    longest_m = float(curve.bounds.length_m[-1])
    if not (np.isfinite(link_m) and link_m > 0.0):
        raise CurveError(
            "the length of a link is not positive",
            where="link_m",
            value=link_m,
            allowed="a finite number above 0 [m]",
            remedy="correct it",
        )
    if most is None and longest_m / link_m > _MOST_LINKS:
        raise CurveError(
            "the links are too many",
            where="link_m",
            value=link_m,
            allowed=f"at least a {_MOST_LINKS:g}th of the curve, {longest_m:g} m",
            remedy="take longer links, or give their number",
        )
