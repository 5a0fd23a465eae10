"""Spheres of known radius through points, fitted by least squares, many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Mask

#: Points within this part of the radius (rms) of one plane count as coplanar.
COPLANAR = 0.05
#: Gauss-Newton ends where no step is longer [mm], or after so many steps.
STEP_TOLERANCE_MM, MAX_ITERATIONS = 1e-10, 50


@dataclass(frozen=True)
class Spheres:
    """G spheres fitted to T touched points each, fewer padded."""

    centre_mm: Array  # (G, 3) centres
    residual_mm: Array  # (G, T) distance of each point outside its sphere; 0 of padding
    # (G, 3, 3) inverse of the normal matrix: covariance of the centre for points of unit variance
    cofactor: Array
    touches: NDArray[np.int64]  # (G,) number of points
    coplanar: Mask  # (G,) whether the points lie in one plane and determine no centre


def fit_spheres(p_mm: Array, valid: Mask, radius_mm: float) -> Spheres:
    """Fit spheres of known radius to points (G, T, 3), padded, by least squares (Gauss-Newton).

    It starts from the linear fit of a sphere of free radius, which four points not in one plane
    determine. Where `coplanar`, centres and residuals have no meaning.
    """
    weight = valid.astype(float)
    count = valid.sum(axis=1)
    mean = (weight[..., None] * p_mm).sum(axis=1) / np.maximum(count, 1)[:, None]
    offset = weight[..., None] * (p_mm - mean[:, None, :])
    scatter = np.swapaxes(offset, 1, 2) @ offset
    square = (offset**2).sum(axis=2)
    moment = (offset * square[..., None]).sum(axis=1)
    thickness = np.sqrt(np.linalg.eigvalsh(scatter)[:, 0].clip(min=0.0) / np.maximum(count, 1))
    inverse = np.linalg.pinv(scatter, rcond=1e-4, hermitian=True)
    centre = mean + 0.5 * (inverse @ moment[..., None])[..., 0]
    coplanar = thickness < COPLANAR * radius_mm
    for _ in range(MAX_ITERATIONS):
        normals, residual, cofactor = _linearise(p_mm, weight, centre, radius_mm)
        step = (cofactor @ (normals * residual[..., None]).sum(axis=1)[..., None])[..., 0]
        step[coplanar] = 0.0
        length = np.linalg.norm(step, axis=1, keepdims=True)
        centre = centre + step * np.minimum(1.0, radius_mm / np.maximum(length, 1e-12))
        if np.abs(step).max(initial=0.0) <= STEP_TOLERANCE_MM:
            break
    _, residual, cofactor = _linearise(p_mm, weight, centre, radius_mm)
    return Spheres(centre, residual, cofactor, count, coplanar)


def normals_and_residuals(
    p_mm: Array, weight: Array, centre: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return outward normals (…, T, 3) and residuals (…, T) of points; both 0 of padding."""
    ray = p_mm - centre[..., None, :]
    distance = np.linalg.norm(ray, axis=-1)
    normals = weight[..., None] * ray / np.maximum(distance, 1e-12)[..., None]
    return normals, weight * (distance - radius_mm)


def _linearise(
    p_mm: Array, weight: Array, centre: Array, radius_mm: float
) -> tuple[Array, Array, Array]:
    """Return outward normals, residuals and the cofactor of each centre; see `Spheres`."""
    normals, residual = normals_and_residuals(p_mm, weight, centre, radius_mm)
    normal_matrix = np.swapaxes(normals, 1, 2) @ normals
    # Too few points, or points in a plane, make it singular; callers look at count and `coplanar`.
    inverse = np.linalg.inv(normal_matrix + 1e-12 * np.eye(3))
    return normals, residual, np.asarray(inverse, dtype=np.float64)
