"""Robust weights of the poses of a fit.

Rows are whitened by the instrument's stated covariance plus a scatter of positions and one of
orientations, estimated from the residuals: the remaining error of the model is then part of the
noise, and positions and orientations have balanced weights. Poses far outside that scatter weigh
less, the less the further off they are, so that a wrong one affects neither the parameters nor the
scatter; none is omitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import Problem, Rows
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.rules import SCATTER

#: Change of a scatter, relative to its size, that counts as none (computing).
_SAME_SCATTER = 1e-3
#: Smallest uncertainty of a reading [m, rad], so that exact ones have a finite weight (computing).
_FINEST = 1e-12
_HALF_WIDTH_95 = float(ndtri(SCATTER.below_half_width))


@dataclass(frozen=True)
class ExcessScatter:
    """What residuals show beyond the stated uncertainty, by kind of component."""

    size: dict[str, float]  # standard deviation of it [m, rad]
    stated: dict[str, float]  # what the instrument states [m, rad], on average
    # degrees of freedom: readings that it was estimated from, less their leverage
    dof: dict[str, float]

    def is_about(self, other: ExcessScatter) -> bool:
        """Return whether only small parts of it have changed."""
        return all(
            abs(size - other.size[kind]) <= _SAME_SCATTER * max(size, self.stated[kind])
            for kind, size in self.size.items()
        )

    def halfway(self, other: ExcessScatter) -> ExcessScatter:
        """Return the scatter whose variances are the means of both."""
        between = {
            kind: float(np.sqrt(0.5 * (size**2 + other.size[kind] ** 2)))
            for kind, size in self.size.items()
        }
        return replace(self, size=between)

    @property
    def stated_part(self) -> float:
        """What is stated of the standard deviation of a reading, of the kind most of it is."""
        return max(
            (self.stated[kind] + _FINEST) / float(np.hypot(self.stated[kind] + _FINEST, size))
            for kind, size in self.size.items()
        )

    @property
    def widening(self) -> float:
        """Student's half-width over that of the normal distribution, of the least certain kind.

        The stated part of a variance counts as known, as Welch and Satterthwaite have it.
        """
        found = [
            max(1.0, self.dof[kind]) * ((size**2 + self.stated[kind] ** 2) / size**2) ** 2
            for kind, size in self.size.items()
            if size > 0.0
        ]
        return (
            float(stdtrit(min(found), SCATTER.below_half_width)) / _HALF_WIDTH_95 if found else 1.0
        )


@dataclass(frozen=True)
class WeightedRows:
    """Rows made independent and of unit variance, each pose by its weight."""

    residual: Array  # (P, b) predicted less seen
    rows: Array  # (P, b, k) its derivative by the unknowns
    normal: Array  # (k, k) their normal equations
    weights: Array  # (P,) of the poses, 1 where the robust loss leaves them alone
    distance: Array  # (P,) Mahalanobis distance of each pose's residual, without its weight
    whitener: Array  # (P, b, b) that makes stated errors and scatter independent and of unit size


def weighted_rows(
    problem: Problem, rows: Rows, scatter: ExcessScatter, robust: bool
) -> WeightedRows:
    """Weigh the rows of a problem; where it is robust, poses far outside the scatter less."""
    whitener = _whitener(problem, scatter.size)
    white = np.einsum("pij,pj->pi", whitener, rows.residual)
    distance = np.sqrt(np.sum(white**2, axis=1))
    weights: Array = np.ones(len(distance))
    if robust:
        enough = problem.readings >= SCATTER.enough * rows.jacobian.shape[2]
        limit = _limit(problem, distance, scatter.stated_part if enough else 1.0)
        weights = (limit / np.maximum(distance, limit)) ** 2
    root = np.sqrt(weights)
    scaled = root[:, None, None] * whitener
    # In the poses of one campaign of a group those of others are zero, and stay out of products.
    normal = np.zeros((rows.jacobian.shape[2],) * 2)
    measured = problem.observations.measured
    weighted = np.zeros_like(rows.jacobian) if measured.campaigns else rows.jacobian
    for at, columns in measured.parts_seen:
        own = _times(scaled[at, columns, columns], rows.jacobian[at, columns])
        if measured.campaigns:
            weighted[at, columns] = own
        else:
            weighted = own
        flat = own.reshape(-1, own.shape[2])
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
    """Return matrices (P, b, b) times rows (P, b, k); diagonal ones take a pass over the rows."""
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    if np.count_nonzero(matrices) > np.count_nonzero(diagonal):
        return np.asarray(matrices @ rows)
    return np.asarray(diagonal[:, :, None] * rows)


def _limit(problem: Problem, distance: Array, least: float) -> Array:
    """Return the distance (P,) beyond which a pose weighs less, by its components seen.

    It goes by the scatter, or by the typical pose where that lies closer: many wrong ones make the
    scatter too wide to show any of them. It is at least this part of the former.
    """
    seen, at = problem.distinct_numbers_seen
    numbers = np.maximum(seen, 1)
    limits = np.sqrt(np.asarray(chdtri(numbers, SCATTER.tail)))
    medians = np.asarray(chdtri(numbers, 0.5))
    typical = np.sqrt(_median(distance**2 / medians[at]))
    return np.asarray(limits[at] * min(1.0, max(typical, least)))


def _median(values: Array) -> float:
    """Return the median of values (N,); that of numpy takes ten times as long for a few poses."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(len(values) - 1) // 2] + ordered[len(values) // 2])


def _whitener(problem: Problem, scatter: dict[str, float]) -> Array:
    """Return (P, b, b) that makes stated errors and scatter independent and of unit size."""
    stated = problem.stated_covariance
    own = np.zeros(stated.shape[1])
    for kind, rows in problem.observations.measured.component_kinds:
        own[rows] = scatter[kind] ** 2 + _FINEST**2
    whitener = np.zeros_like(stated)
    for at, columns in problem.observations.measured.parts_seen:
        block = stated[at, columns, columns]
        one = bool((block == block[:1]).all())
        block = (block[:1] if one else block) + np.diag(own[columns])
        whitener[at, columns, columns] = np.linalg.inv(np.linalg.cholesky(block))
    return whitener


def first_scatter(problem: Problem, rows: Rows) -> ExcessScatter:
    """Return a scatter to start with, estimated at the start and robust to outliers."""
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    found, stated = {}, {}
    for kind, columns in problem.observations.measured.component_kinds:
        seen = problem.components_seen[:, columns]
        found[kind] = _median(np.abs(rows.residual[:, columns][seen])) / SCATTER.median_size
        stated[kind] = float(np.sqrt(variances[:, columns][seen].mean()))
    return ExcessScatter(found, stated, dict.fromkeys(found, 0.0))


def refreshed(
    problem: Problem, rows: Rows, weighted: WeightedRows, parts: Array, before: ExcessScatter
) -> ExcessScatter:
    """Return the scatter of each kind that residuals show beyond what the instrument states.

    A residual is smaller than its error by the leverage. Components
    count by their precision, and poses far off by the square of their weight: in the end not at
    all, where the weight alone would let them widen the scatter without bound.

    Args:
        parts: (k, r) of which A A^T is the covariance of the unknowns.
    """
    leverage = np.zeros(weighted.residual.shape)
    for at, columns in problem.observations.measured.parts_seen:
        own = weighted.rows[at, columns]
        flat = own.reshape(-1, len(parts)) @ parts
        leverage[at, columns] = np.einsum("ij,ij->i", flat, flat).reshape(own.shape[:2])
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    sizes, dof = {}, {}
    for kind, columns in problem.observations.measured.component_kinds:
        seen, stated = problem.components_seen[:, columns], variances[:, columns]
        counts = np.where(seen, weighted.weights[:, None] ** 2, 0.0)
        left = counts * (1.0 - leverage[:, columns])
        precise = (stated + before.size[kind] ** 2 + _FINEST**2) ** -2.0
        over = counts * rows.residual[:, columns] ** 2 - left * stated
        dof[kind] = float(np.sum(left))
        sizes[kind] = 0.0
        if dof[kind] > 1.0:
            excess = float(np.sum(precise * over) / np.sum(precise * left))
            sizes[kind] = float(np.sqrt(max(0.0, excess)))
    return ExcessScatter(sizes, before.stated, dof)


# How far residuals lie outside what their own distribution makes: the heaviness of right data's
# tails is read off the bulk, where a few wrong readings do not show.

#: Degrees of freedom whose ratio is worked out (computing).
_DOF = np.geomspace(1.5, SCATTER.normal_dof, 60)
#: Their outer quantiles over the inner ones (computing).
_RATIOS = stdtrit(_DOF, 0.5 + 0.5 * SCATTER.outer) / stdtrit(_DOF, 0.5 + 0.5 * SCATTER.inner)


@dataclass(frozen=True)
class Tails:
    """Distribution of many deviates about zero: Student's t of some scale."""

    scale: float  # of the deviates, as a standard deviation of its bulk
    # degrees of freedom; the fewer, the heavier the tails. No more than they surely are.
    dof: float
    count: int  # deviates behind it

    @staticmethod
    def of(deviates: Array, surely: float = SCATTER.surely_errors) -> Tails:
        """Return the distribution of deviates (N,).

        Args:
            surely: standard errors by which tails may be heavier than they were found.
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
        """Return the size that the largest of so many deviates exceeds with this probability."""
        count = max(self.count, 1) if count is None else count
        quantile = -float(stdtrit(self.dof, 0.5 * rate / count))
        upper = 0.5 + 0.5 * SCATTER.inner
        bulk = float(stdtrit(self.dof, upper)) / float(ndtri(upper))
        return self.scale * quantile / bulk


# Readings held out of a fit that are far from where it predicts them, whatever it lacks.


def far_from_prediction(
    poses: Observations, model: FittedModel, fitted: Observations
) -> tuple[Mask, Array]:
    """Return which readings are further off than any tail of right data makes, and how far.

    Args:
        poses: P single readings held out, with what the model needs.
        fitted: single readings that it was fitted to, likewise: they show what is usual.

    Returns:
        (P,) which of them, and (P, b) what the model leaves of them in the usual scatter.
    """
    usual = by_stated(fitted, model.compared(fitted).residual)
    left = model.compared(poses).residual
    white = by_stated(poses, left)
    far = np.zeros(len(poses), dtype=bool)
    for _, at in poses.measured.component_kinds:
        seen = components_seen(poses, at)
        of_fitted, own = usual[:, at][components_seen(fitted, at)], white[:, at][seen]
        scale = max(Tails.of(of_fitted).scale, Tails.of(own).scale, SCATTER.least_stated)
        white[:, at] /= scale
        limit = Tails.of(np.concatenate([white[:, at][seen], of_fitted / scale])).largest(
            SCATTER.accused_rate, int(seen.sum())
        )
        far |= np.abs(np.where(seen, white[:, at], 0.0)).max(axis=1, initial=0.0) > limit
    return far & ~confirmed(poses, left, np.flatnonzero(far)), white


def confirmed(readings: Observations, left: Array, rows: Index) -> Mask:
    """Return (P,) which of some rows another reading of the pose and load confirms.

    It does where it is off by about as much in the same direction.

    Args:
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
        near[row] = bool(np.any(apart <= SCATTER.confirmed_share * np.linalg.norm(left[row])))
    return near


def by_stated(readings: Observations, values: Array) -> Array:
    """Return values (P, b) in the stated uncertainty of the readings."""
    stated = np.linalg.inv(np.linalg.cholesky(readings.measured.stated_covariance))
    return np.asarray(np.einsum("pij,pj->pi", stated, values))


def components_seen(readings: Observations, at: slice) -> Mask:
    """Return which of some components of readings were seen."""
    return np.asarray(readings.measured.components_seen[:, at])


def keep_their_distances(places_m: Array) -> Mask:
    """Return (P,) which poses have targets (P, B, 3) as far from each other as the others have.

    What was read there is right, whatever a model makes of it. With fewer than two targets none.
    """
    count, targets = places_m.shape[:2]
    pairs = [(a, b) for a in range(targets) for b in range(a)]
    if not pairs or places_m.shape[2] != 3:
        return np.zeros(count, dtype=bool)
    apart_m = np.stack([np.linalg.norm(places_m[:, a] - places_m[:, b], axis=1) for a, b in pairs])
    off_m = np.abs(apart_m - np.nanmedian(apart_m, axis=1, keepdims=True))
    usual_m = MEDIAN_TO_SIGMA * np.nanmedian(off_m, axis=1, keepdims=True)
    seen = np.isfinite(off_m)
    same = np.where(seen, off_m, 0.0) <= SCATTER.same_distance * usual_m
    return np.asarray(same.all(axis=0) & seen.any(axis=0))
