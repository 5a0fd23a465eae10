"""Formulas proposed for what a verdict has no name for; the verdict stays as it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TypeVar

from pa10cal.discovery.finding import Finding
from pa10cal.discovery.gates import harmless, unfit
from pa10cal.discovery.short_forms import FormulaProposal, choose
from pa10cal.discovery.verdict import MAP, SearchVerdict
from pa10cal.terms.effects.effect import Effect, joint_of, turning_joints
from pa10cal.terms.effects.joint import PeriodicError
from pa10cal.terms.forms.catalogue import all_around, forms_at
from pa10cal.terms.forms.form import Form

V = TypeVar("V", bound=SearchVerdict[object])

#: Poses by which forms are ruled out, where there are many more.
_FEW_POSES = 800
#: Parameters of maps and rivals that one form may stand for: fine maps of several joints are no one
#: formula.
_MOST_HELD = 400


def with_proposals(found: V) -> V:
    """Return a verdict with a formula for each map and rival that a short form does as well as."""
    if found.verdict == "check_the_log":
        return found
    return replace(found, proposed=tuple(_proposals(found)))


def _proposals(found: SearchVerdict[object]) -> Iterator[FormulaProposal]:
    """Yield one formula for everything without a name; else one for each place, where there is."""
    nameless = found.without_name
    if not nameless and not found.over_noise:
        return
    places = sorted({effect.of for effect in nameless})
    others = (*(f"joint {joint}" for joint in turning_joints(found.context)), "base", "instrument")
    forms = {of: forms_at(of, found.context, found.states) for of in (*places, *others)}
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


def _chosen(
    found: SearchVerdict[object], held: tuple[Effect, ...], forms: list[Form]
) -> FormulaProposal | None:
    """Return the shortest form that does as well as some effects without a name."""
    if not forms or sum(effect.linear for effect in held) > _MOST_HELD:
        return None
    few = found.comparison(held, _FEW_POSES)
    many = len(few.states) < len(found.states)
    whole = partial(found.comparison, held) if many else None
    return choose(few, forms, held, found.error_rate, whole)


# A map that is one line gets a name: `periodic_error`, where the joint was seen all around.

#: Orders up to here have names of their own; so have those this near to twice the gear ratio.
NAMED_ORDERS, NEAR_ORDER = 2, 0.5


def with_lines_named(found: V) -> V:
    """Return a verdict in which maps that are one line each have the name of that line.

    A window of part of a turn cannot tell orders apart, however well one of them fits: there the
    formula is proposed, and the map stays.
    """
    for proposal in found.proposed:
        named = _named(found, proposal)
        if named is not None:
            rest = tuple(each for each in found.proposed if each is not proposal)
            found = replace(named, proposed=rest)
    return found


def _named(found: V, proposal: FormulaProposal) -> V | None:
    """Return the verdict with a line in its map's place; None where it has no name."""
    order, held, form = proposal.form.order, proposal.instead, proposal.form
    of_one_map = len(held) == 1 and held[0].id == MAP and held[0].of == form.of
    if form.form != "harmonic" or not of_one_map or found.falls_back is not None:
        return None
    if order is None or order <= NAMED_ORDERS or proposal.record.orders != (order, order):
        return None
    joint = joint_of(form.of)
    gear = 2.0 * float(found.context.arm.gear_ratio[joint - 1])
    if abs(order - gear) < NEAR_ORDER or not all_around(found.states.q_rad[:, joint - 1]):
        return None
    line = PeriodicError(form.of, float(order))
    findings: tuple[Finding[object], ...] = found.findings
    (of_map,) = (each for each in findings if each.effect == held[0])
    # A fit takes an effect in the place of one of which it is an alternative.
    known = replace(of_map, alternatives=(line, *of_map.alternatives))
    beside = replace(found, findings=tuple(known if each is of_map else each for each in findings))
    named = replace(of_map, effect=line)
    tried = beside.with_findings([named if each is of_map else each for each in findings])
    now = next(each for each in tried.findings if each.effect == line)
    return None if any(unfit(now, tried.model)) else harmless(tried)
