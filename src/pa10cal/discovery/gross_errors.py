"""Readings that a gross error moved: far from the calibrated model, and none like them.

What a model lacks moves all readings of a pose alike, while a gross error moves one. So a reading
is suspected where it lies far outside the scatter about the model and no other reading of its pose
and load lies near it. That of a pose measured once is suspected as its calibration suspects it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.linear import residual
from pa10cal.discovery.weights import pose_weights
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.robust_weights import suspect_beyond
from pa10cal.observe.averages import reading_groups
from pa10cal.observe.observations import Observations


def gross_errors(readings: Observations, model: FittedModel) -> NDArray[np.bool_]:
    """Return (P,) which single readings are suspected of a gross error.

    Touches are judged one by one when they are read, so that no pose made of them is suspected.

    Args:
        readings: P single readings, with what the model needs.
        model: the calibrated model.
    """
    suspected = np.zeros(len(readings), dtype=bool)
    measured = readings.measured
    if measured.from_touches:
        return suspected
    seen, left = measured.components_seen, residual(model, readings)
    dof = len(model.model.parameters) + len(model.targets_m) + 6
    whitener = pose_weights(left, dof, measured).whitener
    limit = suspect_beyond(seen)
    group = reading_groups(readings)
    far = np.linalg.norm((whitener @ left[:, :, None])[:, :, 0], axis=1) > limit
    for row in np.flatnonzero(far):
        others = np.flatnonzero(group == group[row])
        others = others[others != row]
        apart = np.where(seen[others] & seen[row], left[others] - left[row], 0.0) / np.sqrt(2.0)
        near = np.linalg.norm(apart @ whitener[row].T, axis=1) <= limit[row]
        suspected[row] = not near.any()
    return suspected
