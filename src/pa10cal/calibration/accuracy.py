"""Position and orientation error of predicted poses, as the paper states them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.calibration.levels import fit_base_frame
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.robust_weights import far_from_prediction
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import Deviations
from pa10cal.results.accuracy import Accuracy
from pa10cal.terms.model import Model


def deviations(
    T_base_ee: Array, T_instr_base: Array, observations: Observations[Pose]
) -> Deviations:
    """Compare predicted with measured poses."""
    return observations.measured.deviations(T_base_ee, T_instr_base, np.zeros(0))


def summarise(found: Deviations, rows: NDArray[np.bool_] | slice = slice(None)) -> Accuracy:
    """Summarise deviations over some rows."""
    distance, angle = found.distance_mm[rows], found.angle_deg
    return Accuracy(
        mean_mm=float(distance.mean()),
        peak_mm=float(distance.max()),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        orientation_deg=None if angle is None else float(angle[rows].mean()),
        configurations=len(distance),
    )


def summarise_by_load(found: Deviations, load_N: Array) -> dict[float, Accuracy]:
    """Summarise deviations for every load."""
    return {float(load): summarise(found, load_N == load) for load in np.unique(load_N)}


def align_nominal(nominal: Model, observations: Observations[Pose]) -> Array:
    """Return T_instr_base (4, 4) that aligns the nominal model on the least loaded positions.

    This is the alignment behind the paper's errors before calibration: positions only, once, on
    the poses with the smallest load, which the paper's campaign measured unloaded.
    """
    load_N = observations.states.load_N
    least = observations.take(load_N == load_N.min())
    return fit_base_frame(
        nominal.predict(least.states, np.zeros(0)),
        least.measured.T_instr_target,
        attitude_weight_m2=0.0,
    ).T_instr_base


# Held-out poses with a reading that is wrong itself: they say nothing of a model.

#: Says by a calibrated model which held-out poses have a suspected reading.
Suspects = Callable[[FittedModel], NDArray[np.bool_]]


def suspected_held_out(every: Observations, model: FittedModel) -> NDArray[np.bool_]:
    """Return which averaged held-out poses have a suspected reading, (H,).

    The evaluation tells them by the same rule.

    Args:
        every: single readings of all kinds.
        model: the calibrated model.
    """
    single, fitted = every.of_kind("holdout"), every.of_kind("grid")
    if not len(single):
        return np.zeros(0, dtype=bool)
    far, _ = far_from_prediction(model.as_modelled(single), model, model.as_modelled(fitted))
    return np.bincount(reading_groups(single), far) > 0.0
