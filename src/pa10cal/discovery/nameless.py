"""What effects predict together, none of them named: their sizes by how likely they make the rows.

Beside a model that stays as it is, departures of its geometry and effects of the vocabulary are
fitted all at once, each in a size of its own: x ~ N(0, size² Q), the size being the one that makes
the rows most likely (MacKay, Bayesian Interpolation, Neural Computation 4, 1992). What is not there
goes to nothing. One effect after the other may find none, where effects mask each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.linear import held_of_base
from pa10cal.discovery.other_numbers import FIELD
from pa10cal.discovery.preparation import computable
from pa10cal.fit.discrepancy import RowsAboutFit
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
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
    """Return the effects that may stand for what has no name: they move the arm with the pose.

    All that have names and that the model does not hold, by states of complete poses. Those that
    yield to torques are left to springs; nothing that a log, an instrument or time alone shows.
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
    """What stands beside a model, which stays as it is."""

    model: Fitted  # with it
    terms: tuple[Term, ...]  # the last ones of that model
    rows: RowsAboutFit  # about it
    scatter: float  # standard deviation of a row

    @classmethod
    def none(cls, model: Fitted, poses: Observations) -> Beside:
        """Return that nothing stands beside a model."""
        return cls(model, (), RowsAboutFit.of(model, poses), 1.0)

    @property
    def amounts(self) -> Gaussian:
        """Return what all rows say of its amounts, each in its size."""
        columns = self.rows.columns[:, :, self.rows.of_field]
        return Gaussian.of(columns / self.scatter, self.rows.data / self.scatter)


def beside(
    model: Fitted, terms: Sequence[Term], poses: Observations, scatter: float, weight: Array
) -> Beside:
    """Return terms beside a model in the amounts that are most likely, linear about it."""
    at = with_terms(model, terms)
    none = Beside(at, tuple(terms), RowsAboutFit.of(at, poses, weight), scatter)
    x, of_field = at.x.copy(), at.model.having("field")
    # What is left is predicted less seen.
    x[of_field] = -none.amounts.mean * none.rows.sizes[none.rows.of_field]
    at = replace(at, x=x)
    return replace(none, model=at, rows=RowsAboutFit.of(at, poses, weight))


def with_terms(model: F, terms: Sequence[Term]) -> F:
    """Return a model with terms beside it in no amount, on a chain that may bend as they do."""
    count, bent = sum(len(term.parameters) for term in terms), model.bending_as(terms)
    return replace(
        bent,
        model=Model(bent.model.chain, (*model.model.terms, *terms)),
        x=np.concatenate([model.x, np.zeros(count)]),
        covariance=None,
        discrepancy=None,
    )


def all_at_once(model: Fitted, poses: Observations, effects: Sequence[Effect]) -> Beside | None:
    """Return departures and effects beside a model, in their most likely sizes and amounts.

    None where every effect goes to nothing.
    """
    chain, geometry = model.model.chain, _departures(model)
    whole = _nameless(chain, geometry, effects, [1.0] * len(effects))
    rows = RowsAboutFit.of(with_terms(model, [whole]), poses)
    every = Gaussian.of(rows.columns[:, :, rows.of_field], rows.data)
    own = sum(len(term.parameters) for term in geometry)
    ends = own + np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    groups, count = [np.arange(*each) for each in pairwise(ends)], int(np.count_nonzero(rows.data))
    sizes, scatter = _most_likely(every, count, own, groups)
    kept = [k for k, size in enumerate(sizes) if size > FIELD.sizes[0]]
    if not kept:
        return None
    terms = [_nameless(chain, geometry, [effects[k] for k in kept], [sizes[k] for k in kept])]
    found = beside(model, terms, poses, scatter, rows.weight)
    # Poses count anew, by what is left of them now.
    again = RowsAboutFit.of(found.model, poses)
    scatter *= float(np.linalg.norm(again.left) / np.linalg.norm(found.rows.left))
    return beside(model, terms, poses, scatter, again.weight)


def _departures(model: Fitted) -> tuple[Term, ...]:
    """Return departures of links, base and tool beside those of a model; the base where it may."""
    links = [term for term in model.model.terms if term.constant and term.of == "links"]
    base = base_frame()
    free = zip(base.parameters, held_of_base(model), strict=True)
    return (*links, base.only({one.name for one, held in free if not held}), tool_frame())


def _nameless(
    chain: Chain, geometry: Sequence[Term], effects: Sequence[Effect], sizes: Sequence[float]
) -> Nameless:
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

    By fixed-point steps: of expectation first, as those of MacKay run away from a bad start.

    Args:
        count: rows that were seen.
        own: unknowns before the groups, in their own sizes.
    """
    gram, projection, squares = every.gram, every.projection, every.squares
    none, first, most = (size**2 for size in FIELD.sizes)
    of_expectation, steps = FIELD.size_steps
    variances, each = np.full(len(groups), first), np.ones(len(projection))
    scatter2, least = squares / count, none**2
    for step in range(steps):
        for at, variance in zip(groups, variances, strict=True):
            each[at] = variance
        found = every.in_sizes(np.sqrt(each / scatter2))
        # The data are still those of rows that scatter by more than one.
        x = np.sqrt(each) * found.taken_of(found.projection / np.sqrt(scatter2))
        unknown = each * np.diag(found.covariance)
        before, taken = variances.copy(), np.zeros(len(groups))
        for k, at in enumerate(groups):
            taken[k] = max(len(at) - unknown[at].sum() / variances[k], least)
            amount = float(x[at] @ x[at])
            if step < of_expectation:
                variances[k] = (amount + unknown[at].sum()) / len(at)
            else:
                variances[k] = amount / taken[k]
        variances = np.clip(variances, least, most)
        left = squares - 2.0 * float(projection @ x) + float(x @ gram @ x)
        scatter2 = left / max(count - own - float(taken.sum()), 1.0)
        there = variances > none
        moved = np.abs(np.log(variances / before))[there].max(initial=0.0)
        if step > of_expectation and moved < FIELD.settled:
            break
    return np.sqrt(variances), float(np.sqrt(scatter2))
