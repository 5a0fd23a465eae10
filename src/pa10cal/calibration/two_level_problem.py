"""The paper's two-level problem: its inner poses and base frame, and residuals with derivatives.

Rows are those of paper equations (2) and (4): position difference over r_max, and the chord of the
orientation difference, for every pose. The base frame is the inner minimum for given outer
parameters, so its derivative is that of an implicit function. On one level, where six parameters
of the model place the base, the problem is `fit.Problem`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.calibration.rules import FIT
from pa10cal.errors import CalibrationError, TooFewPosesError
from pa10cal.fit.problem import Problem, Rows
from pa10cal.frame.point_fits import cross_matrix, pose_error
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.observe.seed import least_loaded
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.term import Report, TermParameter


def spread_poses(observations: Observations[Pose], count: int | Literal["all"]) -> tuple[str, ...]:
    """Choose M poses for the inner level: each next one is the farthest from those chosen.

    The paper does not specify which 8 of its 27 it took; on a 3 x 3 x 3 pattern this gives corners.

    Raises:
        TooFewPosesError: when there are fewer poses than requested.
    """
    labels, codes = np.unique(observations.pose, return_inverse=True)
    if count == "all" or count == len(labels):
        return tuple(str(label) for label in labels)
    if count > len(labels):
        raise TooFewPosesError(
            "more inner poses than measured poses",
            where="calibration.inner_poses",
            value=count,
            allowed=f"1 to {len(labels)}, or 'all'",
            remedy="lower inner_poses",
        )
    # The place of a label is the mean of its rows.
    p_instr_m = observations.measured.T_instr_target[:, :3, 3]
    sums_m = np.stack([np.bincount(codes, weights=along) for along in p_instr_m.T], axis=1)
    places = sums_m / np.bincount(codes)[:, None]
    from_centre = np.linalg.norm(places - places.mean(axis=0), axis=1)
    chosen = [int(np.argmax(from_centre))]
    nearest = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return tuple(str(labels[k]) for k in sorted(chosen))


def rows_of(observations: Observations[Pose], poses: tuple[str, ...]) -> NDArray[np.intp]:
    """Return the rows of the named poses, at every load."""
    return np.flatnonzero(np.isin(observations.pose, poses))


@dataclass(frozen=True)
class BaseFrame:
    """The base frame that minimises the cost of the inner level, paper equation (4)."""

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

    It is a weighted orthogonal Procrustes problem, solved by one singular value decomposition; the
    implicit-function theorem gives the derivative of the minimum.

    Args:
        T_base_ee: (M, 4, 4) predicted poses.
        T_instr_ee: (M, 4, 4) measured poses.
        attitude_weight_m2: w, square of the length that weighs as much as one radian; zero aligns
            positions alone.
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
    U, sizes, Vt = np.linalg.svd(moment)
    if not sizes[1] > FIT.same_directions * max(sizes[0], np.finfo(float).tiny):
        raise CalibrationError(
            "the poses do not determine the base frame",
            where="inner level",
            value=f"singular values {sizes.tolist()}",
            allowed="poses that are not collinear",
            remedy="use more poses, or poses further apart",
        )
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
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
    skew = np.stack([turned[j, i] - turned[i, j] for i, j in ((1, 2), (2, 0), (0, 1))])
    stretch = R.T @ moment
    omega = np.linalg.solve(np.trace(stretch) * np.eye(3) - stretch, skew)
    d_translation = R @ np.cross(mean_base[:, None], omega, axis=0) - R @ shift.mean(axis=0)
    return BaseFrame(T, np.concatenate([d_translation, omega]))


def align_nominal(nominal: Model, observations: Observations[Pose]) -> Array:
    """Return T_instr_base (4, 4) that aligns the nominal model with the least loaded positions.

    The paper's errors before calibration rest on this alignment: by positions alone, of the poses
    with the smallest load, which was zero in the paper's campaign; of all where few have it.
    """
    unloaded = observations.take(least_loaded(observations))
    return fit_base_frame(
        nominal.predict(unloaded.states, np.zeros(0)),
        unloaded.measured.T_instr_target,
        attitude_weight_m2=0.0,
    ).T_instr_base


def _times_cross(matrices: Array, turns: Array) -> Array:
    """Return minus the sum over n of A_n [w_n]x, (3, 3, k), for A (n, 3, 3) and w (n, 3, k)."""
    count, k = len(matrices), turns.shape[2]
    products = matrices.reshape(count, 9).T @ turns.reshape(count, 3 * k)  # sums of A_ij w_l
    sums = products.reshape(3, 3, 3, k)
    return -np.stack([sums[:, i, j] - sums[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], 1)


#: The base frame in the paper's parameters, in scales of a millimetre or milliradian (unit).
_PARAMETERS = (
    *(TermParameter(f"base_p_cmm_{axis}", "m", 1e-3) for axis in "xyz"),
    *(TermParameter(f"gamma_{axis}", "rad", 1e-3) for axis in "xyz"),
)


def report_base(T_instr_base: Array) -> Report:
    """Return the six parameters Psi of paper equation (4).

    The origin of the instrument's frame in the base frame, and the rotations about body-fixed x, y
    and z that turn the base axes into the instrument's.

    Returns:
        Values, with the Jacobian by translation along the instrument's axes and a small right
        rotation of T_instr_base.
    """
    R_base_cmm = T_instr_base[:3, :3].T
    origin = -R_base_cmm @ T_instr_base[:3, 3]
    gamma = Rotation.from_matrix(R_base_cmm).as_euler("XYZ")
    first = Rotation.from_euler("x", gamma[0]).as_matrix()
    second = first @ Rotation.from_euler("y", gamma[1]).as_matrix()
    rates = np.stack([np.array([1.0, 0.0, 0.0]), first[:, 1], second[:, 2]], axis=1)
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -R_base_cmm
    jacobian[:3, 3:] = cross_matrix(origin)
    jacobian[3:, 3:] = -np.linalg.pinv(rates)  # singular where body-fixed y turns by 90 degrees
    return Report(_PARAMETERS, np.concatenate([origin, gamma]), jacobian)


@dataclass(frozen=True)
class TwoLevelRows(Rows):
    """Rows (N, 6) of N poses for given parameters: position over r_max, chord of orientation."""

    # (N, 6, 6) derivative by the base frame: translation in the instrument's frame [m], then a
    # small right rotation
    by_base: Array
    T_instr_base: Array  # (4, 4) base frame
    base_jacobian: Array  # (6, k) derivative of the base frame by the parameters


@dataclass(frozen=True)
class TwoLevel:
    """The paper's problem: base frame inside, link parameters and springs outside."""

    model: Model  # chain and terms, without terms that move the base
    observations: Observations[Pose]  # N measured poses
    inner_rows: NDArray[np.intp]  # rows of the M poses of the inner level
    r_max_m: float = 1.0  # length that normalises positions

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return the outer parameters, those of the model."""
        return self.model.parameters

    @property
    def weights(self) -> Array:
        """Return the factors of the components [m, rad] in the rows, (6,)."""
        return np.concatenate([np.full(3, 1.0 / self.r_max_m), np.ones(3)])

    @property
    def noise(self) -> float:
        """Return the standard deviation of a row (root mean square) by the poses' covariances."""
        variances = np.diagonal(self.observations.measured.cov, axis1=1, axis2=2)
        return float(np.sqrt(np.mean(variances * self.weights**2)))

    def one_level(self, T_instr_base: Array) -> Problem:
        """Return the problem with six small motions of the base as the last unknowns.

        Args:
            T_instr_base: (4, 4) base frame when these are zero.
        """
        model = Model(self.model.chain, (*self.model.terms, base_frame()))
        none = np.zeros(0)
        return Problem(model, none.astype(np.intp), none, T_instr_base, self.observations)

    def rows(self, x: Array) -> TwoLevelRows:
        """Return residuals and exact derivatives at parameters x (k,), by one inner solve."""
        T_instr_target, inner = self.observations.measured.T_instr_target, self.inner_rows
        predicted = self.model.predict_with_jacobian(self.observations.states, x)
        T_base_ee, jacobian = predicted.T_base_ee, predicted.jacobian
        base = fit_base_frame(
            T_base_ee[inner],
            T_instr_target[inner],
            attitude_weight_m2=self.r_max_m**2,
            jacobian=jacobian[inner],
        )
        assert base.jacobian is not None
        R = base.T_instr_base[:3, :3]
        error = pose_error(base.T_instr_base @ T_base_ee, T_instr_target)
        # R exp([omega]) p + t: the base moves the point by dt + (R omega) x (R p), turns it by R
        # omega.
        p = T_base_ee[:, :3, 3] @ R.T
        by_base = np.zeros((len(p), 6, 6))
        by_base[:, :3, :3] = np.eye(3) / self.r_max_m
        by_base[:, :3, 3:] = np.cross(R.T[None], p[:, None, :]).transpose(0, 2, 1) / self.r_max_m
        by_base[:, 3:, 3:] = error.by_rotation @ R
        total = np.empty_like(jacobian)
        total[:, :3] = (R / self.r_max_m) @ jacobian[:, :3]
        total[:, 3:] = by_base[:, 3:, 3:] @ jacobian[:, 3:]
        total += by_base @ base.jacobian
        residual = np.concatenate([error.position_m / self.r_max_m, error.chord], axis=1)
        return TwoLevelRows(residual, total, by_base, base.T_instr_base, base.jacobian)
