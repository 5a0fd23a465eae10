"""Rows of one channel reduced to products, at every variance of the error that poses share.

The model's own parameters, and the errors common to all poses, are integrated out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.noise_model import NoiseModel

Columns = NDArray[np.intp]

#: Variances of the shared error tried, in those of one reading: from none to a hundred times the
#: noise in size.
SHARED_VARIANCES = np.concatenate([[0.0], np.geomspace(1e-2, 1e5, 15)])
#: Rows with less of the shared error than this have none.
_NO_PART = 1e-9


@dataclass(frozen=True)
class Reduced:
    """One channel at each of the G shared variances, the model's own parameters integrated out."""

    gram: Array  # (G, p, p) products of the candidates' columns, in units of their expected sizes
    projection: Array  # (G, p) products with the data
    constant: Array  # (G,) minus twice the logarithm of the likelihood without candidates

    def of(self, columns: Columns) -> Reduced:
        """Return the products of some columns (p',)."""
        return Reduced(
            self.between(slice(None), columns, columns), self.projection[:, columns], self.constant
        )

    def between(self, variances: slice, rows: Columns, columns: Columns) -> Array:
        """Return the products of some columns with some others, at some variances, (V, r, c)."""
        places = self.gram.shape[1] * rows[:, None] + columns
        chosen = self.gram[variances]
        return np.asarray(chosen.reshape(len(chosen), -1).take(places, axis=1))

    def scaled(self, scale: Array) -> Reduced:
        """Return the products of the columns, each scaled (p,)."""
        return Reduced(self.gram * np.outer(scale, scale), self.projection * scale, self.constant)


def reduced(channel: NoiseModel, columns: Array, data: Array, own: Array) -> Reduced:
    """Integrate the model's own parameters and the common errors out, at every shared variance."""
    k, c = own.shape[1], channel.common.shape[1]
    rows = np.concatenate([channel.common, own, columns, data[:, None]], axis=1)
    # Most rows have no part in the shared error: their products are the same for all variances.
    shared = channel.shared_size > _NO_PART
    always = rows[~shared].T @ rows[~shared]
    rows, size = rows[shared], channel.shared_size[shared]
    grams, projections, constants = [], [], []
    for variance in SHARED_VARIANCES:
        total = 1.0 + variance * size
        weighed = rows / np.sqrt(total)[:, None]
        products = always + weighed.T @ weighed
        products, determinant = _integrated_out(products, c + k)
        grams.append(products[:-1, :-1])
        projections.append(products[:-1, -1])
        constants.append(products[-1, -1] + np.log(total).sum() + determinant)
    return Reduced(np.array(grams), np.array(projections), np.array(constants))


def _integrated_out(products: Array, first: int) -> tuple[Array, float]:
    """Return the products of the other columns, the first being Gaussian of unit variance."""
    factor = np.linalg.cholesky(products[:first, :first] + np.eye(first))
    taken = dtrsm(1.0, factor.T, products[first:, :first], side=1)
    left = products[first:, first:] - taken @ taken.T
    return left, 2.0 * float(np.log(np.diag(factor)).sum())


def spread(reduced: Reduced, places: Columns, width: int) -> Reduced:
    """Return the same with columns at other places among more, which are zero."""
    count = len(reduced.constant)
    gram, projection = np.zeros((count, width, width)), np.zeros((count, width))
    gram[:, places[:, None], places] = reduced.gram
    projection[:, places] = reduced.projection
    return Reduced(gram, projection, reduced.constant)


def nothing(columns: int) -> Reduced:
    """Return a channel that says nothing."""
    return Reduced(np.zeros((1, columns, columns)), np.zeros((1, columns)), np.zeros(1))
