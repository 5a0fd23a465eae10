"""Curves to try things on, and a dense scan that finds the first point at a distance slowly."""

from __future__ import annotations

import numpy as np

from pa10cal_curve.curve import Curve, spline_through


def tight_spline(random: np.random.Generator) -> Curve:
    """Return a spline through points scattered at random: loops, near cusps, bends of any kind."""
    points_m = random.normal(size=(random.integers(4, 9), 3))
    if random.uniform() < 0.5:
        points_m[:, 2] *= 0.01  # all but in a plane, where curves come back to where they were
    return spline_through(points_m)


def gentle_spline(random: np.random.Generator, points: int = 9) -> Curve:
    """Return a spline about a metre long without tight bends."""
    t = np.linspace(0.0, 1.0, points)
    a, b, c, d = random.uniform(-0.12, 0.12, 4)
    waves = np.stack([t, a * np.sin(5 * t) + b * t**2, c * np.cos(4 * t) + d * t], axis=1)
    return spline_through(waves)


def scan(curve, t: float, link_m: float, places: int) -> float | None:
    """Return the first of many parameters after t at which the curve is a link away."""
    at = np.linspace(t, curve.bounds.end, places)
    r_m = curve.at(at)
    over = np.flatnonzero(np.linalg.norm(r_m - r_m[0], axis=1) >= link_m)
    return float(at[over[0]]) if len(over) else None


def chord_error(points) -> float:
    """Return by how much links differ from their length, relative to it, at most."""
    chords = np.linalg.norm(np.diff(points.p_m, axis=0), axis=1)
    return float(np.abs(chords / points.link_m - 1.0).max(initial=0.0))


class Counting:
    """A curve that counts at how many places it is asked for."""

    def __init__(self, curve) -> None:
        self._curve = curve
        self.bounds = curve.bounds
        self.places = 0

    def at(self, t):
        self.places += t.size
        return self._curve.at(t)

    def with_velocity(self, t):
        self.places += t.size
        return self._curve.with_velocity(t)

    length_between_m = Curve.length_between_m  # by the places asked for here
    length_left_m = Curve.length_left_m
