"""What has no name, as terms: a smooth displacement by the joints' positions, and a sum of terms.

The displacement is a Gaussian process through some places (Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006, chapter 2; the places as in the subset of regressors, section
8.3.1): far from where anything was measured it is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal, TypeGuard

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.terms.term import OPTIONAL, Report, Role, Term, TermParameter, Traits

#: Part of a variance that no neighbour foretells; keeps the covariance of places well conditioned.
_JITTER = 1e-6
_AXES = 3
#: How the correlation of two places falls with their distance over the length. By the exponential
#: the displacement is continuous and has no derivative, by its square it is smooth.
Kernel = Literal["squared exponential", "exponential"]
_POWERS: dict[Kernel, str] = {"squared exponential": "-d_k^2 / (2 length_m^2)"}
_POWERS["exponential"] = "-d_k / length_m"
#: Where it stands among the places of what is explained.
NO_NAME = "without a name, predicted"


@dataclass(frozen=True)
class Field(Traits):
    """Moves the arm along base axes, by amounts that change smoothly with the joints' positions.

    Solved in amounts, those of all places along one axis after the other, that are independent of
    each other and of the size expected before anything is measured.
    """

    q: tuple[tuple[float, ...], ...]  # (m, n) places [rad, m]
    # (n,) how far a joint moves the end: metres a radian where it turns, 1 where it slides
    lever_m: tuple[float, ...]
    turns: tuple[bool, ...]  # (n,) whether a joint turns
    length_m: float  # distance of poses over which it changes
    size_m: float  # standard deviation expected of the displacement along each axis
    kernel: Kernel = field(default="squared exponential", metadata={OPTIONAL: True})
    id: ClassVar[str] = "field"
    of: ClassVar[str] = "joints"
    #: It was learnt where one campaign measured; of another arm, tool or day it is not known.
    stays_with_arm: ClassVar[bool] = False
    known_elsewhere: ClassVar[bool] = False
    #: What it is called, and does, at the joints that it goes with mostly.
    nouns: ClassVar[tuple[str, ...]] = ("what has no name and is predicted",)
    clauses: ClassVar[tuple[str, ...]] = ("what has no name is predicted, mostly by {at}",)

    @property
    def formula(self) -> str:
        return (
            f"along each base axis sum over places k of exp({_POWERS[self.kernel]}) c_k, d_k the "
            "distance of the joints' positions from place k, each joint along the chord of its "
            "angle times lever_m; c = inverse transpose of L times x, L the lower factor of the "
            "correlation of the places with 1e-6 added to its diagonal"
        )

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            TermParameter(f"field_{axis}_{place:03d}", "m", self.size_m)
            for axis in "xyz"
            for place in range(len(self.q))
        )

    @property
    def roles(self) -> tuple[Role, ...]:
        of_field: Role = "field"
        return (of_field,) * (_AXES * len(self.q))

    @property
    def coordinates(self) -> tuple[str, ...]:
        return BASE[:_AXES]

    @property
    def proportional(self) -> bool:
        return True

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(self.features(states.q_rad) @ x.reshape(_AXES, -1).T)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        features = self.features(states.q_rad)
        along_axes = features[:, None, None, :] * np.eye(_AXES)[None, :, :, None]
        return np.asarray(along_axes.reshape(len(features), _AXES, -1))

    def report(self, x: Array) -> Report:
        """Return nothing: amounts at places are no parameters that readers know."""
        return Report((), np.zeros(0), np.zeros((0, len(x))))

    def features(self, q: Array) -> Array:
        """Return how much of the amount at each place there is at positions (N, n), (N, m)."""
        near = self._correlation(self._points(q), self._places)
        return np.asarray(solve_triangular(self._lower, near.T, lower=True, check_finite=False).T)

    def _points(self, q: Array) -> Array:
        return embedded(q, np.array(self.lever_m), np.array(self.turns))

    def _correlation(self, one: Array, other: Array) -> Array:
        away = cdist(one, other) / self.length_m
        return np.asarray(np.exp(-away if self.kernel == "exponential" else -0.5 * away**2))

    @cached_property
    def _places(self) -> Array:
        return self._points(np.array(self.q))

    @cached_property
    def _lower(self) -> Array:
        between = self._correlation(self._places, self._places)
        lower = np.linalg.cholesky(between + _JITTER * np.eye(len(between)))
        return np.asarray(lower, dtype=np.float64)


@dataclass(frozen=True)
class Nameless(Traits):
    """What terms do together, of which none is said to be there: a part of what has no name.

    Departures of the geometry and effects of the vocabulary, each in proportion to its amounts.
    None yields to torques or shows in them.
    """

    terms: tuple[Term, ...]  # those that it is the sum of
    sizes: tuple[float, ...]  # (k,) standard deviation expected of each amount, term by term
    id: ClassVar[str] = "nameless"
    of: ClassVar[str] = "joints"
    formula: ClassVar[str] = (
        "the sum of the terms of its form, each by its formula, with the amounts x one after the "
        "other; they predict together, and none is said to be there"
    )
    stays_with_arm: ClassVar[bool] = False
    known_elsewhere: ClassVar[bool] = False

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        every = (parameter for term in self.terms for parameter in term.parameters)
        return tuple(
            TermParameter(f"{self.id}_{each.name}", each.unit, size)
            for each, size in zip(every, self.sizes, strict=True)
        )

    @property
    def roles(self) -> tuple[Role, ...]:
        of_field: Role = "field"
        return (of_field,) * len(self.sizes)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for term in self.terms for name in term.coordinates))

    @property
    def proportional(self) -> bool:
        return True

    def shift(self, states: PoseStates, x: Array) -> Array:
        shift, first = np.zeros((len(states), len(self.coordinates))), 0
        for term, rows in zip(self.terms, self._rows, strict=True):
            last = first + len(term.parameters)
            shift[:, rows] += term.shift(states, x[first:last])
            first = last
        return shift

    def derivative(self, states: PoseStates, x: Array) -> Array:
        derivative, first = np.zeros((len(states), len(self.coordinates), len(x))), 0
        for term, rows in zip(self.terms, self._rows, strict=True):
            last = first + len(term.parameters)
            derivative[:, rows, first:last] = term.derivative(states, x[first:last])
            first = last
        return derivative

    def report(self, x: Array) -> Report:
        """Return nothing: these amounts are of no use alone."""
        return Report((), np.zeros(0), np.zeros((0, len(x))))

    @cached_property
    def _rows(self) -> list[list[int]]:
        at = {name: row for row, name in enumerate(self.coordinates)}
        return [[at[name] for name in term.coordinates] for term in self.terms]


def is_nameless(term: Term) -> TypeGuard[Nameless]:
    """Return whether a term is a sum of terms without a name."""
    return term.id == Nameless.id


def embedded(q: Array, lever_m: Array, turns: NDArray[np.bool_]) -> Array:
    """Return joint positions (N, n) as points whose distance is that of the poses [m]."""
    around = lever_m[turns] * np.stack([np.cos(q[:, turns]), np.sin(q[:, turns])])
    return np.concatenate([*around, (lever_m * q)[:, ~turns]], axis=1)


def well_spread(points: Array, count: int) -> Index:
    """Return rows of points (P, d), each in turn the farthest from those before, in order."""
    chosen = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)) and away.max() > 0.0:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(chosen)
