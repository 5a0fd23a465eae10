"""Ball centres by least-squares spheres of known radius, all balls at once."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Touches within so small a part of the radius (rms) of one plane count as coplanar.
COPLANAR = 0.05
STEP_TOLERANCE_MM = 1e-10
MAX_ITERATIONS = 50


@dataclass(frozen=True)
class Spheres:
    """Spheres through the touches of G balls.

    Attributes:
        centre_mm: (G, 3) centres.
        residual_mm: (G, T) distance of each touch outside its sphere; 0 where there is no touch.
        cofactor: (G, 3, 3) covariance of the centre for touches of unit variance, the inverse of
            the normal matrix of the touches' normals.
        touches: (G,) touches used.
        coplanar: (G,) whether the touches lie in one plane, so that the centre is not determined.
    """

    centre_mm: Array
    residual_mm: Array
    cofactor: Array
    touches: NDArray[np.int64]
    coplanar: Mask

    def take(self, balls: Mask) -> Spheres:
        """Return some of the balls."""
        return Spheres(*(getattr(self, field.name)[balls] for field in fields(self)))


def fit_spheres(p_mm: Array, valid: Mask, radius_mm: float) -> Spheres:
    """Fit spheres of known radius by least squares of the touches' distances (Gauss-Newton).

    The start is the linear fit of a sphere of free radius, which four touches not in one plane
    determine.

    Args:
        p_mm: (G, T, 3) touches, padded.
        valid: (G, T) which of them are there.
        radius_mm: radius of the balls.

    Returns:
        Centres and residuals. Where `coplanar`, they are of no use.
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
    return Spheres(
        centre_mm=centre,
        residual_mm=residual,
        cofactor=cofactor,
        touches=count,
        coplanar=coplanar,
    )


def touch_sigma_mm(spheres: Spheres, centre_uncertainty_mm: float) -> float:
    """Return the standard uncertainty of one touch that an instrument's statement implies.

    The instrument states u, the standard uncertainty of one measured centre along an axis. Touches
    of sigma s give a centre the covariance s² times its cofactor; s is chosen so that the variance
    of the median ball, averaged over the axes, is u². A ball with fewer touches than the others, or
    with touches on one side, is thus less certain than the statement, one with more is more so.
    """
    variance = np.median(np.trace(spheres.cofactor, axis1=1, axis2=2)) / 3.0
    return float(centre_uncertainty_mm / np.sqrt(variance))


def pooled_touch_sigma_mm(spheres: Spheres) -> float:
    """Return the standard deviation of one touch from all residuals; nan without redundancy.

    It holds the probing noise alone; what the instrument states also covers errors that all touches
    on a ball share. Hence it is compared with the statement and does not replace it.
    """
    dof = int((spheres.touches - 3).clip(min=0).sum())
    return float(np.sqrt((spheres.residual_mm**2).sum() / dof)) if dof else float("nan")


def _linearise(
    p_mm: Array, weight: Array, centre: Array, radius_mm: float
) -> tuple[Array, Array, Array]:
    """Return outward normals, residuals (both 0 where there is no touch) and the cofactor."""
    ray = p_mm - centre[:, None, :]
    distance = np.linalg.norm(ray, axis=2)
    normals = weight[..., None] * ray / np.maximum(distance, 1e-12)[..., None]
    residual = weight * (distance - radius_mm)
    normal_matrix = np.swapaxes(normals, 1, 2) @ normals
    # A touch too few or a plane makes it singular; such balls are refused by count and plane.
    return normals, residual, np.linalg.inv(normal_matrix + 1e-12 * np.eye(3))
