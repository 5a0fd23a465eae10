"""Weighted, robust least squares for the general model, by Gauss-Newton steps.

Unknowns are expected within a reach of their start. It is far wider than the uncertainty from the
readings, so it matters only along directions that readings hardly determine (a joint that hardly
moved, nearly parallel axes): these stay about where they were instead of moving by metres, and
count as not identifiable. What an earlier fit says of some of them takes the place of their reach.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtri

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.rules import FIT, UNKNOWNS
from pa10cal.fit.identifiability import Identifiability, triangle_of
from pa10cal.fit.problem import GaussianPrior, Problem, Rows, Solution
from pa10cal.fit.robust_weights import first_scatter, refreshed, weighted_rows
from pa10cal.numerics.least_squares import Bounds, Equations, Step, minimise, solve_normal
from pa10cal.rules import PARAMETERS

_STILL = "predictions stand still along directions that the poses hardly identify"


@dataclass(frozen=True)
class Span:
    """Where the k unknowns may lie, and what is expected of them before any reading."""

    bounds: Bounds  # ends of their physical range
    reach: Array  # (k,) how far from the start they may well be
    known: int  # of how many, the first, something is known in place of start and reach
    centre: Array  # (k,) where they are expected
    rows: Array  # (k, k) rows of unit variance that say so, those of the known first

    @classmethod
    def about(cls, problem: Problem, x_start: Array, expected: GaussianPrior | None) -> Span:
        """Return what is expected of the unknowns (k,) of a problem about a point."""
        bounds, reach = Bounds.of(problem.parameters), reach_of(problem)
        centre, rows, known = bounds.clip(x_start), np.diag(1.0 / reach), 0
        if expected is not None:
            known = len(expected.mean)
            centre[:known] = expected.mean
            rows[:known, :known] = np.linalg.cholesky(expected.precision, upper=True)
        return cls(bounds, reach, known, centre, rows)

    @cached_property
    def precision(self) -> Array:
        """Return how precisely the unknowns are known before any reading, (k, k)."""
        return np.asarray(self.rows.T @ self.rows)

    def pull(self, x: Array) -> tuple[float, Array]:
        """Return the squares of what takes unknowns back, and half their gradient (k,)."""
        off = self.rows @ (x - self.centre)
        return float(off @ off), self.rows.T @ off


@dataclass(frozen=True)
class GeneralSolution(Solution):
    """Where a fit of the general model ended."""

    # standard deviation of each kind beyond what the instrument states [m, rad]
    scatter: dict[str, float]
    weights: Array  # (P,) of the poses, 1 where the robust loss leaves them alone
    distance: Array  # (P,) Mahalanobis distance of each pose's residual
    residual: Array  # (P, b) predicted less seen
    whitener: Array  # (P, b, b) that makes stated errors and scatter independent and of unit size
    # (k, k) of the unknowns, such that 1.96 standard uncertainties make an interval of 95 %: wider
    # than that of the normal distribution where the scatter was found from few poses (Student's
    # t). Along directions that the data do not identify it is the reach.
    covariance: Array
    triangle: Array  # (., k) R of the weighted rows and of the known part of `span`
    span: Span  # where the unknowns were expected
    scale: Array  # (k,) their typical sizes
    # by which factor standard uncertainties are wider for the readings being few
    widening: float = 1.0

    @cached_property
    def identifiability(self) -> Identifiability:
        """Return rank and singular values of the weighted rows, in scales.

        Directions identified no better than the reach of the unknowns do not count; those of which
        something was known before do.
        """
        return _identified(self.triangle, self.scale, self.span.reach, self.span.known)


def fit(
    problem: Problem,
    x_start: Array,
    *,
    robust: bool = True,
    max_iterations: int = 50,
    scatter_start: dict[str, float] | None = None,
    about: Array | None = None,
    expected: GaussianPrior | None = None,
) -> GeneralSolution:
    """Fit the general model.

    Args:
        x_start: (k,) where to set out.
        scatter_start: scatter of each kind to set out with [m, rad]; None for that at the start.
        about: (k,) where unknowns are within their reach; None for where it sets out.
        expected: what is known of the first unknowns before any reading; None for nothing.
    """
    span = Span.about(problem, x_start if about is None else about, expected)
    start = span.bounds.clip(x_start)
    weighting = _WeightedProblem(problem, span, robust, start, scatter_start)
    found = minimise(
        start,
        weighting.equations,
        lambda x, step: span.bounds.clip(x + step),
        weighting.arrived,
        most_steps=max_iterations,
        held=span.bounds.held,
        cost=weighting.cost,
        reweighted=weighting.renewed,
        no_worse=FIT.no_worse,
    )
    x, scatter, weighted = found.at, weighting.scatter, weighting.weighted
    held = span.bounds.held(x, found.equations.gradient)
    free = ~held
    triangle = triangle_of(weighted.rows.reshape(-1, len(x)))
    root = np.linalg.inv(np.linalg.qr(np.concatenate([triangle, span.rows])[:, free], mode="r"))
    covariance = np.zeros((len(x), len(x)))
    covariance[np.ix_(free, free)] = root @ root.T
    ahead = _step_ahead(found.equations, free)
    length = _length_of(ahead, found.equations.normal, int(np.count_nonzero(free)))
    return GeneralSolution(
        x=x,
        at_bound=held,
        scatter=scatter.size,
        weights=weighted.weights,
        distance=weighted.distance,
        residual=weighting.rows(x).residual,
        whitener=weighted.whitener,
        covariance=scatter.widening**2 * covariance,
        triangle=np.concatenate([triangle, span.rows[: span.known]]),
        span=span,
        scale=problem.scale,
        cost=float(np.sum(weighted.residual**2)),
        iterations=found.iterations,
        converged=found.converged
        and (weighting.stand_still or bool(length < FIT.nearly_errors * weighting.patience)),
        reason=_STILL if found.converged and weighting.stand_still else found.reason,
        widening=scatter.widening,
    )


def _step_ahead(here: Equations, free: Mask) -> Array:
    """Return the next step (k,) of those that are free."""
    step = np.zeros(len(here.gradient))
    step[free] = solve_normal(here.normal[free][:, free], here.gradient[free])
    return step


def _length_of(step: Array, normal: Array, count: int) -> float:
    """Return the length of a step in standard uncertainties that normal equations tell."""
    return float(np.sqrt(max(0.0, float(step @ normal @ step)) / max(1, count)))


def reach_of(problem: Problem) -> Array:
    """Return how far from their start the k unknowns of a problem may well be."""
    bounds = Bounds.of(problem.parameters)
    width = bounds.upper - bounds.lower
    reach = np.where(np.isfinite(width), width, UNKNOWNS.reach_scales * problem.scale)
    expected = np.array([each.plausible for each in problem.parameters], dtype=float)
    return np.where(np.isnan(expected), reach, expected)


class _WeightedProblem:
    """The weighted problem: weights stay while a step is tried, and are renewed at its end."""

    def __init__(
        self,
        problem: Problem,
        span: Span,
        robust: bool,
        start: Array,
        scatter: dict[str, float] | None,
    ) -> None:
        self._problem, self._span, self._robust = problem, span, robust
        self._last: tuple[Array, Rows] | None = None
        rows = self.rows(start)
        first = first_scatter(problem, rows)
        self.scatter = first if scatter is None else replace(first, size=scatter)
        self._before = self.scatter
        self._length = self._ahead = self._moved_ahead = np.inf
        self._settled = self._turns = False
        # by how much the last steps moved predictions
        self._moved: deque[float] = deque(maxlen=FIT.still_steps)
        if scatter is None:
            self.weighted = weighted_rows(problem, rows, self.scatter, robust)
        else:
            self._renew(start)
        valley = problem.model.u_scale > 0.0  # of the weights only the shape is known
        #: How much longer than usual the last step may be.
        self.patience = FIT.valley_times if valley else 1.0

    def rows(self, x: Array) -> Rows:
        """Return the rows at a point, those of the last one looked at kept and no others.

        Of large campaigns nothing takes as much room.
        """
        if self._last is None or self._last[0] is not x:
            self._last = None
            self._last = (x, self._problem.rows(x))
        return self._last[1]

    def equations(self, x: Array) -> Equations:
        """Return the problem where the weights were renewed last, with what unknowns expect."""
        weighted, (squares, pull) = self.weighted, self._span.pull(x)
        return Equations(
            cost=float(np.sum(weighted.residual**2) + squares),
            gradient=weighted.rows.reshape(-1, len(x)).T @ weighted.residual.ravel() + pull,
            normal=weighted.normal + self._span.precision,
        )

    def cost(self, x: Array) -> float:
        """Return the sum of squares at a point, with the weights as they are."""
        root, whitener = np.sqrt(self.weighted.weights)[:, None], self.weighted.whitener
        white = root * np.einsum("pij,pj->pi", whitener, self.rows(x).residual)
        return float(np.sum(white**2) + self._span.pull(x)[0])

    def renewed(self, x: Array, taken: Step) -> Equations:
        """Renew scatter and weights about a point that a step led to."""
        self._renew(x)
        gained = max(0.0, -float(taken.before.gradient @ taken.step))
        self._length = np.sqrt(gained / max(1, int(np.count_nonzero(~taken.held))))
        # Without what is expected of the unknowns a step's length is that of its predictions.
        precision, count = self._span.precision, len(x)
        self._moved.append(_length_of(taken.step, taken.before.normal - precision, count))
        here = self.equations(x)
        free = ~self._span.bounds.held(x, here.gradient)
        step = _step_ahead(here, free)
        self._ahead = _length_of(step, here.normal, int(np.count_nonzero(free)))
        self._moved_ahead = _length_of(step, here.normal - precision, count)
        return here

    def _renew(self, x: Array) -> None:
        """Renew scatter and weights about a point."""
        problem, span, rows = self._problem, self._span, self.rows(x)
        weighted = self.weighted = weighted_rows(problem, rows, self.scatter, self._robust)
        information = weighted.normal + span.precision
        size = np.sqrt(np.diag(information))
        upper = np.linalg.cholesky(information / np.outer(size, size), upper=True)
        parts = dtrtri(upper)[0] / size[:, None]
        found = refreshed(problem, rows, weighted, parts, self.scatter)
        self._settled = found.is_about(self.scatter)
        # A scatter that leaves a fit from which the one before is found would go on for ever.
        self._turns |= not self._settled and found.is_about(self._before)
        self._before = self.scatter
        self.scatter = found.halfway(self.scatter) if self._turns else found
        if self.scatter.size != self._before.size:
            self.weighted = weighted_rows(problem, rows, self.scatter, self._robust)

    def arrived(self, x: Array, taken: Step) -> bool:
        """Return whether step and weights have converged, or predictions stand still."""
        del x, taken
        near = self._length < FIT.arrived_errors * self.patience or self._ahead < FIT.there_errors
        return bool((near or self.stand_still) and self._settled)

    @property
    def stand_still(self) -> bool:
        """Return whether the last steps moved no prediction, however long the step ahead is."""
        path = sum(self._moved)
        if len(self._moved) < FIT.still_steps or path >= FIT.still_errors:
            return False
        along_a_valley = self._ahead > FIT.not_taken_times * path / FIT.still_steps
        return along_a_valley and self._moved_ahead < FIT.bottom_errors


def _identified(rows: Array, scale: Array, reach: Array, known: int) -> Identifiability:
    """Return what rows (r, k) identify, in scales, at worst within a reach.

    Of the first unknowns so many are known before; the others are identified by what readings say
    beyond these. A null direction counts for those unknowns whose uncertainty it mostly causes.
    """
    triangle = np.asarray(np.linalg.qr(rows, mode="r")) if known else rows
    values = np.zeros(len(scale))
    values[: len(triangle)] = np.linalg.svd(triangle * scale, compute_uv=False)
    reach_of_others, others = reach[known:], slice(known, None)
    beyond: Array = triangle[known:, known:] * reach_of_others
    _, found, right = np.linalg.svd(beyond)
    size = np.zeros(len(right))
    size[: len(found)] = found
    identified = size > max(1.0, PARAMETERS.null_ratio * size[0])
    rank = known + int(np.count_nonzero(identified))
    part = np.abs(right[~identified])
    mostly = np.linalg.norm(part, axis=0) > np.linalg.norm(
        right[identified].T / size[identified], axis=1
    )
    mostly |= np.any(part > UNKNOWNS.mostly_share * part.max(axis=1, keepdims=True), axis=0)
    null_space = np.zeros((len(scale), len(part)))
    null_space[others] = np.linalg.qr(
        (right[~identified] * mostly * reach_of_others / scale[others]).T
    )[0]
    return Identifiability(values, rank, null_space, float(values[0] / values[rank - 1]))
