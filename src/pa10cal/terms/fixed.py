"""A term whose parameters are settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.term import Parameter, Report, Term, TorqueTerm, shows_torque


@dataclass(frozen=True, eq=False)
class Fixed:
    """What a term adds at known parameters; nothing of it is unknown any more."""

    term: Term  # the term, whose effect on chain coordinates is kept
    x_term: Array  # (k,) its parameters

    @property
    def id(self) -> str:
        """Return the id of the term."""
        return self.term.id

    @property
    def of(self) -> str:
        """Return the place of the term."""
        return self.term.of

    @property
    def formula(self) -> str:
        """Return the form of the term."""
        return self.term.formula

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the chain coordinates it adds to."""
        return self.term.coordinates

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return what the term adds, (P, m) or (1, m)."""
        del x
        return self.term.shift(states, self.x_term)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return no column, (1, m, 0)."""
        del states, x
        return np.zeros((1, len(self.coordinates), 0))

    def report(self, x: Array) -> Report:
        """Return nothing."""
        return Report((), x, np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class FixedTorque(Fixed):
    """What a term that shows in torques adds to them at known parameters."""

    term: TorqueTerm  # the term, whose effect on torques is kept too

    @property
    def carried(self) -> bool:
        """Return whether the joint carries that torque; else only the log shows it."""
        return self.term.carried

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return what the term adds to the torques, (P, n)."""
        del x
        return self.term.torque_Nm(states, self.x_term)

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return no column, (P, n, 0)."""
        del x
        return np.zeros((*states.tau_Nm.shape, 0))


def fixed(term: Term, x_term: Array) -> Fixed:
    """Return a term whose parameters (k,) are settled."""
    return FixedTorque(term, x_term) if shows_torque(term) else Fixed(term, x_term)
