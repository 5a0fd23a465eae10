"""Rigid motions and spheres fitted to points, and differences of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Mask, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
from pa10cal.rules import FRAMES

#: Gauss-Newton steps, at most; and the step after which a weighted rigid fit ends, relative to the
#: largest coordinate, and a sphere [mm] (computing).
_MOST_STEPS, _LAST_STEP, _LAST_STEP_MM = 50, 1e-13, 1e-10
#: Least distance that is divided by [mm]; least eigenvalue of normal equations; and eigenvalues of
#: a scatter matrix, relative to the largest, that count as zero (computing).
_NO_DISTANCE_MM, _NO_INFORMATION, _FLAT = 1e-12, 1e-12, 1e-4


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
    for _ in range(_MOST_STEPS):
        jacobian = by_small_motion(source @ np.swapaxes(R, -1, -2))
        weighted = np.swapaxes(jacobian, -1, -2) @ information
        residuals = target - _carry(R, p, source)
        normal = (weighted @ jacobian).sum(axis=1)
        step = np.linalg.solve(normal, (weighted @ residuals[..., None]).sum(axis=1))[..., 0]
        p += step[:, :3]
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        scale = np.maximum(1.0, np.abs(target).max(initial=0.0))
        if np.abs(step).max(initial=0.0) <= _LAST_STEP * scale:
            break
    return WeightedRigidFit(T=homogeneous(R, p), covariance=np.linalg.inv(normal))


def pose_by_source(T: Array, target: Array, covariances: Array) -> Array:
    """Return the derivative of the poses (B, 4, 4) of a weighted fit by the source points.

    Args:
        T: of `fit_rigid_weighted` with these targets (B, k, 3) and covariances (B, k, 3, 3).

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
    """Return points (..., k, 3) rotated by R (..., 3, 3), then shifted by p (..., 3)."""
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


@dataclass(frozen=True)
class Spheres:
    """G spheres of known radius, fitted to T points each; places without a point are padded."""

    centre_mm: Array  # (G, 3) centres; without meaning where `coplanar`
    residual_mm: Array  # (G, T) distance of each point outside its sphere; 0 of padding
    cofactor: Array  # (G, 3, 3) covariance of the centre for points of unit variance
    touches: NDArray[np.int64]  # (G,) number of points
    coplanar: Mask  # (G,) whether the points lie in one plane and determine no centre


def fit_spheres(p_mm: Array, valid: Mask, radius_mm: float) -> Spheres:
    """Fit spheres to points (G, T, 3) by least squares; `valid` (G, T) are those not padded.

    Gauss-Newton from the linear fit of a sphere of free radius, which four points not in one plane
    determine: |offset|^2 = 2 offset.c + a constant, with offsets from the mean of the points.
    """
    weight, count = valid.astype(float), valid.sum(axis=1)
    mean_mm = (weight[..., None] * p_mm).sum(axis=1) / np.maximum(count, 1)[:, None]
    offset = weight[..., None] * (p_mm - mean_mm[:, None, :])
    scatter = np.swapaxes(offset, 1, 2) @ offset
    moment = (offset * (offset**2).sum(axis=2)[..., None]).sum(axis=1)
    inverse = np.linalg.pinv(scatter, rcond=_FLAT, hermitian=True)
    centre_mm = mean_mm + 0.5 * (inverse @ moment[..., None])[..., 0]
    square_thickness = np.linalg.eigvalsh(scatter)[:, 0].clip(min=0.0) / np.maximum(count, 1)
    coplanar = np.sqrt(square_thickness) < FRAMES.coplanar * radius_mm
    for _ in range(_MOST_STEPS):
        normals, residual_mm = normals_and_residuals(p_mm, weight, centre_mm, radius_mm)
        downhill = (normals * residual_mm[..., None]).sum(axis=1)
        step_mm = (_cofactor(normals) @ downhill[..., None])[..., 0]
        step_mm[coplanar] = 0.0
        length_mm = np.maximum(np.linalg.norm(step_mm, axis=1, keepdims=True), _NO_DISTANCE_MM)
        centre_mm = centre_mm + step_mm * np.minimum(1.0, radius_mm / length_mm)
        if np.abs(step_mm).max(initial=0.0) <= _LAST_STEP_MM:
            break
    normals, residual_mm = normals_and_residuals(p_mm, weight, centre_mm, radius_mm)
    return Spheres(centre_mm, residual_mm, _cofactor(normals), count, coplanar)


def normals_and_residuals(
    p_mm: Array, weight: Array, centre_mm: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return outward normals (…, T, 3) and distances outside the spheres (…, T) of points.

    Args:
        weight: (…, T) 1 of points, and 0 of padding, of which both results are 0.
        centre_mm: (…, 3) of the spheres.
    """
    ray_mm = p_mm - centre_mm[..., None, :]
    distance_mm = np.linalg.norm(ray_mm, axis=-1)
    normals = weight[..., None] * ray_mm / np.maximum(distance_mm, _NO_DISTANCE_MM)[..., None]
    return normals, weight * (distance_mm - radius_mm)


def _cofactor(normals: Array) -> Array:
    """Return the cofactors (G, 3, 3) of centres by outward normals (G, T, 3); see `Spheres`."""
    normal_matrix = np.swapaxes(normals, 1, 2) @ normals
    # Too few points make it singular; callers look at `touches`.
    return np.asarray(np.linalg.inv(normal_matrix + _NO_INFORMATION * np.eye(3)), dtype=np.float64)
