"""How large the harmonics of a joint's error are expected to be: its spectrum, a Gaussian prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array

#: How steeply a band begins: the power of the order in its step.
_STEEP = 8
#: Highest order that an axis off its centre or an oval ring makes.
_SLOW = 2


@dataclass(frozen=True)
class Fading:
    """Sizes expected of a map's harmonics: the finer, the less.

    Sine and cosine part of m cycles a turn have the standard deviation
    size / (1 + (m / half_order)²), each for itself.
    """

    size_rad: float  # of the coarsest
    half_order: float  # cycles a turn of which half as much is expected

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        sizes: Array = self.size_rad / (1.0 + (orders / self.half_order) ** 2)
        return sizes


@dataclass(frozen=True)
class Band:
    """Sizes expected of a map's harmonics: a band of orders, less above it, down to a floor.

    Sine and cosine part of m cycles a turn have the variance
    (below² + (level² - below²) / (1 + (first / m)⁸)) / (1 + (m / last)^(2 decay)) + floor²;
    those of one and of two cycles, which a ring off its axis or oval makes, slow² + floor².
    """

    slow_rad: float  # of one and of two cycles a turn
    below_rad: float  # level of the orders between them and the band
    level_rad: float  # level in the band
    # first_order and last_order: where the band begins and ends, in cycles a turn
    first_order: float
    last_order: float
    decay: float  # power of the order by which sizes fall above the band
    floor_rad: float  # that no order falls below

    def sizes_rad(self, orders: Array) -> Array:
        """Return the standard deviation of sine and cosine part of orders (M,)."""
        inside = orders**_STEEP / (orders**_STEEP + self.first_order**_STEEP)
        level = self.below_rad**2 + (self.level_rad**2 - self.below_rad**2) * inside
        above = 1.0 + (orders / self.last_order) ** (2.0 * self.decay)
        variance = np.where(orders <= _SLOW, self.slow_rad**2, level / above)
        sizes: Array = np.sqrt(variance + self.floor_rad**2)
        return sizes


Spectrum = Fading | Band
