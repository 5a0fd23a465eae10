"""The inner level, paper equation (4): the base frame that fits M poses best.

Its cost is that of weighted orthogonal Procrustes on positions and attitudes, whose minimum is one
singular value decomposition; the implicit-function theorem gives the derivative of that minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError


@dataclass(frozen=True)
class BaseFrame:
    """The base frame that minimises the inner cost."""

    T_instr_base: Array  # (4, 4) base frame in the instrument's frame [m]
    # (6, k) derivative by the model's parameters: translation [m] over a small right rotation, R
    # exp([omega]), or None where it was not requested
    jacobian: Array | None = None


def fit_base_frame(
    T_base_ee: Array,
    T_instr_ee: Array,
    *,
    attitude_weight_m2: float,
    jacobian: Array | None = None,
) -> BaseFrame:
    """Minimise sum |p_instr - (R p_base + t)|^2 + w sum chord^2 over R and t.

    Args:
        T_base_ee: (M, 4, 4) predicted poses.
        T_instr_ee: (M, 4, 4) measured poses.
        attitude_weight_m2: w, square of the length that makes one radian weigh like it; zero
            aligns on positions alone.
        jacobian: (M, 6, k) derivative of the predicted poses, where that of the frame is needed.

    Raises:
        CalibrationError: when the poses do not determine the base frame.
    """
    p_base, R_base = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    p_instr, R_cmm = T_instr_ee[:, :3, 3], T_instr_ee[:, :3, :3]
    mean_base, mean_instr = p_base.mean(axis=0), p_instr.mean(axis=0)
    centred_instr = p_instr - mean_instr
    moment = centred_instr.T @ (p_base - mean_base)
    moment += 0.5 * attitude_weight_m2 * np.einsum("nij,nkj->ik", R_cmm, R_base)
    left, sizes, right = np.linalg.svd(moment)
    if not sizes[1] > 1e-12 * max(sizes[0], np.finfo(float).tiny):
        raise CalibrationError(
            "the poses do not determine the base frame",
            where="inner level",
            value=f"singular values {sizes.tolist()}",
            allowed="poses that are not collinear",
            remedy="use more poses, or poses further apart",
        )
    R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, mean_instr - R @ mean_base
    if jacobian is None:
        return BaseFrame(T)
    turn, shift = jacobian[:, 3:], jacobian[:, :3]
    d_moment = (centred_instr.T @ shift.reshape(len(shift), -1)).reshape(3, 3, -1)
    # d(R_cmm R_base^T) for R_base -> exp([turn]) R_base is -(R_cmm R_base^T) [turn].
    relative = R_cmm @ R_base.transpose(0, 2, 1)
    d_moment += 0.5 * attitude_weight_m2 * _times_cross(relative, turn)
    turned = np.tensordot(R.T, d_moment, axes=1)
    skew = np.stack(
        [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
    )
    stretch = R.T @ moment
    omega = np.linalg.solve(np.trace(stretch) * np.eye(3) - stretch, skew)
    d_translation = R @ np.cross(mean_base[:, None], omega, axis=0) - R @ shift.mean(axis=0)
    return BaseFrame(T, np.concatenate([d_translation, omega]))


def _times_cross(matrices: Array, turns: Array) -> Array:
    """Return minus the sum over n of A_n [w_n]x, (3, 3, k), for A (n, 3, 3) and w (n, 3, k)."""
    count, k = len(matrices), turns.shape[2]
    products = matrices.reshape(count, 9).T @ turns.reshape(count, 3 * k)  # sums of A_ij w_l
    column = products.reshape(3, 3, 3, k)
    return -np.stack(
        [
            column[:, 1, 2] - column[:, 2, 1],
            column[:, 2, 0] - column[:, 0, 2],
            column[:, 0, 1] - column[:, 1, 0],
        ],
        axis=1,
    )
