"""Pure error: how much one reading differs from the next of the same pose, load and direction.

Successive readings are compared, not readings with their mean: what drifts slowly, or depends on
the direction of arrival, is then no noise (von Neumann's mean square of successive differences).
The scatter is laid to its sources, joints that stop a little elsewhere and the instrument, so that
it can be told for any pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pa10cal.errors import DiscoveryError
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Successive differences below which nothing can be said of the noise.
LEAST_DIFFERENCES = 20
#: Part of the readings that must be such repeats, where there are so many poses that blocks of them
#: can be left out instead.
LEAST_REPEATED = 0.25
_REWEIGHTED = 2


@dataclass(frozen=True)
class Repeatability:
    """Noise of single readings.

    Attributes:
        cov_ee: (P, 6, 6) covariance of each reading: position [m] and small rotation [rad], along
            the instrument's axes.
        joint_rad: (n,) standard deviation of each joint that the scatter shows.
        instrument: factor on the instrument's stated standard uncertainty that the scatter shows.
        torque_Nm: (n,) standard deviation of a reading's torques (nan where none is logged).
        differences: successive differences behind it.
    """

    cov_ee: Array
    joint_rad: Array
    instrument: float
    torque_Nm: Array
    differences: int


def same_circumstances(readings: Observations[Pose]) -> Index:
    """Return (P,) a number for every pose, load and direction of arrival, from 0."""
    states = readings.states
    keys = np.column_stack(
        [
            np.unique(readings.pose, return_inverse=True)[1],
            np.unique(states.load_N, return_inverse=True)[1],
            np.unique(states.arrival, axis=0, return_inverse=True)[1].ravel(),
        ]
    )
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def repeatability(readings: Observations[Pose], deviation: Array, screws: Array) -> Repeatability:
    """Find the noise of single readings.

    Args:
        readings: P single readings.
        deviation: (P, 6) measured pose less what a model says at the reading's own joint angles and
            torques, position [m] and small rotation [rad] along the instrument's axes.
        screws: (P, 6, n) how the pose follows each joint's angle, along the same axes.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    order, pairs = _successive(readings)
    if len(pairs) < LEAST_DIFFERENCES:
        raise DiscoveryError(
            "too few repeats to know the measurement's own scatter",
            where="grid poses",
            value=f"{len(pairs)} pairs of successive readings of one pose, load and direction",
            allowed=f"at least {LEAST_DIFFERENCES}",
            remedy="measure poses repeatedly",
        )
    first, second = order[pairs], order[pairs + 1]
    difference = (deviation[second] - deviation[first]) / np.sqrt(2.0)
    sources = np.concatenate(
        [
            np.einsum("pik,pjk->pkij", screws, screws),
            readings.measured.cov[:, None],
            _one_sort(len(readings), slice(0, 3)),
            _one_sort(len(readings), slice(3, 6)),
        ],
        axis=1,
    )
    variances = _variance_components(difference, 0.5 * (sources[first] + sources[second]))
    n = screws.shape[2]
    torque = readings.states.tau_Nm
    torque_difference = (torque[second] - torque[first]) / np.sqrt(2.0)
    return Repeatability(
        cov_ee=np.einsum("k,pkij->pij", variances, sources),
        joint_rad=np.sqrt(variances[:n]),
        instrument=float(np.sqrt(variances[n])),
        torque_Nm=np.sqrt(np.mean(torque_difference**2, axis=0)),
        differences=len(pairs),
    )


def repeated(readings: Observations[Pose]) -> int:
    """Return how many readings repeat one of the same pose, load and direction of arrival."""
    return len(_successive(readings)[1])


def _successive(readings: Observations[Pose]) -> tuple[Index, Index]:
    """Return an order of the readings, and where in it a reading and its next one stand."""
    circumstances = same_circumstances(readings)
    order = np.lexsort((readings.states.time_s, circumstances))
    sorted_codes = circumstances[order]
    return order, np.flatnonzero(sorted_codes[1:] == sorted_codes[:-1])


def _one_sort(count: int, rows: slice) -> Array:
    """Return (count, 1, 6, 6) the same independent error of three components."""
    one = np.zeros((count, 1, 6, 6))
    one[:, 0, range(6)[rows], range(6)[rows]] = 1.0
    return one


def _variance_components(difference: Array, sources: Array) -> Array:
    """Fit non-negative variances of sources (D, s, 6, 6) to the squares of differences (D, 6).

    Whitened by the covariance found before, all products of components weigh about alike.
    """
    count = sources.shape[1]
    expected = np.broadcast_to(np.cov(difference.T, bias=True), (len(difference), 6, 6))
    variances = np.zeros(count)
    for _ in range(_REWEIGHTED):
        whiten = np.linalg.inv(np.linalg.cholesky(expected))
        white = np.einsum("pij,pj->pi", whiten, difference)
        squares = np.einsum("pi,pj->pij", white, white)
        whitened = np.einsum("pij,psjk,plk->psil", whiten, sources, whiten, optimize=True)
        rows = whitened.transpose(0, 2, 3, 1).reshape(-1, count)
        size = np.linalg.norm(rows, axis=0)
        size[size == 0.0] = 1.0
        triangle, target = _compressed(rows / size, squares.ravel())
        variances = nnls(triangle, target)[0] / size
        expected = np.einsum("s,psij->pij", variances, sources)
    # What is left over all components is a common factor.
    whiten = np.linalg.inv(np.linalg.cholesky(expected))
    white = np.einsum("pij,pj->pi", whiten, difference)
    return variances * float(np.mean(white**2))


def _compressed(rows: Array, target: Array) -> tuple[Array, Array]:
    """Return a square system with the same least squares solution."""
    q, triangle = np.linalg.qr(rows)
    return triangle, q.T @ target
