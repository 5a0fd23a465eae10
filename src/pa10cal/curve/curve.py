"""What must be known of a curve so that no crossing on it is missed.

A curve is a place and a velocity as functions of any parameter t, not only of arc length, with
bounds that hold in cells of t: how slow and how fast the place moves, how much its velocity can
change, how fast its tangent can turn. They are what makes a search for the first point at a
distance certain: the distance from a point cannot change faster than arc length grows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array

#: Bounds are taken a little wider than computed, against rounding.
_WIDER = 1e-9
#: A tangent that jumps by less does so by rounding.
_ROUNDED_KINK_RAD = 1e-9
#: Lengths that differ by less than this part count as equal.
_SAME_LENGTH = 5e-13
_ROUNDING = 16.0 * float(np.finfo(float).eps)


class Curve(Protocol):
    """A finite curve in space."""

    @property
    def bounds(self) -> Bounds:
        """What holds everywhere on it, cell by cell; its edges begin and end the curve."""
        ...

    def at(self, t: Array) -> Array:
        """Return the places (N, 3) at parameters (N,) [m]."""
        ...

    def with_velocity(self, t: Array) -> tuple[Array, Array]:
        """Return places and their derivatives by t, both (N, 3); at a kink, of what follows."""
        ...


@dataclass(frozen=True)
class Bounds:
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
            link_m: length of a link.
        """
        rounded = _ROUNDING * (np.abs(p_m).max(axis=-1) + self.top_speed * np.abs(t))
        return np.asarray(np.maximum(_SAME_LENGTH * link_m, rounded))


def uniform_bounds(
    start: float, end: float, slowest: float, fastest: float, acceleration: float
) -> Bounds:
    """Return bounds that are the same all along a curve without kinks.

    The tangent turns no faster than acceleration over speed.
    """
    turning = acceleration / slowest if slowest > 0.0 else np.inf
    return Bounds(
        edges=np.array([start, end]),
        slowest=np.array([slowest]),
        fastest=np.array([fastest]),
        acceleration=np.array([acceleration]),
        turning=np.array([turning]),
        kinks_rad=np.zeros(0),
    )


def _sum_from_zero(parts: NDArray[np.generic]) -> Array:
    return np.concatenate([[0.0], np.cumsum(parts)])
