"""Formulas proposed for what a verdict has no name for; the verdict stays as it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TypeVar

from pa10cal.discovery.formulas.choose import Proposal, choose
from pa10cal.discovery.verdict import Verdict
from pa10cal.terms.effects.effect import Effect, turning_joints
from pa10cal.terms.forms.catalogue import forms_at
from pa10cal.terms.forms.form import Form

V = TypeVar("V", bound=Verdict[object])

#: Poses by which forms are ruled out, where there are many more.
_FEW_POSES = 800
#: Parameters of maps and rivals that one form may stand for: fine maps of several joints are no one
#: formula.
_MOST_HELD = 400


def with_proposals(found: V) -> V:
    """Return a verdict with a formula for each map and rival that a short form does as well as."""
    if found.method is None or found.verdict == "check_the_log":
        return found
    return replace(found, proposed=tuple(_proposals(found)))


def _proposals(found: Verdict[object]) -> Iterator[Proposal]:
    """Yield one formula for everything without a name; else one for each place, where there is."""
    nameless = found.without_name
    if not nameless and not found.over_noise:
        return
    places = sorted({effect.of for effect in nameless})
    forms = {of: forms_at(of, found.context, found.states) for of in (*places, *_others(found))}
    elsewhere = [of for of in forms if of not in places]
    everything = found.everything if found.unexplained else nameless
    joints = [of for of in elsewhere if of.startswith("joint")]
    attempts = [  # where it shows, before anywhere else
        (nameless, places),
        (nameless, [of for of in elsewhere if of not in joints]),
        (nameless, joints),
    ]
    if everything != nameless:  # names may stand in for parts of what has none
        attempts.append((everything, list(forms)))
    for held, tried in attempts:
        one = _chosen(found, held, [form for of in tried for form in forms[of]])
        if one is not None:
            yield one
            return
    for place in places if len(places) > 1 else ():
        held = tuple(effect for effect in nameless if effect.of == place)
        proposal = _chosen(found, held, list(forms[place]))
        if proposal is not None:
            yield proposal


def _others(found: Verdict[object]) -> tuple[str, ...]:
    """Return every place of the arm and of the instrument at which a form may sit."""
    joints = (f"joint {joint}" for joint in turning_joints(found.context))
    return (*joints, "base", "instrument")


def _chosen(found: Verdict[object], held: tuple[Effect, ...], forms: list[Form]) -> Proposal | None:
    """Return the shortest form that does as well as some effects without a name."""
    if not forms or sum(effect.linear for effect in held) > _MOST_HELD:
        return None
    few = found.arena(held, _FEW_POSES)
    many = len(few.states) < len(found.states)
    whole = partial(found.arena, held) if many else None
    return choose(few, forms, held, found.error_rate, whole)
