"""Damped least squares for small geometric fits, and what they do not identify."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg import qr

from pa10cal.arrays import Array
from pa10cal.fit.least_squares import Equations, Step, minimise

S = TypeVar("S")

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
    residual: Array  # (m,) measured less predicted

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
) -> tuple[S, Linearised]:
    """Go down from a start by Gauss-Newton steps, damped where they would go up.

    Args:
        start: where to begin.
        linearise: the problem at a point.
        moved: a point and a step (k,) to the next point.
        cost_tolerance: a step that lowers the cost by a smaller part of it is not taken.

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

    found = minimise(start, equations, moved, arrived, most_steps=MAX_ITERATIONS)
    for at, here in looked_at:
        if at is found.at:
            return at, here
    return found.at, linearise(found.at)


def _determined(gradient: Array, normal: Array) -> tuple[Array, Array]:
    """Return gradient and normal equations by which directions of no effect are not moved in.

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
