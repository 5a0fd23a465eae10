"""Robust weights of the poses of a fit.

Rows are whitened by the instrument's stated covariance plus an excess scatter of positions and one
of orientations, estimated from the residuals: the remaining error of the model is then part of the
noise, and positions and orientations have balanced weights. The weight of a pose far outside that
scatter falls with the square of its Mahalanobis distance, so that a gross error affects neither the
parameters nor the scatter. No pose is omitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from pa10cal.arrays import Array
from pa10cal.fit.problem import Problem, Rows
from pa10cal.rules import SCATTER

#: Relative change of a scatter that counts as none (computing).
_SAME_SCATTER = 1e-3
#: Least uncertainty of a reading [m, rad], so that exact ones have a finite weight (computing).
_FINEST = 1e-12
_HALF_WIDTH_95 = float(ndtri(SCATTER.below_half_width))


@dataclass(frozen=True)
class ExcessScatter:
    """Scatter of residuals beyond the stated uncertainty, by kind of component."""

    size: dict[str, float]  # standard deviation of the excess [m, rad]
    stated: dict[str, float]  # root mean square of the stated uncertainty [m, rad]
    dof: dict[str, float]  # degrees of freedom: readings it was estimated from, less their leverage

    def is_about(self, other: ExcessScatter) -> bool:
        """Return whether it differs from another by less than counts as a change."""
        return all(
            abs(size - other.size[kind]) <= _SAME_SCATTER * max(size, self.stated[kind])
            for kind, size in self.size.items()
        )

    def halfway(self, other: ExcessScatter) -> ExcessScatter:
        """Return the scatter whose variances are the means of those of both."""
        between = {
            kind: float(np.sqrt(0.5 * (size**2 + other.size[kind] ** 2)))
            for kind, size in self.size.items()
        }
        return replace(self, size=between)

    @property
    def stated_part(self) -> float:
        """Return the stated over the total standard deviation of a reading, the largest by kind."""
        return max(
            (self.stated[kind] + _FINEST) / float(np.hypot(self.stated[kind] + _FINEST, size))
            for kind, size in self.size.items()
        )

    @property
    def widening(self) -> float:
        """Return Student's 95 % half-width over the normal one, for the kind of the fewest dof.

        The stated part of a variance counts as known: effective degrees of freedom are those of
        Welch and Satterthwaite.
        """
        effective_dof = [
            max(1.0, self.dof[kind]) * ((size**2 + self.stated[kind] ** 2) / size**2) ** 2
            for kind, size in self.size.items()
            if size > 0.0
        ]
        if not effective_dof:
            return 1.0
        return float(stdtrit(min(effective_dof), SCATTER.below_half_width)) / _HALF_WIDTH_95


@dataclass(frozen=True)
class WeightedRows:
    """Whitened rows times the root of each pose's weight."""

    residual: Array  # (P, b) predicted minus measured
    rows: Array  # (P, b, k) its derivative by the unknowns
    normal: Array  # (k, k) normal equations
    weights: Array  # (P,) robust weights of the poses, at most 1
    distance: Array  # (P,) Mahalanobis distance of each pose's residual, without its weight
    whitener: Array  # (P, b, b) W with W C W^T = I for stated covariance plus scatter C


def weighted_rows(
    problem: Problem, rows: Rows, scatter: ExcessScatter, robust: bool
) -> WeightedRows:
    """Whiten the rows of a problem; if `robust`, also weigh poses by their distance."""
    whitener = _whitener(problem, scatter)
    white = np.einsum("pij,pj->pi", whitener, rows.residual)
    distance = np.sqrt(np.sum(white**2, axis=1))
    weights: Array = np.ones(len(distance))
    if robust:
        enough = problem.readings >= SCATTER.enough * rows.jacobian.shape[2]
        limit = _limit(problem, distance, scatter.stated_part if enough else 1.0)
        weights = (limit / np.maximum(distance, limit)) ** 2
    root = np.sqrt(weights)
    scaled = root[:, None, None] * whitener
    # Of a group, components of other campaigns are zero in every pose: they are omitted.
    normal, weighted = np.zeros((rows.jacobian.shape[2],) * 2), np.zeros_like(rows.jacobian)
    for at, columns in problem.observations.measured.parts_seen:
        block = _times(scaled[at, columns, columns], rows.jacobian[at, columns])
        weighted[at, columns] = block
        flat = block.reshape(-1, block.shape[2])
        normal += flat.T @ flat
    return WeightedRows(root[:, None] * white, weighted, normal, weights, distance, whitener)


def suspect_beyond(seen: NDArray[np.bool_]) -> Array:
    """Return the Mahalanobis distance (P,) beyond which a pose is suspected of a gross error.

    Args:
        seen: (P, b) which components were seen.
    """
    square = chdtri(np.maximum(seen.sum(axis=1), 1), SCATTER.error_rate / len(seen))
    return np.asarray(np.sqrt(square), dtype=np.float64)


def _times(matrices: Array, rows: Array) -> Array:
    """Return matrices (P, b, b) times rows (P, b, k), faster where all matrices are diagonal."""
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    if np.count_nonzero(matrices) > np.count_nonzero(diagonal):
        return np.asarray(matrices @ rows)
    return np.asarray(diagonal[:, :, None] * rows)


def _limit(problem: Problem, distance: Array, least_factor: float) -> Array:
    """Return the Mahalanobis distance (P,) beyond which the weight of a pose falls.

    It is a quantile of the chi distribution for the components seen. Many gross errors widen the
    scatter until it hides them all: where the median distance is below that of the distribution,
    the limit is lowered in proportion, by `least_factor` at the most.
    """
    counts, at = problem.distinct_numbers_seen
    limits, medians = _chi_quantiles(tuple(counts.tolist()))
    typical = np.sqrt(_median(distance**2 / medians[at]))
    return np.asarray(limits[at] * min(1.0, max(typical, least_factor)))


@cache
def _chi_quantiles(counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Return largest likely distances, and median squared ones, by numbers of components seen."""
    dof = np.maximum(counts, 1)
    return np.sqrt(np.asarray(chdtri(dof, SCATTER.tail))), np.asarray(chdtri(dof, 0.5))


def _median(values: Array) -> float:
    """Return the median of values (N,); `np.median` takes ten times as long for a few poses."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(len(values) - 1) // 2] + ordered[len(values) // 2])


def _whitener(problem: Problem, scatter: ExcessScatter) -> Array:
    """Return the inverse Cholesky factors (P, b, b) of stated covariance plus scatter."""
    stated = problem.stated_covariance
    if problem.observations.measured.inverse:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(stated)) * scatter.stated_part)
    excess = np.zeros(stated.shape[1])
    for kind, columns in problem.observations.measured.component_kinds:
        excess[columns] = scatter.size[kind] ** 2 + _FINEST**2
    whitener = np.zeros_like(stated)
    for at, columns in problem.observations.measured.parts_seen:
        block = stated[at, columns, columns]
        all_equal = bool((block == block[:1]).all())
        block = (block[:1] if all_equal else block) + np.diag(excess[columns])
        whitener[at, columns, columns] = np.linalg.inv(np.linalg.cholesky(block))
    return whitener


def first_scatter(problem: Problem, rows: Rows) -> ExcessScatter:
    """Return the scatter at the start of a fit, from the median residual of each kind."""
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    sizes, stated = {}, {}
    for kind, columns in problem.observations.measured.component_kinds:
        seen = problem.components_seen[:, columns]
        sizes[kind] = _median(np.abs(rows.residual[:, columns][seen])) / SCATTER.median_size
        stated[kind] = float(np.sqrt(variances[:, columns][seen].mean()))
    return ExcessScatter(sizes, stated, dict.fromkeys(sizes, 0.0))


def refreshed(
    problem: Problem, rows: Rows, weighted: WeightedRows, parts: Array, before: ExcessScatter
) -> ExcessScatter:
    """Return the excess scatter of each kind of component, estimated from the residuals.

    The expected square of a residual is (1 - leverage) times the variance of its error. Components
    are weighted by their precision, poses by the square of their robust weight: with the weight
    itself, poses far off would widen the scatter without bound.

    Args:
        parts: (k, r) A such that A A^T is the covariance of the unknowns.
        before: the scatter that the rows were weighted by.
    """
    if problem.observations.measured.inverse:
        return _common_scatter(weighted, parts, before)
    leverage = np.zeros(weighted.residual.shape)
    for at, columns in problem.observations.measured.parts_seen:
        block = weighted.rows[at, columns]
        flat = block.reshape(-1, len(parts)) @ parts
        leverage[at, columns] = np.einsum("ij,ij->i", flat, flat).reshape(block.shape[:2])
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    sizes, dof = {}, {}
    for kind, columns in problem.observations.measured.component_kinds:
        seen, stated = problem.components_seen[:, columns], variances[:, columns]
        pose_weight = np.where(seen, weighted.weights[:, None] ** 2, 0.0)
        dof_each = pose_weight * (1.0 - leverage[:, columns])
        precision = (stated + before.size[kind] ** 2 + _FINEST**2) ** -2.0
        excess_square = pose_weight * rows.residual[:, columns] ** 2 - dof_each * stated
        dof[kind] = float(np.sum(dof_each))
        sizes[kind] = 0.0
        if dof[kind] > 1.0:
            variance = float(np.sum(precision * excess_square) / np.sum(precision * dof_each))
            sizes[kind] = float(np.sqrt(max(0.0, variance)))
    return ExcessScatter(sizes, before.stated, dof)


def _common_scatter(weighted: WeightedRows, parts: Array, before: ExcessScatter) -> ExcessScatter:
    """Return the scatter of poses whose components are uncertain together: of one factor for all.

    See `refreshed`. Added to each component by itself it would hide how they go together.
    """
    flat = weighted.rows.reshape(-1, len(parts)) @ parts
    leverage = np.sum(flat**2, axis=1).reshape(weighted.residual.shape)
    pose_weight = weighted.weights[:, None] ** 2
    dof = float(np.sum(pose_weight * (1.0 - leverage)))
    square = float(np.sum(weighted.weights * np.sum(weighted.residual**2, axis=1)))
    factor = max(1.0, square / dof / before.stated_part**2) if dof > 1.0 else 1.0
    sizes = {kind: float(np.sqrt(factor - 1.0)) * stated for kind, stated in before.stated.items()}
    return ExcessScatter(sizes, before.stated, dict.fromkeys(sizes, dof))
