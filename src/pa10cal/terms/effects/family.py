"""All effects of the vocabulary, found by looking through this package."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.terms import effects
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.term import Term


@cache
def every_effect() -> tuple[type[Effect], ...]:
    """Return every class of effect, named ones before generic ones, ordered by id."""
    return classes_in(effects, Effect)


def classes_in(package: ModuleType, kind: Any) -> tuple[Any, ...]:
    """Return every class of a kind in a package, named ones before generic ones, by id."""
    modules = [
        import_module(f"{package.__name__}.{module.name}")
        for module in pkgutil.iter_modules(package.__path__)
    ]
    found = {
        each
        for module in modules
        for _, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, kind) and not inspect.isabstract(each) and "id" in vars(each)
    }
    return tuple(sorted(found, key=lambda each: (each.generic, each.id)))


def candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every effect sought, at every place where it may sit, but those that a model has."""
    return everywhere_but((kind for kind in every_effect() if kind.sought), context, held)


def everywhere_but(
    kinds: Iterable[type[Effect]], context: CandidateContext, held: Iterable[Term]
) -> tuple[Effect, ...]:
    """Return effects of some kinds at every place where they may sit, but those held."""
    there = {(term.id, term.of) for term in held if isinstance(term, Effect)}
    return tuple(
        effect
        for kind in kinds
        for effect in kind.everywhere(context)
        if (effect.id, effect.of) not in there
    )


def vocabulary_of(arm: Arm) -> tuple[tuple[Effect, ...], ...]:
    """Return the effects that can be named at an arm of any campaign, each with all its places."""
    anywhere = CandidateContext(
        arm=arm,
        flexible_joints=(),
        reference_temperature_C=20.0,
        tau_span_Nm=arm.rated_Nm(np.ones(arm.n)),
        T_instr_base=np.eye(4),
        p_instr_middle_m=np.zeros(3),
        q_span_rad=arm.limits_rad,
        time_span_s=(0.0, 3600.0),
        commanded=True,
    )
    return tuple(
        places
        for kind in every_effect()
        if not kind.generic and (places := kind.everywhere(anywhere))
    )
