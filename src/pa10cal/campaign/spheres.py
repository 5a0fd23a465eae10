"""Tooling balls as spheres of known radius, and single touches that cannot be on theirs.

Centres are fitted by least squares, all balls at once. A single ball with few touches cannot show
which of them is an outlier (of two opposite ones either may be), nor that one is where it alone
fixes one direction. All touches of a configuration together can: they must lie on balls that sit on
one rigid tool, six unknowns for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Mask
from pa10cal.frame.rigid_fit import fit_rigid

#: Touches within so small a part of the radius (rms) of one plane count as coplanar.
COPLANAR = 0.05
STEP_TOLERANCE_MM = 1e-10
MAX_ITERATIONS = 50
#: The same for the fit of a rigid tool, its damping, and its largest step [mm, rad].
TOOL_ITERATIONS = 30
TOOL_TOLERANCE_MM = 1e-9
DAMPING = 1e-9
LARGEST_STEP = np.array([20.0, 20.0, 20.0, 0.1, 0.1, 0.1])
#: A touch that others leave less than this part of its redundancy cannot be judged.
LEAST_REDUNDANCY = 1e-3


@dataclass(frozen=True)
class Spheres:
    """Spheres through the touches of G balls."""

    centre_mm: Array  # (G, 3) centres
    # (G, T) distance of each touch outside its sphere; 0 where there is no touch
    residual_mm: Array
    # (G, 3, 3) covariance of the centre for touches of unit variance, the inverse of the normal
    # matrix of the touches' normals
    cofactor: Array
    touches: NDArray[np.int64]  # (G,) touches used
    # (G,) whether the touches lie in one plane, so that the centre is not determined
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


@dataclass(frozen=True)
class TouchOutliers:
    """Suspected outliers among the touches of C configurations."""

    touch: Mask  # (C, B, T) single touches that are
    undecided: Mask  # (C,) configurations that do not fit the tool, no one touch being to blame


def find_outliers(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> TouchOutliers:
    """Find touches that do not lie on the balls of a rigid tool, omitting each in turn.

    A configuration is suspect when a touch is further off than `limit_mm`, as judged by the other
    touches. Each of its touches is then omitted in turn: the outlier is the one without which the
    rest fits. When the rest fits without another one too, the better must be better by as many
    sigmas as the limit has, or the configuration is undecided.

    Args:
        p_mm: (C, B, T, 3) touches, padded.
        valid: (C, B, T) which of them are there; every ball must have a determined centre.
        balls_mm: (B, 3) centres in the tool's frame.
        radius_mm: radius of the balls.
        limit_mm: largest departure that noise is allowed.
        sigma_mm: standard uncertainty of one touch.
    """
    C, B, T = valid.shape
    fits, _ = _fits(p_mm, valid, balls_mm, radius_mm, limit_mm, sigma_mm)
    touch = np.zeros(valid.shape, dtype=bool)
    undecided = np.zeros(C, dtype=bool)
    suspects = np.flatnonzero(~fits)
    if not len(suspects):
        return TouchOutliers(touch, undecided)
    owner, out = np.nonzero(valid[suspects].reshape(len(suspects), B * T))
    others = valid[suspects][owner].reshape(-1, B * T)
    others[np.arange(len(owner)), out] = False
    fits, misfit = _fits(
        p_mm[suspects][owner], others.reshape(-1, B, T), balls_mm, radius_mm, limit_mm, sigma_mm
    )
    misfits = np.full((len(suspects), B * T), np.inf)
    misfits[owner[fits], out[fits]] = misfit[fits]
    best = np.argmin(misfits, axis=1)
    ranked = np.sort(misfits, axis=1)
    found = np.isfinite(ranked[:, 0])
    found[found] = (ranked[found, 1] - ranked[found, 0]) > (limit_mm / sigma_mm) ** 2
    undecided[suspects] = ~found
    touch.reshape(C, B * T)[suspects[found], best[found]] = True
    return TouchOutliers(touch, undecided)


def _fits(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> tuple[Mask, Array]:
    """Return (C,) whether every touch fits the tool, and the chi-square of the fit."""
    C, B, T = valid.shape
    spheres = fit_spheres(p_mm.reshape(C * B, T, 3), valid.reshape(C * B, T), radius_mm)
    pose = fit_rigid(balls_mm, spheres.centre_mm.reshape(C, B, 3)).T
    R, origin = pose[:, :3, :3], pose[:, :3, 3]
    weight = valid[..., None].astype(float)
    for _ in range(TOOL_ITERATIONS):
        jacobian, residual = _linearise_tool(p_mm, weight, R, origin, balls_mm, radius_mm)
        transposed = np.swapaxes(jacobian, 1, 2)
        # Far from a fit the normal matrix may be singular and the step wild: damped and bounded.
        cofactor = np.linalg.inv(transposed @ jacobian + DAMPING * np.eye(6))
        step = (cofactor @ (transposed @ residual[..., None]))[..., 0]
        step /= np.maximum(1.0, np.abs(step / LARGEST_STEP).max(axis=1, keepdims=True))
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        origin = origin + step[:, :3]
        if np.abs(step).max() <= TOOL_TOLERANCE_MM:
            break
    jacobian, residual = _linearise_tool(p_mm, weight, R, origin, balls_mm, radius_mm)
    redundancy = 1.0 - np.einsum("cti,cij,ctj->ct", jacobian, cofactor, jacobian)
    judged = valid.reshape(C, B * T) & (redundancy > LEAST_REDUNDANCY)
    departure = np.abs(residual) / np.sqrt(np.where(judged, redundancy, 1.0))
    fits = np.where(judged, departure, 0.0).max(axis=1) <= limit_mm
    return fits, np.square(residual).sum(axis=1) / sigma_mm**2


def _linearise_tool(
    p_mm: Array, weight: Array, R: Array, origin: Array, balls_mm: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return derivative (C, BT, 6) of the reach of (dp, w) along each normal, and residuals."""
    arm = balls_mm @ np.swapaxes(R, 1, 2)
    ray = p_mm - (origin[:, None, :] + arm)[:, :, None, :]
    distance = np.linalg.norm(ray, axis=-1, keepdims=True)
    normal = weight * ray / np.maximum(distance, 1e-12)
    turning = np.cross(np.broadcast_to(arm[:, :, None, :], normal.shape), normal)
    C = len(p_mm)
    residual = (weight * (distance - radius_mm)).reshape(C, -1)
    return np.concatenate([normal, turning], axis=-1).reshape(C, -1, 6), residual
