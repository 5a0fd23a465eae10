"""Variance of predicted positions, maps of joints by the few B-splines that each pose touches.

A map has hundreds of knots, and every one of them moves every pose a little. In B-splines only four
do: 10 000 poses then take a second, and no matrix of poses by knots is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pa10cal.terms.effects.joint_error_map import b_splines, b_splines_by_knots

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MapMotion:
    """What a map does to N poses.

    Attributes:
        columns: (K,) its knots among the parameters.
        q_rad: (N,) the joint's angle.
        moved: (N, 3) velocity of the position by the angle.
    """

    columns: Index
    q_rad: Array
    moved: Array


def position_variance(
    covariance: Array, dense: Index, moved: Array, maps: Sequence[MapMotion]
) -> Array:
    """Return the variance of N positions, summed over their axes, (N,).

    Args:
        covariance: (k, k) of the parameters.
        dense: (d,) those that move poses by `moved`.
        moved: (N, 3, d) velocity of the position by each.
        maps: the other parameters.
    """
    own = covariance[np.ix_(dense, dense)]
    variance = np.einsum("pik,pik->p", moved, moved @ own)
    splines = [b_splines(len(each.columns), each.q_rad) for each in maps]
    at = [each.indices.reshape(-1, 4).astype(np.intp) for each in splines]
    weight = [each.data.reshape(-1, 4) for each in splines]
    to_splines = [b_splines_by_knots(len(each.columns)) for each in maps]
    for k, each in enumerate(maps):
        across = to_splines[k] @ covariance[np.ix_(each.columns, dense)]
        touched = np.einsum("ps,psd->pd", weight[k], across[at[k]])
        variance += 2.0 * np.einsum("pi,pid,pd->p", each.moved, moved, touched)
        inside = to_splines[k] @ covariance[np.ix_(each.columns, each.columns)] @ to_splines[k].T
        variance += np.sum(each.moved**2, axis=1) * _touched(
            inside, at[k], at[k], weight[k], weight[k]
        )
    for j, k in combinations(range(len(maps)), 2):
        between = covariance[np.ix_(maps[j].columns, maps[k].columns)]
        between = to_splines[j] @ between @ to_splines[k].T
        together = np.sum(maps[j].moved * maps[k].moved, axis=1)
        variance += 2.0 * together * _touched(between, at[j], at[k], weight[j], weight[k])
    return np.asarray(np.maximum(variance, 0.0))


def _touched(between: Array, rows: Index, columns: Index, by_row: Array, by_column: Array) -> Array:
    """Return the covariance of two maps at each pose, (N,)."""
    four = between[rows[:, :, None], columns[:, None, :]]
    return np.asarray(np.einsum("ps,pst,pt->p", by_row, four, by_column))
