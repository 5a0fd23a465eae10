"""A map that is one line gets a name: `periodic_error`, where the joint was seen all around."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from pa10cal.discovery.finding import Finding
from pa10cal.discovery.formulas.choose import Proposal
from pa10cal.discovery.gates import unfit
from pa10cal.discovery.harm import harmless
from pa10cal.discovery.verdict import MAP, Verdict
from pa10cal.terms.effects.effect import joint_of
from pa10cal.terms.effects.periodic_error import PeriodicError
from pa10cal.terms.forms.catalogue import all_around

V = TypeVar("V", bound=Verdict[object])

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


def _named(found: V, proposal: Proposal) -> V | None:
    """Return the verdict with a line in its map's place; None where it has no name."""
    order, held = proposal.form.order, proposal.instead
    alone = len(held) == 1 and held[0].id == MAP and held[0].of == proposal.of
    if proposal.form.form != "harmonic" or order is None or not alone:
        return None
    if proposal.orders != (order, order) or order <= NAMED_ORDERS or found.falls_back is not None:
        return None
    joint = joint_of(proposal.of)
    gear = 2.0 * float(found.context.arm.gear_ratio[joint - 1])
    if abs(order - gear) < NEAR_ORDER or not all_around(found.states.q_rad[:, joint - 1]):
        return None
    line = PeriodicError(proposal.of, float(order))
    findings: tuple[Finding[object], ...] = found.findings
    (of_map,) = (each for each in findings if each.effect == held[0])
    # A fit takes an effect in the place of one of which it is an alternative.
    known = replace(of_map, alternatives=(line, *of_map.alternatives))
    beside = replace(found, findings=tuple(known if each is of_map else each for each in findings))
    named = replace(of_map, effect=line)
    tried = beside.with_findings([named if each is of_map else each for each in findings])
    now = next(each for each in tried.findings if each.effect == line)
    return None if any(unfit(now, tried.model)) else harmless(tried)
