"""Products of weighed rows with each other, block of poses by block.

All that is needed of the data afterwards, which effects help and how well held-out poses are
predicted, needs these products and no row. Maps of joint errors are kept as what turning the joint
does and four B-splines of its angle: each pose touches four of a map's many columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.terms.effects.joint_error_map import b_splines

#: Rows are left out where no more than this part of them was seen.
_WORTHWHILE = 0.75


@dataclass(frozen=True, eq=False)
class Products:
    """Products of N columns and the data in each of B blocks."""

    gram: Array  # (B, N, N) of columns with columns
    projection: Array  # (B, N) of columns with the data
    squares: Array  # (B,) of the data
    # the same of the rows of positions alone, where it was requested
    of_positions: Products | None = None

    def summed(self) -> Products:
        """Return the sums over the blocks: (N, N), (N,) and a number without dimension."""
        return Products(
            self.gram.sum(axis=0), self.projection.sum(axis=0), np.asarray(self.squares.sum())
        )


def products(data: Array, dense: Array, maps: csr_array) -> tuple[Array, Array, float]:
    """Return the products of some rows: gram (N, N), projection (N,) and squares.

    Args:
        data: (R,) weighed rows of the data.
        dense: (R, d) weighed columns.
        maps: (R, K) weighed columns of B-splines.

    Returns:
        Of N = d + K columns.
    """
    d, total = dense.shape[1], dense.shape[1] + maps.shape[1]
    seen = np.asarray(dense.any(axis=1))
    if np.count_nonzero(seen) < _WORTHWHILE * len(seen):  # components of other campaigns
        data, dense, maps = data[seen], dense[seen], maps[np.flatnonzero(seen)]
    gram = np.empty((total, total))
    gram[:d, :d] = dense.T @ dense
    gram[d:, :d] = maps.T @ dense
    gram[:d, d:] = gram[d:, :d].T
    gram[d:, d:] = (maps.T @ maps).toarray()
    return gram, np.concatenate([dense.T @ data, maps.T @ data]), float(data @ data)


def in_terms_of(
    gram: Array, projection: Array, dense: int, bases: Sequence[Array]
) -> tuple[Array, Array]:
    """Return products in terms of other parameters of the maps.

    Args:
        gram, projection: of d dense columns, then of B-splines, one map after the other.
        dense: d.
        bases: (K1, h1), (K2, h2), … coefficients of the B-splines that each map's new parameters
            stand for.
    """
    old = list(pairwise(dense + np.cumsum([0, *(len(basis) for basis in bases)])))
    new = list(pairwise(dense + np.cumsum([0, *(basis.shape[1] for basis in bases)])))
    total = dense + sum(basis.shape[1] for basis in bases)
    half = np.empty((total, len(gram)))
    half[:dense] = gram[:dense]
    turned, found = np.empty((total, total)), np.empty(total)
    found[:dense] = projection[:dense]
    for basis, (first, last), (own, end) in zip(bases, old, new, strict=True):
        half[own:end] = basis.T @ gram[first:last]
        found[own:end] = basis.T @ projection[first:last]
    turned[:, :dense] = half[:, :dense]
    for basis, (first, last), (own, end) in zip(bases, old, new, strict=True):
        turned[:, own:end] = half[:, first:last] @ basis
    return turned, found


def map_columns(screws: Array, q_rad: Array, knots: Sequence[int]) -> csr_array:
    """Return how rows follow the B-splines of every joint's map, sparse.

    Args:
        screws: (P, 6, j) how rows follow the joints' angles.
        q_rad: (P, j) these angles.
        knots: K1, K2, … of the maps.

    Returns:
        (6 P, K1 + K2 + …), the rows pose by pose.
    """
    count, rows, joints = screws.shape
    if not joints:
        return csr_array((count * rows, 0))
    splines = [b_splines(each, q_rad[:, j]) for j, each in enumerate(knots)]
    first = np.cumsum([0, *knots])
    values = np.stack([each.data.reshape(count, 4) for each in splines], axis=1)
    columns = np.stack(
        [each.indices.reshape(count, 4) + first[j] for j, each in enumerate(splines)], axis=1
    )
    data = screws[:, :, :, None] * values[:, None]
    indices = np.broadcast_to(columns[:, None], data.shape)
    starts = np.arange(count * rows + 1) * 4 * joints
    return csr_array((data.ravel(), indices.ravel(), starts), shape=(count * rows, first[-1]))
