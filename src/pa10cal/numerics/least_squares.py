"""Least squares by damped Gauss-Newton steps on normal equations, with bounds and reweighting.

The solver of every fit but the paper's two levels, which use scipy. Normal equations are accurate
enough here: every unknown has a prior as a row of its own, or the problem is a small geometric one.
Steps that raise the cost are damped as by Levenberg and Marquardt; unknowns that would leave their
range are held at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from pa10cal.arrays import Array

Point = TypeVar("Point")

#: Actual over predicted reduction of the cost below which a step counts as too long.
_POOR = 0.25
#: Damping after a first step that raises the cost, and beyond which none can lower it.
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e8
#: Relative size of rounding: of eigenvalues of normal equations with unit diagonal, and of costs.
_ROUNDING = 1e-14


class Ranged(Protocol):
    """A parameter with a physical range."""

    @property
    def lower(self) -> float | None:
        """Return the lower bound; None where there is none."""

    @property
    def upper(self) -> float | None:
        """Return the upper bound; None where there is none."""


@dataclass(frozen=True)
class Bounds:
    """Physical ranges of k unknowns."""

    # (k,) bounds; infinite where there is none
    lower: Array
    upper: Array

    @classmethod
    def of(cls, parameters: Sequence[Ranged]) -> Bounds:
        """Return the ranges of parameters."""
        return cls(
            np.array([-np.inf if p.lower is None else p.lower for p in parameters]),
            np.array([np.inf if p.upper is None else p.upper for p in parameters]),
        )

    def clip(self, x: Array) -> Array:
        """Return the nearest point within the ranges."""
        return np.clip(x, self.lower, self.upper)

    def beyond(self, x: Array, step: Array) -> Array:
        """Return the correction (k,) of a step that ends outside the ranges; zero within."""
        return self.clip(x + step) - (x + step)

    def held(self, x: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which unknowns are fixed, or at a bound that lower cost lies beyond, (k,)."""
        at_lower = (x <= self.lower) & (gradient > 0.0)
        at_upper = (x >= self.upper) & (gradient < 0.0)
        return np.asarray(at_lower | at_upper | self.fixed, dtype=np.bool_)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Return which unknowns have a range of a single value, (k,)."""
        return np.asarray(self.lower == self.upper, dtype=np.bool_)


@dataclass(frozen=True)
class Equations:
    """Normal equations of a weighted least-squares problem at one point."""

    cost: float  # sum of squares of the residuals r, predicted minus measured
    gradient: Array  # (k,) J^T r, half the gradient of the cost; J is the derivative of r
    normal: Array  # (k, k) J^T J

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> Equations:
        """Return the equations of residuals (R,) with derivative (R, k)."""
        return cls(float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian)


@dataclass(frozen=True)
class Step:
    """An accepted step."""

    step: Array  # (k,)
    held: NDArray[np.bool_]  # (k,) unknowns held at a bound
    before: Equations  # at the point where it began
    gained: float  # decrease of the cost
    damping: float  # relative to the diagonal of the normal equations


@dataclass(frozen=True)
class Minimum(Generic[Point]):
    """The result of a minimisation."""

    at: Point  # the last point
    equations: Equations  # at that point
    iterations: int  # number of accepted steps
    converged: bool  # whether the last step was small, or none lowered the cost
    reason: str  # why it stopped


def minimise(
    start: Point,
    equations: Callable[[Point], Equations],
    moved: Callable[[Point, Array], Point],
    arrived: Callable[[Point, Step], bool],
    *,
    most_steps: int,
    held: Callable[[Point, Array], NDArray[np.bool_]] | None = None,
    beyond: Callable[[Point, Array], Array] | None = None,
    cost: Callable[[Point], float] | None = None,
    reweighted: Callable[[Point, Step], Equations] | None = None,
    first_damping: float = 0.0,
    no_worse: float = 1e-12,
) -> Minimum[Point]:
    """Minimise a sum of squares from a start.

    Args:
        start: the first point, within the ranges of the unknowns.
        equations: returns the equations at a point, by the present weights.
        moved: returns the point after a step (k,), within the ranges.
        arrived: returns whether an accepted step, which led to a point, was the last.
        most_steps: largest number of accepted steps.
        held: returns the unknowns held at a bound, by `Equations.gradient`; None without bounds.
        beyond: returns the correction (k,) of a step that takes unknowns beyond their bounds, zero
            for others; the step of the other unknowns is then solved again. None where there are no
            bounds, or `moved` clips the unknowns by itself.
        cost: returns the cost at a point, where that is cheaper than the equations.
        reweighted: renews the weights after an accepted step and returns the equations by these;
            None where weights stay.
        first_damping: damping of the first step, relative to the diagonal.
        no_worse: relative increase of the cost that counts as rounding.
    """
    at, here, damping = start, equations(start), first_damping
    for count in range(most_steps):
        active = np.zeros(len(here.gradient), bool) if held is None else held(at, here.gradient)
        correction = partial(beyond, at) if beyond is not None else np.zeros_like
        while True:
            step = _step_within(here, ~active, damping, correction)
            next_point = moved(at, step)
            if cost is None:
                there = equations(next_point)
                next_cost = there.cost
            else:
                there, next_cost = None, cost(next_point)
            if next_cost <= here.cost * (1.0 + no_worse):
                break
            damping = max(10.0 * damping, _LEAST_DAMPING)
            if damping > _LARGEST_DAMPING:
                return Minimum(at, here, count, True, "no step reduces the error: rounding")
        taken = Step(step, active, here, here.cost - next_cost, damping)
        if reweighted is not None:
            there = reweighted(next_point, taken)
        at, here = next_point, there or equations(next_point)
        if arrived(at, taken):
            return Minimum(at, here, count + 1, True, "the last step was small")
        predicted = -float(step @ (2.0 * taken.before.gradient + taken.before.normal @ step))
        if taken.gained < _POOR * predicted and predicted > _ROUNDING * next_cost:
            damping = max(10.0 * damping, _LEAST_DAMPING)  # it overshoots a curved valley
        else:
            damping *= 0.1
    return Minimum(at, here, most_steps, False, f"{most_steps} steps were not enough")


def _step_within(
    here: Equations, free: NDArray[np.bool_], damping: float, correction: Callable[[Array], Array]
) -> Array:
    """Return a damped step (k,) of the free unknowns; those that reach a bound stop there."""
    step = np.zeros(len(free))
    while free.any():
        normal, gradient = here.normal, here.gradient
        if not free.all():
            normal = normal[np.ix_(free, free)]
            gradient = gradient[free] + here.normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = -solve_normal(normal, gradient, damping)
        beyond = correction(step)
        step += beyond
        stopped = free & (beyond != 0.0)
        if not stopped.any():
            break
        free = free & ~stopped
    return step


def solve_normal(normal: Array, right: Array, damping: float = 0.0) -> Array:
    """Return the solution of normal equations (k, k) for a right side (k,).

    Along directions that they do not determine, to within rounding, the solution is zero.

    Args:
        damping: added to the diagonal, relative to it.
    """
    if not len(right):
        return np.zeros(0)
    size = np.sqrt(normal.diagonal())
    size[size == 0.0] = 1.0
    unit = normal / (size[:, None] * size)
    unit.flat[:: len(size) + 1] += damping
    _, solved, failed = dposv(unit, right / size)
    if failed:
        values, vectors = np.linalg.eigh(unit)
        determined = values > _ROUNDING * values[-1]
        directions = vectors[:, determined]
        solved = directions @ ((directions.T @ (right / size)) / values[determined])
    return np.asarray(solved / size, dtype=np.float64)
