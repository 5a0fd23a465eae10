"""The vocabulary: every class of effect in the modules of this package, at all its places."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from typing import TypeVar

import numpy as np

from pa10cal.arm.description import Arm, neighbouring_axes, weights_known
from pa10cal.terms import effects
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import Term

E = TypeVar("E", bound=Effect)


@cache
def every_effect() -> tuple[type[Effect], ...]:
    """Return every class of effect, named ones before generic ones, ordered by id."""
    modules = [
        import_module(f"{effects.__name__}.{module.name}")
        for module in pkgutil.iter_modules(effects.__path__)
    ]
    found = {
        each
        for module in modules
        for _, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, Effect) and not inspect.isabstract(each) and "id" in vars(each)
    }
    return tuple(sorted(found, key=lambda each: (each.generic, each.id)))


def candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every effect that is sought, at every possible place, except those of a model.

    Where weights are not stated, effects that replace others are left to the search for sets.
    """
    stated = weights_known(context.arm).origin == "stated"
    roles = {"candidate", "substitute"} if stated else {"candidate"}
    kinds = (each for each in every_effect() if each.role_in_search in roles)
    return everywhere_but(kinds, context, held)


def everywhere_but(
    kinds: Iterable[type[E]], context: CandidateContext, held: Iterable[Term]
) -> tuple[E, ...]:
    """Return effects of some kinds at every possible place, except those that a model holds."""
    there = {(term.id, term.of) for term in held}
    return tuple(
        effect
        for kind in kinds
        for effect in kind.everywhere(context)
        if (effect.id, effect.of) not in there
    )


def vocabulary_of(arm: Arm) -> tuple[tuple[Effect, ...], ...]:
    """Return the named effects that are possible at an arm, kind by kind, whatever the campaign.

    An effect that needs a quantity which the arm does not state (nan), such as a gear ratio, is
    omitted.
    """
    anywhere = CandidateContext(
        arm=arm,
        flexible_joints=(),
        reference_temperature_C=20.0,
        largest_tau_Nm=arm.rated_Nm(np.ones(arm.n)),
        p_instr_middle_m=np.zeros(3),
        q_span_rad=arm.joint_ranges_rad,
        time_span_s=(0.0, 3600.0),
        torques="none" if arm.mass_kg is None else "masses",
        commanded=True,
        lifts=_lifts_if_upright(arm),
    )
    kinds = (kind.everywhere(anywhere) for kind in every_effect() if not kind.generic)
    stated = (tuple(filter(_is_stated, places)) for places in kinds)
    return tuple(places for places in stated if places)


def _lifts_if_upright(arm: Arm) -> tuple[int, float, float] | None:
    """Return which joint lifts an arm whose first axis is upright, under its rated torque."""
    for axes in neighbouring_axes(arm):
        both = [joint - 1 for joint in axes.joints]
        if not axes.parallel and not arm.prismatic[both].any():
            return axes.joints[1], 0.0, float(arm.rated_Nm(np.ones(arm.n))[both[1]])
    return None


def _is_stated(effect: Effect) -> bool:
    return not any(isinstance(value, float) and np.isnan(value) for value in vars(effect).values())
