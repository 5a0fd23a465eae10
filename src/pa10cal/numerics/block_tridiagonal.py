"""Normal equations of a sequence of vectors, each coupled with the one before and after it.

The matrix is block tridiagonal, of P blocks of d unknowns, and the blocks beside the diagonal are
diagonal themselves, as a random walk in d components makes them. It is a band of width d, so all
is computed in time proportional to P.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from pa10cal.arrays import Array


@dataclass(frozen=True)
class BlockTridiagonal:
    """A positive definite block tridiagonal matrix."""

    blocks: Array  # (P, d, d) on the diagonal
    coupling: Array  # (P - 1, d) minus the diagonals of the blocks beside it

    @classmethod
    def of(cls, information: Array, prior: Array, coupling: Array) -> BlockTridiagonal:
        """Return the matrix with blocks information (P, d, d) plus diagonals prior (P, d)."""
        blocks, diagonal = information.copy(), range(prior.shape[1])
        blocks[:, diagonal, diagonal] += prior
        return cls(blocks, coupling)

    @cached_property
    def factor(self) -> Array:
        """Return the Cholesky factor as a lower band, (d + 1, P d)."""
        count, d = self.blocks.shape[:2]
        band = np.zeros((d + 1, count * d))
        for below in range(d):
            for column in range(d - below):
                band[below, column::d] = self.blocks[:, column + below, column]
        band[d, : (count - 1) * d] = -self.coupling.ravel()
        factor: Array = cholesky_banded(band, lower=True, check_finite=False)
        return factor

    @property
    def log_determinant(self) -> float:
        """Return the logarithm of the determinant."""
        return 2.0 * float(np.sum(np.log(self.factor[0])))

    def solve(self, right: Array) -> Array:
        """Return the solution (P, d) for a right-hand side (P, d)."""
        solution = cho_solve_banded((self.factor, True), right.ravel(), check_finite=False)
        return np.asarray(solution, dtype=np.float64).reshape(right.shape)

    def covariance(self) -> Array:
        """Return the blocks (P, d, d) on the diagonal of the inverse.

        Block elimination from both ends leaves the information of each block with all before it,
        and with all after it; the block itself is in both.
        """
        count = len(self.blocks)
        forward, backward = self.blocks.copy(), self.blocks.copy()
        for i in range(1, count):
            coupling = self.coupling[i - 1]
            forward[i] -= coupling[:, None] * np.linalg.inv(forward[i - 1]) * coupling
            j = count - 1 - i
            coupling = self.coupling[j]
            backward[j] -= coupling[:, None] * np.linalg.inv(backward[j + 1]) * coupling
        return np.asarray(np.linalg.inv(forward + backward - self.blocks), dtype=np.float64)
