"""Covariance of calibrated parameters, from what repeats show and what they cannot.

The estimate is a minimum, so an error e_i of pose i moves it by an influence G_i, to first order
and through both levels. Errors that repeats show are independent between poses; an error in the
places of the tooling balls on the apparatus is the same in all poses and is added whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from pa10cal.calibration.levels import Linearisation
from pa10cal.calibration.pose_error import cross_matrix
from pa10cal.campaign.observations import PoseObservations

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Covariances:
    """Covariances of an estimate.

    Attributes:
        parameters: (k, k) of the outer parameters.
        base: (6, 6) of the base frame: translation along the instrument's axes [m], small right
            rotation [rad].
        from_apparatus: (k,) variance that the apparatus alone contributes.
    """

    parameters: Array
    base: Array
    from_apparatus: Array


def apparatus_covariance(p_ee_balls_m: Array, u_ball_m: float) -> Array:
    """Return the covariance (6, 6) of the end-effector frame that ball places define.

    Args:
        p_ee_balls_m: (b, 3) ball centres in the end-effector frame, b >= 3.
        u_ball_m: standard uncertainty of each coordinate of a ball's place.

    Returns:
        Covariance of translation [m] and small rotation [rad] along end-effector axes.
    """
    rows = np.concatenate(
        [np.concatenate([np.eye(3), -cross_matrix(p)], axis=1) for p in p_ee_balls_m]
    )
    covariance: Array = u_ball_m**2 * np.linalg.inv(rows.T @ rows)
    return covariance


def propagate(
    at_solution: Linearisation,
    observations: PoseObservations,
    inner_rows: NDArray[np.intp],
    terms: Array,
    r_max_m: float,
    apparatus: Array,
) -> Covariances:
    """Propagate the errors of the measured poses to the estimate.

    Args:
        at_solution: linearisation at the estimate.
        observations: measured poses with their covariances.
        inner_rows: rows of the inner level, none on one level.
        terms: (r, k) tolerance rows of the solve.
        r_max_m: length that normalises positions.
        apparatus: (6, 6) covariance of the end-effector frame, the same in all poses.
    """
    J, by_base = at_solution.jacobian, at_solution.by_base
    k = J.shape[2]
    flat = J.reshape(-1, k)
    size = np.sqrt(np.sum(flat**2, axis=0) + np.sum(terms**2, axis=0))
    size[size == 0.0] = 1.0
    normal = (flat.T @ flat + terms.T @ terms) / np.outer(size, size)
    normal_inverse = np.linalg.pinv(normal, hermitian=True) / np.outer(size, size)
    through = J.transpose(0, 2, 1).copy()  # (N, k, 6): what e_i does to the outer gradient
    base_influence = np.zeros((len(J), 6, 6))
    if len(inner_rows):
        inner = by_base[inner_rows]
        hessian = np.einsum("nij,nik->jk", inner, inner)
        base_influence[inner_rows] = -np.linalg.solve(hessian, inner.transpose(0, 2, 1))
        crossed = np.einsum("nij,nik->jk", J, by_base)
        through += crossed @ base_influence
    influence = -normal_inverse @ through
    base_influence = base_influence + at_solution.base_jacobian @ influence
    unit = np.concatenate([np.full(3, 1.0 / r_max_m), np.ones(3)])
    noise = observations.cov_ee * np.outer(unit, unit)
    R_cmm_ee = observations.T_cmm_ee[:, :3, :3]
    common = np.array([block_diag(R / r_max_m, R) for R in R_cmm_ee])
    from_apparatus = _common(influence, common, apparatus)
    return Covariances(
        parameters=_independent(influence, noise) + from_apparatus,
        base=_independent(base_influence, noise) + _common(base_influence, common, apparatus),
        from_apparatus=np.diag(from_apparatus).copy(),
    )


def _independent(influence: Array, noise: Array) -> Array:
    total: Array = np.einsum("nai,nij,nbj->ab", influence, noise, influence, optimize=True)
    return total


def _common(influence: Array, common: Array, covariance: Array) -> Array:
    moved = np.einsum("nai,nij->aj", influence, common)
    total: Array = moved @ covariance @ moved.T
    return total
