"""Position errors of single readings, and the repeatability of the arm that they show.

A model predicts the mean of many approaches to a pose. A single one is off by the repeatability of
the arm in addition (ISO 9283), which is part of the uncertainty of a prediction. Repeated readings
of a pose scatter by it and by the noise of the instrument, of which the stated part is subtracted.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.position_errors import noise_mm2, to_mm
from pa10cal.fit.tails import Tails
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.rules import LACK, SCATTER

#: Least divisor (computing).
_TINY = 1e-300


def repeatability_mm(model: Fitted, readings: Observations) -> float:
    """Return by how much repeats of a pose scatter beyond the stated noise, rms position [mm].

    Readings of the same pose and load are compared with their mean, after what the model explains,
    such as lost motion. Drift during the campaign counts, as a pose may be met again at any time;
    gross errors hardly do. It is 0 where chance explains the scatter, or nothing was repeated.

    Args:
        readings: single readings, as modelled.
    """
    group = reading_groups(readings)
    repeated = np.flatnonzero(np.bincount(group)[group] > 1)
    if not len(repeated):
        return 0.0
    readings = readings.take(repeated).thinned_by_pose(LACK.most_poses)
    _, group = np.unique(reading_groups(readings), return_inverse=True)
    measured, seen = readings.measured, readings.measured.components_seen
    residual, covariance = along_noise_axes(
        measured, model.compared(readings).residual, measured.stated_covariance
    )
    variance = np.diagonal(covariance, axis1=1, axis2=2)

    def of_group(values: Array) -> Array:
        of_columns = [np.bincount(group, column)[group] for column in values.T]
        return np.asarray(np.stack(of_columns, axis=1), dtype=np.float64)

    count = np.maximum(of_group(seen.astype(float)), 1.0)
    free = np.where(seen, 1.0 - 1.0 / count, 0.0)  # variance of a deviation over that of a reading
    off = np.where(seen, residual - of_group(np.where(seen, residual, 0.0)) / count, 0.0)
    white = np.where(free > 0.0, off / np.sqrt(np.maximum(free * variance, _TINY)), 0.0)
    least_trust = np.ones(group.max() + 1)  # one gross error moves the mean of all
    np.minimum.at(least_trust, group, trust_of(measured, white))
    trust = least_trust[group]
    stated_mm2 = noise_mm2(measured, variance)
    found = trust @ np.sum(to_mm(measured, seen.astype(float)) ** 2 * off**2, axis=1)
    expected = trust @ np.sum(stated_mm2 * free, axis=1)
    # Components whose noise is the largest decide: so many deviates of equal size are as uncertain.
    deviates = expected**2 / max(trust @ np.sum(stated_mm2**2 * free, axis=1), _TINY)
    over = float(found / max(expected, _TINY))
    if over <= 1.0 or is_chance(over, float(deviates)):
        return 0.0
    readings_free = float(trust @ (free.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)))
    return float(np.sqrt(components_factor(measured) * (found - expected) / readings_free))


def is_chance(over: float, deviates: float) -> bool:
    """Return whether chance explains a mean square that is `over` times as large as expected.

    Twice the log likelihood ratio of a variance, by so many independent deviates, is compared.
    """
    return bool(deviates * (over - 1.0 - np.log(max(over, _TINY))) <= LACK.beyond_chance)


def components_factor(measured: Instrument) -> float:
    """Return by how much more a position is off than the components that were measured."""
    return LACK.components if len(measured.position_columns) == 1 else 1.0


def along_noise_axes(measured: Instrument, rows: Array, covariance: Array) -> tuple[Array, Array]:
    """Return rows (P, b) or (P, b, k) and covariance (P, b, b) by errors that are independent.

    Of an instrument that the target carries these are along the target's axes.
    """
    if not measured.inverse:
        return rows, covariance
    to_axes = measured.along_noise_axes()
    turned = to_axes @ rows.reshape(*rows.shape[:2], -1)
    return turned.reshape(rows.shape), to_axes @ covariance @ to_axes.swapaxes(1, 2)


def trust_of(measured: Instrument, white: Array) -> Array:
    """Return by how much errors of poses count, (P,), by white residuals (P, b).

    Beyond the tails of the others, however heavy these are, by the square of a robust weight, as in
    the scatter of a fit.
    """
    seen, ratio = measured.components_seen, np.ones(len(white))
    for _, kind in measured.component_kinds:
        size = np.where(seen[:, kind], np.abs(white[:, kind]), 0.0)
        limit = Tails.of(size[seen[:, kind]]).largest(SCATTER.tail, 1)
        ratio = np.maximum(ratio, size.max(axis=1) / max(limit, _TINY))
    return np.asarray(ratio**-4.0)
