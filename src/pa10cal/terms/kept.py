"""Derivatives of terms proportional to their parameters, kept while the states stay the same.

A search fits hundreds of sets of the same effects at the same poses. What a proportional term makes
of a pose depends on the pose alone, and mostly not on the torques that the fit makes of it: it is
worked out again only where something differs that it read.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.term import Term

_FIELDS = frozenset(field.name for field in fields(PoseStates))


class _Watched(PoseStates):
    """States that note which of their fields are read."""

    @classmethod
    def of(cls, states: PoseStates) -> _Watched:
        """Return the same states, watched from now on."""
        watched = cls(**{name: getattr(states, name) for name in _FIELDS})
        vars(watched)["read"] = set()
        return watched

    def __getattribute__(self, name: str) -> Any:
        if name in _FIELDS:
            vars(self).get("read", set()).add(name)
        return super().__getattribute__(name)


@dataclass(frozen=True)
class _Known:
    """A derivative, and what was read of the states for it."""

    derivative: Array
    read: dict[str, Any]

    def holds_at(self, states: PoseStates) -> bool:
        """Return whether states hold the very same arrays."""
        return all(getattr(states, name) is value for name, value in self.read.items())


class Kept:
    """What terms made of the states that they were last asked about."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self._known: dict[Term, _Known | None] = {}

    def derivative(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.derivative(states, x)`, from what is known where that is the same."""
        if not hasattr(type(term), "linear"):
            return term.derivative(states, x)
        if term not in self._known and not _proportional(term):
            self._known[term] = None
        known = self._known.get(term)
        if known is None and term in self._known:
            return term.derivative(states, x)
        if known is None or not known.holds_at(states):
            watched = _Watched.of(states)
            found = term.derivative(watched, x)
            read = {name: getattr(states, name) for name in vars(watched)["read"]}
            known = self._known[term] = _Known(found, read)
        return known.derivative

    def shift(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.shift(states, x)`, from its derivative where that is known."""
        known = self._known.get(term) if hasattr(type(term), "linear") else None
        if known is None or not known.holds_at(states):
            return term.shift(states, x)
        shift: Array = known.derivative @ x
        return shift


def _proportional(term: Term) -> bool:
    """Return whether a term is proportional to all its parameters."""
    return getattr(term, "linear", None) == len(term.parameters)
