"""All faults of a whole log, found by looking through this package."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from pa10cal.terms import faults
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.family import classes_in
from pa10cal.terms.faults.log_fault import LogFault
from pa10cal.terms.term import Term


@cache
def every_fault() -> tuple[type[LogFault], ...]:
    """Return every class of fault, ordered by id."""
    return classes_in(faults, LogFault)


def fault_candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every fault wherever a log may have it, but those that a model has."""
    there = {(term.id, term.of) for term in held if isinstance(term, LogFault)}
    return tuple(
        fault
        for kind in every_fault()
        for fault in kind.everywhere(context)
        if (fault.id, fault.of) not in there
    )
