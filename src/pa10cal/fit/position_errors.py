"""Position errors of poses, from residuals of their components, and those that noise makes.

The position error of a pose is the rms over its targets: squares of components are summed, and
divided by the number of targets seen. An instrument of distances has one component.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations

#: Draws of a mean length (computing).
_DRAWS = 2000
#: Least divisor (computing).
_TINY = 1e-300


def position_error_mm(measured: Instrument, residual: Array) -> Array:
    """Return the position error (P,) of residuals (P, b): the rms over the targets of a pose."""
    squares_m2 = np.sum(residual[:, measured.position_columns] ** 2, axis=1)
    return np.asarray(1e3 * np.sqrt(squares_m2 / measured.targets_seen))


def of_one_target(measured: Instrument, jacobian: Array) -> Array:
    """Return the position rows (P, c, k) of a derivative (P, b, k), scaled to one target.

    They are divided by the square root of the number of targets seen, so that the sum of squares
    over all targets becomes their mean.
    """
    root = np.sqrt(measured.targets_seen)[:, None, None]
    return np.asarray(jacobian[:, measured.position_columns] / root)


def to_mm(measured: Instrument, weight: Array) -> Array:
    """Return the factor (P, b) from a component to its part of the position error [mm].

    Args:
        weight: (P, b) root weight by which the component was multiplied.
    """
    places, factor = measured.position_columns, np.zeros_like(weight)
    seen, roots = measured.components_seen[:, places], np.maximum(weight[:, places], _TINY)
    factor[:, places] = np.where(seen, 1e3 / roots, 0.0)
    return np.asarray(factor / np.sqrt(measured.targets_seen)[:, None])


def noise_mm2(measured: Instrument, variance: Array) -> Array:
    """Return what variances (P, b) of components [m²] add to the square of the position error."""
    places, noise_m2 = measured.position_columns, np.zeros_like(variance)
    seen = measured.components_seen[:, places]
    noise_m2[:, places] = np.where(seen, variance[:, places], 0.0)
    return np.asarray(1e6 * noise_m2 / measured.targets_seen[:, None])


def position_noise_mm(measured: Instrument, covariance: Array) -> float:
    """Return the rms position error that noise of covariances (P, b, b) makes."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return float(np.sqrt(np.mean(noise_mm2(measured, variance).sum(axis=1))))


def position_errors_along_axes(
    at: FittedModel, poses: Observations, deviation: Array, cov: Array
) -> tuple[Array, Array]:
    """Return position errors (P, 3) [m] and the variances (P, 3) [m²] of their noise.

    They are along the instrument's axes and means over the targets; of an instrument of distances,
    along the line of sight.

    Args:
        deviation: (P, b) measured minus predicted components.
        cov: (P, b, b) covariance of their noise.
    """
    columns = poses.measured.position_columns
    to_axes = _directions_seen(at, poses) / poses.measured.targets_seen[:, None, None]
    error_m = (to_axes @ deviation[:, columns, None])[:, :, 0]
    of_positions = cov[:, columns[:, None], columns]
    variance_m2 = np.einsum("pik,pkl,pil->pi", to_axes, of_positions, to_axes, optimize=True)
    return error_m, variance_m2


def seen_along_axes(at: FittedModel, poses: Observations) -> Array:
    """Return what an error of position gives as error along the instrument's axes, (P, 3, 3).

    The identity where targets are seen in all three coordinates; of an instrument of distances, the
    projection on the line of sight.
    """
    directions = _directions_seen(at, poses)
    targets = poses.measured.targets_seen[:, None, None]
    return np.asarray(directions @ directions.transpose(0, 2, 1) / targets)


def _directions_seen(at: FittedModel, poses: Observations) -> Array:
    """Return the direction of each position component, (P, 3, c); zero where it was not seen.

    It is the derivative of the component by the position of the end.
    """
    columns, measured = poses.measured.position_columns, poses.measured
    T_instr_ee = at.T_instr_base @ at.model.predict(poses.states, at.x)
    ideal = measured.ideal(T_instr_ee, at.targets_m).compare(T_instr_ee, at.targets_m)
    seen = measured.components_seen[:, columns, None]
    return np.asarray((seen * ideal.by_end[:, columns, :3]).transpose(0, 2, 1))


def position_noise_m2(measured: Instrument, cov: Array) -> Array:
    """Return covariances (P, d, d) of noise vectors as long as the position errors of poses.

    The squared length of a vector is the mean over the targets seen. It has d components, those of
    positions: three a target, or one of a distance. They are zero where nothing was seen.

    Args:
        cov: (P, b, b) noise covariance of the components.
    """
    columns = measured.position_columns
    seen = measured.components_seen[:, columns]
    both_seen = seen[:, :, None] & seen[:, None, :]
    of_positions = np.where(both_seen, cov[:, columns[:, None], columns], 0.0)
    return np.asarray(of_positions / measured.targets_seen[:, None, None])


def mean_norm(covariance: Array) -> Array:
    """Return the expected norms (P,) of Gaussian vectors of mean zero, by covariances (P, d, d).

    They are Monte Carlo means over draws that are the same for all.
    """
    std = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    draws = np.random.default_rng(0).standard_normal((_DRAWS, covariance.shape[1]))
    norms = np.sqrt((std[:, None, :] ** 2 * draws[None] ** 2).sum(axis=2))
    return np.asarray(norms.mean(axis=1))


def mean_noise_error_mm(measured: Instrument, cov: Array) -> float:
    """Return the mean position error over P poses that noise of covariances (P, b, b) makes.

    One mean covariance stands for all poses; for a group of campaigns, whose instruments differ,
    one for all poses in which the same components were seen.
    """
    noise_m2 = position_noise_m2(measured, cov)
    if not measured.campaigns:
        return float(1e3 * mean_norm(noise_m2.mean(axis=0, keepdims=True))[0])
    _, pattern = np.unique(measured.components_seen, axis=0, return_inverse=True)
    pattern, poses = pattern.ravel(), np.bincount(pattern.ravel())
    means_m2 = np.stack([noise_m2[pattern == k].mean(axis=0) for k in range(len(poses))])
    return float(1e3 * np.average(mean_norm(means_m2), weights=poses))
