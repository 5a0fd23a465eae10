"""Weighted, robust least squares for the complete model.

Rows are weighed by the instrument's stated covariance plus a scatter of its own for positions and
for attitudes, found from the residuals: what the model leaves is then no smaller than it is, and
positions and attitudes weigh as they deserve. Poses far outside that scatter weigh less, the less
the further off they are, so that a wrong one neither pulls nor widens; none is left out.

Unknowns are thought to lie within a reach of where they start. That is far wider than what readings
tell of them, so it shows only along directions of which readings tell next to nothing (a joint that
hardly moved, axes all but parallel): these stay about where they were instead of going metres off,
and count as open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from pa10cal.calibration.complete.instrument import kinds
from pa10cal.calibration.complete.problem import Problem, Rows
from pa10cal.calibration.identifiability import NULL_RATIO, Identifiability, identify

Array = NDArray[np.float64]

#: A step this small, in standard uncertainties, ends the search.
_ARRIVED = 1e-6
#: Change of a scatter, relative to its size, that counts as none.
_SAME_SCATTER = 1e-3
#: Share of undisturbed poses that weigh less than fully.
_TAIL = 1e-3
#: The scatter is far too wide when it is this many times the typical square.
_TOO_WIDE = 2.0
_HALVINGS = 12
#: Reach of an unknown in its scale, where it has no physical range that bounds it.
_REACH = 30.0
#: No reading is taken for finer than this [m, rad], so that exact ones have a weight.
_FINEST = 1e-12
#: Eigenvalues of normal equations of unit diagonal below this part of the largest are rounding.
_ROUNDING = 1e-13
#: Intervals of 95 % are to be this many standard uncertainties to either side.
_HALF_WIDTH_95 = float(ndtri(0.975))


@dataclass(frozen=True)
class Fit:
    """Where a fit ended.

    Attributes:
        x: (k,) unknowns.
        at_bound: (k,) unknowns held at the end of their physical range.
        scatter: standard deviation of each kind beyond what the instrument states [m, rad].
        weights: (P,) of the poses, 1 where the robust loss leaves them alone.
        distance: (P,) Mahalanobis distance of each pose's residual.
        residual: (P, b) predicted less seen.
        jacobian: (P, b, k) its derivative.
        whitener: (P, b, b) that makes stated errors and scatter independent and of unit size.
        covariance: (k, k) of the unknowns, such that 1.96 standard uncertainties make an interval
            of 95 %: wider than the normal distribution asks where the scatter was found from few
            poses (Student's t). Directions that the data leave open have none.
        identifiability: rank and singular values of the weighted rows, in scales; directions told
            no better than the reach of the unknowns do not count.
        cost: weighted sum of squares.
        freedoms: components seen less the rank.
        iterations: steps taken.
        converged: whether the last step was within rounding of nothing.
        reason: why it stopped.
    """

    x: Array
    at_bound: NDArray[np.bool_]
    scatter: dict[str, float]
    weights: Array
    distance: Array
    residual: Array
    jacobian: Array
    whitener: Array
    covariance: Array
    identifiability: Identifiability
    cost: float
    freedoms: int
    iterations: int
    converged: bool
    reason: str


def fit(problem: Problem, x_start: Array, *, robust: bool = True, max_iterations: int = 50) -> Fit:
    """Fit the complete model.

    Args:
        problem: the model and what was seen.
        x_start: (k,) where to set out.
        robust: whether poses far outside the scatter weigh less.
        max_iterations: bound on the steps.
    """
    span = _Span.about(problem, x_start)
    x = span.start
    rows = problem.rows(x)
    scatter = _first_scatter(problem, rows)
    converged, reason, iterations = False, f"{max_iterations} steps were not enough", 0
    while iterations < max_iterations:
        iterations += 1
        weighed = _weigh(problem, rows, scatter.size, robust)
        step, length, held = _step(x, weighed, span)
        ahead = _not_uphill(problem, x, step, weighed, span)
        if ahead is None:
            reason = "no step leads down"
            converged = length < _ARRIVED * 1e3
            break
        x = ahead
        rows = problem.rows(x)
        weighed = _weigh(problem, rows, scatter.size, robust)
        refreshed = _scatter(problem, rows, weighed, scatter, span)
        settled = refreshed.is_about(scatter)
        scatter = refreshed
        if length < _ARRIVED and settled:
            converged, reason = True, "the step is within rounding of nothing"
            break
    weighed = _weigh(problem, rows, scatter.size, robust)
    _, _, held = _step(x, weighed, span)
    triangle = np.asarray(np.linalg.qr(weighed.rows.reshape(-1, len(x)), mode="r"))
    identifiability = _identified(triangle, problem.scale, span.reach)
    covariance = scatter.widening**2 * _covariance(triangle, span.reach, ~held)
    seen = int(problem.components_seen.sum())
    return Fit(
        x=x,
        at_bound=held,
        scatter=scatter.size,
        weights=weighed.weights,
        distance=weighed.distance,
        residual=rows.residual,
        jacobian=rows.jacobian,
        whitener=weighed.whitener,
        covariance=covariance,
        identifiability=identifiability,
        cost=float(np.sum(weighed.residual**2)),
        freedoms=seen - identifiability.rank,
        iterations=iterations,
        converged=converged,
        reason=reason,
    )


@dataclass(frozen=True)
class _Span:
    """Where the k unknowns may lie.

    Attributes:
        start: where they are thought to be.
        lower, upper: ends of their physical range; infinite where there is none.
        reach: how far from the start they may well be.
    """

    start: Array
    lower: Array
    upper: Array
    reach: Array

    @classmethod
    def about(cls, problem: Problem, x_start: Array) -> _Span:
        parameters = problem.parameters
        lower = np.array([-np.inf if p.lower is None else p.lower for p in parameters])
        upper = np.array([np.inf if p.upper is None else p.upper for p in parameters])
        reach = np.where(np.isfinite(upper - lower), upper - lower, _REACH * problem.scale)
        return cls(np.clip(x_start, lower, upper), lower, upper, reach)

    def clip(self, x: Array) -> Array:
        return np.clip(x, self.lower, self.upper)

    def off(self, x: Array) -> Array:
        """Return how far the unknowns have gone, in reaches."""
        off: Array = (x - self.start) / self.reach
        return off


@dataclass(frozen=True)
class _Scatter:
    """What residuals show beyond the stated uncertainty, by kind of component.

    Attributes:
        size: standard deviation of it [m, rad].
        stated: what the instrument states [m, rad], on average.
        freedoms: readings that it was found from, less what the fit took up.
    """

    size: dict[str, float]
    stated: dict[str, float]
    freedoms: dict[str, float]

    def is_about(self, other: _Scatter) -> bool:
        return all(
            abs(size - other.size[kind]) <= _SAME_SCATTER * max(size, self.stated[kind])
            for kind, size in self.size.items()
        )

    @property
    def widening(self) -> float:
        """Student's half-width over that of the normal distribution, of the least certain kind.

        The stated part of a variance counts as known, as Welch and Satterthwaite have it.
        """
        found = [
            max(1.0, self.freedoms[kind]) * ((size**2 + self.stated[kind] ** 2) / size**2) ** 2
            for kind, size in self.size.items()
            if size > 0.0
        ]
        return float(stdtrit(min(found), 0.975)) / _HALF_WIDTH_95 if found else 1.0


@dataclass(frozen=True)
class _Weighed:
    """Rows made independent and of unit variance, each pose by its weight."""

    residual: Array
    rows: Array
    normal: Array
    weights: Array
    distance: Array
    whitener: Array


def _weigh(problem: Problem, rows: Rows, scatter: dict[str, float], robust: bool) -> _Weighed:
    whitener = _whitener(problem, scatter)
    white = np.einsum("pij,pj->pi", whitener, rows.residual)
    distance = np.sqrt(np.sum(white**2, axis=1))
    weights: Array = np.ones(len(distance))
    if robust:
        limit = _limit(problem, distance)
        weights = (limit / np.maximum(distance, limit)) ** 2
    root = np.sqrt(weights)
    weighed = (root[:, None, None] * whitener) @ rows.jacobian
    flat = weighed.reshape(-1, weighed.shape[2])
    return _Weighed(root[:, None] * white, weighed, flat.T @ flat, weights, distance, whitener)


def _limit(problem: Problem, distance: Array) -> Array:
    """Return the distance (P,) beyond which a pose weighs less, by its components seen.

    While the scatter is far too wide for most poses, which wrong ones can make it, the limit is
    closer.
    """
    seen = np.maximum(problem.components_seen.sum(axis=1), 1)
    numbers = np.arange(1, seen.max() + 1)
    limits, medians = np.sqrt(chdtri(numbers, _TAIL)), chdtri(numbers, 0.5)
    typical = float(np.median(distance**2 / medians[seen - 1]))
    return np.asarray(limits[seen - 1] * np.sqrt(min(1.0, _TOO_WIDE * typical)), dtype=np.float64)


def _whitener(problem: Problem, scatter: dict[str, float]) -> Array:
    """Return (P, b, b) that makes stated errors and scatter independent and of unit size."""
    own = np.zeros(problem.stated_covariance.shape[1])
    for kind, rows in kinds(problem.seen):
        own[rows] = scatter[kind] ** 2 + _FINEST**2
    total = problem.stated_covariance + np.diag(own)
    inverse: Array = np.linalg.inv(np.linalg.cholesky(total))
    return inverse


def _step(x: Array, weighed: _Weighed, span: _Span) -> tuple[Array, float, NDArray[np.bool_]]:
    """Return the Gauss-Newton step, its length in standard uncertainties, and what is held."""
    gradient = weighed.rows.reshape(-1, len(x)).T @ weighed.residual.ravel() * span.reach
    gradient += span.off(x)
    held = ((x <= span.lower) & (gradient > 0)) | ((x >= span.upper) & (gradient < 0))
    free = ~held
    step = np.zeros(len(x))
    parts = _inverse_root(weighed.normal, span.reach, free)
    step[free] = -parts @ (parts.T @ gradient[free])
    length = float(np.sqrt(max(0.0, -gradient @ step) / max(1, free.sum())))
    return step * span.reach, length, held


def _inverse_root(normal: Array, reach: Array, free: NDArray[np.bool_]) -> Array:
    """Return A with A A^T the covariance of the free unknowns in reaches, a reach in itself."""
    part = (normal * np.outer(reach, reach) + np.eye(len(reach)))[np.ix_(free, free)]
    size = np.sqrt(np.diag(part))
    values, vectors = np.linalg.eigh(part / np.outer(size, size))
    known = values > _ROUNDING * values[-1]
    root: Array = vectors[:, known] / np.sqrt(values[known]) / size[:, None]
    return root


def _not_uphill(
    problem: Problem, x: Array, step: Array, weighed: _Weighed, span: _Span
) -> Array | None:
    """Return the point ahead, the step halved until the weighted squares do not grow."""
    cost = float(np.sum(weighed.residual**2) + np.sum(span.off(x) ** 2))
    root = np.sqrt(weighed.weights)[:, None]
    for _ in range(_HALVINGS):
        ahead = span.clip(x + step)
        white = root * np.einsum("pij,pj->pi", weighed.whitener, problem.residual(ahead))
        if np.sum(white**2) + np.sum(span.off(ahead) ** 2) <= cost * (1.0 + 1e-9) + 1e-12:
            return ahead
        step = 0.5 * step
    return None


def _identified(triangle: Array, scale: Array, reach: Array) -> Identifiability:
    """Return what rows (given by their triangle) tell, in scales, no worse than within a reach."""
    found = identify(triangle, scale)
    told = identify(triangle, reach, least=1.0)
    null_space = np.linalg.qr(told.null_space * (reach / scale)[:, None])[0]
    values = found.singular_values
    return Identifiability(values, told.rank, null_space, float(values[0] / values[told.rank - 1]))


def _covariance(triangle: Array, reach: Array, free: NDArray[np.bool_]) -> Array:
    """Return the covariance of the free unknowns along the directions told."""
    _, values, right = np.linalg.svd(triangle[:, free] * reach[free])
    told = values > max(1.0, NULL_RATIO * values[0])
    root = reach[free, None] * right[: len(values)][told].T / values[told]
    covariance = np.zeros((len(reach), len(reach)))
    covariance[np.ix_(free, free)] = root @ root.T
    return covariance


def _stated_sizes(problem: Problem) -> dict[str, float]:
    """Return the stated standard uncertainty of each kind, on average."""
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    return {
        kind: float(np.sqrt(variances[:, rows][problem.components_seen[:, rows]].mean()))
        for kind, rows in kinds(problem.seen)
    }


def _first_scatter(problem: Problem, rows: Rows) -> _Scatter:
    """Return a scatter to set out with: that of the start itself, which stray poses do not set."""
    found = {}
    for kind, columns in kinds(problem.seen):
        size = np.abs(rows.residual[:, columns][problem.components_seen[:, columns]])
        found[kind] = float(np.median(size) / 0.6745)
    return _Scatter(found, _stated_sizes(problem), dict.fromkeys(found, 0.0))


def _scatter(
    problem: Problem, rows: Rows, weighed: _Weighed, before: _Scatter, span: _Span
) -> _Scatter:
    """Return the scatter of each kind that residuals show beyond what the instrument states.

    A residual is smaller than the error behind it by what the fit took up, its leverage. Components
    count by their precision, and poses far off by the square of their weight: not at all, in the
    end, where a weight alone would let them widen the scatter without bound.
    """
    everything = np.ones(len(span.reach), dtype=bool)
    parts = span.reach[:, None] * _inverse_root(weighed.normal, span.reach, everything)
    leverage = np.sum((weighed.rows @ parts) ** 2, axis=2)
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)
    sizes, freedoms = {}, {}
    for kind, columns in kinds(problem.seen):
        seen, stated = problem.components_seen[:, columns], variances[:, columns]
        counts = np.where(seen, weighed.weights[:, None] ** 2, 0.0)
        left = counts * (1.0 - leverage[:, columns])
        precise = (stated + before.size[kind] ** 2 + _FINEST**2) ** -2.0
        over = counts * rows.residual[:, columns] ** 2 - left * stated
        excess = np.sum(precise * over) / np.sum(precise * left)
        freedoms[kind] = float(np.sum(left))
        sizes[kind] = float(np.sqrt(max(0.0, excess))) if freedoms[kind] > 1.0 else 0.0
    return _Scatter(sizes, before.stated, freedoms)
