"""How many poses a calibration needs: D-optimal order, and expected uncertainty by their number.

A pose adds its information J^T J, whatever was read there. Taken in the order in which the
determinant grows fastest, the measured poses show with how few of them the model would have been
known nearly as well (D-optimality; Sun and Hollerbach, 2008, compare such criteria).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.fit.exchange import Criterion, Share, one_by_one

#: Poses to choose from and poses chosen at most: more would change no curve that one can see.
_POOL = 1000
_MOST = 200
#: Expected size of a parameter in its scale, which makes information definite before it is full.
_POSSIBLE_SCALES = 30.0


@dataclass(frozen=True)
class PoseDesign:
    """Expected uncertainty of the model by the number of poses of this kind."""

    order: Index  # poses in D-optimal order, as rows, the first the most telling
    numbers: Index  # (m,) numbers of poses
    # (m,) expected standard uncertainty of a predicted position, root mean square over all poses,
    # with the first of `order`; inf where they are too few
    u_optimal_m: Array
    u_measured_m: Array  # (m,) the same with the first of the poses in the order measured
    u_all_m: float


def pose_design(white: Array, position: Array, scale: Array, unknowns: int) -> PoseDesign:
    """Order poses by their information.

    Args:
        white: (P, b, k) rows of every pose, of unit variance.
        position: (P, c, k) derivative of the predicted position [m].
        scale: (k,) typical size of each parameter.
        unknowns: parameters that all poses together identify.
    """
    count = len(white)
    scales = np.outer(scale, scale)
    pool = np.unique(np.linspace(0, count - 1, min(count, _POOL)).round().astype(np.intp))
    information = np.eye(len(scale)) / _POSSIBLE_SCALES**2
    criterion = Criterion(white[pool] * scale * _POSSIBLE_SCALES, [Share(1.0, len(scale))])
    order = pool[one_by_one(criterion, min(len(pool), _MOST))]
    spread = _gram(position) * scales / count
    numbers = np.unique(np.geomspace(1, len(order), 40).round().astype(np.intp))
    enough = -(-unknowns // white.shape[1])

    def expected(of_poses: Array) -> float:
        if len(of_poses) < enough:
            return float("inf")
        covariance = np.linalg.inv(information + _gram(of_poses) * scales)
        return float(np.sqrt(np.sum(covariance * spread)))

    return PoseDesign(
        order=order,
        numbers=numbers,
        u_optimal_m=np.array([expected(white[order[:n]]) for n in numbers]),
        u_measured_m=np.array([expected(white[:n]) for n in numbers]),
        u_all_m=expected(white),
    )


def _gram(rows: Array) -> Array:
    """Return the products (k, k) of the rows (P, b, k) of all poses."""
    flat = rows.reshape(-1, rows.shape[2])
    found: Array = flat.T @ flat
    return found


def poses_needed(design: PoseDesign, u_needed_m: float) -> int | None:
    """Return the least number of well-chosen poses with that uncertainty; None where more."""
    enough = np.flatnonzero(design.u_optimal_m <= u_needed_m)
    return int(design.numbers[enough[0]]) if len(enough) else None
