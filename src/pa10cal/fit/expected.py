"""Unknowns that are expected about known values: what an earlier fit says of them.

Where a fit finds that expectation and readings disagree, the expectation is widened along few
directions: those in which something moved. Evidence decides, in closed form: about the fit all is
linear and Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arrays import Array

#: Part of a variance that nothing else explains; keeps the precision finite.
_JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class Expected:
    """The first k unknowns of a fit are normally distributed."""

    mean: Array  # (k,) where they are expected
    covariance: Array  # (k, k) how well they are known

    @cached_property
    def precision(self) -> Array:
        """Return the inverse of the covariance, (k, k)."""
        size = np.sqrt(np.diag(self.covariance))
        unit = self.covariance / np.outer(size, size)
        unit[np.diag_indices_from(unit)] += _JITTER
        inverse: Array = cho_solve(cho_factor(unit), np.eye(len(size))) / np.outer(size, size)
        return 0.5 * (inverse + inverse.T)

    def widened(self, directions: Array) -> Expected:
        """Return the same, but for further variance along directions (k, r) of standard size."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


@dataclass(frozen=True, eq=False)
class Disagreement:
    """How readings and an expectation, or two fits, disagree about k parameters."""

    pull: Array  # (k,) K^-1 d, for differences d expected to scatter with covariance K
    known: Array  # (k, k) covariance of the pull where nothing moved: K^-1 as far as it is seen

    @classmethod
    def of_fit(cls, expected: Expected, x: Array, covariance: Array) -> Disagreement:
        """Return how a fit disagrees with what was expected.

        Args:
            expected: of the first k unknowns.
            x: (k,) where they are found.
            covariance: (k, k) of them, after the fit.
        """
        precision = expected.precision
        known = precision - precision @ covariance @ precision
        return cls(precision @ (x - expected.mean), 0.5 * (known + known.T))

    def gain(self, directions: Array, sizes: Sequence[float]) -> tuple[float, float]:
        """Return by how much evidence rises if more is possible along directions, and which size.

        Args:
            directions: (k, r), each of a standard size of one.
            sizes: multiples of that to choose from; the choice costs the logarithm of their number.
        """
        values, turn = np.linalg.eigh(directions.T @ self.known @ directions)
        seen = np.maximum(values, 0.0)
        along = (directions @ turn).T @ self.pull
        variances = np.square(np.asarray(sizes, dtype=float))[:, None]
        widened = 1.0 + variances * seen
        rise = 0.5 * np.sum(variances * along**2 / widened - np.log(widened), axis=1)
        best = int(np.argmax(rise))
        return float(rise[best]) - float(np.log(len(sizes))), float(sizes[best])

    def widened(self, directions: Array) -> Disagreement:
        """Return what remains where more is possible along directions (k, r) of standard size."""
        seen = self.known @ directions
        inside = np.eye(directions.shape[1]) + directions.T @ seen
        taken = cho_solve(cho_factor(inside), seen.T)
        return Disagreement(
            self.pull - (directions.T @ self.pull) @ taken, self.known - seen @ taken
        )
