"""Least squares by damped Gauss-Newton steps on normal equations, bounded and reweighted.

The one solver of every fit but the paper's two levels, which stay with scipy. Normal equations are
safe where it is used: every unknown has an expected size or a reach as a row of its own, or the
problem is a small geometric one. Steps that lead uphill are damped as Levenberg and Marquardt do;
unknowns that press on the end of their range are held there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]
S = TypeVar("S")

#: Damping after a first step that led uphill, and beyond which no direction leads down.
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e8
#: Growth of a sum of squares that counts as rounding, relative.
_NO_WORSE = 1e-12
#: Eigenvalues of normal equations of unit diagonal below this part of the largest are rounding.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class Equations:
    """A weighted least-squares problem at one point.

    Attributes:
        cost: sum of squares.
        gradient: (k,) half its gradient by the unknowns.
        normal: (k, k) normal equations.
    """

    cost: float
    gradient: Array
    normal: Array

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> Equations:
        """Return the equations of rows (R,) with derivative (R, k)."""
        return cls(float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian)


@dataclass(frozen=True)
class Bounds:
    """Physical range of k unknowns.

    Attributes:
        lower, upper: (k,) its ends; infinite where there is none.
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Bounds:
        """Return the range of parameters."""
        return cls(
            np.array([-np.inf if p.lower is None else p.lower for p in parameters]),
            np.array([np.inf if p.upper is None else p.upper for p in parameters]),
        )

    def clip(self, x: Array) -> Array:
        """Return a point moved into the range."""
        return np.clip(x, self.lower, self.upper)

    def held(self, x: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which unknowns press on an end of their range, (k,)."""
        pressing: NDArray[np.bool_] = ((x <= self.lower) & (gradient > 0.0)) | (
            (x >= self.upper) & (gradient < 0.0)
        )
        return pressing


class LeastSquares(ABC, Generic[S]):
    """A least-squares problem whose points are of type S, an array or something that moves."""

    #: Damping of the first step.
    first_damping: float = 0.0

    @abstractmethod
    def equations(self, at: S) -> Equations:
        """Return the problem at a point, with the weights as they are."""

    @abstractmethod
    def moved(self, at: S, step: Array) -> S:
        """Return the point after a step (k,), inside the range."""

    def held(self, at: S, gradient: Array) -> NDArray[np.bool_]:  # noqa: ARG002
        """Return which unknowns are held at a point, (k,): none where there is no range."""
        return np.zeros(len(gradient), dtype=bool)

    @abstractmethod
    def arrived(self, at: S, step: Array, before: Equations, gained: float) -> bool:
        """Tell whether an accepted step was the last.

        Args:
            at: where it led.
            step: (k,) the step.
            before: the problem where it began.
            gained: by how much the sum of squares fell.
        """

    def reweigh(self, at: S) -> bool:  # noqa: ARG002
        """Renew weights about an accepted point; tell whether they changed."""
        return False


@dataclass(frozen=True)
class Minimum(Generic[S]):
    """Where a descent ended.

    Attributes:
        at: the point.
        equations: the problem there.
        held: (k,) unknowns held at the end of their range.
        iterations: steps accepted.
        converged: whether it stopped by itself.
        reason: why it stopped.
    """

    at: S
    equations: Equations
    held: NDArray[np.bool_]
    iterations: int
    converged: bool
    reason: str


def minimise(problem: LeastSquares[S], start: S, most_steps: int) -> Minimum[S]:
    """Minimise a sum of squares from a start.

    Args:
        problem: gives equations, moves points, says when to stop.
        start: where to set out, inside the range.
        most_steps: bound on the steps accepted.
    """
    at, here, damping = start, problem.equations(start), problem.first_damping
    converged, reason, count = False, f"{most_steps} steps were not enough", 0
    while count < most_steps and not converged:
        free = ~problem.held(at, here.gradient)
        normal, gradient = here.normal[np.ix_(free, free)], here.gradient[free]
        while True:
            step = np.zeros(len(free))
            step[free] = -solve_normal(normal, gradient, damping)
            tried = problem.moved(at, step)
            there = problem.equations(tried)
            if there.cost <= here.cost * (1.0 + _NO_WORSE):
                break
            damping = max(10.0 * damping, _LEAST_DAMPING)
            if damping > _LARGEST_DAMPING:
                return Minimum(at, here, ~free, count, True, "no step leads down: rounding")
        count += 1
        settled = not problem.reweigh(tried)
        converged = problem.arrived(tried, step, here, here.cost - there.cost) and settled
        at, here = tried, there if settled else problem.equations(tried)
        damping *= 0.1
    if converged:
        reason = "the last step was a small part of the uncertainty"
    return Minimum(at, here, problem.held(at, here.gradient), count, converged, reason)


def solve_normal(normal: Array, right: Array, damping: float = 0.0) -> Array:
    """Solve normal equations (k, k) for one right side (k,), damped along their diagonal.

    Directions that they leave open, to within rounding, are left where they are.
    """
    size = np.sqrt(np.diag(normal))
    size[size == 0.0] = 1.0
    unit = normal / np.outer(size, size)
    unit[np.diag_indices_from(unit)] += damping
    try:
        solved = cho_solve(cho_factor(unit), right / size)
    except LinAlgError:
        values, vectors = np.linalg.eigh(unit)
        known = values > _ROUNDING * values[-1]
        part = vectors[:, known]
        solved = part @ ((part.T @ (right / size)) / values[known])
    return np.asarray(solved / size, dtype=np.float64)
