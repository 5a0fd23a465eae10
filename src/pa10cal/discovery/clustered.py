"""Weighted means and slopes whose uncertainty counts poses, not rows.

Rows of a pose share its errors, so what scatters from pose to pose decides (the cluster-robust
covariance of Liang and Zeger, with the usual factor for few clusters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array

#: What differs by a smaller part than this is the same.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Estimate:
    """A number with its standard uncertainty, nan where there is one pose only."""

    value: float
    std: float


def mean(values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate:
    """Return the weighted mean of (C,) values of cells at (C,) poses."""
    return _last_coefficient(np.ones((len(values), 1)), values, weight, pose)


def slope(by: Array, values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate | None:
    """Return the slope of (C,) values by (C,) another quantity, beside a constant.

    None where that quantity is the same in all of them, but for rounding, or not known.
    """
    if not np.ptp(by) > _ROUNDING * np.abs(by).max():
        return None
    columns = np.column_stack([np.ones(len(by)), by - by.mean()])
    return _last_coefficient(columns, values, weight, pose)


def _last_coefficient(
    columns: Array, values: Array, weight: Array, pose: NDArray[np.str_]
) -> Estimate:
    weighted = columns * weight[:, None]
    inverse = np.linalg.inv(columns.T @ weighted)
    found = inverse @ (weighted.T @ values)
    _, cluster = np.unique(pose, return_inverse=True)
    count = int(cluster.max()) + 1
    if count < 2:
        return Estimate(float(found[-1]), np.nan)
    scores = np.zeros((count, columns.shape[1]))
    np.add.at(scores, cluster, weighted * (values - columns @ found)[:, None])
    covariance = inverse @ (scores.T @ scores) @ inverse * count / (count - 1)
    return Estimate(float(found[-1]), float(np.sqrt(covariance[-1, -1])))
