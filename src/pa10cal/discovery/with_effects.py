"""The calibrated model with effects, fitted anew: where every search ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import about_moved_base, motion_of_base
from pa10cal.terms.offsets import base_frame


@dataclass(frozen=True, eq=False)
class ModelWithEffects:
    """The calibrated model with effects.

    The unknowns are the parameters of the calibrated model, effect by effect, six small motions of
    the base, and the places of the instrument's targets, in that order.
    """

    effects: tuple[Effect, ...]
    # chain and terms: those of the calibrated model, the effects, and small motions of the base;
    # with their parameters, and targets where the instrument has some of its own
    at: FittedModel
    converged: bool  # whether the solver stopped by itself

    @property
    def model(self) -> Model:
        """Return chain and terms, the base's own among them."""
        return self.at.model

    @property
    def x(self) -> Array:
        """Return all unknowns."""
        return unknowns(self.at)

    def effect_columns(self) -> list[tuple[int, int]]:
        """Return first column and the one past the last of each effect."""
        widths = [len(effect.parameters) for effect in self.effects]
        stops = len(self.at.x) - 6 - np.cumsum([0, *widths[::-1]])[::-1]
        return list(pairwise(stops.tolist()))

    def columns_of(self, effect: Effect) -> slice:
        """Return where the parameters of one of its effects stand."""
        return slice(*self.effect_columns()[self.effects.index(effect)])

    def own_columns(self) -> NDArray[np.intp]:
        """Return the columns of the unknowns that belong to no effect."""
        effects = np.concatenate(
            [np.zeros(0, int), *(np.arange(*ends) for ends in self.effect_columns())]
        )
        return np.setdiff1d(np.arange(len(self.x)), effects)

    def of(self, effect: Effect) -> Array:
        """Return the parameters of one of its effects."""
        return self.at.x[self.columns_of(effect)]

    def fitted(self, covariance: Array | None = None) -> FittedModel:
        """Return the model with its base where it is found to stand, the base's own term gone.

        Args:
            covariance: (k, k) of all unknowns; None where it is not wanted.
        """
        k, terms = len(self.at.x) - 6, self.model.terms[:-1]
        return replace(
            self.at,
            model=Model(self.model.chain, terms),
            x=about_moved_base(terms, self.at.x[:k], self.at.x[k:]),
            T_instr_base=moved_base(self.at.T_instr_base, self.at.x[k:]),
            covariance=None if covariance is None else covariance[: k + 6, : k + 6],
        )


def with_base_term(baseline: FittedModel, effects: tuple[Effect, ...] = ()) -> Model:
    """Return the calibrated model's terms, effects, and small motions of the base."""
    terms = (*baseline.model.terms, *effects, base_frame())
    return Model(baseline.model.chain, terms)


def unknowns(at: FittedModel) -> Array:
    """Return the parameters of a model's terms and the places of its targets, (k + t,)."""
    return np.concatenate([at.x, at.targets_m])


def at_unknowns(at: FittedModel, x: Array) -> FittedModel:
    """Return a model with other `unknowns` (k + t,)."""
    k = len(at.model.parameters)
    return replace(at, x=x[:k], targets_m=x[k:])


def moved_base(T_instr_base: Array, small: Array) -> Array:
    """Return a base frame moved by the six small motions (6,) that a model's base term makes."""
    T: Array = T_instr_base @ motion_of_base(small)
    return T
