"""Formulas proposed for what has no name in a verdict; maps of joints that are one line, named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

from pa10cal.discovery.finding import is_named
from pa10cal.discovery.no_harm import harmless
from pa10cal.discovery.probabilities import with_unknown_cause
from pa10cal.discovery.refitted_verdict import fitted_instead
from pa10cal.discovery.rules import CANDIDATES
from pa10cal.discovery.short_forms import FormulaProposal, choose
from pa10cal.discovery.tuning import FORMS
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.terms.effects.context import joint_of, turning_joints
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import PeriodicError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.forms.catalogue import all_around, forms_at
from pa10cal.terms.forms.form import Form

S = TypeVar("S", bound=Scorer)


def with_proposals(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with formulas that do as well as its maps and rivals; it names no more."""
    if found.verdict == "check_the_log":
        return found
    return replace(found, proposed=tuple(_proposals(found)))


def _proposals(found: Verdict[Scorer]) -> Iterator[FormulaProposal]:
    """Yield one formula for everything without a name, or else one for each place that has one.

    And where nothing is without a name, one for each joint that has several names.
    """
    nameless = found.without_name
    if not nameless and not found.over_noise:
        for place, held in _names_of_one_joint(found).items():
            proposal = _shortest(found, held, forms_at(place, found.context, found.states))
            if proposal is not None and proposal.form.length < sum(each.linear for each in held):
                yield proposal
        return
    places = sorted({effect.of for effect in nameless})
    possible = (
        *(f"joint {joint}" for joint in turning_joints(found.context)),
        "base",
        "instrument",
    )
    forms = {of: forms_at(of, found.context, found.states) for of in (*places, *possible)}
    joints = [of for of in forms if of not in places and of.startswith("joint")]
    elsewhere = [of for of in forms if of not in places and of not in joints]
    # Where it shows first, then elsewhere.
    attempts: list[tuple[tuple[Effect, ...], list[str]]] = [
        (nameless, places),
        (nameless, elsewhere),
        (nameless, joints),
    ]
    with_names = _with_names_in_rows(found, nameless) if found.unexplained else nameless
    if with_names != nameless:  # names may stand in for parts of what has none
        attempts.append((with_names, list(forms)))
    for held, tried in attempts:
        proposal = _shortest(found, held, [form for of in tried for form in forms[of]])
        if proposal is not None:
            yield proposal
            return
    if len(places) < 2:
        return
    for place in places:
        held = tuple(effect for effect in nameless if effect.of == place)
        proposal = _shortest(found, held, list(forms[place]))
        if proposal is not None:
            yield proposal


def _names_of_one_joint(found: Verdict[Scorer]) -> dict[str, tuple[Effect, ...]]:
    """Return, by joint, two names and more of it in whose place its map may be.

    Together they may stand for one wave that has no name, over the angles seen.
    """
    names: dict[str, list[Effect]] = {}
    for each in (with_unknown_cause(found, effect) for effect in found.effects):
        others = each.explanations.smallest_set
        has_map = any(other.id == JointErrorMap.id and other.of == each.of for other in others)
        if is_named(each.effect) and has_map:
            names.setdefault(each.of, []).append(each.effect)
    return {of: tuple(effects) for of, effects in names.items() if len(effects) > 1}


def _with_names_in_rows(found: Verdict[Scorer], nameless: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Return effects without a name and those with one that the rows of a comparison can hold."""
    every = dict.fromkeys((*nameless, *(finding.effect for finding in found.effects)))
    searched = found.scorer.searched
    return tuple(each for each in every if searched is None or each in searched)


def _shortest(
    found: Verdict[Scorer], held: tuple[Effect, ...], forms: Sequence[Form]
) -> FormulaProposal | None:
    """Return the shortest form that does as well as some effects without a name; None for none."""
    if not forms or sum(effect.linear for effect in held) > FORMS.most_parameters:
        return None
    few = found.scorer.comparison(held, FORMS.few_poses)
    there_are_more = len(few.states) < len(found.states)
    whole = partial(found.scorer.comparison, held) if there_are_more else None
    return choose(few, forms, held, found.error_rate, whole)


def with_lines_named(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which each map that is one line is a `periodic_error` of that order.

    The joint must have been seen all around: on part of a turn several orders fit, however well one
    of them does. There the formula is proposed, and the map stays.
    """
    for proposal in found.proposed:
        named = _with_line_named(found, proposal)
        if named is not None:
            others = tuple(other for other in found.proposed if other is not proposal)
            found = replace(named, proposed=others)
    return found


def _with_line_named(found: Verdict[S], proposal: FormulaProposal) -> Verdict[S] | None:
    """Return the verdict with a line in its map's place; None where the line has no name.

    None too where the map has left the verdict, with another line that was named before.
    """
    order, form = proposal.form.order, proposal.form
    if form.form != "harmonic" or found.falls_back is not None:
        return None
    maps = [effect for effect in proposal.instead if effect.id == JointErrorMap.id]
    of_maps = [finding for finding in found.findings if finding.effect in maps]
    if len(proposal.instead) != 1 or not of_maps or maps[0].of != form.of:
        return None
    if order is None or order <= CANDIDATES.named_orders:
        return None
    if proposal.record.orders != (order, order):
        return None
    joint = joint_of(form.of)
    twice_ratio = 2.0 * float(found.context.arm.gear_ratio[joint - 1])
    if abs(order - twice_ratio) < CANDIDATES.near_order:
        return None
    if not all_around(found.states.q_rad[:, joint - 1]):
        return None
    line = PeriodicError(form.of, float(order))
    refitted = fitted_instead(found, of_maps[0], replace(of_maps[0], effect=line))
    return None if refitted is None else harmless(refitted)
