"""A model and its observations as a least-squares problem: what it identifies, and priors.

A prior is a standard deviation of every parameter, or the Gaussian distribution of an earlier fit.
Where readings or another fit contradict that distribution, it is widened along the few directions
in which something moved. The log evidence of a widened prior has a closed form, because the problem
is linear and Gaussian about the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, qr

from pa10cal.arrays import Array, Index, Mask
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.rules import PARAMETERS
from pa10cal.terms.model import Model
from pa10cal.terms.term import Role, TermParameter

#: Prior standard deviations of parameters that are not in proportion to their scale.
_POSSIBLE: dict[Role, float] = {
    "windup": PARAMETERS.windup_rad,
    "cubic": PARAMETERS.cubic,
    "base": PARAMETERS.base,
}
#: Number of rows factorised at once (computing).
_QR_ROWS = 50_000
#: Added to the correlation matrix's diagonal, to keep the precision finite (computing).
_JITTER = 1e-9


@dataclass(frozen=True)
class Rows:
    """Residuals of the problem at one point, and their derivative."""

    residual: Array  # (P, b) predicted minus measured [m, rad]
    jacobian: Array  # (P, b, k) exact derivative by all unknowns


@dataclass(frozen=True)
class Solution:
    """Result of a fit."""

    x: Array  # (k,) parameters
    at_bound: NDArray[np.bool_]  # (k,) parameters held at the end of their physical range
    cost: float  # weighted sum of squares, including that of the prior
    iterations: int  # steps taken
    converged: bool  # whether it ended at a stationary point
    reason: str  # why it stopped, in words


@dataclass(frozen=True)
class Problem:
    """A model and P observed poses with b components each.

    Its k unknowns are the parameters of the model, then the free coordinates of targets.
    """

    model: Model  # chain and terms: links, springs, tool, base
    # coordinates of targets that are unknowns, as indices into `target_parameters`
    places: NDArray[np.intp]
    places_m: Array  # (t,) coordinates of all targets; those of unknowns are start values
    T_instr_base: Array  # (4, 4) approximate base frame, which the base's term corrects
    # P poses, orientations turned so that the tool's nearly equals that of the chain's end
    observations: Observations

    @property
    def roles(self) -> tuple[Role, ...]:
        """Return the kind of each unknown, those of the model first."""
        of_target: Role = "target"
        return (*self.model.roles, *(of_target for _ in self.places))

    def having(self, *roles: Role) -> Mask:
        """Return which unknowns (k,) are of these kinds."""
        return np.array([role in roles for role in self.roles], dtype=bool)

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return all k unknowns, those of the model first."""
        of_targets = self.observations.measured.target_parameters
        return (*self.model.parameters, *(of_targets[k] for k in self.places))

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
        """Return the distinct counts of components seen in a pose, and each pose's index (P,)."""
        counts, index = np.unique(self.components_seen.sum(axis=1), return_inverse=True)
        return counts, index

    @cached_property
    def readings(self) -> int:
        """Return the number of components seen in all poses."""
        return int(self.components_seen.sum())

    def start(self, x_model: Array) -> Array:
        """Return unknowns (k,) with targets at their approximate coordinates."""
        return np.concatenate([x_model, self.places_m[self.places]])

    def places_at(self, x: Array) -> Array:
        """Return the coordinates of all targets (t,) for unknowns (k,)."""
        places_m = self.places_m.copy()
        places_m[self.places] = x[len(x) - len(self.places) :]
        return places_m

    def of_model(self, x: Array) -> Array:
        """Return the parameters of the model among unknowns (k,)."""
        return x[: len(x) - len(self.places)]

    def predict(self, x: Array) -> Array:
        """Return the end of the chain in the instrument's frame, (P, 4, 4)."""
        predicted: Array = self.T_instr_base @ self.model.predict(
            self.observations.states, self.of_model(x)
        )
        return predicted

    def _places_read_m(self, x: Array) -> Array:
        """Return the coordinates of targets as they are read, (t,), or (P, t) if distorted."""
        places_m = self.places_at(x)
        if not len(places_m):
            return places_m
        return places_m + self.model.distortion_m(self.observations.states, self.of_model(x))

    def rows(self, x: Array) -> Rows:
        """Return residuals and exact derivatives at unknowns (k,)."""
        states, x_model = self.observations.states, self.of_model(x)
        predicted = self.model.predict_with_jacobian(states, x_model)
        compared = self.observations.measured.compare(
            self.T_instr_base @ predicted.T_base_ee, self._places_read_m(x)
        )
        by_end = compared.by_end.reshape(-1, 3) @ self.T_instr_base[:3, :3]  # to base axes
        by_end = by_end.reshape(compared.by_end.shape)
        model_count = predicted.jacobian.shape[2]
        jacobian = np.empty((*compared.residual.shape, model_count + len(self.places)))
        jacobian[..., :model_count] = 0.0  # components of other campaigns of a group
        for at, columns in self.observations.measured.parts_seen:
            jacobian[at, columns, :model_count] = by_end[at, columns] @ predicted.jacobian[at]
        if len(self.places_m):
            for columns, distorted in self.model.distortions(states, x_model):
                jacobian[..., columns] += compared.by_targets @ distorted
        jacobian[..., model_count:] = compared.by_targets[..., self.places]
        return Rows(compared.residual, jacobian)


@dataclass(frozen=True)
class Identifiability:
    """Singular values of the Jacobian in parameters divided by their scale."""

    singular_values: Array  # (k,) descending
    rank: int  # number of directions that the data identify
    null_space: Array  # (k, k - rank) orthonormal basis of the others, in scaled parameters
    condition: float  # ratio of the largest singular value to the smallest of those within the rank


def triangle_of(rows: Array) -> Array:
    """Return R of the QR factorisation of rows (r, k), computed in blocks to save memory.

    It has the singular values of the rows; the Gram matrix would square the condition number.
    """
    triangle = rows[:0]
    for first in range(0, len(rows), _QR_ROWS):
        part = np.concatenate([triangle, rows[first : first + _QR_ROWS]])
        triangle = np.asarray(np.linalg.qr(part, mode="r"))
    return triangle


def identify(jacobian: Array, scale: Array) -> Identifiability:
    """Return what a Jacobian (rows, k) identifies of parameters of given scale (k,)."""
    _, values, right = np.linalg.svd(triangle_of(jacobian * scale))
    full = np.zeros(len(scale))
    full[: len(values)] = values
    rank = int(np.count_nonzero(full > PARAMETERS.null_ratio * full[0]))
    return Identifiability(full, rank, right[rank:].T, float(full[0] / full[rank - 1]))


def identify_beyond(
    jacobian: Array, scale: Array, possible: Array, noise: float
) -> Identifiability:
    """Return what a Jacobian (rows, k) identifies, directions that it hardly shows left out.

    A direction counts as identified if the rows tell it better than what is thought possible of it
    beforehand: stiffness and the shape of a spring in a joint that hardly yields, or a length
    that only the yielding shows, are no results though their rank is full.

    Args:
        possible: (k,) sizes thought possible of the parameters.
        noise: standard deviation of a row; 0 leaves out no direction that has any effect.
    """
    exact = identify(jacobian, scale)
    if not noise:
        return exact
    _, values, right = np.linalg.svd(triangle_of(jacobian * possible))
    values = np.append(values, np.zeros(len(scale) - len(values)))
    hardly_shown = right[values < noise].T * (possible / scale)[:, None]
    if hardly_shown.shape[1] <= exact.null_space.shape[1]:
        return exact
    sparse, _ = _in_few_parameters(hardly_shown)
    sparse[np.abs(sparse) < PARAMETERS.hardly_part] = 0.0
    null_space, _ = np.linalg.qr(sparse)
    rank = len(scale) - null_space.shape[1]
    beside = jacobian * scale
    beside = beside - (beside @ null_space) @ null_space.T
    kept = np.linalg.svd(triangle_of(beside), compute_uv=False)[:rank]
    return replace(exact, rank=rank, null_space=null_space, condition=float(kept[0] / kept[-1]))


def _in_few_parameters(basis: Array) -> tuple[Array, Index]:
    """Return a basis (k, r) of the same space that is the identity on r pivot rows, and these."""
    _, _, order = qr(basis.T, pivoting=True, mode="economic")
    pivots = np.asarray(order[: basis.shape[1]], dtype=np.intp)
    return np.asarray(basis @ np.linalg.inv(basis[pivots])), pivots


def unidentified_directions(
    identifiability: Identifiability, parameters: tuple[TermParameter, ...]
) -> tuple[dict[str, float], ...]:
    """Return the null directions, each in as few parameters as the null space allows.

    Returns:
        For each direction its components by name of the parameter, in the parameters' own units,
        relative to the first.
    """
    basis = identifiability.null_space
    if not basis.shape[1]:
        return ()
    basis, pivots = _in_few_parameters(basis)
    scale = np.array([parameter.scale for parameter in parameters])
    directions = []
    for column, pivot in zip(basis.T, pivots, strict=True):
        weights = column * scale / scale[pivot]
        members = np.flatnonzero(np.abs(column) > PARAMETERS.no_part)
        ranked = sorted(members, key=lambda k: (k != pivot, -abs(column[k])))
        directions.append({parameters[k].name: float(weights[k]) for k in ranked})
    return tuple(directions)


def not_identifiable(
    identifiability: Identifiability, parameters: tuple[TermParameter, ...]
) -> frozenset[str]:
    """Return the names of the parameters with a component in some null direction."""
    share = np.linalg.norm(identifiability.null_space, axis=1)
    return frozenset(
        parameter.name
        for parameter, part in zip(parameters, share, strict=True)
        if part > PARAMETERS.no_part
    )


def possible_sizes(model: Model, measured: Instrument | None = None) -> Array:
    """Return the prior standard deviation of every parameter, (k + t,).

    Of the k parameters of a model's terms, then of the t coordinates of an instrument's targets.
    """
    targets = () if measured is None else measured.target_parameters
    of_target: Role = "target"
    roles = (*model.roles, *(of_target for _ in targets))
    sizes = []
    for role, parameter in zip(roles, (*model.parameters, *targets), strict=True):
        factor = 1.0 if role in ("weight", "field") else PARAMETERS.possible_scales
        sizes.append(_POSSIBLE.get(role, float(parameter.scale) * factor))
    return np.array(sizes)


#: Roles of departures from nominal whose sizes in one arm are alike, each in its scale.
DEPARTURES: tuple[tuple[Role, ...], ...] = (("link", "tilt"), ("zero",))


def usual_departures(
    x: Array, covariance: Array, scale: Array, groups: Sequence[Mask], prior: Array | None = None
) -> Array:
    """Return the standard deviation expected of each unknown, (k,), infinite but for departures.

    Links of one arm are about as accurate as each other, and so are zeros: the departures of a
    group have a normal distribution about zero, of a size in scales that makes the readings most
    likely (the EM algorithm, linear about the fit). Twice that size is expected: some are larger
    than normal.

    Args:
        x: (k,) the unknowns as fitted.
        covariance: (k, k) by the fit.
        scale: (k,) typical size of each.
        groups: which unknowns (k,) are departures of one size.
        prior: (k,) precision about zero that the fit had besides its readings; None for none.
    """
    known = np.diag(covariance) > 0.0
    at = np.flatnonzero(known & np.logical_or.reduce(groups))
    inverse = np.linalg.inv(covariance[np.ix_(at, at)])
    information = inverse if prior is None else inverse - np.diag(prior[at])
    towards, size = inverse @ x[at], np.full(len(x), PARAMETERS.usual_scales)
    for _ in range(PARAMETERS.usual_rounds):
        spread = np.linalg.inv(information + np.diag((size[at] * scale[at]) ** -2.0))
        square = np.zeros(len(x))
        square[at] = ((spread @ towards) ** 2 + np.diag(spread)) / scale[at] ** 2
        for group in groups:
            if (of_group := group & known).any():
                size[group] = np.sqrt(square[of_group].mean())
    usual = np.full(len(x), np.inf)
    expected = np.maximum(PARAMETERS.usual_times * size, PARAMETERS.usual_scales)
    usual[at] = (scale * expected)[at]
    return usual


def hardly_known(covariance: Array, usual: Array, prior: Array | None = None) -> Array:
    """Return rows (r, k) of a prior along the directions that a fit hardly determines.

    There unknowns depart by no more than is usual. What the readings determine is left as it is.

    Args:
        covariance: (k, k) by the fit.
        usual: (k,) usual size of each unknown, infinite where none is known.
        prior: (k,) precision that the fit had besides its readings; None for none.
    """
    at = np.flatnonzero(np.isfinite(usual) & (np.diag(covariance) > 0.0))
    precision = np.linalg.inv(covariance[np.ix_(at, at)] / np.outer(usual[at], usual[at]))
    if prior is not None:
        precision -= np.diag(prior[at] * usual[at] ** 2)
    known, directions = np.linalg.eigh(precision)
    hardly = known < PARAMETERS.known_share**-2.0
    rows = np.zeros((int(np.count_nonzero(hardly)), len(usual)))
    rows[:, at] = directions[:, hardly].T / usual[at]
    return rows


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Normal distribution of the first k unknowns of a fit."""

    mean: Array  # (k,)
    covariance: Array  # (k, k)

    @cached_property
    def precision(self) -> Array:
        """Return the inverse of the covariance, (k, k)."""
        size = np.sqrt(np.diag(self.covariance))
        unit = self.covariance / np.outer(size, size)
        unit[np.diag_indices_from(unit)] += _JITTER
        inverse: Array = cho_solve(cho_factor(unit), np.eye(len(size))) / np.outer(size, size)
        return 0.5 * (inverse + inverse.T)

    def marginal(self, chosen: Mask) -> GaussianPrior:
        """Return the distribution of some of the unknowns, chosen by a mask (k,)."""
        return GaussianPrior(self.mean[chosen], self.covariance[np.ix_(chosen, chosen)])

    def widened(self, directions: Array) -> GaussianPrior:
        """Return the prior with the covariance D D^T of r directions D (k, r) added."""
        return replace(self, covariance=self.covariance + directions @ directions.T)


def disagreement(expected: GaussianPrior, x: Array, covariance: Array) -> Gaussian:
    """Return the information of a fit about a deviation z of the parameters beyond their prior.

    Were the prior widened by z, its normal matrix would be P - P C P and its right side
    P (x - mean), with the prior's precision P and the posterior covariance C.

    Args:
        expected: prior of the first k unknowns.
        x: (k,) their values after the fit.
        covariance: (k, k) their covariance after the fit.
    """
    precision = expected.precision
    known = precision - precision @ covariance @ precision
    return Gaussian.of_products(0.5 * (known + known.T), precision @ (x - expected.mean))


def gain_along(
    disagreed: Gaussian, directions: Array, sizes: Sequence[float]
) -> tuple[float, float]:
    """Return the gain in log evidence by widening the prior along directions, and the best size.

    Args:
        disagreed: see `disagreement`.
        directions: (k, r), each of one standard deviation.
        sizes: multiples of these to choose from; the logarithm of their number is subtracted.
    """
    along = disagreed.in_terms_of(directions)
    unwidened = -0.5 * (disagreed.squares + disagreed.log_det)
    evidence = [along.in_sizes(np.full(along.unknowns, size)).log_evidence for size in sizes]
    best = int(np.argmax(evidence))
    return evidence[best] - unwidened - float(np.log(len(sizes))), float(sizes[best])


def remaining_disagreement(disagreed: Gaussian, directions: Array) -> Gaussian:
    """Return the disagreement that remains with a prior widened along directions (k, r)."""
    both = np.concatenate([directions, np.eye(disagreed.unknowns)], axis=1)
    return disagreed.in_terms_of(both).without(np.arange(directions.shape[1]))
