"""Mean and covariance of unknowns by the products of their rows and a prior, safe from rounding.

A gram is of rows alone; a precision contains the prior, too. The prior of unknowns expected about
zero is their precision, with a row of zeros for an unknown that rows alone determine. Systems are
scaled to a unit diagonal. Where rounding makes one indefinite all the same, as by rows that were
subtracted, no direction of the unknowns is less certain than by the prior.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri

from pa10cal.arrays import Array

#: Precision of an unknown without a prior where rounding is put right, in that which it has
#: (computing).
_LEAST_PRECISION = 1e-12


def posterior_mean(gram: Array, projection: Array, prior: Array) -> Array:
    """Return the unknowns (k,) or (k, m) that solve (gram + prior) x = projection.

    Raises:
        LinAlgError: when an unknown has neither rows nor a prior.
    """
    precision = gram + prior
    scale = _to_unit_diagonal(np.diag(precision), np.diag(prior))
    if not len(scale):
        return projection.copy()
    precision *= scale
    precision *= scale[:, None]
    _, solved, failed = dposv(precision.T, (projection.T * scale).T, overwrite_a=1)
    if failed:
        return _no_wider_than(gram + prior, prior) @ projection
    return np.asarray((solved.T * scale).T)


def posterior_covariance(precision: Array, prior: Array) -> Array:
    """Return the covariance (k, k) of unknowns by their precision, which contains the prior's.

    Raises:
        LinAlgError: when an unknown has neither rows nor a prior.
    """
    scale = _to_unit_diagonal(np.diag(precision), np.diag(prior))
    if not len(scale):
        return precision.copy()
    scaled = precision * scale
    scaled *= scale[:, None]
    factor, failed = dpotrf(scaled.T, overwrite_a=1)
    if failed:
        return _no_wider_than(precision, prior)
    upper, _ = dpotri(factor, overwrite_c=1)  # zero below its diagonal
    upper *= scale
    upper *= scale[:, None]
    found = upper + upper.T
    found.flat[:: len(scale) + 1] *= 0.5
    return np.asarray(found)


def covariance_by_sizes(gram: Array, sizes: Array) -> Array:
    """Return the covariance (k, k) of unknowns with standard deviations `sizes` (k,) expected."""
    prior = np.diag(sizes**-2.0)
    return posterior_covariance(gram + prior, prior)


def posterior_means(gram: Array, projection: Array, priors: Array) -> Array:
    """Return the unknowns (m, k) of m systems (m, k, k) with diagonals of priors (m, k)."""
    diagonal = np.arange(gram.shape[1])
    precision = gram.copy()
    precision[:, diagonal, diagonal] += priors
    scale = _to_unit_diagonal(precision[:, diagonal, diagonal], priors)
    precision *= scale[:, :, None]
    precision *= scale[:, None]
    solved = scale * projection
    for k, one in enumerate(precision):
        _, solved[k], failed = dposv(one.T, solved[k], overwrite_a=1)
        if failed:  # indefinite by rounding
            solved[k] = posterior_mean(gram[k], projection[k], np.diag(priors[k])) / scale[k]
    return np.asarray(scale * solved)


def _to_unit_diagonal(precision: Array, prior: Array) -> Array:
    """Return what scales unknowns (..., k) to a unit diagonal of the precision, by the diagonals.

    Rounding may leave less than the prior.
    """
    diagonal = np.maximum(precision, prior)
    if np.any(diagonal == 0.0):
        raise np.linalg.LinAlgError("an unknown has neither rows nor a prior")
    return np.asarray(1.0 / np.sqrt(diagonal))


def _no_wider_than(precision: Array, prior: Array) -> Array:
    """Return the inverse of a precision (k, k) with no direction less certain than the prior.

    Without rounding the precision's eigenvalues in units of the prior are at least one.
    """
    bare = np.diag(prior) == 0.0
    root = np.linalg.cholesky(
        prior + np.diag(np.where(bare, _LEAST_PRECISION * np.diag(precision), 0.0))
    )
    within = np.linalg.solve(root, np.linalg.solve(root, precision).T)
    values, vectors = np.linalg.eigh(0.5 * (within + within.T))
    vectors = np.linalg.solve(root.T, vectors)
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)
