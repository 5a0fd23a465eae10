"""Distances of readings from the nominal arm, base and targets fitted towards least distances."""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array, drawn
from pa10cal.errors import CalibrationError
from pa10cal.frame.hand_eye import Located, hand_eye_from_points
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: Reweighted fits towards least distances, at most: of any instrument, and of points alone.
FITS, FITS_OF_POINTS = 10, 6
#: Rows that are fitted, at most.
FITTED_ROWS = 300
#: Distances below this weigh the same [m].
ALIKE_M = 1e-3
#: Poses that a fit of points needs.
LEAST_POSES = 12
#: Reweighting ends where a fit leaves more than this part of the sum of distances before.
_CONVERGED = 0.999


def misfit_of(measured: Instrument, T_base_ee: Array, fitted: int | None = None) -> Misfit | None:
    """Return how far readings are from the nominal end (P, 4, 4), base and target fitted.

    The fit minimises the sum of distances (iteratively reweighted least squares) over the first
    `fitted` readings, None for all. The misfit is None where these do not determine a frame.
    """
    rows = len(T_base_ee) if fitted is None else fitted
    if rows < measured.least_rows:
        return None
    used = drawn(rows, FITTED_ROWS)
    weights, sum_m = np.ones(len(used)), np.inf
    try:
        for _ in range(FITS):
            misfit = measured.misfit(T_base_ee, used, weights)
            off_m = np.maximum(misfit.size_m[used], ALIKE_M)
            before_m, sum_m = sum_m, float(off_m.sum())
            if sum_m > _CONVERGED * before_m:
                break
            weights = 1e-3 / off_m  # in millimetres, so that weights are about one
    except CalibrationError:
        return None
    return misfit


def nominal_places(T_base_ee: Array, p_m: Array) -> Array | None:
    """Return where the nominal arm, fitted for the least sum of distances, puts the targets [m].

    Targets (P, B, 3) were measured at p_m, nan where not seen. None where the poses (P, 4, 4) do
    not determine base and targets.
    """
    if len(p_m) < LEAST_POSES:
        return None
    used = drawn(len(p_m), FITTED_ROWS)
    weights = np.ones(len(used))
    for _ in range(FITS_OF_POINTS):
        located = placed_by_points(T_base_ee[used], p_m[used], weights)
        if located is None:
            return None
        modelled: Array = located.targets(T_base_ee)[..., :3, 3]
        weights = 1.0 / np.maximum(misfit_mm(p_m[used], modelled[used]), 1.0)
    return modelled


def placed_by_points(
    T_base_ee: Array, p_m: Array, weights: Array | None = None, *, roughly: bool = False
) -> Located | None:
    """Return base and targets fitted to positions; None where the poses do not determine them."""
    try:
        return hand_eye_from_points(T_base_ee, p_m, weights=weights, roughly=roughly)
    except CalibrationError:
        return None


def misfit_mm(p_m: Array, modelled_m: Array) -> Array:
    """Return the rms distance (P,) of measured from modelled targets, over those seen."""
    squares = np.sum((1e3 * (p_m - modelled_m)) ** 2, axis=2)
    return np.asarray(np.sqrt(np.nanmean(squares, axis=1)))
