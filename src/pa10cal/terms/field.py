"""Unexplained errors as terms: a smooth displacement by the joint positions, and a sum of terms.

The displacement is a Gaussian process with inducing points, here called places (Rasmussen and
Williams, Gaussian Processes for Machine Learning, 2006, chapter 2; subset of regressors, section
8.3.1): far from all places it is zero.
"""

from __future__ import annotations

from abc import abstractmethod
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

#: Variance added to the correlation matrix of places, so that it is well conditioned.
_JITTER = 1e-6
_AXES = 3
#: Covariance function of the distance over the length: with `exponential` the displacement is
#: continuous but has no derivative, with `squared exponential` it is smooth.
Kernel = Literal["squared exponential", "exponential"]
_POWERS: dict[Kernel, str] = {
    "squared exponential": "-d_k^2 / (2 length_m^2)",
    "exponential": "-d_k / length_m",
}
#: The place of predicted errors without a name, in lists of what is explained.
NO_NAME = "without a name, predicted"


class Unnamed(Traits):
    """A term for errors without a name, whose amounts mean nothing one by one.

    It is known in the poses of one campaign, and not for another arm, tool or day.
    """

    id: ClassVar[str]
    of: ClassVar[str] = "joints"
    proportional: ClassVar[bool] = True
    stays_with_arm: ClassVar[bool] = False

    @cached_property
    @abstractmethod
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return its amounts."""

    @property
    def roles(self) -> tuple[Role, ...]:
        of_field: Role = "field"
        return (of_field,) * len(self.parameters)

    def report(self, x: Array) -> Report:
        return Report((), np.zeros(0), np.zeros((0, len(x))))


@dataclass(frozen=True)
class Field(Unnamed):
    """Moves the end along base axes, by amounts that change smoothly with the joint positions.

    Its parameters, those of all places along x, then y, then z, are a priori independent with the
    standard deviation `size_m`.
    """

    q: tuple[tuple[float, ...], ...]  # (m, n) joint positions of the places [rad, m]
    # (n,) distance that a joint moves the end by: metres a radian where it turns, 1 where it slides
    lever_m: tuple[float, ...]
    turns: tuple[bool, ...]  # (n,) whether a joint turns
    length_m: float  # correlation length, in distances as of `embedded`
    size_m: float  # prior standard deviation of the displacement along each axis
    kernel: Kernel = field(default="squared exponential", metadata={OPTIONAL: True})
    id: ClassVar[str] = "field"
    #: Words for it, see `Effect`.
    nouns: ClassVar[tuple[str, ...]] = ("what has no name and is predicted",)
    clauses: ClassVar[tuple[str, ...]] = ("what has no name is predicted",)
    varies_with: ClassVar[str] = "the pose"

    @property
    def formula(self) -> str:
        return (
            f"along each base axis sum over places k of exp({_POWERS[self.kernel]}) c_k, d_k the "
            "distance of the joints' positions from place k, each joint along the chord of its "
            "angle times lever_m; c = inverse transpose of L times x, L the lower factor of the "
            "correlation of the places with 1e-6 added to its diagonal"
        )

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            TermParameter(f"field_{axis}_{place:03d}", "m", self.size_m)
            for axis in "xyz"
            for place in range(len(self.q))
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        return BASE[:_AXES]

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(self.features(states.q_rad) @ x.reshape(_AXES, -1).T)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        features = self.features(states.q_rad)
        along_axes = features[:, None, None, :] * np.eye(_AXES)[None, :, :, None]
        return np.asarray(along_axes.reshape(len(features), _AXES, -1))

    def features(self, q: Array) -> Array:
        """Return the derivative of the displacement by the parameters of one axis, (N, m)."""
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
class Nameless(Unnamed):
    """A sum of terms that predicts an unexplained error; none of them is claimed to be present.

    Terms are departures of the geometry and effects, proportional to their parameters. None of them
    deflects a joint under torque or changes logged torques.
    """

    terms: tuple[Term, ...]  # the summands
    sizes: tuple[float, ...]  # (k,) prior standard deviation of each parameter, term by term
    id: ClassVar[str] = "nameless"
    formula: ClassVar[str] = (
        "the sum of the terms of its form, each by its formula, with the amounts x one after the "
        "other; they predict together, and none is said to be there"
    )

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        every = (parameter for term in self.terms for parameter in term.parameters)
        return tuple(
            TermParameter(f"{self.id}_{each.name}", each.unit, size)
            for each, size in zip(every, self.sizes, strict=True)
        )

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for term in self.terms for name in term.coordinates))

    def shift(self, states: PoseStates, x: Array) -> Array:
        shift = np.zeros((len(states), len(self.coordinates)))
        for term, rows, columns in self._parts:
            shift[:, rows] += term.shift(states, x[columns])
        return shift

    def derivative(self, states: PoseStates, x: Array) -> Array:
        derivative = np.zeros((len(states), len(self.coordinates), len(x)))
        for term, rows, columns in self._parts:
            derivative[:, rows, columns] = term.derivative(states, x[columns])
        return derivative

    @cached_property
    def _parts(self) -> list[tuple[Term, list[int], slice]]:
        """Return every term with the indices of its coordinates and its columns."""
        parts, first = [], 0
        for term in self.terms:
            last = first + len(term.parameters)
            rows = [self.coordinates.index(name) for name in term.coordinates]
            parts.append((term, rows, slice(first, last)))
            first = last
        return parts


def is_nameless(term: Term) -> TypeGuard[Nameless]:
    """Return whether a term is a sum of terms without a name."""
    return term.id == Nameless.id


def embedded(q: Array, lever_m: Array, turns: NDArray[np.bool_]) -> Array:
    """Return joint positions (N, n) as points (N, d) whose distances are those of poses [m].

    A joint that turns gives cosine and sine of its angle, times its lever: distances are chords.
    """
    around = lever_m[turns] * np.stack([np.cos(q[:, turns]), np.sin(q[:, turns])])
    return np.concatenate([*around, (lever_m * q)[:, ~turns]], axis=1)


def well_spread(points: Array, count: int) -> Index:
    """Return `count` rows of points (P, d), sorted: each is chosen farthest from those before."""
    chosen = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)) and away.max() > 0.0:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(chosen)
