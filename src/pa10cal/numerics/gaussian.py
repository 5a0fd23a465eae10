"""Linear Gaussian models in information form: rows are added, held out, unknowns integrated out.

A model is white rows y = A x + e, e ~ N(0, I), with the prior x ~ N(0, I): unknowns are scaled to
their expected size. Its sufficient statistics are the products [A y]^T [A y]: the gram matrix
G = A^T A, the projection A^T y and the squares y^T y. The posterior has the precision G + I and the
mean (G + I)^-1 A^T y. Adding rows adds products, holding rows out subtracts them, and integrating
unknowns out is a Schur complement, in any order (Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, sections 2.1 and A.3). Lower factors L are Cholesky's: L L^T = G + I.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf, dpotri

from pa10cal.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A linear Gaussian model of k unknowns with a standard normal prior."""

    products: Array  # (k + 1, k + 1) [A y]^T [A y]
    # log determinant of the covariance of the rows, which integrating unknowns out adds to
    log_det: float = 0.0

    @classmethod
    def of(cls, columns: Array, data: Array) -> Gaussian:
        """Return the model of white rows, by A (..., k) and y (...,)."""
        return cls.of_rows(np.concatenate([columns, data[..., None]], axis=-1))

    @classmethod
    def of_rows(cls, rows: Array) -> Gaussian:
        """Return the model of white rows [A y], (..., k + 1)."""
        rows = rows.reshape(-1, rows.shape[-1])
        return cls(rows.T @ rows)

    @classmethod
    def of_products(
        cls, gram: Array, projection: Array | None = None, squares: float = 0.0
    ) -> Gaussian:
        """Return the model of products A^T A (k, k), A^T y (k,) and y^T y; y is 0 by default."""
        products = np.empty((len(gram) + 1, len(gram) + 1))
        products[:-1, :-1] = gram
        products[-1, :-1] = products[:-1, -1] = 0.0 if projection is None else projection
        products[-1, -1] = squares
        return cls(products)

    @classmethod
    def none(cls, unknowns: int) -> Gaussian:
        """Return the model of k unknowns without rows."""
        return cls(np.zeros((unknowns + 1, unknowns + 1)))

    def __add__(self, other: Gaussian) -> Gaussian:
        """Return the model of the rows of both."""
        return Gaussian(self.products + other.products, self.log_det + other.log_det)

    def __sub__(self, other: Gaussian) -> Gaussian:
        """Return the model without the other's rows, which must be among these."""
        return Gaussian(self.products - other.products, self.log_det - other.log_det)

    @property
    def unknowns(self) -> int:
        """Return k, the number of unknowns."""
        return len(self.products) - 1

    @property
    def gram(self) -> Array:
        """Return A^T A, (k, k)."""
        return self.products[:-1, :-1]

    @property
    def projection(self) -> Array:
        """Return A^T y, (k,)."""
        return self.products[:-1, -1]

    @property
    def squares(self) -> float:
        """Return y^T y."""
        return float(self.products[-1, -1])

    def along(self, at: Index) -> Gaussian:
        """Return the model of these unknowns, in this order, with all others held at zero."""
        chosen = np.append(at, self.unknowns)
        return replace(self, products=self.products[np.ix_(chosen, chosen)])

    def in_sizes(self, sizes: Array) -> Gaussian:
        """Return the model with each prior standard deviation multiplied by `sizes` (k,)."""
        scale = np.append(sizes, 1.0)
        products = self.products * scale
        products *= scale[:, None]
        return replace(self, products=products)

    def in_terms_of(self, basis: Array) -> Gaussian:
        """Return the model of coefficients (m,) of directions (k, m), with a standard prior."""
        projected = np.concatenate([basis.T @ self.products[:-1], self.products[-1:]])
        products = np.concatenate([projected[:, :-1] @ basis, projected[:, -1:]], axis=1)
        return replace(self, products=products)

    def times(self, weight: float) -> Gaussian:
        """Return the model with all squares of rows weighted."""
        return replace(self, products=weight * self.products)

    def about(self, mean: Array) -> Gaussian:
        """Return the model of x - mean, with a standard prior about `mean` (k,)."""
        products, projection = self.products.copy(), self.projection - self.gram @ mean
        products[:-1, -1] = products[-1, :-1] = projection
        products[-1, -1] -= float(mean @ (self.projection + projection))
        return replace(self, products=products)

    def without(self, at: Index) -> Gaussian:
        """Return the model of the other unknowns, with these integrated out."""
        if not len(at):
            return self
        others = np.delete(np.arange(self.unknowns + 1), at)
        lower = np.ascontiguousarray(_factor(self.products[np.ix_(at, at)]))
        explained = _forward(lower, self.products[np.ix_(at, others)])
        products = self.products[np.ix_(others, others)] - explained.T @ explained
        return Gaussian(products, self.log_det + float(_log_det(lower)))

    @property
    def determined(self) -> float:
        """Return how many unknowns the rows determine: the trace of (G + I)^-1 G."""
        return self.unknowns - float(np.trace(cho_solve((self.lower, True), np.eye(self.unknowns))))

    @cached_property
    def lower(self) -> Array:
        """Return the lower factor of the posterior precision G + I, (k, k)."""
        return np.ascontiguousarray(self._by_columns)

    @cached_property
    def _by_columns(self) -> Array:
        """Return the same column by column, which LAPACK takes without a copy."""
        return _factor(self.gram)

    def of_further(self, across: Array, gram: Array, projection: Array) -> Gaussian:
        """Return the model of m further unknowns with columns B, with those here integrated out.

        Args:
            across: (k, m) A^T B.
            gram: (m, m) B^T B.
            projection: (m,) B^T y.
        """
        further = Gaussian.of_products(gram, projection, self.squares).products
        right = np.concatenate([across, self.projection[:, None]], axis=1)
        explained = _forward(self.lower, right)
        return Gaussian(further - explained.T @ explained, self.log_det + self.log_precision)

    def of_each_further(self, across: Array, gram: Array, projection: Array) -> Gaussians:
        """Return `of_further` for each of m sets of j further unknowns.

        Args:
            across: (k, m, j) A^T B of each set.
            gram: (m, j, j) B^T B of each set.
            projection: (m, j) B^T y of each set.
        """
        white = _forward(self.lower, self.projection[:, None])[:, 0]
        squares, log_det = np.array(self.squares), np.array(self.log_det)
        here = Gaussians(self.gram, self.projection, squares, log_det)
        return here._of_each_further(self.lower, white, across, gram, projection)

    def taken_of(self, across: Array) -> Array:
        """Return (G + I)^-1 times right sides (k, m), such as A^T B: what x absorbs of B."""
        return np.asarray(cho_solve((self._by_columns, True), across, check_finite=False))

    @cached_property
    def mean(self) -> Array:
        """Return the posterior mean, (k,)."""
        return self.taken_of(self.projection)

    @cached_property
    def covariance(self) -> Array:
        """Return the posterior covariance, (k, k)."""
        if not self.unknowns:
            return np.zeros((0, 0))
        upper, _ = dpotri(self.lower.T)  # it leaves zeros below the diagonal
        return np.asarray(upper + upper.T - np.diag(np.diag(upper)))

    def in_turn(self, first: Index, then: Index) -> tuple[Gaussian, Gaussian, Array]:
        """Fit some unknowns with the others at zero, then the others with these held.

        Returns:
            The model of the first, that of the others about it, and all posterior means (k,).
        """
        mean = np.zeros(self.unknowns)
        of_first = self.along(first)
        mean[first] = of_first.mean
        of_others = self.about(mean).along(then)
        mean[then] = of_others.mean
        return of_first, of_others, mean

    @property
    def residual_squares(self) -> float:
        """Return the squares at the mean, of residuals and of the mean over the prior."""
        return self.squares - float(self.projection @ self.mean)

    def squares_at(self, x: Array) -> float:
        """Return the squares of the residuals at x (k,)."""
        return self.squares - 2.0 * float(self.projection @ x) + float(x @ (self.gram @ x))

    @property
    def log_precision(self) -> float:
        """Return log det(G + I), 0 without rows."""
        return float(_log_det(self._by_columns))

    @property
    def log_evidence(self) -> float:
        """Return the log marginal likelihood of the data, up to a constant of the rows."""
        return -0.5 * (self.residual_squares + self.log_det + self.log_precision)

    def variances(self, columns: Array) -> Array:
        """Return the posterior variances (...,) of predictions by columns (..., k), noise apart."""
        flat = columns.reshape(-1, self.unknowns)
        variances = np.asarray(np.sum(_forward(self.lower, flat.T) ** 2, axis=0))
        return variances.reshape(columns.shape[:-1])


@dataclass(frozen=True, eq=False)
class Gaussians:
    """Many models as `Gaussian` at once, of shape (...), each of k unknowns.

    What several models have in common may be stored once (numpy's broadcasting).
    """

    gram: Array  # (..., k, k) A^T A
    projection: Array  # (..., k) A^T y
    squares: Array  # (...) y^T y
    log_det: Array  # (...) see `Gaussian`

    @classmethod
    def of(cls, each: Iterable[Gaussian]) -> Gaussians:
        """Return models of equally many unknowns as one, (m,)."""
        models = list(each)
        products = np.stack([model.products for model in models])
        log_det = np.array([model.log_det for model in models])
        gram = np.ascontiguousarray(products[:, :-1, :-1])  # `across` indexes it flat
        return cls(gram, products[:, :-1, -1], products[:, -1, -1], log_det)

    def __add__(self, other: Gaussians) -> Gaussians:
        """Return the models of the rows of both."""
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
        """Return the block of the gram matrices at r rows and c columns, (..., r, c)."""
        flat_index = self.gram.shape[-1] * rows[:, None] + columns
        flat = self.gram.reshape(*self.gram.shape[:-2], -1)
        return np.asarray(flat.take(flat_index, axis=-1))

    def along(self, at: Index) -> Gaussians:
        """Return the models of these unknowns, in this order, with all others held at zero."""
        return replace(self, gram=self.across(at, at), projection=self.projection[..., at])

    def among(self, at: Index, unknowns: int) -> Gaussians:
        """Return the models with these unknowns at places `at` of more, which no row depends on."""
        models = self.projection.shape[:-1]
        gram = np.zeros((*models, unknowns, unknowns))
        projection = np.zeros((*models, unknowns))
        gram[..., at[:, None], at] = self.gram
        projection[..., at] = self.projection
        return replace(self, gram=gram, projection=projection)

    def in_sizes(self, sizes: Array) -> Gaussians:
        """Return the models with prior standard deviations multiplied by `sizes` (..., k)."""
        scales = sizes[..., :, None] * sizes[..., None, :]
        return replace(self, gram=self.gram * scales, projection=self.projection * sizes)

    def for_each(self, sizes: Array) -> Gaussians:
        """Return each model (m,) in each of s sizes (s, k), see `in_sizes`, (m, s)."""
        squares, log_det = self.squares[:, None], self.log_det[:, None]
        once = Gaussians(self.gram[:, None], self.projection[:, None], squares, log_det)
        return once.in_sizes(sizes)

    def of_each_further(self, across: Array, gram: Array, projection: Array) -> Gaussians:
        """Return `Gaussian.of_each_further` for every model (v,) and each of m sets, (v, m).

        Args:
            across: (v, k, m, j) A^T B.
            gram: (v, m, j, j) B^T B.
            projection: (v, m, j) B^T y.
        """
        lower, white = self._factors
        return self._of_each_further(lower, white, across, gram, projection)

    def _of_each_further(
        self, lower: Array, white: Array, across: Array, gram: Array, projection: Array
    ) -> Gaussians:
        """Return the same by lower factors L (..., k, k) and L^-1 A^T y (..., k)."""
        *_, m, j = across.shape
        explained = _forward_each(lower, across.reshape(*across.shape[:-2], m * j))
        explained = np.moveaxis(explained.reshape(across.shape), -3, -1)  # (..., m, j, k)
        shape = projection.shape[:-1]
        return Gaussians(
            gram - explained @ explained.swapaxes(-1, -2),
            projection - (explained @ white[..., None, :, None])[..., 0],
            np.broadcast_to((self.squares - np.sum(white**2, axis=-1))[..., None], shape),
            np.broadcast_to((self.log_det + _log_det(lower))[..., None], shape),
        )

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """Return lower factors L (..., k, k) of G + I, and L^-1 A^T y (..., k)."""
        k = self.projection.shape[-1]
        # With A^T y as a last row and column, the last row of the factor is L^-1 A^T y. The last
        # diagonal element only has to be large enough.
        bordered = np.empty((*self.projection.shape[:-1], k + 1, k + 1))
        bordered[..., :k, :k] = self.gram + np.eye(k)
        bordered[..., k, :k] = bordered[..., :k, k] = self.projection
        bordered[..., k, k] = 1.0 + 2.0 * np.sum(self.projection**2, axis=-1)
        try:
            factor = np.linalg.cholesky(bordered)
        except np.linalg.LinAlgError:  # one of them is singular: one by one
            for at in np.ndindex(bordered.shape[:-2]):
                lower = np.ascontiguousarray(_factor(self.gram[at]))
                bordered[at][:k, :k] = lower
                bordered[at][k, :k] = _forward(lower, self.projection[at][:, None])[:, 0]
            factor = bordered
        return factor[..., :k, :k], factor[..., k, :k]

    @property
    def mean(self) -> Array:
        """Return the posterior means, (..., k)."""
        lower, white = self._factors
        return np.asarray(np.linalg.solve(lower.swapaxes(-1, -2), white[..., None])[..., 0])

    @property
    def residual_squares(self) -> Array:
        """Return the squares at the means, see `Gaussian.residual_squares`, (...)."""
        return np.asarray(self.squares - np.sum(self._factors[1] ** 2, axis=-1))

    @property
    def log_precision(self) -> Array:
        """Return log det(G + I), (...)."""
        return _log_det(self._factors[0])

    @property
    def log_evidence(self) -> Array:
        """Return the log marginal likelihoods (...), up to a constant of the rows."""
        return np.asarray(-0.5 * (self.residual_squares + self.log_det + self.log_precision))

    def gains(self, rows: int, least: float = np.finfo(float).tiny) -> tuple[Array, Array]:
        """Return the gain in log evidence by the unknowns, and the share of the squares after it.

        Args:
            rows: their number. Their variance is unknown, and set to the likeliest value.
            least: lower bound of the share.
        """
        share = np.maximum(
            self.residual_squares / np.maximum(self.squares, np.finfo(float).tiny), least
        )
        return np.asarray(-0.5 * (rows * np.log(share) + self.log_precision)), share


def cv_residual(data: Array, columns: Array, fold: Index) -> Array:
    """Return the residuals (R,) of white rows, those of each fold predicted from all other folds.

    Args:
        data: (R,) y.
        columns: (R, k) A.
        fold: (R,) number of the fold of each row.
    """
    residual = np.empty(len(data))
    folds = [np.flatnonzero(fold == number) for number in np.unique(fold)]
    models = [Gaussian.of(columns[rows], data[rows]) for rows in folds]
    whole = sum(models, Gaussian.none(columns.shape[1]))
    for rows, held_out in zip(folds, models, strict=True):
        residual[rows] = data[rows] - columns[rows] @ (whole - held_out).mean
    return residual


def _factor(gram: Array) -> Array:
    """Return the lower factor L of G + I, (k, k), in Fortran's order.

    Where columns are nearly equal and far above the noise, rounding may leave G + I indefinite;
    then negative eigenvalues of G count as zero.
    """
    normal = np.array(gram, order="C")
    normal.flat[:: len(gram) + 1] += 1.0
    lower, failed = dpotrf(normal.T, lower=1, overwrite_a=1)  # of the same matrix, in place
    if failed:
        values, vectors = np.linalg.eigh(gram)
        root = np.sqrt(1.0 + np.maximum(values, 0.0))[:, None] * vectors.T
        upper = np.linalg.qr(root, mode="r")
        lower = np.asfortranarray((upper * np.sign(np.diag(upper))[:, None]).T)
    return np.asarray(lower, dtype=np.float64)


def _forward(lower: Array, right: Array) -> Array:
    """Return L^-1 times right sides (k, m)."""
    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False))


def _forward_each(lower: Array, right: Array) -> Array:
    """Return L^-1 times right sides, for factors (..., k, k) and right sides (..., k, m)."""
    solved = np.array(right, order="C")
    for at in np.ndindex(lower.shape[:-2]):  # BLAS, as numpy has no triangular solver of stacks
        dtrsm(1.0, lower[at].T, solved[at].T, side=1, overwrite_b=1)
    return solved


def _log_det(lower: Array) -> Array:
    """Return log det(L L^T), (...), of lower factors (..., k, k)."""
    return np.asarray(2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1))
