"""Sine and 1 - cosine of random small angles, in as few passes over memory as they can take."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pa10cal.arrays import Array

#: The series leaves out δ⁴/24 of 1 - cos δ and δ⁵/120 of sin δ; it serves while the former, of
#: an angle this many standard deviations long, stays below `_LEFT_OUT`: a longer angle comes once
#: in 1e15 draws.
_LONGEST_SIGMAS = 8.0
_LEFT_OUT = 1e-12


class Turns(Protocol):
    """How rows of standard normals become sines and cosines of angles.

    The two are wanted only as factors in a linear map, so they may come in any fixed scale.

    Attributes:
        sine_scale: sin δ over what `fill` writes for it.
        versine_scale: (1 - cos δ) over what `fill` writes for it.
        refined_scale: (1 - cos δ) over what `refine` makes of it.
    """

    @property
    def sine_scale(self) -> float:
        """Return sin δ over the sine row."""

    @property
    def versine_scale(self) -> float:
        """Return (1 - cos δ) over the versine row."""

    @property
    def refined_scale(self) -> float:
        """Return (1 - cos δ) over the refined versine row."""

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Replace the normals z by the sine rows of the angles σz, and write the versines."""

    def refine(self, versine: Array, work: Array) -> None:
        """Make a versine row exact for sums of errors, which are longer than single ones."""


@dataclass(frozen=True)
class SeriesTurns:
    """Taylor series: sin δ = -(σ³/6) z (z² - 6/σ²), 1 - cos δ = (σ²/2) z², with δ = σ z.

    Refined: 1 - cos δ = (σ⁴/24) z² (12/σ² - z²).
    """

    sigma_rad: float

    @property
    def sine_scale(self) -> float:
        """Return sin δ over the sine row."""
        return -(self.sigma_rad**3) / 6.0

    @property
    def versine_scale(self) -> float:
        """Return (1 - cos δ) over the versine row."""
        return self.sigma_rad**2 / 2.0

    @property
    def refined_scale(self) -> float:
        """Return (1 - cos δ) over the refined versine row."""
        return self.sigma_rad**4 / 24.0

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Write z (z² - 6/σ²) and z²."""
        np.square(normals, versine)
        np.subtract(versine, self._six, work)
        np.multiply(normals, work, normals)

    def refine(self, versine: Array, work: Array) -> None:
        """Make z² into z² (12/σ² - z²)."""
        np.subtract(self._twelve, versine, work)
        np.multiply(versine, work, versine)

    # Arrays, because numpy would convert a number at every call.

    @cached_property
    def _six(self) -> Array:
        return np.array(6.0 / self.sigma_rad**2)

    @cached_property
    def _twelve(self) -> Array:
        return np.array(12.0 / self.sigma_rad**2)


@dataclass(frozen=True)
class LibraryTurns:
    """numpy's sine, for angles too large for the series; 1 - cos δ = 2 sin²(δ/2)."""

    sigma_rad: float
    sine_scale: float = 1.0
    versine_scale: float = 2.0
    refined_scale: float = 2.0

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Write sin σz and sin² σz/2."""
        np.multiply(normals, 0.5 * self.sigma_rad, work)
        np.sin(work, work)
        np.multiply(work, work, versine)
        np.multiply(normals, self.sigma_rad, normals)
        np.sin(normals, normals)

    def refine(self, versine: Array, work: Array) -> None:
        """Leave the row as it is: exact already."""


def turns_of(sigma_rad: float, most_added: int) -> Turns:
    """Return the series where it is exact, else numpy's sine.

    Args:
        sigma_rad: standard deviation of one joint's angle.
        most_added: how many independent angles at most are added into one.
    """
    longest = _LONGEST_SIGMAS * np.sqrt(most_added) * sigma_rad
    return SeriesTurns(sigma_rad) if longest**4 / 24.0 <= _LEFT_OUT else LibraryTurns(sigma_rad)
