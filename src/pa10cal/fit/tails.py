"""Gross errors: readings further from a model than the tails of correct readings reach.

How heavy the tails of correct readings are is read off the bulk of the residuals (the ratio of two
quantiles of a Student's t distribution), where a few wrong readings have no influence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.rules import SCATTER

#: Degrees of freedom for which the ratio of quantiles is tabulated (computing).
_DOF = np.geomspace(1.5, SCATTER.normal_dof, 60)
#: Their outer quantile over the inner one (computing).
_RATIOS = stdtrit(_DOF, 0.5 + 0.5 * SCATTER.outer) / stdtrit(_DOF, 0.5 + 0.5 * SCATTER.inner)


@dataclass(frozen=True)
class Tails:
    """Scaled Student's t distribution of many deviates about zero."""

    scale: float  # standard deviation of a normal distribution with the same bulk
    dof: float  # lower bound of the degrees of freedom; the fewer, the heavier the tails
    count: int  # deviates it was estimated from

    @staticmethod
    def of(deviates: Array, surely: float = SCATTER.surely_errors) -> Tails:
        """Return the distribution of deviates (N,).

        Args:
            surely: standard errors by which the ratio of quantiles is raised, to be conservative.
        """
        sizes = np.abs(deviates)
        if not len(sizes):
            return Tails(0.0, SCATTER.normal_dof, 0)
        inner, outer = np.quantile(sizes, [SCATTER.inner, SCATTER.outer])
        if inner == 0.0:
            return Tails(0.0, SCATTER.normal_dof, len(sizes))
        ratio = outer / inner * (1.0 + surely * SCATTER.error_of_ratio / np.sqrt(len(sizes)))
        dof = float(np.interp(-ratio, -_RATIOS, _DOF))
        scale = inner / ndtri(0.5 + 0.5 * SCATTER.inner)
        return Tails(float(scale), dof, len(sizes))

    def largest(self, rate: float, count: int | None = None) -> float:
        """Return the size that the largest of `count` deviates exceeds with probability `rate`."""
        count = max(self.count, 1) if count is None else count
        quantile = -float(stdtrit(self.dof, 0.5 * rate / count))
        upper = 0.5 + 0.5 * SCATTER.inner
        scale_of_t = float(stdtrit(self.dof, upper)) / float(ndtri(upper))
        return self.scale * quantile / scale_of_t


def far_from_prediction(
    poses: Observations, model: FittedModel, fitted: Observations
) -> tuple[Mask, Array]:
    """Return which held-out readings have gross errors, and the whitened residuals of all.

    Args:
        poses: P single readings held out, as modelled, with all that the model needs.
        fitted: single readings that the model was fitted to, likewise; they show its usual errors.

    Returns:
        (P,) which readings have a gross error, whatever the model lacks; and (P, b) residuals over
        the usual scatter.
    """
    white_fitted = by_stated(fitted, model.compared(fitted).residual)
    residual = model.compared(poses).residual
    white = by_stated(poses, residual)
    kinds = poses.measured.component_kinds
    far, far_in_each = np.zeros(len(poses), dtype=bool), np.full(len(poses), len(kinds) > 1)
    for _, columns in kinds:
        seen, seen_fitted = components_seen(poses, columns), components_seen(fitted, columns)
        # Each by its own scatter: a camera's depth beside what it sees across looks like one heavy
        # tail, in which no reading is too far off.
        scales = _scale_by_component(white_fitted[:, columns], seen_fitted)
        of_fitted = (white_fitted[:, columns] / scales)[seen_fitted]
        white[:, columns] /= scales
        scale = max(1.0, Tails.of(white[:, columns][seen]).scale)
        white[:, columns] /= scale
        tails = Tails.of(np.concatenate([white[:, columns][seen], of_fitted / scale]))
        size = np.abs(np.where(seen, white[:, columns], 0.0)).max(axis=1, initial=0.0)
        # What is far off in a component that hardly scatters is none beside the others' scatter.
        whole = np.linalg.norm(np.where(seen, white[:, columns] * scales, 0.0), axis=1)
        size[whole < SCATTER.least_far * np.linalg.norm(scales)] = 0.0
        far |= size > tails.largest(SCATTER.accused_rate, int(seen.sum()))
        # Position and orientation that are both far off need not be so far by themselves.
        far_in_each &= size > tails.largest(SCATTER.accused_rate**0.5, int(seen.sum()))
    far |= far_in_each
    return far & ~confirmed(poses, residual, np.flatnonzero(far)), white


def _scale_by_component(white: Array, seen: Mask) -> Array:
    """Return the usual size of each component (c,) of whitened residuals (P, c), those seen."""
    scales = [Tails.of(of_one[rows]).scale for of_one, rows in zip(white.T, seen.T, strict=True)]
    return np.maximum(scales, SCATTER.least_stated)


def confirmed(readings: Observations, residual: Array, rows: Index) -> Mask:
    """Return which readings another reading of the same pose and load confirms, (P,).

    It confirms a reading if its residual has about the same size and direction.

    Args:
        residual: (P, b) residuals of the readings.
        rows: readings to test; all others are False.
    """
    group, found = reading_groups(readings), np.zeros(len(readings), dtype=bool)
    seen = readings.measured.components_seen
    for row in rows:
        others = np.flatnonzero(group == group[row])
        others = others[others != row]
        both_seen = seen[others] & seen[row]
        difference = np.where(both_seen, residual[others] - residual[row], 0.0)
        limit = SCATTER.confirmed_share * np.linalg.norm(residual[row])
        found[row] = bool(np.any(np.linalg.norm(difference, axis=1) <= limit))
    return found


def by_stated(readings: Observations, values: Array) -> Array:
    """Return values (P, b), such as residuals, whitened by the readings' stated covariance."""
    whitener = np.linalg.inv(np.linalg.cholesky(readings.measured.stated_covariance))
    return np.asarray(np.einsum("pij,pj->pi", whitener, values))


def components_seen(readings: Observations, columns: slice) -> Mask:
    """Return which of these components were seen in each reading, (P, c)."""
    return np.asarray(readings.measured.components_seen[:, columns])
