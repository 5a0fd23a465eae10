"""Linear Gaussian models as products: rows join, leave, and unknowns are integrated out.

White rows y = A x + e, e ~ N(0, I), say of unknowns x only what the products of the columns of A
and of y do. Each unknown counts in the size expected of it: x ~ N(0, I) unless a mean is given. So
joining rows adds products, holding rows out subtracts them, and integrating unknowns out is a Schur
complement (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sections 2.1 and
A.3), in whatever order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotri

from pa10cal.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class Gaussian:
    """What white rows say of k unknowns, each in the size expected of it."""

    products: Array  # (k + 1, k + 1) of the columns and, last, of the data
    # log determinant of the covariance of the rows, as far as unknowns were integrated out
    log_det: float = 0.0

    @classmethod
    def of(cls, columns: Array, data: Array) -> Gaussian:
        """Return what rows say, by columns (..., k) and data (...,), both white."""
        every = np.concatenate([columns, data[..., None]], axis=-1)
        every = every.reshape(-1, every.shape[-1])
        return cls(every.T @ every)

    @classmethod
    def of_products(
        cls, gram: Array, projection: Array | None = None, squares: float = 0.0
    ) -> Gaussian:
        """Return what products of columns (k, k), with the data (k,), and of the data say.

        Where no data are given, these are zero.
        """
        projection = np.zeros(len(gram)) if projection is None else projection
        return cls(np.block([[gram, projection[:, None]], [projection, np.array(squares)]]))

    @classmethod
    def none(cls, unknowns: int) -> Gaussian:
        """Return what no rows say of unknowns."""
        return cls(np.zeros((unknowns + 1, unknowns + 1)))

    def __add__(self, other: Gaussian) -> Gaussian:
        """Return what both rows say."""
        return Gaussian(self.products + other.products, self.log_det + other.log_det)

    def __sub__(self, other: Gaussian) -> Gaussian:
        """Return what is said without the other's rows, which are among these."""
        return Gaussian(self.products - other.products, self.log_det - other.log_det)

    @property
    def unknowns(self) -> int:
        """Return how many unknowns there are."""
        return len(self.products) - 1

    @property
    def gram(self) -> Array:
        """Return the products of the columns, (k, k)."""
        return self.products[:-1, :-1]

    @property
    def projection(self) -> Array:
        """Return the products of the columns with the data, (k,)."""
        return self.products[:-1, -1]

    @property
    def squares(self) -> float:
        """Return the squares of the data."""
        return float(self.products[-1, -1])

    def along(self, at: Index) -> Gaussian:
        """Return the same of some unknowns, in this order, all others being as expected."""
        every = np.append(at, self.unknowns)
        return replace(self, products=self.products[np.ix_(every, every)])

    def in_sizes(self, sizes: Array) -> Gaussian:
        """Return the same of unknowns in other sizes (k,), in units of those now."""
        scale = np.append(sizes, 1.0)
        products = self.products * scale
        products *= scale[:, None]
        return replace(self, products=products)

    def in_terms_of(self, basis: Array) -> Gaussian:
        """Return the same of amounts (m,) along directions (k, m), in units of their own."""
        along = np.concatenate([basis.T @ self.products[:-1], self.products[-1:]])
        return replace(
            self, products=np.concatenate([along[:, :-1] @ basis, along[:, -1:]], axis=1)
        )

    def times(self, weight: float) -> Gaussian:
        """Return what is said where rows count so many times."""
        return replace(self, products=weight * self.products)

    def about(self, mean: Array) -> Gaussian:
        """Return the same of how far unknowns are from (k,), where they are then expected."""
        products, left = self.products.copy(), self.projection - self.gram @ mean
        products[:-1, -1] = products[-1, :-1] = left
        products[-1, -1] -= float(mean @ (self.projection + left))
        return replace(self, products=products)

    def without(self, at: Index) -> Gaussian:
        """Return what is said of the other unknowns, those at some places integrated out."""
        rest = np.delete(np.arange(self.unknowns + 1), at)
        if not len(at):
            return self
        lower = _factor(self.products[np.ix_(at, at)])
        taken = _forward(lower, self.products[np.ix_(at, rest)])
        products = self.products[np.ix_(rest, rest)] - taken.T @ taken
        return Gaussian(products, self.log_det + float(_log_det(lower)))

    @cached_property
    def lower(self) -> Array:
        """Return the lower factor (k, k) of the inverse of the covariance."""
        return _factor(self.gram)

    def of_further(self, across: Array, gram: Array, projection: Array) -> Gaussian:
        """Return what the rows say of further unknowns (m,), those here integrated out.

        By the products of their columns with those here (k, m), each other, and the data (m,).
        """
        further = Gaussian.of_products(gram, projection, self.squares).products
        taken = _forward(self.lower, np.concatenate([across, self.projection[:, None]], axis=1))
        return Gaussian(further - taken.T @ taken, self.log_det + self.log_precision)

    def of_each_further(self, across: Array, gram: Array, projection: Array) -> Gaussians:
        """Return what the rows say of each of m sets of further unknowns, as `of_further` of one.

        By the products of their columns with those here (k, m, j), those of each set (m, j, j), and
        with the data (m, j).
        """
        white = _forward(self.lower, self.projection[:, None])[:, 0]
        squares, log_det = np.array(self.squares), np.array(self.log_det)
        here = Gaussians(self.gram, self.projection, squares, log_det)
        return here._of_each_further(self.lower, white, across, gram, projection)

    def taken_of(self, across: Array) -> Array:
        """Return how the unknowns follow others, (k, m), by products (k, m) with their columns."""
        return np.asarray(cho_solve((self.lower, True), across, check_finite=False))

    @cached_property
    def mean(self) -> Array:
        """Return where the unknowns are found, (k,)."""
        return self.taken_of(self.projection)

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of the unknowns there, (k, k)."""
        if not self.unknowns:
            return np.zeros((0, 0))
        upper, _ = dpotri(self.lower.T)  # of zeros below its diagonal
        return np.asarray(upper + upper.T - np.diag(np.diag(upper)))

    def in_turn(self, first: Index, then: Index) -> tuple[Gaussian, Gaussian, Array]:
        """Return what is said of some unknowns alone, of others about these, and both means (k,).

        Those found first stay as they are found, where those that follow are as expected.
        """
        mean = np.zeros(self.unknowns)
        alone = self.along(first)
        mean[first] = alone.mean
        beside = self.about(mean).along(then)
        mean[then] = beside.mean
        return alone, beside, mean

    @property
    def left(self) -> float:
        """Return the squares left at the mean, those of its way from what is expected included."""
        return self.squares - float(self.projection @ self.mean)

    def squares_at(self, x: Array) -> float:
        """Return the squares that unknowns (k,) leave of the data."""
        return self.squares - 2.0 * float(self.projection @ x) + float(x @ (self.gram @ x))

    @property
    def log_precision(self) -> float:
        """Return the log determinant of the precision of the unknowns, 0 without rows."""
        return float(_log_det(self.lower))

    @property
    def log_evidence(self) -> float:
        """Return the logarithm of how likely the data are, up to a constant of the rows."""
        return -0.5 * (self.left + self.log_det + self.log_precision)

    def variances(self, columns: Array) -> Array:
        """Return the variances (...,) of predictions by columns (..., k), noise apart."""
        flat = columns.reshape(-1, self.unknowns)
        return np.asarray(np.sum(_forward(self.lower, flat.T) ** 2, axis=0)).reshape(
            columns.shape[:-1]
        )


@dataclass(frozen=True, eq=False)
class Gaussians:
    """What white rows say of k unknowns each, of many such models (...) at once.

    Each is what `Gaussian` is of one; of several models what they have in common may be there once
    (numpy's broadcasting).
    """

    gram: Array  # (..., k, k) products of the columns
    projection: Array  # (..., k) products of the columns with the data
    squares: Array  # (...) of the data
    # (...) log determinants of the covariance of the rows, as far as unknowns were integrated out
    log_det: Array

    @classmethod
    def of(cls, each: Iterable[Gaussian]) -> Gaussians:
        """Return the models (m,) of some, each of as many unknowns."""
        every = list(each)
        products = np.stack([one.products for one in every])
        log_det = np.array([one.log_det for one in every])
        gram = np.ascontiguousarray(products[:, :-1, :-1])  # of which some are taken by `across`
        return cls(gram, products[:, :-1, -1], products[:, -1, -1], log_det)

    def __add__(self, other: Gaussians) -> Gaussians:
        """Return what both rows say."""
        return Gaussians(
            self.gram + other.gram,
            self.projection + other.projection,
            self.squares + other.squares,
            self.log_det + other.log_det,
        )

    def __getitem__(self, at: int | slice) -> Gaussians:
        """Return some of the models, by the first axis."""
        return Gaussians(self.gram[at], self.projection[at], self.squares[at], self.log_det[at])

    def across(self, rows: Index, columns: Index) -> Array:
        """Return the products of some columns with some others, (..., r, c)."""
        places = self.gram.shape[-1] * rows[:, None] + columns
        flat = self.gram.reshape(*self.gram.shape[:-2], -1)
        return np.asarray(flat.take(places, axis=-1))

    def along(self, at: Index) -> Gaussians:
        """Return the same of some unknowns, in this order, all others being as expected."""
        return replace(self, gram=self.across(at, at), projection=self.projection[..., at])

    def among(self, at: Index, unknowns: int) -> Gaussians:
        """Return the same of so many unknowns, these at some places; of the others nothing."""
        models = self.projection.shape[:-1]
        gram, projection = np.zeros((*models, unknowns, unknowns)), np.zeros((*models, unknowns))
        gram[..., at[:, None], at], projection[..., at] = self.gram, self.projection
        return replace(self, gram=gram, projection=projection)

    def in_sizes(self, sizes: Array) -> Gaussians:
        """Return the same of unknowns in other sizes (..., k), in units of those now."""
        scales = sizes[..., :, None] * sizes[..., None, :]
        return replace(self, gram=self.gram * scales, projection=self.projection * sizes)

    def of_each_further(self, across: Array, gram: Array, projection: Array) -> Gaussians:
        """Return what rows say of each of m sets of further unknowns, those here integrated out.

        Of every model (v,), by the products of their columns with those here (v, k, m, j), those of
        each set (v, m, j, j), and with the data (v, m, j).

        Returns:
            The models (v, m).
        """
        return self._of_each_further(*self._factors, across, gram, projection)

    def _of_each_further(
        self, lower: Array, white: Array, across: Array, gram: Array, projection: Array
    ) -> Gaussians:
        *_, m, j = across.shape
        taken = _forward_each(lower, across.reshape(*across.shape[:-2], m * j))
        taken = np.moveaxis(taken.reshape(across.shape), -3, -1)  # (..., m, j, k)
        every = projection.shape[:-1]
        return Gaussians(
            gram - taken @ taken.swapaxes(-1, -2),
            projection - (taken @ white[..., None, :, None])[..., 0],
            np.broadcast_to((self.squares - np.sum(white**2, axis=-1))[..., None], every),
            np.broadcast_to((self.log_det + _log_det(lower))[..., None], every),
        )

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """Return the lower factors (..., k, k) as of one model, and what they make of data."""
        k = self.projection.shape[-1]
        # With the projection as a last row, the factor's last row is what the factor makes of it.
        beside = np.empty((*self.projection.shape[:-1], k + 1, k + 1))
        beside[..., :k, :k] = self.gram + np.eye(k)
        beside[..., k, :k] = beside[..., :k, k] = self.projection
        beside[..., k, k] = 1.0 + 2.0 * np.sum(self.projection**2, axis=-1)
        try:
            factor = np.linalg.cholesky(beside)
        except np.linalg.LinAlgError:  # as for one of them
            for at in np.ndindex(beside.shape[:-2]):
                lower = _factor(self.gram[at])
                beside[at][:k, :k] = lower
                beside[at][k, :k] = _forward(lower, self.projection[at][:, None])[:, 0]
            factor = beside
        return factor[..., :k, :k], factor[..., k, :k]

    @property
    def mean(self) -> Array:
        """Return where the unknowns are found, (..., k)."""
        lower, white = self._factors
        return np.asarray(np.linalg.solve(lower.swapaxes(-1, -2), white[..., None])[..., 0])

    @property
    def left(self) -> Array:
        """Return the squares left at the mean (...), as of one model."""
        return np.asarray(self.squares - np.sum(self._factors[1] ** 2, axis=-1))

    @property
    def log_precision(self) -> Array:
        """Return the log determinants (...) of the precisions of the unknowns."""
        return _log_det(self._factors[0])

    @property
    def log_evidence(self) -> Array:
        """Return the logarithm of how likely the data are (...), up to a constant of the rows."""
        return np.asarray(-0.5 * (self.left + self.log_det + self.log_precision))

    def gains(self, rows: int, least: float = np.finfo(float).tiny) -> tuple[Array, Array]:
        """Return what log evidence gains by the unknowns, and the part of squares left, (...).

        So many rows scatter by what makes them likeliest; at least so large a part is left.
        """
        share = np.maximum(self.left / np.maximum(self.squares, np.finfo(float).tiny), least)
        return np.asarray(-0.5 * (rows * np.log(share) + self.log_precision)), share


def _factor(gram: Array) -> Array:
    """Return the lower factor of products beside what is expected.

    Of columns that are nearly the same, and far over the noise, rounding may leave the products
    less than nothing; then their eigenvalues below zero count as zero.
    """
    try:
        return np.asarray(np.linalg.cholesky(gram + np.eye(len(gram))), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(gram)
        root = np.sqrt(1.0 + np.maximum(values, 0.0))[:, None] * vectors.T
        upper = np.linalg.qr(root, mode="r")
        return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T, dtype=np.float64)


def _forward(lower: Array, right: Array) -> Array:
    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False))


def _forward_each(lower: Array, right: Array) -> Array:
    """Return right sides (..., k, m) solved by lower factors (..., k, k)."""
    solved = np.array(right, order="C")
    for at in np.ndindex(lower.shape[:-2]):  # triangular: a third of a solution
        dtrsm(1.0, lower[at].T, solved[at].T, side=1, overwrite_b=1)
    return solved


def _log_det(lower: Array) -> Array:
    """Return the log determinants (...) of what lower factors (..., k, k) are of."""
    return np.asarray(2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1))
