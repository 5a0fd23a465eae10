"""The points of a curve at which links of equal length join, from its beginning to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.optimize import brentq

from pa10cal.arrays import Array
from pa10cal.errors import CurveError
from pa10cal_curve.angles import refuse_no_link
from pa10cal_curve.curve import Curve, CurveBounds

#: Points sought together at least and at most, and how much more than were found before.
_FIRST_BLOCK, _LARGEST_BLOCK, _GROWTH = 32, 4096, 4
_MOST_LINKS = 10_000_000
#: By so much a speed may exceed its bound, by rounding far from the origin or at its parameter.
_SLACK = 1e-6
#: Halvings of a part in which a length ends, beyond the last digit.
_HALVINGS = 60
#: Places at which the distance of the curve from a link is looked at, its middle one of them.
_PLACES_A_LINK = 33
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
class CurvePoints:
    """Points on a curve, each the first of the curve at the link's length from the one before."""

    link_m: float  # length of the n links
    t: Array  # (n + 1,) parameters of the points; the first is where the chain begins
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


def lay_points(
    curve: Curve, link_m: float, most: int | None = None, start: float | None = None
) -> CurvePoints:
    """Lay points along a curve, each the first of it at the link's length from the one before.

    Args:
        most: how many links at most; None for as many as there is room for.
        start: parameter at which the first link begins; None for the curve's beginning.

    Raises:
        CurveError: when the length is not positive or longer than the curve, there would be
            millions of links, or the curve is faster than its bound.
    """
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
    points = _lay(curve, link_m, _MOST_LINKS if most is None else most, start)
    if points.ending is Ending.USED_UP and not points.n:
        raise CurveError(
            "the link is longer than the curve",
            where="link_m",
            value=link_m,
            allowed=f"less than the curve's length, {points.left_m:g} m",
            remedy="take shorter links",
        )
    _refuse_false_bound(curve, points)
    return points


def _refuse_false_bound(curve: Curve, points: CurvePoints) -> None:
    """Refuse a bound of the speed that does not hold at the points, as others may be the first.

    Raises:
        CurveError: naming the speed.
    """
    _, v = curve.with_velocity(points.t)
    speed, top_speed = np.linalg.norm(v, axis=1), curve.bounds.top_speed
    fastest = int(np.argmax(speed))
    if speed[fastest] > top_speed * (1.0 + _SLACK):
        raise CurveError(
            "the curve is faster than its bound says",
            where=f"t = {points.t[fastest]:g}",
            value=float(speed[fastest]),
            allowed=f"at most {top_speed:g}, the bound that the curve states",
            remedy="state a bound of the speed that holds all along the curve",
        )


def equal_links(curve: Curve, n: int) -> CurvePoints:
    """Lay n links along a curve, as long as they must be for the last to end where it ends.

    The links that a curve has room for, and what they leave over in links, are all but linear in
    one over their length; they jump where a link just fails to reach past a bend, and may jump over
    the number requested.

    Raises:
        CurveError: when no length is found.
    """
    refuse_no_link(n)
    bounds = curve.bounds
    longest_m = arc_length_m(curve, bounds.start, bounds.end) / n

    def left_over(shorter: float) -> float:
        points = _lay(curve, longest_m / shorter, _MOST_LINKS)
        return points.n + points.gap_m / points.link_m - n

    low = high = 1.0 / _TIMES  # arcs of links are no shorter than links: this leaves too little
    while left_over(high) < 0.0 and high < _MOST_TIMES:
        low, high = high, _TIMES * high
    link_m = longest_m / brentq(left_over, low, high, xtol=_FINEST, rtol=_FINEST)
    for shorter in _SHORTER:
        points = _lay(curve, link_m * (1.0 - shorter), n)
        if points.ending is Ending.EXACT:
            break
    if points.ending is Ending.EXACT and points.n == n:
        _refuse_false_bound(curve, points)
        return points
    nearest = f"{points.n} links of {points.link_m:g} m leave {points.left_m:g} m"
    raise CurveError(
        f"no {n} equal links end where the curve ends",
        where="links",
        value=nearest,
        allowed="a number at which links a little longer do not reach past a bend",
        remedy="request another number of links",
    )


def arc_length_m(curve: Curve, low: float, high: float) -> float:
    """Return the length of a curve between two parameters [m]."""
    from_low_m, from_high_m = _left_m(curve, np.array([low, high]))
    return float(from_low_m - from_high_m)


def _left_m(curve: Curve, t: Array) -> Array:
    """Return the arc lengths (k,) from parameters (k,) to the end of the curve [m]."""
    ends, left_m = curve.length_left_m
    following = np.searchsorted(ends, t, "right").clip(1, len(ends) - 1)
    return np.asarray(left_m[following] + curve.length_between_m(t, ends[following]))


def parameters_at(curve: Curve, length_m: Array) -> Array:
    """Return the parameters (N,) up to which a curve has so much arc length (N,) [m].

    The end of the curve where it is shorter.
    """
    ends, all_left_m = curve.length_left_m
    left_m = all_left_m[0] - length_m
    within = (np.searchsorted(-all_left_m, -left_m, "right") - 1).clip(0, len(ends) - 2)
    low, high = ends[within], ends[within + 1]
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        beyond_m = all_left_m[within + 1] + curve.length_between_m(middle, ends[within + 1])
        short = beyond_m >= left_m
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.asarray(np.where(length_m > 0.0, np.where(left_m > 0.0, low, ends[-1]), ends[0]))


def farthest_m(curve: Curve, points: CurvePoints) -> float:
    """Return how far the curve is from its links at most, where these stand for it [m].

    Each place is measured to the link over it; exactly of a polyline, to a thousandth of an arc.
    """
    bounds, farthest = curve.bounds, 0.0
    share = np.linspace(0.0, 1.0, _PLACES_A_LINK)
    for first in range(0, points.n, _LARGEST_BLOCK):
        t = points.t[first : first + _LARGEST_BLOCK + 1]
        begin, end = np.searchsorted(bounds.edges, [t[0], t[-1]])
        inner = bounds.edges[begin:end]
        even = t[:-1, None] + np.diff(t)[:, None] * share
        at = np.concatenate([even.ravel(), inner])
        link = (np.searchsorted(t, at, "right") - 1).clip(0, len(t) - 2)
        link[: even.size] = np.repeat(np.arange(len(t) - 1), _PLACES_A_LINK)
        along = points.directions[first : first + len(t) - 1][link]
        away_m = curve.at(at) - points.p_m[first + link]
        on_link_m = (away_m * along).sum(axis=1).clip(0.0, points.link_m)
        off_m = np.linalg.norm(away_m - on_link_m[:, None] * along, axis=1)
        farthest = max(farthest, float(off_m.max()))
    return farthest


def _lay(curve: Curve, link_m: float, wanted: int, start: float | None = None) -> CurvePoints:
    """Lay points, many at once where they can be proved, else one by one."""
    bounds, end = curve.bounds, curve.bounds.end
    begun = np.array([bounds.start if start is None else start])
    laid, touches = [(begun, curve.at(begun))], [np.zeros(0, dtype=bool)]
    count, block = 0, _FIRST_BLOCK
    while count < wanted:
        t, p_m = float(laid[-1][0][-1]), laid[-1][1][-1]
        ahead = points_ahead(curve, t, p_m, link_m, min(block, wanted - count))
        found = len(ahead[0])
        if found:
            touches.append(np.zeros(found, dtype=bool))
            block = min(_LARGEST_BLOCK, max(_FIRST_BLOCK, _GROWTH * found))
        else:
            block = _FIRST_BLOCK
            crossing = first_crossing(curve, t, p_m, link_m)
            if crossing is None:
                break
            ahead = np.array([crossing.t]), crossing.p_m[None]
            touches.append(np.array([crossing.touches]))
        laid.append(ahead)
        count += len(ahead[0])
    t_all, p_all_m = (np.concatenate(parts) for parts in zip(*laid, strict=True))
    gap_m = float(np.linalg.norm(curve.at(np.array([end]))[0] - p_all_m[-1]))
    left_m = float(_left_m(curve, t_all[-1:])[0]) if t_all[-1] < end else 0.0
    same_m = float(bounds.same_length_m(t_all[-1], p_all_m[-1], link_m))
    if max(left_m, gap_m) <= len(t_all) * same_m:
        ending = Ending.EXACT
    elif count == wanted:
        ending = Ending.COMPLETE
    else:
        ending = Ending.USED_UP if left_m < link_m else Ending.INSIDE
    return CurvePoints(link_m, t_all, p_all_m, np.concatenate(touches), ending, left_m, gap_m)


# Many points at once, guessed and then proved to be the first at their distance ("Many at once" of
# docs/curve.md), where the curve bends gently. The distance from the first point of an arc only
# grows while the tangent turns by no more than a quarter turn (every tangent has a component along
# the last one), or while the curvature is nowhere above k and the arc no longer than pi / k (the
# chord has, by the same integral with the angles at their worst).

_QUARTER_TURN = np.pi / 2.0 - 1e-6
_HALF_TURN = np.pi - 1e-6
_STEPS = 10
#: A link this slanted to the curve goes to the search.
_LEAST_SLOPE = 0.05


#: Points that follow one another: their parameters (k,), and the points (k, 3) [m].
Ahead = tuple[Array, Array]
NONE: Ahead = np.zeros(0), np.zeros((0, 3))


def points_ahead(curve: Curve, t: float, p_m: Array, link_m: float, most: int) -> Ahead:
    """Find the next points as far as each can be proved to be the first at the link's length.

    Args:
        t: parameter of the last point.
        p_m: (3,) that point [m].
    """
    bounds = curve.bounds
    first_end = float(bounds.not_beyond(bounds.length_to(np.array(t)) + link_m))
    if not _only_leaves(bounds, np.array([t, first_end])).all():
        return NONE
    guess = _guess(curve, t, link_m, most)
    guess = guess[_leading(_only_leaves(bounds, np.append(t, guess)))]
    if not len(guess):
        return NONE
    at, at_m = _solve(curve, t, p_m, link_m, guess)
    chords = np.linalg.norm(np.diff(at_m, axis=0, prepend=p_m[None]), axis=1)
    along = np.append(t, at)
    good = np.abs(chords - link_m) <= bounds.same_length_m(at, at_m, link_m)
    good = _leading(good & (np.diff(along) > 0.0) & (at <= bounds.end))
    good[good] = _only_leaves(bounds, along[: good.sum() + 1])
    good = _leading(good)
    return at[good], at_m[good]


def _guess(curve: Curve, t: float, link_m: float, most: int) -> Array:
    """Guess parameters from arc length and curvature, each arc taken for one of a circle."""
    bounds = curve.bounds
    here = float(bounds.length_to(np.array(t)))
    there = min(here + most * link_m, float(bounds.length_m[-1]))
    nodes = 2 * max(1, int(np.ceil((there - here) / link_m))) + 1
    at = bounds.not_beyond(np.linspace(here, there, nodes))
    at[0] = t
    _, v = curve.with_velocity(at)
    speed = np.linalg.norm(v, axis=1)
    arc = np.diff(at) * (speed[:-1] + speed[1:]) / 2.0
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = np.linalg.norm(np.diff(v / speed[:, None], axis=0), axis=1) / arc
        links = arc / link_m * (1.0 - (bend * link_m) ** 2 / 24.0)
    if not (np.isfinite(links).all() and (links > 0.0).all()):
        return np.zeros(0)
    total = np.append(0.0, np.cumsum(links))
    count = min(most, int(total[-1] + 1e-9))
    return np.asarray(np.interp(np.arange(1, count + 1), total, at))


def _solve(curve: Curve, t: float, p_m: Array, link_m: float, guess: Array) -> Ahead:
    """Solve for all points together, up to the first that does not settle or is too slanted.

    The last step, below what t can say, goes into the points along the tangent.
    """
    end = curve.bounds.end
    found = guess
    with np.errstate(all="ignore"):  # what is not finite does not settle
        for _ in range(_STEPS):
            r_m, v = curve.with_velocity(found)
            chord = np.diff(r_m, axis=0, prepend=p_m[None])
            length = np.linalg.norm(chord, axis=1)
            towards = chord / length[:, None]
            slope = (towards * v).sum(axis=1)
            before = -(towards[1:] * v[:-1]).sum(axis=1)
            fine = slope > _LEAST_SLOPE * np.linalg.norm(v, axis=1)
            count = int(_leading(fine & np.isfinite(length)).sum())
            if not count:
                return NONE
            bands = np.stack([slope[:count], np.append(before[: count - 1], 0.0)])
            step = solve_banded((1, 0), bands, (link_m - length)[:count], check_finite=False)
            move = np.abs(step) * np.linalg.norm(v[:count], axis=1)
            same_m = curve.bounds.same_length_m(found[:count], r_m[:count], link_m)
            settled = _leading(move <= same_m)
            if settled.all():
                break
            found = np.maximum.accumulate((found[:count] + step).clip(t, end))
        kept = int(settled.sum())
        return found[:kept] + step[:kept], r_m[:kept] + step[:kept, None] * v[:kept]


def _only_leaves(bounds: CurveBounds, t: Array) -> NDArray[np.bool_]:
    """Return between which parameters the distance from the former is proved to grow all along."""
    certain = bounds.turning_between(t) <= _QUARTER_TURN
    if not certain.all():
        arc = np.diff(bounds.length_to(t)) * bounds.curvature_between(t)
        certain |= arc <= _HALF_TURN
    return certain


def _leading(good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.logical_and.accumulate(good)


# The first point of a curve at a distance from one of its points, never a later one ("Certain
# everywhere" of docs/curve.md): stretches that may reach the distance are cut again, until the
# squared distance provably only grows in the first of them, or until only rounding remains, where
# the curve touches the sphere and turns back.

#: Stretches searched at first, as a part of the link, and into how many the suspicious is cut.
_FIRST_STRETCH, _CUTS = 0.125, 16
#: The search looks this many links ahead, then twice as many, up to the most at once.
_FIRST_LOOK, _LONGEST_LOOK = 2.0, 2048.0
#: Where the tangent is within this of square to the link, the curve may be turning back.
_SLANT = 1e-5
#: Half the reach in which it is looked for where the curve turns back, as a part of the link.
_NEAR = 1e-4
_ROUNDING = 16.0 * float(np.finfo(float).eps)
_LEAST = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Crossing:
    """The first point of a curve at a distance."""

    t: float  # its parameter
    p_m: Array  # (3,) the point [m]
    touches: bool  # whether the curve only touches the sphere there, and turns back


def first_crossing(curve: Curve, t: float, p_m: Array, link_m: float) -> Crossing | None:
    """Find the first point of the curve after one of its points, at a distance from it.

    Args:
        t: parameter of the point.
        p_m: (3,) the point [m].

    Returns:
        The first point, or None when all the rest of the curve is nearer.
    """
    bounds = curve.bounds
    same_m = float(bounds.same_length_m(np.array(t), p_m, link_m))
    search = _ChordSearch(curve, p_m, link_m, 2.0 * link_m * same_m)
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
class _ChordSearch:
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
    return float(brentq(f, low, high, xtol=_LEAST, rtol=_ROUNDING))
