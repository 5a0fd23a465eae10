"""Stray touches, found against the rigid tool that carries the balls.

A single ball with few touches cannot tell which of them is astray (of two opposite ones either may
be), nor see a stray that alone fixes one direction. All touches of a configuration together can:
they must lie on balls that sit on one rigid tool, six unknowns for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.spheres import fit_spheres
from pa10cal.frame.rigid_fit import fit_rigid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_ITERATIONS = 30
STEP_TOLERANCE_MM = 1e-9
DAMPING = 1e-9
#: Largest step of position [mm] and attitude [rad].
LARGEST_STEP = np.array([20.0, 20.0, 20.0, 0.1, 0.1, 0.1])
#: A touch that others leave less than this part of its freedom cannot be judged.
LEAST_FREEDOM = 1e-3


@dataclass(frozen=True)
class Strays:
    """What was found astray in C configurations.

    Attributes:
        touch: (C, B, T) single touches found astray.
        undecided: (C,) configurations that do not fit the tool, no one touch being to blame.
    """

    touch: Mask
    undecided: Mask


def find_strays(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> Strays:
    """Find touches that do not lie on the balls of a rigid tool (leave one out).

    A configuration is suspect when a touch is further off than `limit_mm`, as judged by the other
    touches. Each of its touches is then left out in turn: the stray is the one without which the
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
        return Strays(touch, undecided)
    owner, out = np.nonzero(valid[suspects].reshape(len(suspects), B * T))
    left = valid[suspects][owner].reshape(-1, B * T)
    left[np.arange(len(owner)), out] = False
    fits, misfit = _fits(
        p_mm[suspects][owner], left.reshape(-1, B, T), balls_mm, radius_mm, limit_mm, sigma_mm
    )
    misfits = np.full((len(suspects), B * T), np.inf)
    misfits[owner[fits], out[fits]] = misfit[fits]
    best = np.argmin(misfits, axis=1)
    ranked = np.sort(misfits, axis=1)
    found = np.isfinite(ranked[:, 0])
    found[found] = (ranked[found, 1] - ranked[found, 0]) > (limit_mm / sigma_mm) ** 2
    undecided[suspects] = ~found
    touch.reshape(C, B * T)[suspects[found], best[found]] = True
    return Strays(touch, undecided)


def _fits(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> tuple[Mask, Array]:
    """Return (C,) whether every touch fits the tool, and the chi-square of the fit."""
    C, B, T = valid.shape
    spheres = fit_spheres(p_mm.reshape(C * B, T, 3), valid.reshape(C * B, T), radius_mm)
    pose = fit_rigid(balls_mm, spheres.centre_mm.reshape(C, B, 3)).T
    R, origin = pose[:, :3, :3], pose[:, :3, 3]
    weight = valid[..., None].astype(float)
    for _ in range(MAX_ITERATIONS):
        jacobian, residual = _linearise(p_mm, weight, R, origin, balls_mm, radius_mm)
        transposed = np.swapaxes(jacobian, 1, 2)
        # Far from a fit the normal matrix may be singular and the step wild: damped and bounded.
        cofactor = np.linalg.inv(transposed @ jacobian + DAMPING * np.eye(6))
        step = (cofactor @ (transposed @ residual[..., None]))[..., 0]
        step /= np.maximum(1.0, np.abs(step / LARGEST_STEP).max(axis=1, keepdims=True))
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        origin = origin + step[:, :3]
        if np.abs(step).max() <= STEP_TOLERANCE_MM:
            break
    jacobian, residual = _linearise(p_mm, weight, R, origin, balls_mm, radius_mm)
    freedom = 1.0 - np.einsum("cti,cij,ctj->ct", jacobian, cofactor, jacobian)
    judged = valid.reshape(C, B * T) & (freedom > LEAST_FREEDOM)
    departure = np.abs(residual) / np.sqrt(np.where(judged, freedom, 1.0))
    fits = np.where(judged, departure, 0.0).max(axis=1) <= limit_mm
    return fits, np.square(residual).sum(axis=1) / sigma_mm**2


def _linearise(
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
