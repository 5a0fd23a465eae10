"""Residuals of measured poses, expressed as errors of the joints.

A picture of where to look, not a test: a joint that does not err takes part of what another does,
wherever a pose has fewer or hardly more readings than joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain

Array = NDArray[np.float64]

#: Joint error thought possible, a standard deviation [rad or m]: decides what poses leave open.
_POSSIBLE = 1e-3
#: Part of the residuals that joints need not explain; small, or their errors would come out short.
_NOISE_SHARE = 0.1
#: Fewer points than this have no mean worth drawing.
_LEAST_IN_BIN = 5


@dataclass(frozen=True)
class PoseResiduals:
    """Residuals of P poses about a model.

    Attributes:
        q: (P, n) joint positions [rad, m].
        position_mm: (P, 3) predicted less measured, along the axes of the base.
        rotation_deg: (P, 3) axis times angle, along the axes of the base; None where no attitude
            was seen.
    """

    q: Array
    position_mm: Array
    rotation_deg: Array | None


def joint_errors(chain: Chain, left: PoseResiduals, p_ee_target_m: Array) -> Array:
    """Return by how much further joints stand than the model says, (P, n) [rad, m].

    Least squares over the readings of a pose, position and attitude weighed by what is left of
    each, and every joint's error by what is possible.

    Args:
        chain: of the nominal arm, which is near enough for this.
        left: what the model leaves.
        p_ee_target_m: (3,) place of what was measured, in the end-effector frame.
    """
    end = chain.forward_with_screws(left.q)
    screws = end.screws[:, :, chain.joint_columns]
    arm_m = end.T[:, :3, :3] @ p_ee_target_m
    along: Array = screws[:, :3] + np.cross(screws[:, 3:], arm_m[:, :, None], axis=1)
    rows, off = _weighed(along, -1e-3 * left.position_mm)
    if left.rotation_deg is not None:
        turned, more = _weighed(screws[:, 3:], -np.radians(left.rotation_deg))
        rows, off = np.concatenate([rows, turned], axis=1), np.concatenate([off, more], axis=1)
    across = rows.transpose(0, 2, 1)
    normal = across @ rows + np.eye(rows.shape[2]) / _POSSIBLE**2
    return np.asarray(np.linalg.solve(normal, across @ off[:, :, None])[:, :, 0])


def _weighed(rows: Array, off: Array) -> tuple[Array, Array]:
    """Return rows (P, 3, n) and what is off (P, 3) over what passes for noise."""
    size = _NOISE_SHARE * float(np.sqrt(np.mean(off**2)))
    return (rows / size, off / size) if size > 0.0 else (rows, off)


def running_mean(x: Array, y: Array, width: float) -> tuple[Array, Array]:
    """Return the middles (B,) of bins, and the mean of each: nan where it holds hardly a point."""
    bins = np.floor((x - x.min()) / width).astype(np.intp)
    count = np.bincount(bins)
    mean = np.bincount(bins, y) / np.maximum(count, 1)
    middle = x.min() + width * (np.arange(len(count)) + 0.5)
    return middle, np.where(count >= _LEAST_IN_BIN, mean, np.nan)
