"""Readings held out of a fit that are far from where it predicts them, whatever it lacks."""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.tails import ACCUSED_RATE, Tails
from pa10cal.observe.averages import reading_groups
from pa10cal.observe.observations import Observations

#: Another reading confirms one where they differ by less than this part of how far it is off.
_CONFIRMED = 0.3
#: Scatter is no less than this part of what is stated: rounding is none.
LEAST_STATED = 1e-3


def far_from_prediction(
    poses: Observations, model: FittedModel, fitted: Observations
) -> tuple[Mask, Array]:
    """Return which readings are further off than any tail of right data makes, and how far.

    Args:
        poses: P single readings held out, with what the model needs.
        model: the calibrated model.
        fitted: single readings that it was fitted to, likewise: they show what is usual.

    Returns:
        (P,) which of them, and (P, b) what the model leaves of them in the usual scatter.
    """
    usual = by_stated(fitted, model.compared(fitted).residual)
    left = model.compared(poses).residual
    white = by_stated(poses, left)
    far = np.zeros(len(poses), dtype=bool)
    for _, at in poses.measured.component_kinds:
        of_fitted, own = _tails(usual, fitted, at), _tails(white, poses, at)
        scale = max(of_fitted.scale, own.scale, LEAST_STATED)
        white[:, at] /= scale
        seen = components_seen(poses, at)
        both = np.concatenate(
            [white[:, at][seen], usual[:, at][components_seen(fitted, at)] / scale]
        )
        limit = Tails.of(both).largest(ACCUSED_RATE, int(seen.sum()))
        far |= np.abs(np.where(seen, white[:, at], 0.0)).max(axis=1, initial=0.0) > limit
    return far & ~confirmed(poses, left, np.flatnonzero(far)), white


def confirmed(readings: Observations, left: Array, rows: Index) -> Mask:
    """Return (P,) which of some rows another reading of the pose and load confirms.

    It does where it is off by about as much in the same direction.

    Args:
        readings: P single readings.
        left: (P, b) what the model leaves of them.
        rows: those that are far from it.
    """
    group, near = reading_groups(readings), np.zeros(len(readings), dtype=bool)
    seen = readings.measured.components_seen
    for row in rows:
        others = np.flatnonzero(group == group[row])
        others = others[others != row]
        both = seen[others] & seen[row]
        apart = np.linalg.norm(np.where(both, left[others] - left[row], 0.0), axis=1)
        near[row] = bool(np.any(apart <= _CONFIRMED * np.linalg.norm(left[row])))
    return near


def by_stated(readings: Observations, values: Array) -> Array:
    """Return values (P, b) in the stated uncertainty of the readings."""
    stated = np.linalg.inv(np.linalg.cholesky(readings.measured.stated_covariance))
    return np.asarray((stated @ values[:, :, None])[:, :, 0])


def components_seen(readings: Observations, at: slice) -> Mask:
    """Return which of some components of readings were seen."""
    return np.asarray(readings.measured.components_seen[:, at])


def _tails(white: Array, readings: Observations, at: slice) -> Tails:
    return Tails.of(white[:, at][components_seen(readings, at)])
