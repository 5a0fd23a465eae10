"""Shares of trials with their exact intervals, and how sure an effect of some size is found."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binomtest

from pa10cal.arrays import Array
from pa10cal.results.trial_bars import Bar, Rate
from pa10cal.results.trials import PowerCurve

LEVEL = 0.95
#: Standard deviation expected of the slope of a power curve: none is steeper than a few of these
#: where all trials below some size fail and all above succeed.
_STEEP = 5.0


def rate(outcomes: Iterable[bool]) -> Rate:
    """Count outcomes."""
    flags = list(outcomes)
    if not flags:
        return Rate(count=0, of=0, low=0.0, high=1.0, share=None)
    interval = binomtest(sum(flags), len(flags)).proportion_ci(LEVEL, method="exact")
    count = sum(flags)
    return Rate(
        count=count,
        of=len(flags),
        low=float(interval.low),
        high=float(interval.high),
        share=count / len(flags),
    )


def bar(what: str, found: Rate, limit: float, *, at_least: bool = True) -> Bar:
    """Return a share with its interval against the one to reach."""
    bare = figure(what, found.share, limit, found.of, at_least=at_least)
    return bare.model_copy(update={"low": found.low, "high": found.high, "share": True})


def figure(
    what: str, reached: float | None, limit: float, trials: int, *, at_least: bool = False
) -> Bar:
    """Return a figure, None where no trial shows it, against the one to reach."""
    met = None  # where no trial counts
    if reached is not None:
        met = reached >= limit if at_least else reached <= limit
    return Bar(
        what=what,
        at_least=at_least,
        limit=limit,
        reached=reached,
        low=None,
        high=None,
        trials=trials,
        share=False,
        met=met,
    )


def power(size: Array, found: NDArray[np.bool_]) -> PowerCurve | None:
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

    return PowerCurve(intercept=intercept, slope=slope, half=size_at(0.5), most=size_at(LEVEL))
