"""Covariance of predicted positions, maps of joints by the few B-splines that each pose touches.

A map has hundreds of knots, and every one of them moves every pose a little. In B-splines only four
do: 10 000 poses then take a second, and no matrix of poses by knots is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.terms.effects.joint_error_map import b_splines, b_splines_by_knots


@dataclass(frozen=True, eq=False)
class MapMotion:
    """What a map does to N poses."""

    columns: Index  # (K,) its knots among the parameters
    q_rad: Array  # (N,) the joint's angle
    moved: Array  # (N, 3) velocity of the position by the angle


def position_covariance(
    covariance: Array, dense: Index, moved: Array, maps: Sequence[MapMotion]
) -> Array:
    """Return the covariance of N positions, (N, 3, 3).

    Args:
        covariance: (k, k) of the parameters.
        dense: (d,) those that move poses by `moved`.
        moved: (N, 3, d) velocity of the position by each.
        maps: the other parameters.
    """
    own = covariance[np.ix_(dense, dense)]
    found = (moved @ own) @ np.swapaxes(moved, 1, 2)
    splines = [b_splines(len(each.columns), each.q_rad) for each in maps]
    at = [each.indices.reshape(-1, 4).astype(np.intp) for each in splines]
    weight = [each.data.reshape(-1, 4) for each in splines]
    to_splines = [b_splines_by_knots(len(each.columns)) for each in maps]
    for k, each in enumerate(maps):
        across = to_splines[k] @ covariance[np.ix_(each.columns, dense)]
        touched = np.einsum("ps,psd->pd", weight[k], across[at[k]])
        half = _outer(np.einsum("pid,pd->pi", moved, touched), each.moved)
        inside = to_splines[k] @ covariance[np.ix_(each.columns, each.columns)] @ to_splines[k].T
        alone = _touched(inside, at[k], at[k], weight[k], weight[k])
        found += half + np.swapaxes(half, 1, 2)
        found += _outer(each.moved, each.moved) * alone[:, None, None]
    for j, k in combinations(range(len(maps)), 2):
        between = covariance[np.ix_(maps[j].columns, maps[k].columns)]
        between = to_splines[j] @ between @ to_splines[k].T
        both = _touched(between, at[j], at[k], weight[j], weight[k])
        half = _outer(maps[j].moved, maps[k].moved) * both[:, None, None]
        found += half + np.swapaxes(half, 1, 2)
    return np.asarray(found, dtype=np.float64)


def _outer(one: Array, other: Array) -> Array:
    return np.asarray(one[:, :, None] * other[:, None, :])


def _touched(between: Array, rows: Index, columns: Index, by_row: Array, by_column: Array) -> Array:
    """Return the covariance of two maps at each pose, (N,)."""
    four = between[rows[:, :, None], columns[:, None, :]]
    return np.asarray(np.einsum("ps,pst,pt->p", by_row, four, by_column))
