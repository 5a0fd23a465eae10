"""All faults of a whole log, found by looking through this package."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from pa10cal.terms import faults
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.family import classes_in, everywhere_but
from pa10cal.terms.faults.log_fault import LogFault
from pa10cal.terms.term import Term


@cache
def every_fault() -> tuple[type[LogFault], ...]:
    """Return every class of fault, ordered by id."""
    return classes_in(faults, LogFault)


def fault_candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every fault wherever a log may have it, but those that a model has."""
    return everywhere_but(every_fault(), context, held)
