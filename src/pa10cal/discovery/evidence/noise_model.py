"""One kind of measured rows, poses or torques, and the covariance by which they are weighed.

Three kinds of error add up: the noise of readings, independent from cell to cell; an error of
unknown cause that the cells of a pose share (`cells.SharedError`), of a variance found from the
data; and errors common to all poses (places of balls on the apparatus, masses, loads), whose
standard uncertainties are known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.cells import SharedError


@dataclass(frozen=True)
class NoiseModel:
    """Rows of C cells with b components each."""

    whitener: Array  # (C, b, b) makes the noise of each cell's mean independent and of unit size
    shared: SharedError  # errors that the cells of a pose share
    common: Array  # (C b, c) whitened rows of errors common to all poses, each of unit size
    _whitenings: dict[float, Whitening] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, whitener: Array, shared: SharedError, common: Array) -> NoiseModel:
        """Lay out a channel.

        Args:
            whitener: (C, b, b).
            shared: errors that cells of a pose share.
            common: (C, b, c) errors common to all poses, at their standard uncertainty.
        """
        bare = cls(whitener, shared, np.zeros((whitener.shape[0] * whitener.shape[1], 0)))
        return cls(whitener, shared, bare.rows(common))

    @property
    def shared_size(self) -> Array:
        """(R,) variance of each row a unit variance of the shared error."""
        return np.repeat(self.shared.size, self.whitener.shape[1])

    def rows(self, values: Array) -> Array:
        """Return whitened, turned rows (C b, k) of values (C, b, k)."""
        white = self.whitener @ values
        count, b, k = white.shape
        turned: Array = self._turn @ white.reshape(count, b * k)
        return turned.reshape(count * b, k)

    @cached_property
    def _turn(self) -> csr_array:
        """Return the turn without its zeros: few cells belong to one pose."""
        return csr_array(self.shared.turn)

    def whitening(self, variance: float) -> Whitening:
        """Return the weights for a variance of the shared error, in those of one reading."""
        if variance not in self._whitenings:
            self._whitenings[variance] = self._whitening_for(variance)
        return self._whitenings[variance]

    def _whitening_for(self, variance: float) -> Whitening:
        total = 1.0 + variance * self.shared_size
        scale = 1.0 / np.sqrt(total)
        left, sizes, _ = np.linalg.svd(scale[:, None] * self.common, full_matrices=False)
        return Whitening(
            scale=scale,
            directions=left,
            shrink=1.0 - 1.0 / np.sqrt(1.0 + sizes**2),
            log_determinant=float(np.log(total).sum() + np.log1p(sizes**2).sum()),
        )


@dataclass(frozen=True)
class Whitening:
    """What makes rows of a channel independent and of unit variance."""

    scale: Array  # (R,) by which each row is scaled
    directions: Array  # (R, c) orthonormal directions of the common errors in scaled rows
    shrink: Array  # (c,) part by which rows shrink along them
    log_determinant: float  # of the covariance of the rows

    def __call__(self, rows: Array) -> Array:
        """Weigh rows (R, k)."""
        scaled = self.scale[:, None] * rows
        weighed: Array = scaled - self.directions @ (
            self.shrink[:, None] * (self.directions.T @ scaled)
        )
        return weighed
