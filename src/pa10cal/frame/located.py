"""Base frame and targets as they were found with the nominal arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import fit_rigid, fit_rigid_weighted
from pa10cal.rules import FRAMES


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
