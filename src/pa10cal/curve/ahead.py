"""Many points at once, guessed and then proved, where the curve bends gently.

Each point depends on the one before, but all of them together are the solution of one system of
equations, each link's length in its two end points, which Newton's method solves with a matrix of
two diagonals. Whether each point is also the first at its distance is settled afterwards, for all
of them: while the tangent turns by no more than a quarter turn, or the curvature is nowhere above k
and the arc no longer than pi / k, the distance from the first point of an arc only grows along it.
(In the first case every tangent has a component along the last one; for the second the chord has,
by the same integral with the angles at their worst.) With k L < 2 the crossing is then inside the
arc length [L, (2 / k) asin(k L / 2)]. Points for which neither can be shown go to the search
that is certain everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from pa10cal.arrays import Array
from pa10cal.curve.curve import Bounds, Curve

_QUARTER_TURN = np.pi / 2.0 - 1e-6
_HALF_TURN = np.pi - 1e-6
_STEPS = 10
#: A link this slanted to the curve goes to the search.
_LEAST_SLOPE = 0.05


@dataclass(frozen=True)
class Ahead:
    """Points that follow one another, each proved to be the first at the link's length."""

    t: Array  # (k,) their parameters
    p_m: Array  # (k, 3) the points [m]

    def __len__(self) -> int:
        return len(self.t)


def points_ahead(curve: Curve, t: float, p_m: Array, link_m: float, most: int) -> Ahead:
    """Find the next points as far as they can be proved.

    Args:
        curve: the curve.
        t: parameter of the last point.
        p_m: (3,) that point [m].
        link_m: length of a link.
        most: how many points at most.
    """
    bounds = curve.bounds
    first_end = float(bounds.not_beyond(bounds.length_to(np.array(t)) + link_m))
    none = Ahead(np.zeros(0), np.zeros((0, 3)))
    if not _only_leaves(bounds, np.array([t, first_end])).all():
        return none
    guess = _guess(curve, t, link_m, most)
    guess = guess[_leading(_only_leaves(bounds, np.append(t, guess)))]
    if not len(guess):
        return none
    found = _solve(curve, t, p_m, link_m, guess)
    chords = np.linalg.norm(np.diff(found.p_m, axis=0, prepend=p_m[None]), axis=1)
    along = np.append(t, found.t)
    same_m = bounds.same_length_m(found.t, found.p_m, link_m)
    good = (np.abs(chords - link_m) <= same_m) & (np.diff(along) > 0.0)
    good &= found.t <= bounds.end
    good = _leading(good)
    good[good] = _only_leaves(bounds, along[: good.sum() + 1])
    good = _leading(good)
    return Ahead(found.t[good], found.p_m[good])


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
                return Ahead(found[:0], r_m[:0])
            bands = np.stack([slope[:count], np.append(before[: count - 1], 0.0)])
            step = solve_banded((1, 0), bands, (link_m - length)[:count], check_finite=False)
            move = np.abs(step) * np.linalg.norm(v[:count], axis=1)
            same_m = curve.bounds.same_length_m(found[:count], r_m[:count], link_m)
            settled = _leading(move <= same_m)
            if settled.all():
                break
            found = np.maximum.accumulate((found[:count] + step).clip(t, end))
        kept = int(settled.sum())
        return Ahead(found[:kept] + step[:kept], r_m[:kept] + step[:kept, None] * v[:kept])


def _only_leaves(bounds: Bounds, t: Array) -> NDArray[np.bool_]:
    """Return between which parameters the distance from the former is proved to grow all along."""
    certain = bounds.turning_between(t) <= _QUARTER_TURN
    if not certain.all():
        arc = np.diff(bounds.length_to(t)) * bounds.curvature_between(t)
        certain |= arc <= _HALF_TURN
    return certain


def _leading(good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.logical_and.accumulate(good)
