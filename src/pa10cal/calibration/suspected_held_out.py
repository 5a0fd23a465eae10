"""Held-out poses with a reading that is wrong itself: they say nothing of a model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.off_prediction import far_from_prediction
from pa10cal.observe.averages import reading_groups
from pa10cal.observe.observations import Observations

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
