"""Gauss-Newton descent for small geometric fits, and the unknowns that such a fit identifies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg import qr

from pa10cal.arrays import Array
from pa10cal.numerics.least_squares import Equations, Step, minimise

Point = TypeVar("Point")

#: A descent ends after so many steps, when no unknown moves by more than a tolerance [m, rad], when
#: the cost falls by less than a relative tolerance, or when no step lowers it.
MAX_ITERATIONS, STEP_TOLERANCE, COST_TOLERANCE = 100, 1e-13, 1e-15
#: Directions without effect: eigenvalues of the normal equations below this part of the largest.
NO_EFFECT = 1e-14
#: Unknowns are not identified if others can reproduce all but this part of their effect: an error
#: of millimetres in the nominal geometry would move their estimates by metres.
OPEN = 1e-3


@dataclass(frozen=True)
class Linearised:
    """A least-squares problem at one point."""

    by_step: Array  # (m, k) derivative of the prediction by the step
    residual: Array  # (m,) measured minus predicted: the opposite sign to `Equations.of`

    @property
    def cost(self) -> float:
        """Return the sum of squares."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class Split:
    """Directions of k unknowns that the data identify, and those that they do not."""

    identified: Array  # (k, r) a column a direction
    unidentified: Array  # (k, k - r) a column a direction, of unit length


def descend(
    start: Point,
    linearise: Callable[[Point], Linearised],
    moved: Callable[[Point, Array], Point],
    cost_tolerance: float = COST_TOLERANCE,
    most_steps: int = MAX_ITERATIONS,
) -> tuple[Point, Linearised]:
    """Minimise the sum of squares from a start by Gauss-Newton steps, damped if they raise it.

    Args:
        linearise: returns the problem at a point.
        moved: returns the point after a step (k,).
        cost_tolerance: a step that lowers the cost by less, relative, is the last.
        most_steps: largest number of steps.

    Returns:
        The point of the lowest cost, and the problem there.
    """

    last_two: list[tuple[Point, Linearised]] = []  # the last of them may have been rejected

    def equations(at: Point) -> Equations:
        here = linearise(at)
        last_two[:] = [*last_two[-1:], (at, here)]
        downhill = here.by_step.T @ here.residual
        return Equations(here.cost, *_without_no_effect(-downhill, here.by_step.T @ here.by_step))

    def arrived(at: Point, taken: Step) -> bool:
        del at
        still = np.abs(taken.step).max(initial=0.0) <= STEP_TOLERANCE
        return bool(still or taken.gained <= cost_tolerance * taken.before.cost)

    minimum = minimise(start, equations, moved, arrived, most_steps=most_steps)
    for at, here in last_two:
        if at is minimum.at:
            return at, here
    return minimum.at, linearise(minimum.at)


def _without_no_effect(gradient: Array, normal: Array) -> tuple[Array, Array]:
    """Return gradient and normal equations whose steps have no part in directions without effect.

    These get a gradient of zero and a large normal term. Scaled to unit diagonal, rounding would
    make large steps of them: of the height of a fixed point in the plane of all poses, for example,
    which changes no distance.
    """
    values, vectors = np.linalg.eigh(normal)
    no_effect = vectors[:, values <= NO_EFFECT * values[-1]]
    if no_effect.shape[1]:
        gradient = gradient - no_effect @ (no_effect.T @ gradient)
        normal = normal + values[-1] * no_effect @ no_effect.T
    return gradient, normal


def split_identified(by_these: Array, by_others: Array) -> Split:
    """Split directions of unknowns by whether other unknowns can reproduce their effect.

    Args:
        by_these: (m, k) derivative of the prediction by the unknowns to split.
        by_others: (m, l) derivative by the others.
    """
    size = np.maximum(np.sqrt((by_these**2).sum(axis=0)), np.finfo(float).tiny)
    unit = by_these / size
    basis = np.asarray(np.linalg.qr(by_others)[0], dtype=float)
    not_reproduced = unit - basis @ (basis.T @ unit)
    squares, directions = np.linalg.eigh(not_reproduced.T @ not_reproduced)
    steps = np.asarray(directions / size[:, None], dtype=float)
    identified = squares > OPEN**2
    return Split(steps[:, identified], _along_single_unknowns(steps[:, ~identified]))


def axis_text(vector: Array) -> str:
    """Return a direction for messages, its largest component positive."""
    unit = vector / np.linalg.norm(vector) * np.sign(vector[np.argmax(np.abs(vector))])
    return "(" + ", ".join(f"{value:.2f}" for value in unit.round(2) + 0.0) + ")"


def _along_single_unknowns(directions: Array) -> Array:
    """Return unit columns of the same span, along single unknowns as far as possible."""
    if not directions.size:
        return directions
    pivots = qr(directions.T, pivoting=True, mode="economic")[2][: directions.shape[1]]
    sparse = directions @ np.linalg.inv(directions[pivots])
    return np.asarray(sparse / np.linalg.norm(sparse, axis=0))
