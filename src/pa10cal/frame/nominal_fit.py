"""Base frame from a rigid fit of the nominal model, for campaigns without straight moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import fit_rigid, fit_rigid_weighted


@dataclass(frozen=True)
class NominalSeed:
    """The base frame in the instrument's frame, from positions of the nominal model."""

    T_instr_base: Array  # (4, 4) instrument from base [m]
    # (3,) standard uncertainty of the directions of x, y and z, per axis across each, taking the
    # residuals as independent
    axis_u_rad: Array
    residual_rms_m: float  # root mean square distance of measured from modelled positions
    poses: int  # poses fitted


def seed_from_nominal(p_instr_m: Array, p_base_m: Array) -> NominalSeed:
    """Fit the base frame to measured positions and those of the nominal model.

    Args:
        p_instr_m: (P, 3) measured positions of the end-effector, P >= 3.
        p_base_m: (P, 3) the nominal model's positions in the base frame.

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
    turning = fit_rigid_weighted(p_base_m, p_instr_m[None], points).covariance[0, 3:, 3:]
    axes = fit.T[:3, :3]
    along = np.einsum("ik,ij,jk->k", axes, turning, axes)
    across = (np.trace(turning) - along) / 2.0
    return NominalSeed(fit.T, np.sqrt(across), float(fit.rms), count)
