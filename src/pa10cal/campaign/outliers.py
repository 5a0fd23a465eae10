"""Single positions that cannot be of their pose: against reach, repeats and the nominal model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.errors import CalibrationError
from pa10cal.frame.target_fit import LEVER_M

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Misfit:
    """How far B targets were seen from where the nominal model, fitted to them, puts them.

    Attributes:
        length_mm: (N, B) distance, nan where a target was not seen.
        turn_deg: (N,) angle between the attitudes; 0 where none was seen.
    """

    length_mm: Array
    turn_deg: Array

    @property
    def size_mm(self) -> Array:
        """Return the largest misfit of each row (N,), a turn as far as it moves a target."""
        turned_mm = 1e3 * LEVER_M * np.radians(self.turn_deg)
        return np.asarray(np.hypot(np.nanmax(self.length_mm, axis=1), turned_mm))


#: Rows to fit and their weights, to the misfit of all rows.
Fit = Callable[[NDArray[np.intp], Array], Misfit]

#: Distances that are always allowed from repeats and from the nominal model, in robust sigmas and
#: typical residuals too; gross errors are sought here, not bad readings.
REPEATS_MM = 10.0
MODEL_MM = 100.0
ROBUST_SIGMAS = 10.0
MODEL_DEG = 10.0
#: Part of these distances that is allowed beside a reading that is further off: errors of one size
#: differ by what the arm itself errs, and are to go together.
BESIDE_ANOTHER = 0.5
#: Repeats of which a median tells the one that is off.
LEAST_REPEATS = 3
#: Reweighted fits towards least distances, rows fitted, and the distance below which all weigh
#: alike.
FITS = 10
FITTED_ROWS = 300
ALIKE_MM = 1.0

OUT_OF_REACH = "further from the other positions than the arm reaches"
OFF_REPEATS = "far from the other readings of this pose and load"
OFF_MODEL = "far from where the joint angles put the end-effector"


def out_of_reach(p_mm: Array, arm: Arm) -> Mask:
    """Return positions (N, 3) further from their median than the arm's span; none if most are.

    Distances (N, 1) are judged alike.
    """
    if not len(p_mm):
        return np.zeros(0, dtype=bool)
    span_mm = 2e3 * arm.reach_m
    far = np.linalg.norm(p_mm - np.median(p_mm, axis=0), axis=1) > span_mm
    return np.asarray(far & (2 * far.sum() < len(far)))


def off_repeats(p_mm: Array, pose: NDArray[np.str_], load_N: Array) -> Mask:
    """Return readings far from the median of their pose and load, where there are enough.

    Args:
        p_mm: (N, 3) positions, or (N, 1) distances.
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


def robust_misfit(fit: Fit, rows: int) -> Misfit | None:
    """Fit the nominal model to what was seen, towards least distances rather than least squares.

    Args:
        fit: the model fitted to some rows with weights, and its misfit in all of them.
        rows: number of rows.

    Returns:
        The misfit of every row; None where the rows do not tell a frame.
    """
    used = np.sort(np.random.default_rng(0).permutation(rows)[:FITTED_ROWS])
    weights = np.ones(len(used))
    try:
        for _ in range(FITS):
            misfit = fit(used, weights)
            weights = 1.0 / np.maximum(misfit.size_mm[used], ALIKE_MM)
    except CalibrationError:
        return None
    return misfit


def off_model(misfit: Misfit) -> Mask:
    """Return targets (N, B) far from where the nominal model, fitted to all, puts them."""

    def far(off: Array, always: float) -> Mask:
        typical = ROBUST_SIGMAS * float(np.nanmedian(off))
        if (off > max(always, typical)).any():
            always *= BESIDE_ANOTHER
        return np.asarray(off > max(always, typical))

    return far(misfit.length_mm, MODEL_MM) | far(misfit.turn_deg, MODEL_DEG)[:, None]
