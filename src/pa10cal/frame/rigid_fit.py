"""Rigid fits of points to points: closed form, and weighted by the points' covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError

#: A set thinner than this part of its length counts as lying on one line.
RANK_TOLERANCE = 1e-6
#: The weighted fit stops when no component moves further than this (lengths and radians).
STEP_TOLERANCE = 1e-13
MAX_ITERATIONS = 50


@dataclass(frozen=True)
class RigidFit:
    """The rigid motion that carries points of a source frame onto points of a target frame."""

    T: Array  # (..., 4, 4) target from source, in the points' length unit
    residuals: Array  # (..., k, 3) target point minus carried source point
    rms: Array  # (...) root mean square distance, weighted as the fit was


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
    chi_square: Array  # (B,) weighted sum of squared residuals
    residuals: Array  # (B, k, 3) target point minus carried source point


def fit_rigid(source: Array, target: Array, weights: Array | None = None) -> RigidFit:
    """Fit a rotation and a translation by least squares (singular value decomposition).

    Args:
        source: (..., k, 3) points in the source frame; leading dimensions broadcast.
        target: (..., k, 3) the same points in the target frame.
        weights: (..., k) non-negative weights of the squared distances; None for equal ones.

    Returns:
        The proper rotation (never a reflection) and translation of least weighted distance.

    Raises:
        CalibrationError: when either set lies on one line or in one point.
    """
    source, target = np.broadcast_arrays(
        np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    )
    w = np.ones(source.shape[:-1]) if weights is None else np.asarray(weights, dtype=float)
    w = np.broadcast_to(w, source.shape[:-1])[..., None]
    total = w.sum(axis=-2)
    source_mean = (w * source).sum(axis=-2) / total
    target_mean = (w * target).sum(axis=-2) / total
    source_off = source - source_mean[..., None, :]
    target_off = target - target_mean[..., None, :]
    _refuse_lines(np.sqrt(w) * source_off, "source points")
    _refuse_lines(np.sqrt(w) * target_off, "target points")
    U, _, Vt = np.linalg.svd(np.swapaxes(target_off, -1, -2) @ (w * source_off))
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    R = U @ Vt
    p = target_mean - (R @ source_mean[..., None])[..., 0]
    residuals = target - _carry(R, p, source)
    square = (w[..., 0] * (residuals**2).sum(axis=-1)).sum(axis=-1)
    return RigidFit(_homogeneous(R, p), residuals, np.sqrt(square / total[..., 0]))


def fit_rigid_weighted(source: Array, target: Array, covariances: Array) -> WeightedRigidFit:
    """Fit poses to points that are uncertain each in its own way (Gauss-Newton).

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
        jacobian = _jacobian(R, source)
        weighted = np.swapaxes(jacobian, -1, -2) @ information
        residuals = target - _carry(R, p, source)
        normal = (weighted @ jacobian).sum(axis=1)
        step = np.linalg.solve(normal, (weighted @ residuals[..., None]).sum(axis=1))[..., 0]
        p += step[:, :3]
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        scale = np.maximum(1.0, np.abs(target).max(initial=0.0))
        if np.abs(step).max(initial=0.0) <= STEP_TOLERANCE * scale:
            break
    residuals = target - _carry(R, p, source)
    chi_square = np.einsum("bki,bkij,bkj->b", residuals, information, residuals)
    return WeightedRigidFit(
        T=_homogeneous(R, p),
        covariance=np.linalg.inv(normal),
        chi_square=chi_square,
        residuals=residuals,
    )


def pose_by_source(T: Array, target: Array, covariances: Array) -> Array:
    """Return how a weighted fit's pose answers to errors in the source points.

    Args:
        T: (B, 4, 4) fitted poses.
        target: (B, k, 3) measured points.
        covariances: (B, k, 3, 3) covariance of every measured point.

    Returns:
        (B, 6, 3 k) derivative of (dp, w) by the coordinates of the source points, along the source
        frame's axes, point by point.
    """
    R, p = T[:, :3, :3], T[:, :3, 3]
    source = (target - p[:, None, :]) @ R
    jacobian = _jacobian(R, source)
    weighted = np.swapaxes(jacobian, -1, -2) @ np.linalg.inv(covariances)
    normal = (weighted @ jacobian).sum(axis=1)
    pulled = -np.linalg.solve(normal[:, None], weighted @ R[:, None])
    by_source: Array = np.concatenate(list(np.moveaxis(pulled, 1, 0)), axis=-1)
    return by_source


def _carry(R: Array, p: Array, points: Array) -> Array:
    return points @ np.swapaxes(R, -1, -2) + p[..., None, :]


def _jacobian(R: Array, source: Array) -> Array:
    """Return d(carried point) / d(dp, w), (B, k, 3, 6): dp + w x (R source)."""
    x, y, z = np.moveaxis(source @ np.swapaxes(R, -1, -2), -1, 0)
    jacobian = np.zeros((*source.shape, 6))
    jacobian[..., range(3), range(3)] = 1.0
    jacobian[..., 0, 4], jacobian[..., 0, 5] = z, -y
    jacobian[..., 1, 3], jacobian[..., 1, 5] = -z, x
    jacobian[..., 2, 3], jacobian[..., 2, 4] = y, -x
    return jacobian


def _homogeneous(R: Array, p: Array) -> Array:
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def _refuse_lines(offsets: Array, where: str) -> None:
    """Refuse point sets about their mean (..., k, 3) that do not span a plane."""
    spread = np.linalg.svd(offsets, compute_uv=False)
    spread = np.concatenate([spread, np.zeros((*spread.shape[:-1], 2))], axis=-1)
    thin = spread[..., 1] <= RANK_TOLERANCE * spread[..., 0]
    if np.any(thin):
        rank = int(np.any(spread[thin][0] > 0.0))
        raise CalibrationError(
            f"a rigid fit needs points that span a plane; these are of rank {rank}",
            where=where,
            value=[float(f"{value:.3g}") for value in spread[thin][0][:2]],
            allowed="at least three points that are not collinear",
            remedy="measure points further apart across the line",
        )
