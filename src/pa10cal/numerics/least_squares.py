"""Least squares by damped Gauss-Newton steps on normal equations, bounded and reweighted.

The solver of every fit but the paper's two levels, which stay with scipy. Normal equations are safe
where it is used: every unknown has an expected size or a reach as a row of its own, or the problem
is a small geometric one. Steps that lead uphill are damped as Levenberg and Marquardt do; unknowns
that press on the end of their range are held there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.linalg.lapack import dposv

from pa10cal.arrays import Array

S = TypeVar("S")

#: Part of the promised reduction below which a step counts as too long.
_POOR = 0.25
#: Damping after a first step that led uphill, and beyond which no direction leads down.
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e8
#: Eigenvalues of normal equations of unit diagonal below this part of the largest are rounding.
_ROUNDING = 1e-14


class Ranged(Protocol):
    """A parameter with a physical range."""

    @property
    def lower(self) -> float | None:
        """Return its lower end, None where there is none."""

    @property
    def upper(self) -> float | None:
        """Return its upper end, None where there is none."""


@dataclass(frozen=True)
class Bounds:
    """Physical range of k unknowns."""

    # lower and upper: (k,) its ends; infinite where there is none
    lower: Array
    upper: Array

    @classmethod
    def of(cls, parameters: Sequence[Ranged]) -> Bounds:
        """Return the range of parameters."""
        return cls(
            np.array([-np.inf if p.lower is None else p.lower for p in parameters]),
            np.array([np.inf if p.upper is None else p.upper for p in parameters]),
        )

    def clip(self, x: Array) -> Array:
        """Return a point moved into the range."""
        return np.clip(x, self.lower, self.upper)

    def beyond(self, x: Array, step: Array) -> Array:
        """Return what brings back into the range what a step takes out of it, (k,)."""
        return self.clip(x + step) - (x + step)

    def held(self, x: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which unknowns press on an end of their range, (k,)."""
        active: NDArray[np.bool_] = ((x <= self.lower) & (gradient > 0.0)) | (
            (x >= self.upper) & (gradient < 0.0)
        )
        return active


@dataclass(frozen=True)
class Equations:
    """A weighted least-squares problem at one point; residuals are predicted less measured."""

    cost: float  # sum of squares
    gradient: Array  # (k,) half its gradient by the unknowns
    normal: Array  # (k, k) normal equations

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> Equations:
        """Return the equations of rows (R,) with derivative (R, k)."""
        return cls(float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian)


@dataclass(frozen=True)
class Step:
    """An accepted step."""

    step: Array  # (k,) the step
    held: NDArray[np.bool_]  # (k,) unknowns held at the end of their range
    before: Equations  # the problem where it began
    gained: float  # by how much the sum of squares fell
    damping: float  # of the normal equations' unit diagonal that it took


@dataclass(frozen=True)
class Minimum(Generic[S]):
    """Where a descent ended."""

    at: S  # the point
    equations: Equations  # the problem there
    iterations: int  # steps accepted
    converged: bool  # whether it stopped by itself, also where no step lowered the cost
    reason: str  # why it stopped


def minimise(
    start: S,
    equations: Callable[[S], Equations],
    moved: Callable[[S, Array], S],
    arrived: Callable[[S, Step], bool],
    *,
    most_steps: int,
    held: Callable[[S, Array], NDArray[np.bool_]] | None = None,
    beyond: Callable[[S, Array], Array] | None = None,
    cost: Callable[[S], float] | None = None,
    reweighted: Callable[[S, Step], Equations] | None = None,
    first_damping: float = 0.0,
    no_worse: float = 1e-12,
) -> Minimum[S]:
    """Minimise a sum of squares from a start.

    Args:
        start: where to set out, inside the range.
        equations: the problem at a point, with the weights as they are.
        moved: the point after a step (k,), inside the range.
        arrived: whether an accepted step, and where it led, was the last.
        most_steps: bound on the steps accepted.
        held: unknowns held at a point, by half the gradient there; None where nothing bounds them.
        beyond: what brings unknowns back that a step (k,) takes beyond their range, zero where it
            takes none: they stop at its end, and the others step as they then should. None where
            they are cut off alone, or nothing bounds them.
        cost: the sum of squares at a point, where that is cheaper than the equations.
        reweighted: renews weights about an accepted point and returns the problem there; None where
            weights stay.
        no_worse: growth of the sum of squares that counts as rounding, relative.
    """
    at, here, damping = start, equations(start), first_damping
    for count in range(most_steps):
        active = np.zeros(len(here.gradient), bool) if held is None else held(at, here.gradient)
        free = ~active
        back = partial(beyond, at) if beyond is not None else np.zeros_like
        while True:
            step = _step_inside(here, free, damping, back)
            tried = moved(at, step)
            if cost is None:
                there = equations(tried)
                ahead = there.cost
            else:
                there, ahead = None, cost(tried)
            if ahead <= here.cost * (1.0 + no_worse):
                break
            damping = max(10.0 * damping, _LEAST_DAMPING)
            if damping > _LARGEST_DAMPING:
                return Minimum(at, here, count, True, "no step reduces the error: rounding")
        taken = Step(step, active, here, here.cost - ahead, damping)
        if reweighted is not None:
            there = reweighted(tried, taken)
        at, here = tried, there or equations(tried)
        if arrived(at, taken):
            return Minimum(at, here, count + 1, True, "the last step was small")
        promised = -float(step @ (2.0 * taken.before.gradient + taken.before.normal @ step))
        if taken.gained < _POOR * promised and promised > _ROUNDING * ahead:
            damping = max(10.0 * damping, _LEAST_DAMPING)  # it overshoots a curved valley
        else:
            damping *= 0.1
    return Minimum(at, here, most_steps, False, f"{most_steps} steps were not enough")


def _step_inside(
    here: Equations, free: NDArray[np.bool_], damping: float, beyond: Callable[[Array], Array]
) -> Array:
    """Return a damped step (k,) of the unknowns that are free, inside their range."""
    step = np.zeros(len(free))
    while free.any():
        normal, gradient = here.normal, here.gradient
        if not free.all():
            normal = normal[np.ix_(free, free)]
            gradient = gradient[free] + here.normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = -solve_normal(normal, gradient, damping)
        back = beyond(step)
        step += back
        stopped = free & (back != 0.0)
        if not stopped.any():
            break
        free = free & ~stopped
    return step


def solve_normal(normal: Array, right: Array, damping: float = 0.0) -> Array:
    """Solve normal equations (k, k) for one right side (k,), damped along their diagonal.

    Directions that they do not determine, to within rounding, keep their values.
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
        known = values > _ROUNDING * values[-1]
        part = vectors[:, known]
        solved = part @ ((part.T @ (right / size)) / values[known])
    return np.asarray(solved / size, dtype=np.float64)


# Damped least squares for small geometric fits, and what they do not identify.

MAX_ITERATIONS = 100
#: The descent ends when no unknown moves further than this (metres and radians), when the cost
#: fell by less than this part of it, or when no step leads down.
STEP_TOLERANCE = 1e-13
COST_TOLERANCE = 1e-15
#: Eigenvalues of normal equations below this part of the largest are directions of no effect.
NO_EFFECT = 1e-14
#: Unknowns of which the others can mimic all but this part are not identified: with geometry that
#: is wrong by millimetres the data would place them metres off.
OPEN = 1e-3


@dataclass(frozen=True)
class Linearised:
    """A least-squares problem at one point."""

    by_step: Array  # (m, k) derivative of the prediction by the step
    residual: Array  # (m,) measured less predicted: the opposite sign to `Equations.of`

    @property
    def cost(self) -> float:
        """Return the sum of squares."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class Split:
    """Unknowns split into what the data identify and what they do not."""

    identified: Array  # (k, r) columns span what is to be solved for
    unidentified: Array  # (k, k - r) columns of unit length span what the data do not identify


def descend(
    start: S,
    linearise: Callable[[S], Linearised],
    moved: Callable[[S, Array], S],
    cost_tolerance: float = COST_TOLERANCE,
    most_steps: int = MAX_ITERATIONS,
) -> tuple[S, Linearised]:
    """Go down from a start by Gauss-Newton steps, damped where they would go up.

    Args:
        moved: a point and a step (k,) to the next point.
        cost_tolerance: the descent ends after a step that lowers the cost by a smaller part of it.
        most_steps: bound on the steps.

    Returns:
        The lowest point reached, and the problem there.
    """

    looked_at: list[tuple[S, Linearised]] = []

    def equations(at: S) -> Equations:
        here = linearise(at)
        looked_at[:] = [*looked_at[-1:], (at, here)]
        towards = here.by_step.T @ here.residual
        return Equations(here.cost, *_determined(-towards, here.by_step.T @ here.by_step))

    def arrived(at: S, taken: Step) -> bool:
        del at
        still = np.abs(taken.step).max(initial=0.0) <= STEP_TOLERANCE
        return bool(still or taken.gained <= cost_tolerance * taken.before.cost)

    found = minimise(start, equations, moved, arrived, most_steps=most_steps)
    for at, here in looked_at:
        if at is found.at:
            return at, here
    return found.at, linearise(found.at)


def _determined(gradient: Array, normal: Array) -> tuple[Array, Array]:
    """Return gradient and normal equations by which directions of no effect are not moved in.

    They are left with no gradient and a large normal term, so that no step has a part in them.
    Scaled to their own size such directions would be worth the largest steps: the height of a fixed
    point in the plane of all poses, say, which changes no distance.
    """
    values, vectors = np.linalg.eigh(normal)
    still = vectors[:, values <= NO_EFFECT * values[-1]]
    if still.shape[1]:
        gradient = gradient - still @ (still.T @ gradient)
        normal = normal + values[-1] * still @ still.T
    return gradient, normal


def split_identified(by_these: Array, by_others: Array) -> Split:
    """Split unknowns into what the data identify and what other unknowns can mimic.

    Args:
        by_these: (m, k) derivative of the prediction by the unknowns to split.
        by_others: (m, l) derivative by the others.
    """
    size = np.maximum(np.sqrt((by_these**2).sum(axis=0)), np.finfo(float).tiny)
    unit = by_these / size
    basis = np.asarray(np.linalg.qr(by_others)[0], dtype=float)
    own = unit - basis @ (basis.T @ unit)
    parts, directions = np.linalg.eigh(own.T @ own)
    steps = np.asarray(directions / size[:, None], dtype=float)
    known = parts > OPEN**2
    return Split(steps[:, known], _plain(steps[:, ~known]))


def axis_text(vector: Array) -> str:
    """Return a direction for messages, its largest component positive."""
    unit = vector / np.linalg.norm(vector) * np.sign(vector[np.argmax(np.abs(vector))])
    return "(" + ", ".join(f"{value:.2f}" for value in unit.round(2) + 0.0) + ")"


def _plain(directions: Array) -> Array:
    """Return columns that span the same as those given, along single unknowns where they can."""
    if not directions.size:
        return directions
    pivots = qr(directions.T, pivoting=True, mode="economic")[2][: directions.shape[1]]
    plain = directions @ np.linalg.inv(directions[pivots])
    return np.asarray(plain / np.linalg.norm(plain, axis=0))
