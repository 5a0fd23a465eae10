"""Shares of trials with their exact intervals, and how sure an effect of some size is found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binomtest

Array = NDArray[np.float64]

LEVEL = 0.95
#: Standard deviation expected of the slope of a power curve: none is steeper than a few of these
#: where all trials below some size fail and all above succeed.
_STEEP = 5.0


@dataclass(frozen=True)
class Rate:
    """How many of some trials.

    Attributes:
        count: how many.
        of: out of these.
        low, high: 95 % interval of the share (Clopper and Pearson).
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def share(self) -> float | None:
        """Return the share, None of no trial."""
        return self.count / self.of if self.of else None


def rate(outcomes: Iterable[bool]) -> Rate:
    """Count outcomes."""
    flags = list(outcomes)
    if not flags:
        return Rate(0, 0, 0.0, 1.0)
    interval = binomtest(sum(flags), len(flags)).proportion_ci(LEVEL, method="exact")
    return Rate(sum(flags), len(flags), float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Power:
    """How the chance to be found grows with size: logistic in the logarithm of size.

    Attributes:
        intercept, slope: log odds = intercept + slope ln(size).
        half, most: sizes found in 50 and 95 of 100; None outside the sizes tried.
    """

    intercept: float
    slope: float
    half: float | None
    most: float | None

    def at(self, size: Array) -> Array:
        """Return the chance at some sizes."""
        chance: Array = 1.0 / (1.0 + np.exp(-(self.intercept + self.slope * np.log(size))))
        return chance


def power(size: Array, found: NDArray[np.bool_]) -> Power | None:
    """Fit a power curve; None where all trials, or none, were found.

    Args:
        size: (T,) positive.
        found: (T,).
    """
    if not len(size) or found.all() or not found.any():
        return None
    logarithm = np.log(size)
    middle = logarithm.mean()

    def misfit(x: Array) -> float:
        odds = x[0] + x[1] * (logarithm - middle)
        return float(np.sum(np.logaddexp(0.0, np.where(found, -odds, odds)))) + 0.5 * float(
            (x[1] / _STEEP) ** 2
        )

    best = minimize(misfit, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    centre, slope = float(best.x[0]), float(best.x[1])
    intercept = centre - slope * float(middle)

    def size_at(chance: float) -> float | None:
        if slope <= 0.0:
            return None
        found_at = float(np.exp((np.log(chance / (1.0 - chance)) - intercept) / slope))
        return found_at if size.min() <= found_at <= size.max() else None

    return Power(intercept, slope, size_at(0.5), size_at(LEVEL))
