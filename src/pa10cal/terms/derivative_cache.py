"""A cache of derivatives of terms that are proportional to their parameters.

A search fits hundreds of sets of the same effects in the same poses. The derivative of a
proportional term depends on the states of the poses alone, and mostly not on the torques that a
fit changes in these: it is computed anew only when a field of the states that it read has changed.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.term import Term

_FIELDS = frozenset(field.name for field in fields(PoseStates))


class _Watched(PoseStates):
    """States that record which of their fields are read."""

    @classmethod
    def of(cls, states: PoseStates) -> _Watched:
        """Return the same states with an empty record."""
        watched = cls(**{name: getattr(states, name) for name in _FIELDS})
        vars(watched)["read"] = set()
        return watched

    def __getattribute__(self, name: str) -> Any:
        if name in _FIELDS:
            vars(self).get("read", set()).add(name)
        return super().__getattribute__(name)


class Kept:
    """The derivative of each proportional term at the states it was last computed for."""

    def __init__(self) -> None:
        """Start empty."""
        #: Derivatives, each with the fields of the states that were read for it, by name.
        self._cached: dict[Term, tuple[Array, dict[str, Any]]] = {}

    def derivative(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.derivative(states, x)`, from the cache where that is valid."""
        if not term.proportional:
            return term.derivative(states, x)
        if not self._is_valid(term, states):
            watched = _Watched.of(states)
            derivative = term.derivative(watched, x)
            read = {name: getattr(states, name) for name in vars(watched)["read"]}
            self._cached[term] = derivative, read
        return self._cached[term][0]

    def shift(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.shift(states, x)`, from the cached derivative where that is valid."""
        if not self._is_valid(term, states):
            return term.shift(states, x)
        shift: Array = self._cached[term][0] @ x
        return shift

    def _is_valid(self, term: Term, states: PoseStates) -> bool:
        """Return whether a derivative is cached, of states with the very same arrays."""
        if not term.proportional or term not in self._cached:
            return False
        _, read = self._cached[term]
        return all(getattr(states, name) is value for name, value in read.items())
