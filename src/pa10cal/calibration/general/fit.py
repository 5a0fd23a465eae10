"""Weighted, robust least squares for the general model, by Gauss-Newton steps.

Every unknown has a normal prior about its start; its standard deviation is called reach. It is far
larger than the uncertainty from the readings, so it matters only along directions that the readings
hardly determine (a joint that hardly moved, nearly parallel axes): these stay near the start
instead of moving by metres, and count as not identifiable. Unknowns that an earlier fit determined
have the normal distribution of that fit as prior instead. Departures of links and zeros are at last
expected to be as large as those are that the readings do determine (empirical Bayes).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtri

from pa10cal.arrays import Array, Mask
from pa10cal.calibration.rules import FIT, UNKNOWNS
from pa10cal.fit.problem import GaussianPrior, Identifiability, Problem, Rows, Solution, triangle_of
from pa10cal.fit.robust_weights import first_scatter, refreshed, weighted_rows
from pa10cal.numerics.least_squares import Bounds, Equations, Step, minimise, solve_normal
from pa10cal.rules import PARAMETERS

#: Why a fit ended whose unknowns still move while its predictions do not (format).
_STILL = "predictions stand still along directions that the poses hardly identify"


@dataclass(frozen=True)
class Span:
    """Bounds and prior of the k unknowns."""

    bounds: Bounds  # ends of their physical range
    reach: Array  # (k,) beyond which a direction counts as not identified
    # informative prior of the first unknowns in place of the reach; None for none
    expected: GaussianPrior | None
    centre: Array  # (k,) mean of the prior
    rows: Array  # (k + r, k) root W of its precision W'W, rows of the known unknowns first

    @classmethod
    def about(
        cls,
        problem: Problem,
        x_start: Array,
        expected: GaussianPrior | None,
        usual: Array | None = None,
    ) -> Span:
        """Return the prior of a problem's unknowns about a start (k,).

        Args:
            expected: informative prior of the first unknowns; None for none.
            usual: (r, k) further rows of the prior, see `hardly_known`; None for none.
        """
        bounds, reach = Bounds.of(problem.parameters), reach_of(problem)
        centre, rows = bounds.clip(x_start), np.diag(1.0 / reach)
        if expected is not None:
            known = len(expected.mean)
            centre[:known] = expected.mean
            rows[:known, :known] = np.linalg.cholesky(expected.precision, upper=True)
        if usual is not None:
            rows = np.concatenate([rows, usual])
        return cls(bounds, reach, expected, centre, rows)

    @property
    def known(self) -> int:
        """Return how many of the first unknowns have an informative prior."""
        return 0 if self.expected is None else len(self.expected.mean)

    @cached_property
    def precision(self) -> Array:
        """Return the precision (inverse covariance) of the prior, (k, k)."""
        return np.asarray(self.rows.T @ self.rows)

    def pull(self, x: Array) -> tuple[float, Array]:
        """Return the sum of squares of the prior at x (k,), and half its gradient (k,)."""
        residual = self.rows @ (x - self.centre)
        return float(residual @ residual), self.rows.T @ residual


@dataclass(frozen=True)
class GeneralSolution(Solution):
    """Where a fit of the general model ended."""

    # standard deviation of each kind of component beyond what the instrument states [m, rad]
    scatter: dict[str, float]
    weights: Array  # (P,) robust weights of the poses, 1 for those that are no outliers
    distance: Array  # (P,) Mahalanobis distance of each pose's residual
    residual: Array  # (P, b) predicted less seen
    whitener: Array  # (P, b, b) makes stated errors and scatter independent, of unit variance
    # (k, k) of the unknowns, such that 1.96 standard uncertainties make an interval of 95 %, by
    # Student's t where few poses determine the scatter. Along directions that the data do not
    # identify it is the square of the reach.
    covariance: Array
    triangle: Array  # (., k) R of the weighted rows and of the informative rows of `span`
    span: Span  # bounds and prior of the unknowns
    scale: Array  # (k,) their typical sizes
    widening: float = 1.0  # factor of standard uncertainties by Student's t

    @cached_property
    def identifiability(self) -> Identifiability:
        """Return rank and singular values of the weighted rows, in scales.

        Directions that the readings determine no better than the reach do not count; those with an
        informative prior do.
        """
        return _identified(self.triangle, self.scale, self.span.reach, self.span.known)


def fit(
    problem: Problem,
    x_start: Array,
    *,
    robust: bool = True,
    max_iterations: int = FIT.most_steps,
    scatter_start: dict[str, float] | None = None,
    about: Array | None = None,
    expected: GaussianPrior | None = None,
    usual: Array | None = None,
) -> GeneralSolution:
    """Fit the general model.

    Args:
        x_start: (k,) start.
        robust: whether poses far outside the scatter get less weight.
        scatter_start: scatter of each kind at the start [m, rad]; None to estimate it there.
        about: (k,) mean of the prior of the unknowns; None for the start.
        expected: informative prior of the first unknowns; None for none.
        usual: (r, k) further rows of the prior, see `hardly_known`; None for none.
    """
    span = Span.about(problem, x_start if about is None else about, expected, usual)
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
    next_step = _next_step(found.equations, free)
    length = _length_of(next_step, found.equations.normal, int(np.count_nonzero(free)))
    nearly = bool(length < FIT.nearly_errors * weighting.tolerance_factor)
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
        converged=found.converged and (weighting.stand_still or nearly),
        reason=_STILL if found.converged and weighting.stand_still else found.reason,
        widening=scatter.widening,
    )


def _next_step(equations: Equations, free: Mask) -> Array:
    """Return the Gauss-Newton step (k,) of the free unknowns."""
    step = np.zeros(len(equations.gradient))
    step[free] = solve_normal(equations.normal[free][:, free], equations.gradient[free])
    return step


def _length_of(step: Array, normal: Array, count: int) -> float:
    """Return the rms length of a step of `count` unknowns in their standard uncertainties."""
    return float(np.sqrt(max(0.0, float(step @ normal @ step)) / max(1, count)))


def reach_of(problem: Problem) -> Array:
    """Return the standard deviation of the prior of the k unknowns of a problem.

    It is what a parameter states as plausible; else the width of its physical range, or a multiple
    of its scale where that is unbounded.
    """
    bounds = Bounds.of(problem.parameters)
    width = bounds.upper - bounds.lower
    reach = np.where(np.isfinite(width), width, UNKNOWNS.reach_scales * problem.scale)
    plausible = np.array([each.plausible for each in problem.parameters], dtype=float)
    return np.where(np.isnan(plausible), reach, plausible)


class _WeightedProblem:
    """The weighted problem: weights stay while a step is tried, and are renewed when it is taken.

    It also decides whether the fit has converged, by the lengths of the last steps.
    """

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
        # Lengths in standard uncertainties: of the last step, and of the next one; of the next one
        # without the prior, which is how far it moves predictions; and that of the last steps.
        self._length = self._next_length = self._next_moves = np.inf
        self._moved: deque[float] = deque(maxlen=FIT.still_steps)
        # Whether the scatter has converged, and whether it alternated between two values.
        self._settled = self._alternates = False
        if scatter is None:
            self.weighted = weighted_rows(problem, rows, self.scatter, robust)
        else:
            self._renew(start)
        # Where only the shape of the weights is known, weights and springs have a common scale
        # along which no prediction changes: the last step may be longer by this factor.
        self.tolerance_factor = FIT.valley_times if problem.model.u_scale > 0.0 else 1.0

    def rows(self, x: Array) -> Rows:
        """Return the rows at a point; only those of the last point are kept, as they are large."""
        if self._last is None or self._last[0] is not x:
            self._last = None
            self._last = (x, self._problem.rows(x))
        return self._last[1]

    def equations(self, x: Array) -> Equations:
        """Return the normal equations, prior included, where the weights were renewed last."""
        weighted = self.weighted
        prior_squares, prior_gradient = self._span.pull(x)
        gradient = weighted.rows.reshape(-1, len(x)).T @ weighted.residual.ravel()
        return Equations(
            cost=float(np.sum(weighted.residual**2) + prior_squares),
            gradient=gradient + prior_gradient,
            normal=weighted.normal + self._span.precision,
        )

    def cost(self, x: Array) -> float:
        """Return the sum of squares at a point, prior included, with the present weights."""
        root, whitener = np.sqrt(self.weighted.weights)[:, None], self.weighted.whitener
        white = root * np.einsum("pij,pj->pi", whitener, self.rows(x).residual)
        return float(np.sum(white**2) + self._span.pull(x)[0])

    def renewed(self, x: Array, taken: Step) -> Equations:
        """Renew scatter and weights at a point that a step led to; return its equations."""
        self._renew(x)
        gained = max(0.0, -float(taken.before.gradient @ taken.step))
        self._length = np.sqrt(gained / max(1, int(np.count_nonzero(~taken.held))))
        precision, count = self._span.precision, len(x)
        self._moved.append(_length_of(taken.step, taken.before.normal - precision, count))
        equations = self.equations(x)
        free = ~self._span.bounds.held(x, equations.gradient)
        step = _next_step(equations, free)
        self._next_length = _length_of(step, equations.normal, int(np.count_nonzero(free)))
        self._next_moves = _length_of(step, equations.normal - precision, count)
        return equations

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
        # A scatter that alternates between two values would never converge: halve its steps.
        self._alternates |= not self._settled and found.is_about(self._before)
        self._before = self.scatter
        self.scatter = found.halfway(self.scatter) if self._alternates else found
        if self.scatter.size != self._before.size:
            self.weighted = weighted_rows(problem, rows, self.scatter, self._robust)

    def arrived(self, x: Array, taken: Step) -> bool:
        """Return whether step and weights have converged, or predictions stand still."""
        del x, taken
        near = self._length < FIT.arrived_errors * self.tolerance_factor
        near = near or self._next_length < FIT.there_errors
        return bool((near or self.stand_still) and self._settled)

    @property
    def stand_still(self) -> bool:
        """Return whether the last steps moved no prediction, however long the next step is."""
        path = sum(self._moved)
        if len(self._moved) < FIT.still_steps or path >= FIT.still_errors:
            return False
        along_a_valley = self._next_length > FIT.not_taken_times * path / FIT.still_steps
        return along_a_valley and self._next_moves < FIT.bottom_errors


def _identified(rows: Array, scale: Array, reach: Array, known: int) -> Identifiability:
    """Return what rows (r, k) identify of the unknowns, in scales.

    The first unknowns, `known` in number, have an informative prior and count as identified. Of the
    others a direction is identified if the rows determine it better than the reach. A direction
    that is not identified belongs to the unknowns whose uncertainty it mostly causes.
    """
    triangle = np.asarray(np.linalg.qr(rows, mode="r")) if known else rows
    values = np.zeros(len(scale))
    values[: len(triangle)] = np.linalg.svd(triangle * scale, compute_uv=False)
    reach_of_others, others = reach[known:], slice(known, None)
    beyond: Array = triangle[known:, known:] * reach_of_others
    _, singular_values, right = np.linalg.svd(beyond)
    size = np.zeros(len(right))
    size[: len(singular_values)] = singular_values
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
