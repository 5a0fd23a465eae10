"""Covariances of measured components, some of which a reading may lack.

A component that was not seen counts with variance one and without covariances, so that every matrix
has an inverse.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from pa10cal.arrays import Array, Index, Mask

#: Least share of the variance along a direction, of what the parameters' own make it, that is not
#: zero (computing).
NO_VARIANCE = 1e-12


def whitener_of(cov: Array) -> Array:
    """Return matrices (P, b, b) that make components of covariances (P, b, b) white."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)), dtype=np.float64)


def precision_of(cov: Array) -> Array:
    """Return the inverse of a covariance (k, k), zero along directions without variance."""
    size = np.sqrt(np.diag(cov))
    size[size == 0.0] = 1.0
    variances, axes = np.linalg.eigh(cov / np.outer(size, size))
    known = variances > NO_VARIANCE * variances.max(initial=0.0)
    along = axes[:, known] / size[:, None]
    return np.asarray((along / variances[known]) @ along.T)


def of_seen(cov: Array, seen: Mask) -> Array:
    """Return covariances (P, b, b) with unit variance of components not seen, whose rows are 0."""
    here = np.where(seen[:, :, None] & seen[:, None, :], cov, 0.0)
    return here + np.eye(seen.shape[1]) * ~seen[:, :, None]


def mean_covariance(cov: Array, seen: Mask, group: Index) -> Array:
    """Return the covariance (G, b, b) of the means of independent readings of each group.

    Args:
        cov: (P, b, b) covariance of the readings.
        seen: (P, b) components that each reading has.
        group: (P,) number of each reading's group, from 0, none omitted.
    """
    count = np.bincount(group)
    total, times = np.zeros((len(count), *cov.shape[1:])), np.zeros((len(count), cov.shape[1]))
    if seen.all():
        np.add.at(total, group, cov)
        return np.asarray(total / count[:, None, None] / count[:, None, None])
    np.add.at(times, group, seen)
    share = seen / np.maximum(times, 1.0)[group]
    np.add.at(total, group, share[:, :, None] * cov * share[:, None, :])
    return of_seen(total, times > 0.0)


def source_variances(difference: Array, sources: Array, seen: Mask, rounds: int) -> Array:
    """Fit non-negative variances (s,) of sources to the squares of differences.

    Rows are products of components, whitened by the covariance found before so that all weigh about
    the same.

    Args:
        difference: (D, b) differences, of the variance of one reading.
        sources: (D, s, b, b) covariance that each source has at a variance of one.
        seen: (D, b) components that a difference has.
        rounds: how often variances and whitening are found in turn.

    Raises:
        numpy.linalg.LinAlgError: when some direction has no variance.
    """
    count = sources.shape[1]
    if seen.all():
        first = np.atleast_2d(np.cov(difference.T, bias=True))
    else:
        first = np.diag(np.sum(difference**2, axis=0) / np.maximum(seen.sum(axis=0), 1))
    expected = np.broadcast_to(first, (len(difference), *first.shape))
    variances = np.zeros(count)
    for _ in range(rounds):
        whiten = whitener_of(of_seen(expected, seen))
        white = np.einsum("pij,pj->pi", whiten, difference)
        squares = np.einsum("pi,pj->pij", white, white)
        whitened = np.einsum("pij,psjk,plk->psil", whiten, sources, whiten, optimize=True)
        rows = whitened.transpose(0, 2, 3, 1).reshape(-1, count)
        size = np.linalg.norm(rows, axis=0)
        size[size == 0.0] = 1.0
        q, triangle = np.linalg.qr(rows / size)  # a small system of the same solution
        variances = nnls(triangle, q.T @ squares.ravel())[0] / size
        expected = np.einsum("s,psij->pij", variances, sources)
    return variances


def likelier_variances(
    found: Array, of_instrument: Array, difference: Array, sources: Array, seen: Mask
) -> Array:
    """Return the likelier of two sets of variances (s,), each times its best common factor.

    Where something else than noise is in the differences, as a step of the base between repeats,
    joints may seem to be all of the noise: their covariance has next to none in some directions, by
    which the common factor, and with it all the noise, came out three hundred times too large.

    Args:
        found: variances of all sources.
        of_instrument: those of the instrument as stated, alone.
        difference: (D, b), with `sources` and `seen` as in `source_variances`.

    Raises:
        numpy.linalg.LinAlgError: when those found leave some direction without variance.
    """
    sets, misfits = [], []
    for variances in (found, of_instrument):
        try:
            whiten = whitener_of(of_seen(np.einsum("s,psij->pij", variances, sources), seen))
        except np.linalg.LinAlgError:
            if variances is found:
                raise
            continue
        white = np.einsum("pij,pj->pi", whiten, difference)
        factor = float(np.sum(white**2) / seen.sum())
        log_det = -2.0 * float(np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum())
        sets.append(variances * factor)
        misfits.append(log_det + seen.sum() * np.log(factor))
    return sets[int(np.argmin(misfits))]
