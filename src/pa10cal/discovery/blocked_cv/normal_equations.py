"""Normal equations of whitened rows by blocks of poses, with maps of joint errors as splines.

The search needs the products of the columns with each other and with the data, and no row. A map is
kept as the derivative by the joint's angle and four B-splines of that angle (`spline_columns`):
each pose touches four of a map's many columns, so that these columns are sparse.

`BlockedRows` makes the rows of a block and has `normal_equations_of` multiply them, position rows
and others each by themselves (`ByKind`). The search stacks the totals of all blocks
(`BlockEquations`); fits sum up a list of them (`summed`), from which a block may be subtracted.

Columns here are in the units of their unknowns, and the prior is added when a system is solved
(`numerics/posterior.py`): of a `Gaussian` of these only products count. Its own mean and evidence
suppose unknowns in units of their prior (`numerics/gaussian.py`), as `Gaussian.in_sizes` makes
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.discovery.rules import BLOCKS
from pa10cal.numerics.gaussian import Gaussian


def normal_equations_of(
    data: Array, dense: Array, splines: csr_array, bases: Sequence[Array] = ()
) -> Gaussian:
    """Return the normal equations of data (R,) in dense columns (R, d), then B-splines (R, K).

    With bases of maps in other unknowns of these, see `in_map_bases`.
    """
    if not bases:
        return _in_coefficients(data, dense, splines)
    if len(data) >= splines.shape[1]:
        return in_map_bases(_in_coefficients(data, dense, splines), dense.shape[1], bases)
    # The columns of few rows take less than the products of all coefficients.
    stops = np.cumsum([0, *(len(basis) for basis in bases)])
    places = zip(pairwise(stops), bases, strict=True)
    turned = [splines[:, first:last] @ basis for (first, last), basis in places]
    return Gaussian.of(np.hstack([dense, *turned]), data)


def _in_coefficients(data: Array, dense: Array, splines: csr_array) -> Gaussian:
    """Return the normal equations in dense columns, then the coefficients of all B-splines."""
    d, total = dense.shape[1], dense.shape[1] + splines.shape[1]
    data, dense, splines = _without_rows_of_zeros(data, dense, splines)
    products = np.empty((total + 1, total + 1))
    products[:d, :d] = dense.T @ dense
    products[d:-1, :d] = splines.T @ dense
    products[:d, d:-1] = products[d:-1, :d].T
    products[d:-1, d:-1] = (splines.T @ splines).toarray()
    products[-1, :-1] = np.concatenate([dense.T @ data, splines.T @ data])
    products[:-1, -1], products[-1, -1] = products[-1, :-1], data @ data
    return Gaussian(products)


def _without_rows_of_zeros(
    data: Array, dense: Array, splines: csr_array
) -> tuple[Array, Array, csr_array]:
    """Return the rows without those of zeros, which add nothing, where these are many.

    They are the components that only other campaigns of a group have.
    """
    kept = np.asarray(dense.any(axis=1))
    if np.count_nonzero(kept) >= BLOCKS.seen_share * len(kept):
        return data, dense, splines
    rest = np.flatnonzero(~kept)
    kept[rest] = (data[rest] != 0.0) | (abs(splines[rest]).sum(axis=1) > 0.0)
    return data[kept], dense[kept], splines[np.flatnonzero(kept)]


def in_map_bases(equations: Gaussian, dense_count: int, bases: Sequence[Array]) -> Gaussian:
    """Return normal equations in other unknowns of the maps.

    The unknowns are those of `dense_count` dense columns, then the B-spline coefficients of one map
    after the other. Coefficients become basis (K, h) @ new unknowns (h,), map by map: the matrix of
    all bases is block-diagonal, mostly zeros.
    """
    old_stops = dense_count + np.cumsum([0, *(len(basis) for basis in bases)])
    new_stops = dense_count + np.cumsum([0, *(basis.shape[1] for basis in bases)])
    maps = list(zip(bases, pairwise(old_stops), pairwise(new_stops), strict=True))
    found = Gaussian(np.empty((new_stops[-1] + 1, new_stops[-1] + 1)), equations.log_det)
    gram, projection = found.gram, found.projection  # views of its products, filled below
    gram[:dense_count, :dense_count] = equations.gram[:dense_count, :dense_count]
    projection[:dense_count] = equations.projection[:dense_count]
    for k, (basis, (old, old_end), (new, new_end)) in enumerate(maps):
        projection[new:new_end] = basis.T @ equations.projection[old:old_end]
        # products of this map with itself and with all that stands before it
        across = basis.T @ equations.gram[old:old_end, :old_end]
        gram[new:new_end, :dense_count] = across[:, :dense_count]
        for other_basis, (start, stop), (first, last) in maps[: k + 1]:
            gram[new:new_end, first:last] = across[:, start:stop] @ other_basis
        gram[:new, new:new_end] = gram[new:new_end, :new].T
    found.products[-1, :-1], found.products[-1, -1] = projection, equations.squares
    return found


class ByKind(NamedTuple):
    """Normal equations of the same columns: of position rows, and of all other rows."""

    positions: Gaussian
    others: Gaussian

    @property
    def total(self) -> Gaussian:
        """Return the normal equations of all rows."""
        return self.positions + self.others

    def weighted(self, weight: float) -> Gaussian:
        """Return the normal equations of all rows, those of orientations times a weight."""
        return self.positions + self.others.times(weight**2)


@dataclass(frozen=True, eq=False)
class BlockEquations:
    """Normal equations in N columns of the rows of each of B blocks.

    In arrays, for the search solves all blocks at once; fits hold a list of `Gaussian`.
    """

    gram: Array  # (B, N, N) products of columns with columns
    projection: Array  # (B, N) products of columns with the data
    squares: Array  # (B,) sums of squares of the data
    # the same of position rows alone; None where all rows are of positions
    of_positions: BlockEquations | None = None
    # (N,) prior precision that every block's gram contains in addition to its rows, the B-th part
    # of the prior, so that their sum contains all of it; None: none
    prior_precision: Array | None = None

    @classmethod
    def empty(cls, blocks: int, columns: int) -> BlockEquations:
        """Return room for the equations of so many blocks."""
        shape = blocks, columns
        return cls(np.empty((*shape, columns)), np.empty(shape), np.empty(blocks))

    def put(self, block: int, equations: Gaussian) -> None:
        """Set the equations of a block, of which nothing is integrated out."""
        assert equations.log_det == 0.0
        self.gram[block], self.projection[block] = equations.gram, equations.projection
        self.squares[block] = equations.squares

    def summed(self) -> Gaussian:
        """Return the normal equations of all blocks together."""
        return Gaussian.of_products(
            self.gram.sum(axis=0), self.projection.sum(axis=0), float(self.squares.sum())
        )


def summed(blocks: Sequence[Gaussian]) -> Gaussian:
    """Return the normal equations of all blocks together."""
    products = blocks[0].products.copy()
    for each in blocks[1:]:
        products += each.products
    return Gaussian(products, sum(each.log_det for each in blocks))
