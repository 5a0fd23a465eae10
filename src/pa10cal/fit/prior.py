"""A Gaussian prior of the first unknowns of a fit, and how readings or another fit contradict it.

Where they do, the prior is widened along few directions: those in which something moved. The log
evidence decides, in closed form: about the fit the problem is linear and Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arrays import Array
from pa10cal.numerics.gaussian import Gaussian

#: Added to the correlation matrix's diagonal, to keep the precision finite (computing).
_JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Normal distribution expected of the first k unknowns of a fit."""

    mean: Array  # (k,)
    covariance: Array  # (k, k)

    @cached_property
    def precision(self) -> Array:
        """Return the inverse of the covariance, (k, k)."""
        size = np.sqrt(np.diag(self.covariance))
        unit = self.covariance / np.outer(size, size)
        unit[np.diag_indices_from(unit)] += _JITTER
        inverse: Array = cho_solve(cho_factor(unit), np.eye(len(size))) / np.outer(size, size)
        return 0.5 * (inverse + inverse.T)

    def widened(self, directions: Array) -> GaussianPrior:
        """Return the prior with the covariance D D^T of r directions D (k, r) added."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


def disagreement(expected: GaussianPrior, x: Array, covariance: Array) -> Gaussian:
    """Return what a fit says of a further deviation z from the prior's mean, as linear rows.

    With the prior's precision P and the posterior covariance C, the gram matrix of z is P - P C P
    and its projection P (x - mean).

    Args:
        expected: prior of the first k unknowns.
        x: (k,) their values after the fit.
        covariance: (k, k) their covariance after the fit.
    """
    precision = expected.precision
    known = precision - precision @ covariance @ precision
    return Gaussian.of_products(0.5 * (known + known.T), precision @ (x - expected.mean))


def gain_along(
    disagreed: Gaussian, directions: Array, sizes: Sequence[float]
) -> tuple[float, float]:
    """Return the gain in log evidence if the prior is widened along directions, and the best size.

    Args:
        disagreed: see `disagreement`.
        directions: (k, r), each of a standard deviation of one.
        sizes: multiples of that to choose from; the choice costs the logarithm of their number.
    """
    along = disagreed.in_terms_of(directions)
    unwidened = -0.5 * (disagreed.squares + disagreed.log_det)
    evidence = [along.in_sizes(np.full(along.unknowns, size)).log_evidence for size in sizes]
    best = int(np.argmax(evidence))
    return evidence[best] - unwidened - float(np.log(len(sizes))), float(sizes[best])


def remaining_disagreement(disagreed: Gaussian, directions: Array) -> Gaussian:
    """Return the disagreement that remains with a prior widened along directions (k, r)."""
    both = np.concatenate([directions, np.eye(disagreed.unknowns)], axis=1)
    return disagreed.in_terms_of(both).without(np.arange(directions.shape[1]))
