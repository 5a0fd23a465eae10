"""Single positions that cannot be of their pose: against reach, repeats and the nominal model."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import fit_rigid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Distances that are always allowed from repeats and from the nominal model, in robust sigmas and
#: typical residuals too; gross errors are sought here, not bad readings.
REPEATS_MM = 10.0
MODEL_MM = 100.0
ROBUST_SIGMAS = 10.0
#: Repeats of which a median tells the one that is off, and positions that tell a frame.
LEAST_REPEATS = 3
LEAST_POSITIONS = 6
#: Reweighted fits towards least distances, and the distance below which all weigh alike.
FITS = 30
ALIKE_MM = 1.0

OUT_OF_REACH = "further from the other positions than the arm reaches"
OFF_REPEATS = "far from the other readings of this pose and load"
OFF_MODEL = "far from where the joint angles put the end-effector"


def out_of_reach(p_mm: Array, arm: Arm) -> Mask:
    """Return positions (N, 3) further from their median than the arm's span; none if most are."""
    if not len(p_mm):
        return np.zeros(0, dtype=bool)
    span_mm = 2e3 * float(np.hypot(arm.a_m, arm.d_m).sum())
    far = np.linalg.norm(p_mm - np.median(p_mm, axis=0), axis=1) > span_mm
    return np.asarray(far & (2 * far.sum() < len(far)))


def off_repeats(p_mm: Array, pose: NDArray[np.str_], load_N: Array) -> Mask:
    """Return readings far from the median of their pose and load, where there are enough.

    Args:
        p_mm: (N, 3) positions.
        pose: (N,) labels.
        load_N: (N,) loads.
    """
    groups = pd.DataFrame(p_mm).groupby([pose, load_N])
    distance = np.linalg.norm(p_mm - groups.transform("median").to_numpy(), axis=1)
    judged = groups[0].transform("size").to_numpy() >= LEAST_REPEATS
    if not judged.any():
        return judged
    sigma_mm = 1.4826 * float(np.median(distance[judged]))
    return np.asarray(judged & (distance > max(REPEATS_MM, ROBUST_SIGMAS * sigma_mm)))


def off_model(p_mm: Array, nominal_mm: Array) -> Mask:
    """Return positions far from the nominal model's, carried to them by a robust rigid fit.

    Args:
        p_mm: (N, 3) measured positions.
        nominal_mm: (N, 3) the nominal model's for the same joint positions.

    Returns:
        (N,) mask; nothing is judged where the positions are too few, or on one line.
    """
    distance = np.zeros(len(p_mm))
    if len(p_mm) < LEAST_POSITIONS:
        return distance > 0.0
    try:
        for _ in range(FITS):
            fit = fit_rigid(nominal_mm, p_mm, 1.0 / np.maximum(distance, ALIKE_MM))
            distance = np.linalg.norm(fit.residuals, axis=1)
    except CalibrationError:
        return np.zeros(len(p_mm), dtype=bool)
    return np.asarray(distance > max(MODEL_MM, ROBUST_SIGMAS * float(np.median(distance))))
