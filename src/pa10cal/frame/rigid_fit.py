"""Differences of poses, and rigid fits of points: in closed form, and weighted by covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
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
