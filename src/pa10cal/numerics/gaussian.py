"""Linear Gaussian models as products: rows join, leave, and unknowns are integrated out.

White rows y = A x + e, e ~ N(0, I), say of unknowns x only what the products of the columns of A
and of y do. Each unknown counts in the size expected of it: x ~ N(0, I) unless a mean is given. So
joining rows adds products, holding rows out subtracts them, and integrating unknowns out is a Schur
complement (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sections 2.1 and
A.3), in whatever order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

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
    def of_products(cls, gram: Array, projection: Array, squares: float = 0.0) -> Gaussian:
        """Return what products of columns (k, k), with the data (k,), and of the data say."""
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
        return replace(self, products=self.products * np.outer(scale, scale))

    def in_terms_of(self, basis: Array) -> Gaussian:
        """Return the same of amounts (m,) along directions (k, m), in units of their own."""
        along = np.concatenate([basis.T @ self.products[:-1], self.products[-1:]])
        return replace(
            self, products=np.concatenate([along[:, :-1] @ basis, along[:, -1:]], axis=1)
        )

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
        return Gaussian(
            self.products[np.ix_(rest, rest)] - taken.T @ taken, self.log_det + _log_det(lower)
        )

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
        return Gaussian(further - taken.T @ taken, self.log_det + _log_det(self.lower))

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
        return self.taken_of(np.eye(self.unknowns))

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

    @property
    def log_precision(self) -> float:
        """Return the log determinant of the precision of the unknowns, 0 without rows."""
        return _log_det(self.lower)

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


def taken_by_each(gram: Array, projection: Array) -> tuple[Array, Array]:
    """Return the squares that unknowns take away, and log determinants of their precisions.

    Of m models of k unknowns each, in the sizes expected of these.

    Args:
        gram: (m, k, k) products of the columns.
        projection: (m, k) the same with the data.
    """
    try:
        lower = np.linalg.cholesky(gram + np.eye(gram.shape[1]))
    except np.linalg.LinAlgError:  # as for one of them
        lower = np.stack([_factor(each) for each in gram])
    white = np.linalg.solve(lower, projection[:, :, None])[:, :, 0]
    diagonal = np.diagonal(lower, axis1=1, axis2=2)
    return np.sum(white**2, axis=1), 2.0 * np.sum(np.log(diagonal), axis=1)


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


def _log_det(lower: Array) -> float:
    return 2.0 * float(np.log(np.diag(lower)).sum())
