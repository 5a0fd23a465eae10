"""A model and what was measured as a least-squares problem: residual rows and their derivative.

Then Gaussian priors of its unknowns, and how readings or another fit disagree with one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arrays import Array, Index, Mask
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.rules import PARAMETERS
from pa10cal.terms.model import Model
from pa10cal.terms.term import Role, TermParameter


@dataclass(frozen=True)
class Rows:
    """Rows of the problem at one point."""

    residual: Array  # (P, b) predicted less seen [m, rad]
    jacobian: Array  # (P, b, k) exact derivative by all unknowns


@dataclass(frozen=True)
class Solution:
    """Where a fit ended."""

    x: Array  # (k,) parameters
    at_bound: NDArray[np.bool_]  # (k,) parameters held at the end of their physical range
    cost: float  # weighted sum of squares, that of the prior among them
    iterations: int  # steps taken
    converged: bool  # whether it stopped by itself, at a stationary point
    reason: str  # why it stopped, in words


@dataclass(frozen=True)
class Problem:
    """A model and its observations: unknowns are the model's, then free coordinates of targets."""

    model: Model  # chain and terms: links, springs, tool, base
    # coordinates of targets that are unknowns, as indices into `target_parameters`
    places: NDArray[np.intp]
    places_m: Array  # (t,) all coordinates of targets, approximate where they are unknowns
    T_instr_base: Array  # (4, 4) base frame from which the base's term makes small motions
    # P poses, an orientation turned so that the tool's own is near that of the chain
    observations: Observations

    @property
    def roles(self) -> tuple[Role, ...]:
        """Return what each of the unknowns is one of, those of the model first."""
        of_target: Role = "target"
        return (*self.model.roles, *(of_target for _ in self.places))

    def having(self, *roles: Role) -> Mask:
        """Return which unknowns (k,) are of some kinds."""
        return np.array([role in roles for role in self.roles], dtype=bool)

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return all k unknowns, those of the model first."""
        everywhere = self.observations.measured.target_parameters
        return (*self.model.parameters, *(everywhere[k] for k in self.places))

    @cached_property
    def scale(self) -> Array:
        """Return the typical size of each unknown, (k,)."""
        return np.array([parameter.scale for parameter in self.parameters])

    @cached_property
    def stated_covariance(self) -> Array:
        """Return the covariance (P, b, b) that the instrument states."""
        return self.observations.measured.stated_covariance

    @cached_property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which components were seen, (P, b)."""
        return self.observations.measured.components_seen

    @cached_property
    def distinct_numbers_seen(self) -> tuple[Index, Index]:
        """Return the distinct numbers of components seen, and which of these each pose has (P,)."""
        numbers, at = np.unique(self.components_seen.sum(axis=1), return_inverse=True)
        return numbers, at

    @cached_property
    def readings(self) -> int:
        """Return how many components were seen in all."""
        return int(self.components_seen.sum())

    def start(self, x_model: Array) -> Array:
        """Return a point (k,) with targets about where they sit."""
        return np.concatenate([x_model, self.places_m[self.places]])

    def places_at(self, x: Array) -> Array:
        """Return the places of targets (t,) at a point."""
        places_m = self.places_m.copy()
        places_m[self.places] = x[len(x) - len(self.places) :]
        return places_m

    def of_model(self, x: Array) -> Array:
        """Return the parameters of the model at a point."""
        return x[: len(x) - len(self.places)]

    def predict(self, x: Array) -> Array:
        """Return the end of the chain in the instrument's frame, (P, 4, 4)."""
        predicted: Array = self.T_instr_base @ self.model.predict(
            self.observations.states, self.of_model(x)
        )
        return predicted

    def rows(self, x: Array) -> Rows:
        """Return residuals and exact derivatives."""
        predicted = self.model.predict_with_jacobian(self.observations.states, self.of_model(x))
        found = self.observations.measured.compare(
            self.T_instr_base @ predicted.T_base_ee, self.places_at(x)
        )
        by_end = found.by_end.reshape(-1, 3) @ self.T_instr_base[:3, :3]
        by_end = by_end.reshape(found.by_end.shape)
        of_model = predicted.jacobian.shape[2]
        jacobian = np.empty((*found.residual.shape, of_model + len(self.places)))
        jacobian[..., :of_model] = 0.0  # what other campaigns of a group see
        for at, columns in self.observations.measured.parts_seen:
            jacobian[at, columns, :of_model] = by_end[at, columns] @ predicted.jacobian[at]
        jacobian[..., of_model:] = found.by_targets[..., self.places]
        return Rows(found.residual, jacobian)


# What is thought possible of every unknown, before anything was measured.

_POSSIBLE: dict[Role, float] = {
    "windup": PARAMETERS.windup_rad,
    "cubic": PARAMETERS.cubic,
    "base": PARAMETERS.base,
}


def possible_sizes(model: Model, measured: Instrument | None = None) -> Array:
    """Return the standard deviation thought possible for every parameter, (k + t,).

    Of the k parameters of a model's terms, then of the t coordinates of an instrument's targets.
    """
    targets = () if measured is None else measured.target_parameters
    scale = np.array([each.scale for each in (*model.parameters, *targets)])
    of_target: Role = "target"
    roles = (*model.roles, *(of_target for _ in targets))
    usual = (1.0 if role in ("weight", "field") else PARAMETERS.possible_scales for role in roles)
    each = zip(roles, scale.tolist(), usual, strict=True)
    return np.array([_POSSIBLE.get(role, size * times) for role, size, times in each])


# Unknowns that are expected about known values: what an earlier fit says of them.
#
# Where a fit finds that expectation and readings disagree, the expectation is widened along few
# directions: those in which something moved. Evidence decides, in closed form: about the fit all
# is linear and Gaussian.

#: Part of a variance that nothing else explains; keeps the precision finite (computing).
_JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """The first k unknowns of a fit are normally distributed."""

    mean: Array  # (k,) where they are expected
    covariance: Array  # (k, k) how well they are known

    @cached_property
    def precision(self) -> Array:
        """Return the inverse of the covariance, (k, k)."""
        size = np.sqrt(np.diag(self.covariance))
        unit = self.covariance / np.outer(size, size)
        unit[np.diag_indices_from(unit)] += _JITTER
        inverse: Array = cho_solve(cho_factor(unit), np.eye(len(size))) / np.outer(size, size)
        return 0.5 * (inverse + inverse.T)

    def widened(self, directions: Array) -> GaussianPrior:
        """Return the same, but for further variance along directions (k, r) of standard size."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


def disagreement(expected: GaussianPrior, x: Array, covariance: Array) -> Gaussian:
    """Return what a fit says of the way off that more than was expected is possible.

    Its gram is how well that would be seen, its projection how readings pull towards it.

    Args:
        expected: of the first k unknowns.
        x: (k,) where they are found.
        covariance: (k, k) of them, after the fit.
    """
    precision = expected.precision
    known = precision - precision @ covariance @ precision
    return Gaussian.of_products(0.5 * (known + known.T), precision @ (x - expected.mean))


def gain_along(
    disagreed: Gaussian, directions: Array, sizes: Sequence[float]
) -> tuple[float, float]:
    """Return by how much evidence rises if more is possible along directions, and which size.

    Args:
        directions: (k, r), each of a standard size of one.
        sizes: multiples of that to choose from; the choice costs the logarithm of their number.
    """
    along = disagreed.in_terms_of(directions)
    now = -0.5 * (disagreed.squares + disagreed.log_det)
    each = [along.in_sizes(np.full(along.unknowns, size)).log_evidence for size in sizes]
    best = int(np.argmax(each))
    return each[best] - now - float(np.log(len(sizes))), float(sizes[best])


def widened(disagreed: Gaussian, directions: Array) -> Gaussian:
    """Return what remains where more is possible along directions (k, r) of standard size."""
    further = np.concatenate([directions, np.eye(disagreed.unknowns)], axis=1)
    return disagreed.in_terms_of(further).without(np.arange(directions.shape[1]))
