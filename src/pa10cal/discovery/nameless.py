"""Prediction by effects of the vocabulary together, none of which can be named.

The model is not changed. Departures of its geometry and effects are fitted to its residual
together, each with a prior x ~ N(0, size² Q) whose size maximises the marginal likelihood (MacKay,
Bayesian Interpolation, Neural Computation 4, 1992). The size of an effect that is absent goes to
zero. Forward selection may find none where effects mask each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress, pairwise
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.linear import base_shown
from pa10cal.discovery.preparation import computable
from pa10cal.discovery.tuning import FIELD
from pa10cal.fit.discrepancy import RowsAboutFit
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext, Effect, every_effect, everywhere_but
from pa10cal.terms.field import Nameless
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term, base_frame, tool_frame
from pa10cal.terms.weights import is_fault

F = TypeVar("F", bound=Fitted)


def nameless_effects(
    context: CandidateContext, states: PoseStates, held: Sequence[Term], *, logged: bool
) -> tuple[Effect, ...]:
    """Return the effects that may predict errors without a name: those of the arm, by the pose.

    They are the named effects that the model does not hold and that the states of complete poses
    determine. Deflections of joints are left to springs; effects of the log, of the instrument and
    of time are not of the arm.
    """
    kinds = [
        kind
        for kind in every_effect()
        if kind.sought
        and not (kind.generic or kind.at_knots or kind.falsifies_readings or kind.goes_with_time)
    ]
    known, _ = computable(everywhere_but(kinds, context, held), states, logged=logged, weights=True)
    return tuple(
        effect
        for effect in known
        if effect.proportional
        and not (effect.yields or effect.shows_torque or effect.falsifies_log or is_fault(effect))
    )


@dataclass(frozen=True, eq=False)
class Beside:
    """Terms added to a model whose own parameters stay as they are."""

    model: Fitted  # the model with the terms
    terms: tuple[Term, ...]  # the added ones, last in that model
    rows: RowsAboutFit  # about that model
    scatter: float  # standard deviation of a row

    @classmethod
    def none(cls, model: Fitted, poses: Observations) -> Beside:
        """Return that no term is added to a model."""
        return cls(model, (), RowsAboutFit.of(model, poses), 1.0)

    @property
    def amounts(self) -> Gaussian:
        """Return the normal equations of the amounts, each in units of its size."""
        columns = self.rows.columns[:, :, self.rows.of_field]
        return Gaussian.of(columns / self.scatter, self.rows.data / self.scatter)


def beside(
    model: Fitted, terms: Sequence[Term], poses: Observations, scatter: float, weight: Array
) -> Beside:
    """Return terms added to a model in their most likely amounts, linear about it."""
    at = with_terms(model, terms)
    none = Beside(at, tuple(terms), RowsAboutFit.of(at, poses, weight), scatter)
    x, of_field = at.x.copy(), at.model.having("field")
    # The residual is predicted less measured.
    x[of_field] = -none.amounts.mean * none.rows.sizes[none.rows.of_field]
    at = replace(at, x=x)
    return replace(none, model=at, rows=RowsAboutFit.of(at, poses, weight))


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


def all_at_once(model: Fitted, poses: Observations, effects: Sequence[Effect]) -> Beside | None:
    """Return departures and effects added to a model, in their most likely sizes and amounts.

    None where the size of every effect goes to zero.
    """
    chain, geometry = model.model.chain, _departures(model, poses.measured)
    whole = _nameless(chain, geometry, effects, [1.0] * len(effects))
    rows = RowsAboutFit.of(with_terms(model, [whole]), poses)
    every = Gaussian.of(rows.columns[:, :, rows.of_field], rows.data)
    own = sum(len(term.parameters) for term in geometry)
    ends = own + np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    groups = [np.arange(*pair) for pair in pairwise(ends)]
    count = int(np.count_nonzero(rows.data))
    sizes, scatter = _most_likely(every, count, own, groups)
    kept = [k for k, size in enumerate(sizes) if size > FIELD.sizes[0]]
    if not kept:
        return None
    terms = [_nameless(chain, geometry, [effects[k] for k in kept], [sizes[k] for k in kept])]
    found = beside(model, terms, poses, scatter, rows.weight)
    # Poses are weighed anew, by their residuals now.
    again = RowsAboutFit.of(found.model, poses)
    scatter *= float(np.linalg.norm(again.left) / np.linalg.norm(found.rows.left))
    return beside(model, terms, poses, scatter, again.weight)


def _departures(model: Fitted, measured: Instrument) -> tuple[Term, ...]:
    """Return departures of links, base (where it shows) and tool in addition to those there."""
    links = [term for term in model.model.terms if term.constant and term.of == "links"]
    base = base_frame()
    shown = compress((parameter.name for parameter in base.parameters), base_shown(measured))
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


def _most_likely(
    every: Gaussian, count: int, own: int, groups: Sequence[Index]
) -> tuple[Array, float]:
    """Return the most likely size of each group of unknowns, and the scatter of a row.

    Fixed-point iteration: expectation maximisation first, since MacKay's faster steps diverge from
    a bad start.

    Args:
        every: normal equations of rows of unit scatter.
        count: number of components seen.
        own: number of unknowns before the groups, whose sizes are known.
        groups: unknowns of each group.
    """
    gram, projection, squares = every.gram, every.projection, every.squares
    none, first, most = (size**2 for size in FIELD.sizes)
    of_expectation, steps = FIELD.size_steps
    variances = np.full(len(groups), first)
    prior_variances = np.ones(len(projection))
    scatter2, least = squares / count, none**2
    for step in range(steps):
        for at, variance in zip(groups, variances, strict=True):
            prior_variances[at] = variance
        found = every.in_sizes(np.sqrt(prior_variances / scatter2))
        # Projections are still those of rows that are not divided by their scatter.
        x = np.sqrt(prior_variances) * found.taken_of(found.projection / np.sqrt(scatter2))
        posterior_variances = prior_variances * np.diag(found.covariance)
        before = variances.copy()
        dof = np.zeros(len(groups))  # effective number of parameters of each group
        for k, at in enumerate(groups):
            dof[k] = max(len(at) - posterior_variances[at].sum() / variances[k], least)
            amount = float(x[at] @ x[at])
            if step < of_expectation:
                variances[k] = (amount + posterior_variances[at].sum()) / len(at)
            else:
                variances[k] = amount / dof[k]
        variances = np.clip(variances, least, most)
        remaining = squares - 2.0 * float(projection @ x) + float(x @ gram @ x)
        scatter2 = remaining / max(count - own - float(dof.sum()), 1.0)
        there = variances > none
        moved = np.abs(np.log(variances / before))[there].max(initial=0.0)
        if step > of_expectation and moved < FIELD.settled:
            break
    return np.sqrt(variances), float(np.sqrt(scatter2))
