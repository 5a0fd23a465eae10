"""Normal equations of whitened rows, block of poses by block, and their solution under a prior.

The search needs the products of the columns with each other and with the data, and no row. Maps of
joint errors are kept as the derivative by the joint's angle and four B-splines of that angle: each
pose touches four of a map's many columns, so that these columns are sparse.

Columns here are in the units of their unknowns, and the prior is added when a system is solved: of
a `Gaussian` of these only products count. Its own mean and evidence suppose unknowns in units of
their prior (`numerics/gaussian.py`), as `Gaussian.in_sizes` makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index
from pa10cal.discovery.rules import BLOCKS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import b_splines

#: Cubic B-splines of a map that are not zero at an angle (format).
_SUPPORT = 4


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


# What holds several: of two kinds of rows, and of all blocks.


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


# Columns of maps.


def map_columns(
    by_angle: Array, q_rad: Array, knots: Sequence[int], touched: Sequence[Index] = ()
) -> csr_array:
    """Return the derivative of rows by the B-splines of maps, sparse (b P, K1 + K2 + …), by pose.

    Args:
        by_angle: (P, b, j) derivative of the rows by the angle of each joint that has a map.
        q_rad: (P, j) these angles.
        knots: knots a turn of each map.
        touched: the B-splines of each map that are columns, see `touched_by`; none for all. All
            others have to be zero at the angles.
    """
    count, components, joints = by_angle.shape
    rows = count * components
    if not joints:
        return csr_array((rows, 0))
    splines = [b_splines(each, q_rad[:, j]) for j, each in enumerate(knots)]
    first = np.cumsum([0, *knots])
    # Each pose has a fixed number of B-splines of every map that are not zero.
    values = np.stack([each.data.reshape(count, _SUPPORT) for each in splines], axis=1)
    columns = np.stack(
        [each.indices.reshape(count, _SUPPORT) + first[j] for j, each in enumerate(splines)],
        axis=1,
    )
    data = by_angle[:, :, :, None] * values[:, None]
    width = int(first[-1])
    if touched:
        chosen = np.concatenate([at + first[j] for j, at in enumerate(touched)])
        number = np.full(width, -1, dtype=columns.dtype)
        number[chosen] = np.arange(len(chosen))
        columns, width = number[columns], len(chosen)
        assert columns.min(initial=0) >= 0
    indices = np.broadcast_to(columns[:, None], data.shape)
    starts = np.arange(rows + 1) * _SUPPORT * joints
    return csr_array((data.ravel(), indices.ravel(), starts), shape=(rows, width))


def touched_by(q_rad: Array, knots: int) -> Index:
    """Return the B-splines of a map (v,) that are not zero at some of the angles (P,).

    A joint is seldom seen all around, and the prior alone determines the others.
    """
    return np.unique(b_splines(knots, q_rad).indices).astype(np.intp)


# Solutions, scaled to a unit diagonal, with a way out where rounding makes a matrix indefinite. A
# gram is of rows alone; a precision contains the prior, too. The prior of unknowns expected about
# zero is their precision, with a row of zeros for an unknown that rows alone determine.


def solve(gram: Array, projection: Array, prior: Array) -> Array:
    """Return the unknowns (k,) or (k, m) that solve (gram + prior) x = projection.

    Raises:
        LinAlgError: when an unknown has neither rows nor a prior.
    """
    precision = gram + prior
    scale = _to_unit_diagonal(np.diag(precision), np.diag(prior))
    if not len(scale):
        return projection.copy()
    precision *= scale
    precision *= scale[:, None]
    _, solved, failed = dposv(precision.T, (projection.T * scale).T, overwrite_a=1)
    if failed:
        return no_wider_than(gram + prior, prior) @ projection
    return np.asarray((solved.T * scale).T)


def inverse(precision: Array, prior: Array) -> Array:
    """Return the covariance (k, k) of unknowns by their precision, which contains the prior's.

    Raises:
        LinAlgError: when an unknown has neither rows nor a prior.
    """
    scale = _to_unit_diagonal(np.diag(precision), np.diag(prior))
    if not len(scale):
        return precision.copy()
    scaled = precision * scale
    scaled *= scale[:, None]
    factor, failed = dpotrf(scaled.T, overwrite_a=1)
    if failed:
        return no_wider_than(precision, prior)
    upper, _ = dpotri(factor, overwrite_c=1)  # zero below its diagonal
    upper *= scale
    upper *= scale[:, None]
    found = upper + upper.T
    found.flat[:: len(scale) + 1] *= 0.5
    return np.asarray(found)


def inverse_of(gram: Array, sizes: Array) -> Array:
    """Return the covariance (k, k) of unknowns with standard deviations `sizes` (k,) expected."""
    prior = np.diag(sizes**-2.0)
    return inverse(gram + prior, prior)


def solve_each(gram: Array, projection: Array, priors: Array) -> Array:
    """Return the unknowns (m, k) of m systems (m, k, k) with diagonals of priors (m, k)."""
    diagonal = np.arange(gram.shape[1])
    precision = gram.copy()
    precision[:, diagonal, diagonal] += priors
    scale = _to_unit_diagonal(precision[:, diagonal, diagonal], priors)
    precision *= scale[:, :, None] * scale[:, None, :]
    try:
        np.linalg.cholesky(precision)
    except np.linalg.LinAlgError:  # at least one of them is indefinite
        systems = zip(gram, projection, priors, strict=True)
        return np.stack([solve(one, right, np.diag(prior)) for one, right, prior in systems])
    solved = np.linalg.solve(precision, (scale * projection)[:, :, None])[:, :, 0]
    return np.asarray(scale * solved)


def _to_unit_diagonal(precision: Array, prior: Array) -> Array:
    """Return what scales unknowns (..., k) to a unit diagonal of the precision, by the diagonals.

    Rounding may leave less than the prior.
    """
    diagonal = np.maximum(precision, prior)
    if np.any(diagonal == 0.0):
        raise np.linalg.LinAlgError("an unknown has neither rows nor a prior")
    return np.asarray(1.0 / np.sqrt(diagonal))


def no_wider_than(precision: Array, prior: Array) -> Array:
    """Return the inverse of a precision (k, k) with no direction less certain than the prior.

    Without rounding the precision's eigenvalues in units of the prior are at least one.
    """
    bare = np.diag(prior) == 0.0
    root = np.linalg.cholesky(
        prior + np.diag(np.where(bare, COMPUTING.least_precision * np.diag(precision), 0.0))
    )
    within = np.linalg.solve(root, np.linalg.solve(root, precision).T)
    values, vectors = np.linalg.eigh(0.5 * (within + within.T))
    vectors = np.linalg.solve(root.T, vectors)
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)
