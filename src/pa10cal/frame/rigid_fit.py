"""Differences of poses, and rigid fits of points: in closed form, and weighted by covariances.

Then what such fits are used for: base and targets as found, and the unit of what was measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
from pa10cal.frame.target_problem import NO_COLUMN
from pa10cal.rules import FRAMES

#: The weighted fit stops when no component moves further than this (lengths and radians), or after
#: this many steps (computing).
STEP_TOLERANCE, MAX_ITERATIONS = 1e-13, 50


@dataclass(frozen=True)
class PoseError:
    """Difference of predicted and measured poses, along the measuring frame's axes.

    Orientations are compared by the chord: twice the vector part of the quaternion of the
    difference, of length 2 sin(angle / 2). It is smooth, differs from the angle by angle^3 / 24,
    and orthogonal Procrustes minimises its sum of squares in closed form.
    """

    position_m: Array  # (P, 3) predicted minus measured
    chord: Array  # (P, 3) orientation difference: axis times 2 sin(angle / 2)
    by_rotation: Array  # (P, 3, 3) derivative of `chord` by a small left rotation of the prediction


def pose_error(T_predicted: Array, T_measured: Array) -> PoseError:
    """Compare poses (P, 4, 4) given in the same frame."""
    difference = T_predicted[:, :3, :3] @ T_measured[:, :3, :3].transpose(0, 2, 1)
    quaternion = Rotation.from_matrix(difference, assume_valid=True).as_quat(canonical=True)
    vector, scalar = quaternion[:, :3], quaternion[:, 3]
    by_rotation = scalar[:, None, None] * np.eye(3) - cross_matrix(vector)
    return PoseError(T_predicted[:, :3, 3] - T_measured[:, :3, 3], 2.0 * vector, by_rotation)


def cross_matrix(vector: Array) -> Array:
    """Return the matrices [v]x (..., 3, 3) with [v]x u = v × u."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix


def by_small_motion(arms: Array) -> Array:
    """Return the derivative (..., 3, 6) of points by a shift and a small turn of their body.

    Args:
        arms: (..., 3) vectors from the centre of the turn to the points.
    """
    by_motion = np.zeros((*arms.shape, 6))
    x, y, z = arms[..., 0], arms[..., 1], arms[..., 2]
    for axis in range(3):
        by_motion[..., axis, axis] = 1.0
    by_motion[..., 0, 4], by_motion[..., 0, 5] = z, -y
    by_motion[..., 1, 3], by_motion[..., 1, 5] = -z, x
    by_motion[..., 2, 3], by_motion[..., 2, 4] = y, -x
    return by_motion


@dataclass(frozen=True)
class RigidFit:
    """The rigid motion that carries points of a source frame onto points of a target frame."""

    T: Array  # (..., 4, 4) target from source, in the points' length unit
    rms: Array  # (...) root mean square distance of target from carried source points


@dataclass(frozen=True)
class WeightedRigidFit:
    """A rigid motion fitted to points with full covariances.

    The covariance is that of dp (position of the source's origin) and w (a small rotation applied
    on the left), both along the target's axes: the true pose is [exp(w) R, p + dp]. The rotation
    turns about the source's own origin, so dp is the error of that origin and of nothing else,
    however far it lies from the points.
    """

    T: Array  # (B, 4, 4) target from source, in the points' length unit
    covariance: Array  # (B, 6, 6) of (dp, w) [length², length rad, rad²]


def fit_rigid(source: Array, target: Array) -> RigidFit:
    """Fit a rotation, never a reflection, and a translation by least squares (singular values).

    Points (..., k, 3) in either frame; leading dimensions broadcast.

    Raises:
        CalibrationError: when either set lies on one line or in one point.
    """
    source, target = np.broadcast_arrays(
        np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    )
    source_mean, target_mean = source.mean(axis=-2), target.mean(axis=-2)
    source_off = source - source_mean[..., None, :]
    target_off = target - target_mean[..., None, :]
    _refuse_lines(source_off, "source points")
    _refuse_lines(target_off, "target points")
    R = nearest_rotation(np.swapaxes(target_off, -1, -2) @ source_off)
    p = target_mean - (R @ source_mean[..., None])[..., 0]
    square = ((target - _carry(R, p, source)) ** 2).sum(axis=-1)
    return RigidFit(homogeneous(R, p), np.sqrt(square.mean(axis=-1)))


def fit_rigid_weighted(source: Array, target: Array, covariances: Array) -> WeightedRigidFit:
    """Fit poses to points with a covariance each (Gauss-Newton).

    Args:
        source: (k, 3) or (B, k, 3) points in the source frame, k >= 3, taken as exact.
        target: (B, k, 3) the same points measured in the target frame.
        covariances: (B, k, 3, 3) covariance of every measured point.

    Returns:
        Poses that minimise the covariance-weighted residuals, with their covariances.

    Raises:
        CalibrationError: when the points lie on one line or in one point.
    """
    source = np.broadcast_to(source, target.shape)
    T = fit_rigid(source, target).T
    R, p = T[:, :3, :3].copy(), T[:, :3, 3].copy()
    information = np.linalg.inv(covariances)
    for _ in range(MAX_ITERATIONS):
        jacobian = by_small_motion(source @ np.swapaxes(R, -1, -2))
        weighted = np.swapaxes(jacobian, -1, -2) @ information
        residuals = target - _carry(R, p, source)
        normal = (weighted @ jacobian).sum(axis=1)
        step = np.linalg.solve(normal, (weighted @ residuals[..., None]).sum(axis=1))[..., 0]
        p += step[:, :3]
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        scale = np.maximum(1.0, np.abs(target).max(initial=0.0))
        if np.abs(step).max(initial=0.0) <= STEP_TOLERANCE * scale:
            break
    return WeightedRigidFit(T=homogeneous(R, p), covariance=np.linalg.inv(normal))


def pose_by_source(T: Array, target: Array, covariances: Array) -> Array:
    """Return the derivative of the poses (B, 4, 4) of a weighted fit by the source points.

    Returns:
        (B, 6, 3 k) derivative of (dp, w), see `WeightedRigidFit`, by the coordinates of the source
        points, point by point.
    """
    R, p = T[:, :3, :3], T[:, :3, 3]
    source = (target - p[:, None, :]) @ R
    jacobian = by_small_motion(source @ np.swapaxes(R, -1, -2))
    weighted = np.swapaxes(jacobian, -1, -2) @ np.linalg.inv(covariances)
    normal = (weighted @ jacobian).sum(axis=1)
    by_point = -np.linalg.solve(normal[:, None], weighted @ R[:, None])
    by_source: Array = np.concatenate(list(np.moveaxis(by_point, 1, 0)), axis=-1)
    return by_source


def _carry(R: Array, p: Array, points: Array) -> Array:
    return points @ np.swapaxes(R, -1, -2) + p[..., None, :]


def _refuse_lines(offsets: Array, where: str) -> None:
    """Refuse point sets about their mean (..., k, 3) that do not span a plane."""
    spread = np.linalg.svd(offsets, compute_uv=False)
    spread = np.concatenate([spread, np.zeros((*spread.shape[:-1], 2))], axis=-1)
    thin = spread[..., 1] <= FRAMES.in_line * spread[..., 0]
    if np.any(thin):
        rank = int(np.any(spread[thin][0] > 0.0))
        raise CalibrationError(
            f"a rigid fit needs points that span a plane; these are of rank {rank}",
            where=where,
            value=[float(f"{value:.3g}") for value in spread[thin][0][:2]],
            allowed="at least three points that are not collinear",
            remedy="measure points further apart across the line",
        )


# Base frame and targets as they were found with the nominal arm.


@dataclass(frozen=True)
class Located:
    """Base frame and targets, found with the nominal arm."""

    T_instr_base: Array  # (4, 4) base in the instrument's frame [m]
    scatter_m: float  # root mean square of the residuals, positions or distances
    poses: int  # number of poses that were fitted
    # (3,) standard uncertainty of the direction of each axis of the base, per direction across it,
    # for independent residuals; None where the instrument measures distances alone
    axis_u_rad: Array | None = None
    # root mean square angle between measured and modelled orientations; None where none is measured
    scatter_rad: float | None = None
    # (4, 4) the one target whose orientation is measured; None where it is the end-effector itself,
    # or there is none
    T_ee_target: Array | None = None
    # (B, 3) places of targets, in the order of their names
    p_ee_targets_m: Array | None = None
    # (4, 4) `T_ee_target` of each campaign of a group, by its name
    T_ee_target_of: Mapping[str, Array] = field(default_factory=dict)
    # directions of the targets that the poses do not identify, held as stated
    held: tuple[str, ...] | None = None
    # whether the places of the targets are stated; None where it does not matter
    stated: bool | None = None

    @property
    def misfit_m(self) -> float:
        """Return the rms misfit, orientations by the lengths that they make at `FRAMES.lever_m`."""
        return float(np.hypot(self.scatter_m, FRAMES.lever_m * (self.scatter_rad or 0.0)))

    @property
    def T_ee_targets(self) -> Array:
        """Return the targets in the end-effector frame, (B, 4, 4) [m], without turns if unknown."""
        if self.T_ee_target is not None:
            return self.T_ee_target[None]
        places_m = np.zeros((0, 3)) if self.p_ee_targets_m is None else self.p_ee_targets_m
        return homogeneous(np.eye(3), places_m)

    def targets(self, T_base_ee: Array) -> Array:
        """Return the targets in the instrument's frame, (P, B, 4, 4) [m]."""
        return np.asarray(self.T_instr_base @ T_base_ee[:, None] @ self.T_ee_targets)


def seed_from_nominal(p_instr_m: Array, p_base_m: Array) -> Located:
    """Fit the base frame to measured positions (P, 3), by those of the nominal model.

    For campaigns without straight moves.

    Args:
        p_base_m: (P, 3) positions of the nominal model in the base frame.

    Raises:
        CalibrationError: with fewer than three poses, or when the positions lie on one line.
    """
    count = len(p_instr_m)
    if count < 3:
        raise CalibrationError(
            "too few poses to fit a base frame to",
            where="unloaded poses",
            value=count,
            allowed="at least 3",
            remedy="measure more unloaded grid poses, or straight moves",
        )
    fit = fit_rigid(p_base_m, p_instr_m)
    variance = float(fit.rms) ** 2 * count / (3 * count - 6)
    # The covariance scales with the variance; a floor keeps it invertible when the fit is exact.
    scale = max(variance, np.finfo(float).tiny ** 0.5)
    points = np.broadcast_to(scale * np.eye(3), (1, count, 3, 3))
    of_turn = fit_rigid_weighted(p_base_m, p_instr_m[None], points).covariance[0, 3:, 3:]
    axes = fit.T[:3, :3]
    about_axis = np.einsum("ik,ij,jk->k", axes, of_turn, axes)
    across = (np.trace(of_turn) - about_axis) / 2.0
    return Located(fit.T, float(fit.rms), count, np.sqrt(across))


# The unit of what was measured: how far the nominal model moves for one measured unit.
#
# The place of the target on the end-effector and that of the instrument are not known. They enter
# linearly, by columns of the nominal model's position and orientation; what these columns do not
# explain of the model's motion is proportional to what they do not explain of the measured one.


def scale_of_points(p_m: Array, T_base_ee: Array) -> float | None:
    """Return the motion of the nominal model [m] for a unit of measured positions (N, 3).

    It is 1 where positions are in metres, as the model's poses (N, 4, 4) are. None where the rows
    do not determine the scale, such as positions along one line.
    """
    if len(p_m) < FRAMES.scale_rows:
        return None
    extent_m = np.linalg.svd(p_m - p_m.mean(axis=0), compute_uv=False)
    if extent_m[1] < FRAMES.least_breadth * extent_m[0]:
        return None
    # x = S p + s - R u, linear in the general matrix S, in s and in the target's place u.
    of_S = np.kron((p_m - p_m.mean(axis=0))[:, None, :], np.eye(3)).reshape(-1, 9)
    others = np.concatenate([np.tile(np.eye(3), (len(p_m), 1, 1)), T_base_ee[:, :3, :3]], axis=2)
    partial = _partial_regression(T_base_ee[:, :3, 3].ravel(), of_S, others.reshape(-1, 6))
    if partial is None or partial.rms < FRAMES.least_motion_m:
        return None
    # The second singular value: of positions in one plane the third one is zero.
    return float(np.linalg.svd(partial.coefficients.reshape(3, 3), compute_uv=False)[1])


def scale_of_distances(d_m: Array, T_base_ee: Array) -> float | None:
    """Return the motion of the nominal model [m] for a unit of measured distances (N,).

    See `scale_of_points`; the distances are those of one target from a fixed point.
    """
    if len(d_m) < FRAMES.scale_rows:
        return None
    # |x|^2 = k^2 d^2 + 2 x.c - |c|^2 for a target at the origin, and with its products elsewhere.
    x, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    others = [x, np.ones((len(x), 1))]
    if len(d_m) >= FRAMES.rows_for_target:
        others += [np.einsum("pji,pj->pi", R, x), R.reshape(-1, 9)]
    partial = _partial_regression((x**2).sum(axis=1), d_m[:, None] ** 2, np.hstack(others))
    if partial is None or partial.rms < FRAMES.least_motion_m**2:
        return None
    square = partial.coefficients[0]
    return None if square <= 0.0 else float(np.sqrt(square))


class _Partial(NamedTuple):
    """A regression of values on some columns, both without what other columns explain."""

    coefficients: Array
    rms: float  # of the values without what the other columns explain


def _partial_regression(values: Array, columns: Array, others: Array) -> _Partial | None:
    """Return a partial regression; None where the columns do not explain nearly all of the rest."""
    together = np.column_stack([values, columns])
    together = together - others @ np.linalg.lstsq(others, together, rcond=NO_COLUMN)[0]
    rest, rest_columns = together[:, 0], together[:, 1:]
    solved = np.linalg.lstsq(rest_columns, rest, rcond=NO_COLUMN)[0]
    coefficients = np.asarray(solved, dtype=float)
    residual = rest - rest_columns @ coefficients
    if residual @ residual > (1.0 - FRAMES.explained_share) * (rest @ rest):
        return None
    return _Partial(coefficients, float(np.sqrt(np.mean(rest**2))))
