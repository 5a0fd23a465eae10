"""Readings gathered into cells: one pose, one load, one direction of arrival, one stretch of time.

A cell averages what does not differ; what may distinguish effects stays apart. The pose
remains the unit of evidence: cells of a pose share whatever is wrong there, and `SharedError` is
the covariance of an error of unknown cause that they share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.noise import mean_covariance, same_circumstances
from pa10cal.observe.averages import average_groups
from pa10cal.observe.observations import Observations

#: Readings a cell at most: a drift shows between the cells of a longer row of repeats.
READINGS_A_CELL = 4


def gather(
    readings: Observations, cov: Array, most: int = READINGS_A_CELL
) -> tuple[Observations, Array]:
    """Average readings into cells, ordered by pose, load, direction and time.

    Args:
        readings: P single readings.
        cov: (P, b, b) covariances of their components.
        most: readings a cell.

    Returns:
        The C cells, and the covariances (C, b, b) of their means.
    """
    circumstances = same_circumstances(readings)
    order = np.lexsort((readings.states.time_s, circumstances))
    stretch = np.empty(len(order), dtype=np.intp)
    start = 0
    for size in np.bincount(circumstances):
        blocks = -(-size // most)
        stretch[order[start : start + size]] = np.arange(size) * blocks // size
        start += size
    code = circumstances * (stretch.max() + 1) + stretch
    code = np.unique(code, return_inverse=True)[1]
    seen = readings.measured.components_seen
    return average_groups(readings, code), mean_covariance(cov, seen, code)


@dataclass(frozen=True)
class SharedError:
    """Errors that the cells of a pose share, in whitened rows.

    A pose may be off, and differently with load, with direction, and in the course of time. In
    `turn`ed rows that covariance is diagonal: 1 + variance * `size`.
    """

    turn: Array  # (C, C) orthogonal, block by block of the cells of a pose
    # (C,) variance of each turned row a unit variance of the shared error, the unit being the
    # variance of one reading
    size: Array


def shared_error(cells: Observations) -> SharedError:
    """Lay out the errors that cells of a pose share.

    Args:
        cells: C cells, whose rows are whitened by the covariance of their own mean.
    """
    count = len(cells)
    turn, size = np.zeros((count, count)), np.zeros(count)
    for pose in np.unique(cells.pose):
        rows = np.flatnonzero(cells.pose == pose)
        shapes = _shapes(cells.take(rows))
        # Whitening by the covariance of a mean of k readings makes a shared error sqrt(k) larger.
        shapes *= np.sqrt(cells.readings[rows])[:, None]
        values, vectors = np.linalg.eigh(shapes @ shapes.T)
        turn[np.ix_(rows, rows)] = vectors.T
        size[rows] = np.maximum(values, 0.0)
    return SharedError(turn, size)


def _shapes(cells: Observations) -> Array:
    """Return how an error of one pose may go with its cells, (c, s), each of unit size."""
    states = cells.states
    columns = [np.ones(len(cells))]
    for values in (states.load_N, states.time_s, _direction(states.arrival)):
        centred = values - values.mean()
        largest = float(np.abs(centred).max())
        if largest > 0:
            columns.append(centred / largest)
    return np.column_stack(columns)


def _direction(arrival: Array) -> Array:
    """Return one number a cell that separates directions of arrival: along the main contrast."""
    centred = arrival - arrival.mean(axis=0)
    _, _, right = np.linalg.svd(centred, full_matrices=False)
    along: Array = centred @ right[0]
    return along
