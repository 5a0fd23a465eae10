"""Do intervals hold what they promise: scores of many campaigns whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from pa10cal.arrays import Array

LEVEL = 0.95


@dataclass(frozen=True)
class Coverage:
    """How often intervals held the truth."""

    inside: float  # share of all scores inside their 95 % interval
    # inside_low and inside_high: 95 % interval of that share, campaigns being independent and the
    # parameters of one campaign not
    inside_low: float
    inside_high: float
    rms: float  # root mean square of the scores, 1 where the uncertainties are right
    by_parameter: Array  # (k,) share of the campaigns for each parameter
    rms_by_parameter: Array  # (k,) root mean square for each parameter


def coverage(scores: Array) -> Coverage:
    """Summarise scores (campaigns, parameters): (estimate - truth) / standard uncertainty.

    A parameter without an interval in some campaign has nan there.
    """
    there = np.isfinite(scores)
    held = np.where(there, np.abs(scores) <= ndtri(0.5 + LEVEL / 2.0), np.nan)
    shares = np.nanmean(held, axis=1)
    count = len(shares)
    half = (
        float(stdtrit(count - 1, 0.975) * shares.std(ddof=1) / np.sqrt(count)) if count > 1 else 1.0
    )
    inside = float(shares.mean())
    return Coverage(
        inside=inside,
        inside_low=max(0.0, inside - half),
        inside_high=min(1.0, inside + half),
        rms=float(np.sqrt(np.nanmean(scores**2))),
        by_parameter=np.nanmean(held, axis=0),
        rms_by_parameter=np.sqrt(np.nanmean(scores**2, axis=0)),
    )
