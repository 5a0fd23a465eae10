"""Covariance of the rows of poses and torques, by which they are whitened.

Three kinds of error add up: the noise of readings, independent from cell to cell; an error of
unknown cause that the cells of a pose share (`SharedByCells`), of a variance estimated from the
data; and errors common to all poses (places of targets on the apparatus, masses, loads), whose
standard uncertainties are known. The pose is the unit of evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.numerics.covariances import mean_covariance
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations, average_groups


class SharedVariances(NamedTuple):
    """Variances of the errors that the cells of a pose share, in units of that of a reading."""

    pose: float
    torque: float


NO_SHARED_ERROR = SharedVariances(0.0, 0.0)


def average_into_cells(readings: Observations, cov: Array, most: int) -> tuple[Observations, Array]:
    """Average readings into C cells: of one pose, load, direction of arrival and stretch of time.

    A cell has at most `most` readings, in which the same components were seen: so its mean joint
    positions are those of all its components. What may distinguish effects is not averaged.

    Returns:
        The cells, and the covariances (C, b, b) of their means, from those (P, b, b) of readings.
    """
    seen = readings.measured.components_seen
    patterns, pattern = np.unique(seen, axis=0, return_inverse=True)
    numbers = same_circumstances(readings) * len(patterns) + pattern.ravel()
    circumstances = np.unique(numbers, return_inverse=True)[1]
    order = np.lexsort((readings.states.time_s, circumstances))
    sizes = np.bincount(circumstances)
    stretch = np.empty(len(order), dtype=np.intp)
    for rows in np.split(order, np.cumsum(sizes)[:-1]):
        stretches = -(-len(rows) // most)  # rounded up
        stretch[rows] = np.arange(len(rows)) * stretches // len(rows)
    _, cell = np.unique(circumstances * (stretch.max() + 1) + stretch, return_inverse=True)
    return average_groups(readings, cell), mean_covariance(cov, seen, cell)


@dataclass(frozen=True)
class SharedByCells:
    """Covariance of an error of unknown cause that the cells of a pose share.

    It concerns the R = C b rows of C cells with b components each, a cell's rows side by side,
    whitened by the noise of the cells. Multiplied by `rotation`, they have the diagonal covariance
    1 + v * `variance`, with v the variance of the shared error in units of that of one reading.
    """

    rotation: csr_array  # (R, R) orthogonal; mixes the cells of a pose, each component by itself
    variance: Array  # (R,) variance of each rotated row for v = 1; 0 of components not seen


def shared_error(cells: Observations, seen: Mask) -> SharedByCells:
    """Return the covariance of the errors that the cells of a pose share.

    A cell in which a component was not seen says nothing about the error of that component.

    Args:
        cells: C cells.
        seen: (C, b) which components each cell has.
    """
    row = np.arange(seen.size).reshape(seen.shape)
    variance = np.zeros(seen.size)
    _, number, count = np.unique(cells.pose, return_inverse=True, return_counts=True)
    # A cell that is alone has the error of its pose as it is.
    alone = count[number] == 1
    variance[row[alone]] = np.where(seen[alone], cells.readings[alone, None], 0.0)
    of_alone = row[alone].ravel()
    # of the rotation: rows, columns and values
    entries: list[tuple[Array | Index, ...]] = [(of_alone, of_alone, np.ones(len(of_alone)))]
    for pose in np.flatnonzero(count > 1):
        here = np.flatnonzero(number == pose)
        # The noise of a mean of k readings is sqrt(k) smaller than that of one, so that in its unit
        # a shared error is sqrt(k) larger.
        sizes = _amplitudes(cells.states.take(here)) * np.sqrt(cells.readings[here])[:, None]
        # Components that the same cells have, mostly all of them, are rotated alike.
        if seen[here].all():
            patterns, pattern = seen[here, :1], np.zeros(seen.shape[1], dtype=np.intp)
        else:
            patterns, pattern = np.unique(seen[here], axis=1, return_inverse=True)
        for k, had in enumerate(patterns.T):
            of_pattern = row[here][:, pattern.ravel() == k]
            with_it, without = of_pattern[had], of_pattern[~had].ravel()
            eigenvalues, vectors = np.linalg.eigh(sizes[had] @ sizes[had].T)
            variance[with_it] = np.maximum(eigenvalues, 0.0)[:, None]
            entries += [
                tuple(np.broadcast_arrays(with_it[:, None], with_it[None], vectors.T[:, :, None])),
                (without, without, np.ones(len(without))),
            ]
    rows, columns, values = (
        np.concatenate([part.ravel() for part in parts]) for parts in zip(*entries, strict=True)
    )
    rotation = csr_array((values, (rows, columns)), shape=(seen.size, seen.size))
    return SharedByCells(rotation, variance)


def _amplitudes(states: PoseStates) -> Array:
    """Return how the error of a pose may differ between its cells, (c, a), each column up to 1.

    It may be constant, or depend on load, time and direction of arrival. The direction is one
    number a cell: that along the first principal component of the arrivals.
    """
    arrival = states.arrival - states.arrival.mean(axis=0)
    direction = arrival @ np.linalg.svd(arrival, full_matrices=False)[2][0]
    columns = [np.ones(len(arrival))]
    for state in (states.load_N, states.time_s, direction):
        centred = state - state.mean()
        largest = float(np.abs(centred).max())
        if largest > 0:
            columns.append(centred / largest)
    return np.column_stack(columns)


@dataclass(frozen=True)
class NoiseModel:
    """Covariance of the rows of one channel, poses or torques: C cells with b components each.

    Its R = C b rows are those of `SharedByCells`.
    """

    whitener: Array  # (C, b, b) makes the noise of each cell's mean independent, of unit variance
    shared: SharedByCells  # errors that the cells of a pose share
    # (R, c) noise-whitened rows of one standard uncertainty of each error common to all poses
    common: Array
    _whitenings: dict[float, Whitening] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, whitener: Array, shared: SharedByCells, common: Array) -> NoiseModel:
        """Return the model, with common errors (C, b, c) of one standard uncertainty each."""
        return cls(whitener, shared, _noise_whitened(whitener, shared, common))

    def noise_whitened(self, values: Array) -> Array:
        """Return rows (R, k) of values (C, b, k), whitened by the noise of readings and rotated.

        They still have the errors that cells of a pose share, and those common to all poses.
        """
        return _noise_whitened(self.whitener, self.shared, values)

    def whitened(self, values: Array, variance: float) -> Array:
        """Return rows (R, k) of values (C, b, k) whose errors have unit covariance."""
        return self.whitening(variance)(self.noise_whitened(values))

    def common_amounts(self, rows: Array, variance: float) -> Array:
        """Return the most likely amounts (c, k) of the common errors in noise-whitened rows (R, k).

        Their prior is standard normal. Rows weigh less by the variance of the shared error, so that
        the common errors are not bent to explain what the model lacks.
        """
        weight = 1.0 / (1.0 + variance * self.shared.variance)[:, None]
        equations = Gaussian.of_products(self.common.T @ (weight * self.common))
        return equations.taken_of(self.common.T @ (weight * rows))

    def whitening(self, variance: float) -> Whitening:
        """Return what whitens noise-whitened rows, for a variance of the shared error.

        The variance is in units of that of a reading.
        """
        if variance not in self._whitenings:
            scale = 1.0 / np.sqrt(1.0 + variance * self.shared.variance)
            self._whitenings[variance] = Whitening.of(scale, self.common)
        return self._whitenings[variance]


def _noise_whitened(whitener: Array, shared: SharedByCells, values: Array) -> Array:
    count, b, k = values.shape
    rotated: Array = shared.rotation @ (whitener @ values).reshape(count * b, k)
    return rotated


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
        directions, std, _ = np.linalg.svd(scale[:, None] * common, full_matrices=False)
        return cls(scale, directions, 1.0 - 1.0 / np.sqrt(1.0 + std**2))

    def __call__(self, rows: Array) -> Array:
        """Return whitened rows (R, k)."""
        scaled = self.scale[:, None] * rows
        whitened: Array = scaled - self.directions @ (
            self.shrink[:, None] * (self.directions.T @ scaled)
        )
        return whitened
