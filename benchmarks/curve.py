"""A curve as links: exactness, time, growth of the cost, and whether a first point is missed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from pa10cal.arrays import Array
from pa10cal_curve.angles import JointAngles, chain_points, first_axes, joint_angles
from pa10cal_curve.curve import Curve, spline_through
from pa10cal_curve.points import CurvePoints, first_crossing, lay_points
from pa10cal_curve.roll import RollMap, smallest_move

COUNTS = tuple(int(n) for n in np.geomspace(10, 100_000, 13).round())
ROUNDS = 7
SPLINES = 10_000
_SCANNED = 2001


class Counting:
    """A curve that counts at how many places it is asked for."""

    def __init__(self, curve: Curve) -> None:
        self._curve = curve
        self.bounds = curve.bounds
        self.places = 0

    def at(self, t: Array) -> Array:
        self.places += t.size
        return self._curve.at(t)

    def with_velocity(self, t: Array) -> tuple[Array, Array]:
        self.places += t.size
        return self._curve.with_velocity(t)

    length_between_m = Curve.length_between_m  # by the places asked for here
    length_left_m = Curve.length_left_m


def bent_spline(seed: int = 1, points: int = 30) -> Curve:
    """Return a spline through a random walk: about 50 m long, bends down to centimetres."""
    steps = np.random.default_rng(seed).normal(size=(points, 3))
    return spline_through(np.cumsum(steps, axis=0))


def waved_spline() -> Curve:
    """Return a spline about a metre long that ten links can follow as well."""
    t = np.linspace(0.0, 1.0, 12)
    return spline_through(np.stack([t, 0.1 * np.sin(5 * t), 0.1 * np.cos(4 * t)], axis=1))


def whole(curve: Curve, link_m: float, n: int) -> tuple[CurvePoints, JointAngles]:
    """Lay links and work out their joint angles at roll zero."""
    points = lay_points(curve, link_m, n)
    return points, joint_angles(points.directions, first_axes(points.directions, 0.0))


def best_s(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the shortest of several times [s]."""
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


@dataclass(frozen=True)
class Growth:
    """A cost at each of `COUNTS`, and the power of n by which it grows.

    Attributes:
        cost: (13,) the cost.
        exponent: p of c + k n^p, by regression of its logarithm: c is the cost of a call.
        plain: exponent of a power alone, which takes the cost of a call for that of links.
    """

    cost: Array
    exponent: float
    plain: float

    @classmethod
    def of(cls, cost: Array) -> Growth:
        n = np.array(COUNTS, dtype=float)

        def off(x: Array) -> Array:
            return np.asarray(np.log(np.exp(x[0]) + np.exp(x[1]) * n ** x[2]) - np.log(cost))

        start = np.array([np.log(cost[0] / 2.0), np.log(cost[-1] / n[-1]), 1.0])
        plain = np.polyfit(np.log(n), np.log(cost), 1)[0]
        return cls(cost, float(least_squares(off, start).x[2]), float(plain))


def growth() -> tuple[Growth, Growth]:
    """Measure places of the curve asked for, and seconds for points and angles [s]."""
    curve = waved_spline()
    length_m = lay_points(curve, 1e-3).n * 1e-3
    places, seconds = [], []
    for n in COUNTS:
        link_m = 0.99 * length_m / n
        counting = Counting(curve)
        lay_points(counting, link_m, n)
        places.append(counting.places)
        seconds.append(best_s(partial(whole, curve, link_m, n)))
    return Growth.of(np.array(places, dtype=float)), Growth.of(np.array(seconds))


def missed(splines: int = SPLINES) -> int:
    """Count the splines with tight bends on which a dense scan finds an earlier first point."""
    random = np.random.default_rng(20080427)
    count = 0
    for _ in range(splines):
        points_m = random.normal(size=(random.integers(4, 9), 3))
        points_m[:, 2] *= random.choice([1.0, 0.01])
        curve = spline_through(points_m)
        t = float(random.uniform(curve.bounds.start, 0.7 * curve.bounds.end))
        link_m = random.uniform(0.2, 3.0)
        p_m = curve.at(np.array([t]))[0]
        found = first_crossing(curve, t, p_m, link_m)
        at = np.linspace(t, curve.bounds.end, _SCANNED)
        over = np.flatnonzero(np.linalg.norm(curve.at(at) - p_m, axis=1) >= link_m)
        if len(over) and (found is None or found.t > at[over[0]] * (1.0 + 1e-14)):
            count += 1
    return count


def rows() -> list[tuple[str, float, str, str]]:
    """Return what was measured: what, value, unit, bar."""
    curve, n = bent_spline(), 1000
    link_m = 0.99e-3 * lay_points(curve, 1e-3).n / n
    points, joints = whole(curve, link_m, n)
    back = chain_points(
        joints.a_rad, joints.b_rad, "zy", joints.axes[0], points.p_m[0], points.link_m
    )
    chords = np.linalg.norm(np.diff(points.p_m, axis=0), axis=1)
    off = np.linalg.norm(back - points.p_m, axis=1).max() / (n * link_m)

    def with_roll() -> None:
        laid = lay_points(curve, link_m, n)
        best = smallest_move(RollMap.of(laid.directions))
        joint_angles(laid.directions, first_axes(laid.directions, best.roll_rad))

    places, seconds = growth()
    bar, of = "0.95 to 1.05", "curve, 10 to 100 000 links: exponent of"
    thousand = "curve, 1000 links on a spline:"
    gentle_s = seconds.cost[COUNTS.index(n)]
    bent_s = best_s(partial(whole, curve, link_m, n))
    return [
        (f"{thousand} chord error over the link", np.abs(chords / link_m - 1).max(), "", "≤ 1e-12"),
        (f"{thousand} forward kinematics over the length", off, "", "≤ 1e-11"),
        (f"{thousand} points and angles", 1e3 * gentle_s, "ms", "≤ 20"),
        (f"{thousand} points and angles, tight bends", 1e3 * bent_s, "ms", "≤ 20"),
        (f"{thousand} with tight bends, roll optimised", 1e3 * best_s(with_roll), "ms", "≤ 300"),
        ("curve, 100 000 links: points and angles", seconds.cost[-1], "s", ""),
        (f"{of} time, a call's own aside", seconds.exponent, "", bar),
        (f"{of} time, a call's own counted to links", seconds.plain, "", ""),
        (f"{of} places, a call's own aside", places.exponent, "", bar),
        (f"{of} places, a call's own counted to links", places.plain, "", ""),
        (f"curve, first points missed on {SPLINES} splines", float(missed()), "", "0"),
    ]


if __name__ == "__main__":
    for what, value, unit, bar in rows():
        print(f"{what:<76} {value:10.3g} {unit:<3} {bar}")
