"""Prediction by effects of the vocabulary together, none of which can be named.

The model is not changed. Departures of its geometry and effects are fitted to its residual
together, each with a prior x ~ N(0, size² Q) whose size maximises the marginal likelihood (MacKay,
Bayesian Interpolation, Neural Computation 4, 1992). The size of an effect that is absent goes to
zero. Forward selection may find none where effects mask each other.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.model_with_effects import identifiable_base_motions
from pa10cal.discovery.preparation import computable
from pa10cal.discovery.tuning import FIELD
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.generic import ArrivalMap
from pa10cal.terms.effects.vocabulary import every_effect, everywhere_but
from pa10cal.terms.field import Nameless
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame, tool_frame
from pa10cal.terms.term import Term

F = TypeVar("F", bound=Fitted)


def nameless_effects(
    context: CandidateContext,
    states: PoseStates,
    held: Sequence[Term],
    *,
    logged: bool,
    arriving: Collection[int] = (),
) -> tuple[Effect, ...]:
    """Return the effects that may predict errors without a name: those of the arm, by the pose.

    They are the named effects that the model does not hold and that the states of complete poses
    determine, and what depends on the directions in which some joints arrive, from 1, at each angle
    by itself. Deflections of joints are left to springs; effects of the log, of the instrument and
    of time are not of the arm.
    """
    kinds = [
        kind
        for kind in every_effect()
        if kind.role_in_search != "proposed"
        and kind.error_of == "robot"
        and not (kind.generic or kind.at_knots or kind.depends_on)
    ]
    by_arrival = (each for each in ArrivalMap.everywhere(context) if each.joint in arriving)
    every = (*everywhere_but(kinds, context, held), *by_arrival)
    known, _ = computable(every, states, logged=logged, weights=True)
    return tuple(
        effect
        for effect in known
        if effect.proportional and not (effect.yields or effect.shows_torque)
    )


@dataclass(frozen=True, eq=False)
class AddedTerms:
    """Terms added to a model whose own parameters stay as they are."""

    model: Fitted  # the model with the terms
    terms: tuple[Term, ...]  # the added ones, last in that model
    rows: RowsAboutFit  # about that model
    scatter: float  # standard deviation of a row

    @classmethod
    def none(cls, model: Fitted, poses: Observations) -> AddedTerms:
        """Return that no term is added to a model."""
        return cls(model, (), RowsAboutFit.of(model, poses), 1.0)

    @classmethod
    def fitted(
        cls,
        model: Fitted,
        terms: Sequence[Term],
        poses: Observations,
        scatter: float,
        weight: Array,
    ) -> AddedTerms:
        """Return terms in their most likely amounts by poses of weights (P,), linear about them."""
        at = with_terms(model, terms)
        added = cls(at, tuple(terms), RowsAboutFit.of(at, poses, weight), scatter)
        x, of_field = at.x.copy(), at.model.having("field")
        # The residual is predicted less measured.
        x[of_field] = -added.amounts.mean * added.rows.sizes[added.rows.of_field]
        at = replace(at, x=x)
        return replace(added, model=at, rows=RowsAboutFit.of(at, poses, weight))

    @property
    def amounts(self) -> Gaussian:
        """Return the normal equations of the amounts, each in units of its size."""
        columns = self.rows.columns[:, :, self.rows.of_field]
        return Gaussian.of(columns / self.scatter, self.rows.data / self.scatter)


def with_terms(model: F, terms: Sequence[Term]) -> F:
    """Return a model with terms added in amounts of zero, on a chain that bends as they do."""
    count, bent = sum(len(term.parameters) for term in terms), model.bending_as(terms)
    return replace(
        bent,
        model=Model(bent.model.chain, (*model.model.terms, *terms)),
        x=np.concatenate([model.x, np.zeros(count)]),
        covariance=None,
        discrepancy=None,
    )


def effects_together(
    model: Fitted, poses: Observations, effects: Sequence[Effect]
) -> AddedTerms | None:
    """Return departures and effects added to a model, in their most likely sizes and amounts.

    None where the size of every effect goes to zero.
    """
    chain, geometry = model.model.chain, _departures(model, poses.measured)
    whole = _nameless(chain, geometry, effects, [1.0] * len(effects))
    rows = RowsAboutFit.of(with_terms(model, [whole]), poses)
    equations = Gaussian.of(rows.columns[:, :, rows.of_field], rows.data)
    first = sum(len(term.parameters) for term in geometry)
    ends = first + np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    amounts_of = [np.arange(*pair) for pair in pairwise(ends)]
    count = int(np.count_nonzero(rows.data))
    sizes, scatter = _likeliest_sizes(equations, count, amounts_of)
    kept = [k for k, size in enumerate(sizes) if size > FIELD.sizes[0]]
    if not kept:
        return None
    terms = [_nameless(chain, geometry, [effects[k] for k in kept], [sizes[k] for k in kept])]
    found = AddedTerms.fitted(model, terms, poses, scatter, rows.weight)
    # Weights of poses follow from their residuals with the terms.
    again = RowsAboutFit.of(found.model, poses)
    scatter *= float(np.linalg.norm(again.residual) / np.linalg.norm(found.rows.residual))
    return AddedTerms.fitted(model, terms, poses, scatter, again.weight)


def _departures(model: Fitted, measured: Instrument) -> tuple[Term, ...]:
    """Return departures of links, base (where it shows) and tool in addition to those there."""
    links = [term for term in model.model.terms if term.constant and term.of == "links"]
    base = base_frame()
    shown = compress(
        (parameter.name for parameter in base.parameters), identifiable_base_motions(measured)
    )
    return (*links, base.only(set(shown)), tool_frame())


def _nameless(
    chain: Chain, geometry: Sequence[Term], effects: Sequence[Effect], sizes: Sequence[float]
) -> Nameless:
    """Return departures and effects as one term; sizes are in units of plausible ones."""
    departures = possible_sizes(Model(chain, tuple(geometry)))
    of_effects = (
        size * np.sqrt(np.diag(effect.prior_factor @ effect.prior_factor.T))
        for effect, size in zip(effects, sizes, strict=True)
    )
    every = np.concatenate([departures, *of_effects])
    return Nameless((*geometry, *effects), tuple(every.tolist()))


def _likeliest_sizes(
    equations: Gaussian, count: int, amounts_of: Sequence[Index]
) -> tuple[Array, float]:
    """Return the likeliest size of each of m effects, (m,), and the scatter of a row.

    Fixed-point iteration: expectation maximisation first, since MacKay's faster steps diverge from
    a bad start.

    Args:
        equations: normal equations of rows of unit scatter, by amounts of departures and effects.
        count: number of components seen.
        amounts_of: the amounts of each effect, after those of departures, whose sizes are known.
    """
    none, first, most = (size**2 for size in FIELD.sizes)
    least = none**2  # so small that logarithms and quotients stay finite
    of_expectation, steps = FIELD.size_steps
    number = np.array([len(at) for at in amounts_of])
    departures = equations.unknowns - int(number.sum())
    variances, row_variance = np.full(len(amounts_of), first), equations.squares / count
    prior_variances = np.ones(equations.unknowns)
    for step in range(steps):
        for at, variance in zip(amounts_of, variances, strict=True):
            prior_variances[at] = variance
        mean, posterior_variances = _posterior(equations, prior_variances, row_variance)
        of_mean = np.array([mean[at] @ mean[at] for at in amounts_of])
        of_posterior = np.array([posterior_variances[at].sum() for at in amounts_of])
        dof = np.maximum(number - of_posterior / variances, least)  # effective parameters of each
        likelier = (of_mean + of_posterior) / number if step < of_expectation else of_mean / dof
        before, variances = variances, np.clip(likelier, least, most)
        left = max(count - departures - float(dof.sum()), 1.0)
        row_variance = equations.squares_at(mean) / left
        there = variances > none
        moved = np.abs(np.log(variances / before))[there].max(initial=0.0)
        if step > of_expectation and moved < FIELD.settled:
            break
    return np.sqrt(variances), float(np.sqrt(row_variance))


def _posterior(
    equations: Gaussian, prior_variances: Array, row_variance: float
) -> tuple[Array, Array]:
    """Return mean and variance (k,) of amounts of some prior variances (k,)."""
    scaled = equations.in_sizes(np.sqrt(prior_variances / row_variance))
    # Projections are still those of rows that are not divided by their scatter.
    mean = np.sqrt(prior_variances) * scaled.taken_of(scaled.projection / np.sqrt(row_variance))
    return mean, prior_variances * np.diag(scaled.covariance)
