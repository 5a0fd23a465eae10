"""Covariance of the rows of poses and torques, by which they are whitened.

Three kinds of error add up: the noise of readings, independent from cell to cell; an error of
unknown cause that the cells of a pose share (`SharedByCells`), of a variance estimated from the
data; and errors common to all poses (places of targets on the apparatus, masses, loads), whose
standard uncertainties are known. The pose is the unit of evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.discovery.noise import mean_covariance, same_circumstances
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations, average_groups


class SharedVariances(NamedTuple):
    """Variances of the errors that the cells of a pose share, in units of that of a reading."""

    pose: float
    torque: float


NO_SHARED_ERROR = SharedVariances(0.0, 0.0)


def average_into_cells(readings: Observations, cov: Array, most: int) -> tuple[Observations, Array]:
    """Average readings into C cells: of one pose, load, direction of arrival and stretch of time.

    A cell has at most `most` readings. What may distinguish effects is not averaged.

    Returns:
        The cells, and the covariances (C, b, b) of their means, from those (P, b, b) of readings.
    """
    circumstances = same_circumstances(readings)
    order = np.lexsort((readings.states.time_s, circumstances))
    sizes = np.bincount(circumstances)
    stretch = np.empty(len(order), dtype=np.intp)
    for rows in np.split(order, np.cumsum(sizes)[:-1]):
        stretches = -(-len(rows) // most)  # rounded up
        stretch[rows] = np.arange(len(rows)) * stretches // len(rows)
    _, cell = np.unique(circumstances * (stretch.max() + 1) + stretch, return_inverse=True)
    seen = readings.measured.components_seen
    return average_groups(readings, cell), mean_covariance(cov, seen, cell)


@dataclass(frozen=True)
class SharedByCells:
    """Covariance of an error of unknown cause that the cells of a pose share.

    The error of a pose may depend on load, direction of arrival and time. Whitened rows times
    `rotation` have the diagonal covariance 1 + v * `variance`, with v the variance of the shared
    error in units of that of one reading.
    """

    rotation: Array  # (C, C) orthogonal, block by block of the cells of a pose
    variance: Array  # (C,) variance of each rotated row for v = 1


def shared_error(cells: Observations) -> SharedByCells:
    """Return the covariance of the shared errors of C cells, each whitened by its own noise."""
    count, states = len(cells), cells.states
    rotation, variance = np.zeros((count, count)), np.zeros(count)
    for pose in np.unique(cells.pose):
        rows = np.flatnonzero(cells.pose == pose)
        # An error of the pose may depend on load, time and direction, each with unit amplitude. The
        # direction is one number a cell: that along the first principal component of the arrivals.
        arrival = states.arrival[rows] - states.arrival[rows].mean(axis=0)
        direction = arrival @ np.linalg.svd(arrival, full_matrices=False)[2][0]
        columns = [np.ones(len(rows))]
        for values in (states.load_N[rows], states.time_s[rows], direction):
            centred = values - values.mean()
            largest = float(np.abs(centred).max())
            if largest > 0:
                columns.append(centred / largest)
        # Whitening by the covariance of a mean of k readings makes a shared error sqrt(k) larger.
        shapes = np.column_stack(columns) * np.sqrt(cells.readings[rows])[:, None]
        values, vectors = np.linalg.eigh(shapes @ shapes.T)
        rotation[np.ix_(rows, rows)] = vectors.T
        variance[rows] = np.maximum(values, 0.0)
    return SharedByCells(rotation, variance)


@dataclass(frozen=True)
class NoiseModel:
    """Covariance of the rows of one channel, poses or torques: C cells with b components each."""

    whitener: Array  # (C, b, b) makes the noise of each cell's mean independent, of unit variance
    shared: SharedByCells  # errors that the cells of a pose share
    common: Array  # (R, c) derivative of the R = C b rows by errors common to all poses, in sizes
    _whitenings: dict[float, Whitening] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, whitener: Array, shared: SharedByCells, common: Array) -> NoiseModel:
        """Return the model, with common errors (C, b, c) of one standard uncertainty each."""
        bare = cls(whitener, shared, np.zeros((whitener.shape[0] * whitener.shape[1], 0)))
        return cls(whitener, shared, bare.rows(common))

    @property
    def shared_size(self) -> Array:
        """Return the variance of each row (R,) for a shared error of the variance of a reading."""
        return np.repeat(self.shared.variance, self.whitener.shape[1])

    def rows(self, values: Array) -> Array:
        """Return whitened and rotated rows (R, k) of values (C, b, k)."""
        white = self.whitener @ values
        count, b, k = white.shape
        rotated: Array = self._rotation @ white.reshape(count, b * k)
        return rotated.reshape(count * b, k)

    def whitened(self, values: Array, variance: float) -> Array:
        """Return rows (R, k) of values (C, b, k) whose errors have unit covariance."""
        return self.whitening(variance)(self.rows(values))

    def common_amounts(self, rows: Array, variance: float) -> Array:
        """Return the most likely amounts (c, k) of the common errors in rows (R, k).

        With the variance of the shared error, they do not take up what the model lacks.
        """
        weight = 1.0 / (1.0 + variance * self.shared_size)[:, None]
        equations = Gaussian.of_products(self.common.T @ (weight * self.common))
        return equations.taken_of(self.common.T @ (weight * rows))

    @cached_property
    def _rotation(self) -> csr_array:
        """Return the rotation as a sparse matrix: few cells belong to one pose."""
        return csr_array(self.shared.rotation)

    def whitening(self, variance: float) -> Whitening:
        """Return the whitening for a variance of the shared error, in units of a reading's."""
        if variance not in self._whitenings:
            scale = 1.0 / np.sqrt(1.0 + variance * self.shared_size)
            self._whitenings[variance] = Whitening.of(scale, self.common)
        return self._whitenings[variance]


@dataclass(frozen=True)
class Whitening:
    """Whitening by a diagonal covariance and one of low rank.

    Rows D^-1/2 r have the covariance 1 + C C^T, whose inverse root is 1 - U shrink U^T, with
    C = U S V^T and shrink = 1 - 1 / sqrt(1 + S^2).
    """

    scale: Array  # (R,) factor of each row, D^-1/2
    directions: Array  # (R, c) U, orthonormal directions of the common errors in scaled rows
    shrink: Array  # (c,) part by which rows shrink along them

    @classmethod
    def of(cls, scale: Array, common: Array) -> Whitening:
        """Return the whitening for factors of rows (R,) and common errors of unit size (R, c)."""
        directions, sizes, _ = np.linalg.svd(scale[:, None] * common, full_matrices=False)
        return cls(scale, directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def __call__(self, rows: Array) -> Array:
        """Return whitened rows (R, k)."""
        scaled = self.scale[:, None] * rows
        whitened: Array = scaled - self.directions @ (
            self.shrink[:, None] * (self.directions.T @ scaled)
        )
        return whitened
