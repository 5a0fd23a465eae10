"""Statistical power of blind trials: probability that a hidden effect is found, by its size."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize

from pa10cal.arrays import Array
from pa10cal_lab import trial_records as results
from pa10cal_lab.blind_trial import DETECTABLE_RATIO, LARGE_RATIO
from pa10cal_lab.trial_quantities import Quantity

#: Probability of being found from which an effect counts as found surely.
_SURELY = 0.95
#: Prior standard deviation of the slope of a power curve, which keeps it finite where all trials
#: below some size fail and all above succeed.
_STEEP = 5.0
#: Edges of bins of an effect's part of the residual over the noise floor. At two of them the whole
#: residual is `DETECTABLE_RATIO` and `LARGE_RATIO` times the floor.
MOVED_EDGES = (
    *(0.0, 0.1, 0.2, 0.4),
    *(float(np.sqrt(ratio**2 - 1.0)) for ratio in (DETECTABLE_RATIO, LARGE_RATIO)),
    *(8.0, np.inf),
)
#: Least part of the residual over the noise floor, whose logarithm is finite.
_LEAST_MOVED = 0.03
_FOUND = Quantity(what="named or among the alternatives", table="effects", value="listed")


def study_power(effects: pd.DataFrame) -> results.PowerStudy:
    """Return power curves of trials that hide one effect and were judged."""
    columns = ["id", "size", "moved", "moves_poses", "listed"]
    known = effects.query("kind == 'single' and judged") if len(effects) else effects
    known = known.reindex(columns=columns)
    moving = known[known["moves_poses"].astype(bool)]
    moved, listed = moving["moved"].to_numpy(float), moving["listed"].to_numpy(bool)
    return results.PowerStudy(
        by_id={
            str(name): power(rows["size"].to_numpy(float), rows["listed"].to_numpy(bool))
            for name, rows in known.groupby("id")
        },
        by_moved=power(np.maximum(moved, _LEAST_MOVED), listed),
        bins=tuple(
            results.MovedBin(
                low=low,
                high=high if np.isfinite(high) else None,
                listed=_FOUND.score(listed[(moved >= low) & (moved < high)]),
            )
            for low, high in itertools.pairwise(MOVED_EDGES)
        ),
    )


def power(size: Array, found: NDArray[np.bool_]) -> results.PowerCurve | None:
    """Fit a power curve: logistic in the logarithm of the size, with a prior of its slope.

    Args:
        size: (T,) positive sizes.
        found: (T,) whether the effect was found.

    Returns:
        The curve; None where all effects were found, or none.
    """
    if not len(size) or found.all() or not found.any():
        return None
    log_size = np.log(size)
    mean = log_size.mean()

    def minus_log_posterior(x: Array) -> float:
        log_odds = x[0] + x[1] * (log_size - mean)
        minus_log_likelihood = np.sum(np.logaddexp(0.0, np.where(found, -log_odds, log_odds)))
        return float(minus_log_likelihood) + 0.5 * float((x[1] / _STEEP) ** 2)

    best = minimize(minus_log_posterior, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    at_mean, slope = float(best.x[0]), float(best.x[1])
    intercept = at_mean - slope * float(mean)

    def size_at(probability: float) -> float | None:
        if slope <= 0.0:
            return None
        at = (np.log(probability / (1.0 - probability)) - intercept) / slope
        return float(np.exp(at)) if log_size.min() <= at <= log_size.max() else None

    return results.PowerCurve(
        intercept=intercept, slope=slope, half=size_at(0.5), most=size_at(_SURELY)
    )
