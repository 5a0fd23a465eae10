"""Weighted, robust least squares for the general model, by Gauss-Newton steps.

Unknowns are thought to lie within a reach of where they start. That is far wider than what readings
tell of them, so it shows only along directions of which readings tell next to nothing (a joint that
hardly moved, axes all but parallel): these stay about where they were instead of going metres off,
and count as open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.fit.identifiability import NULL_RATIO, Identifiability, identify
from pa10cal.fit.problem import Problem, Rows
from pa10cal.fit.robust_weights import Weighed, first_scatter, refreshed, weigh

Array = NDArray[np.float64]

#: A step this small, in standard uncertainties, ends the search ...
_ARRIVED = 1e-4
#: ... and so does one that leads nowhere if it is this small.
_NEARLY = 1e-3
_HALVINGS = 12
#: Reach of an unknown in its scale, where it has no physical range that bounds it.
_REACH = 30.0
#: Eigenvalues of normal equations of unit diagonal below this part of the largest are rounding.
_ROUNDING = 1e-13


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
            poses (Student's t). Along directions that the data leave open it is the reach.
        identifiability: rank and singular values of the weighted rows, in scales; directions told
            no better than the reach of the unknowns do not count.
        cost: weighted sum of squares.
        dof: components seen less the rank.
        iterations: steps taken.
        converged: whether the last step was a small part of the uncertainty.
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
    dof: int
    iterations: int
    converged: bool
    reason: str


def fit(problem: Problem, x_start: Array, *, robust: bool = True, max_iterations: int = 50) -> Fit:
    """Fit the general model.

    Args:
        problem: the model and what was seen.
        x_start: (k,) where to set out.
        robust: whether poses far outside the scatter weigh less.
        max_iterations: bound on the steps.
    """
    span = _Span.about(problem, x_start)
    x = span.start
    rows = problem.rows(x)
    scatter = first_scatter(problem, rows)
    converged, reason, iterations = False, f"{max_iterations} steps were not enough", 0
    while iterations < max_iterations:
        iterations += 1
        weighed = weigh(problem, rows, scatter, robust)
        step, length, held = _step(x, weighed, span)
        ahead = _not_uphill(problem, x, step, weighed, span)
        if ahead is None:
            reason = "no step leads down"
            converged = length < _NEARLY
            break
        x, rows = ahead
        weighed = weigh(problem, rows, scatter, robust)
        parts = span.reach[:, None] * _inverse_root(weighed.normal, span.reach)
        found = refreshed(problem, rows, weighed, parts, scatter)
        settled = found.is_about(scatter)
        scatter = found
        if length < _ARRIVED and settled:
            converged, reason = True, "the last step was a small part of the uncertainty"
            break
    weighed = weigh(problem, rows, scatter, robust)
    held = span.held(x, _gradient(x, weighed, span))
    triangle = np.asarray(np.linalg.qr(weighed.rows.reshape(-1, len(x)), mode="r"))
    directions = _directions(triangle, span.reach)
    identifiability = _identified(triangle, directions, problem.scale, span.reach)
    if held.any():
        directions = _directions(triangle[:, ~held], span.reach[~held])
    covariance = scatter.widening**2 * _covariance(directions, span.reach, ~held)
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
        dof=problem.readings - identifiability.rank,
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

    def held(self, x: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which unknowns press on an end of their range."""
        pressing: NDArray[np.bool_] = ((x <= self.lower) & (gradient > 0)) | (
            (x >= self.upper) & (gradient < 0)
        )
        return pressing


def _gradient(x: Array, weighed: Weighed, span: _Span) -> Array:
    """Return half the gradient of the sum of squares by the unknowns in reaches."""
    gradient = weighed.rows.reshape(-1, len(x)).T @ weighed.residual.ravel() * span.reach
    return np.asarray(gradient + span.off(x))


def _step(x: Array, weighed: Weighed, span: _Span) -> tuple[Array, float, NDArray[np.bool_]]:
    """Return the Gauss-Newton step, its length in standard uncertainties, and what is held."""
    gradient = _gradient(x, weighed, span)
    held = span.held(x, gradient)
    free = ~held
    step = np.zeros(len(x))
    parts = _inverse_root(weighed.normal[np.ix_(free, free)], span.reach[free])
    step[free] = -parts @ (parts.T @ gradient[free])
    length = float(np.sqrt(max(0.0, -gradient @ step) / max(1, free.sum())))
    return step * span.reach, length, held


def _inverse_root(normal: Array, reach: Array) -> Array:
    """Return A with A A^T the covariance of unknowns in reaches, before any reading a reach."""
    part = normal * np.outer(reach, reach) + np.eye(len(reach))
    size = np.sqrt(np.diag(part))
    values, vectors = np.linalg.eigh(part / np.outer(size, size))
    known = values > _ROUNDING * values[-1]
    root: Array = vectors[:, known] / np.sqrt(values[known]) / size[:, None]
    return root


def _not_uphill(
    problem: Problem, x: Array, step: Array, weighed: Weighed, span: _Span
) -> tuple[Array, Rows] | None:
    """Return the point ahead and its rows, halving until the weighted squares do not grow."""
    cost = float(np.sum(weighed.residual**2) + np.sum(span.off(x) ** 2))
    root = np.sqrt(weighed.weights)[:, None]
    for _ in range(_HALVINGS):
        ahead = span.clip(x + step)
        rows = problem.rows(ahead)
        white = root * np.einsum("pij,pj->pi", weighed.whitener, rows.residual)
        if np.sum(white**2) + np.sum(span.off(ahead) ** 2) <= cost * (1.0 + 1e-9) + 1e-12:
            return ahead, rows
        step = 0.5 * step
    return None


def _identified(
    triangle: Array, directions: tuple[Array, Array], scale: Array, reach: Array
) -> Identifiability:
    """Return what rows (given by their triangle) tell, in scales, no worse than within a reach.

    A direction is open in those unknowns whose uncertainty it makes for the most part.
    """
    found = identify(triangle, scale)
    size, right = directions
    told = size > max(1.0, NULL_RATIO * size[0])
    rank, values = int(np.count_nonzero(told)), found.singular_values
    part = np.abs(right[~told])
    mostly = np.linalg.norm(part, axis=0) > np.linalg.norm(right[told].T / size[told], axis=1)
    mostly |= np.any(part > 0.5 * part.max(axis=1, keepdims=True), axis=0)
    null_space = np.linalg.qr((right[~told] * mostly * reach / scale).T)[0]
    return Identifiability(values, rank, null_space, float(values[0] / values[rank - 1]))


def _directions(triangle: Array, reach: Array) -> tuple[Array, Array]:
    """Return the singular values (k,) of rows in reaches, and right singular vectors as rows."""
    _, values, right = np.linalg.svd(triangle * reach)
    size = np.zeros(len(right))
    size[: len(values)] = values
    return size, right


def _covariance(directions: tuple[Array, Array], reach: Array, free: NDArray[np.bool_]) -> Array:
    """Return the covariance (k, k) of the free unknowns by the directions of theirs, and reach."""
    size, right = directions
    root = reach[free, None] * right.T / np.hypot(size, 1.0)
    covariance = np.zeros((len(reach), len(reach)))
    covariance[np.ix_(free, free)] = root @ root.T
    return covariance
