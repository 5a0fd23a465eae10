"""What a term is: a few parameters that shift chain coordinates, with the derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeGuard

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array

#: In the metadata of a field of a term: omitted from files where it has its default.
OPTIONAL = "optional"


@dataclass(frozen=True)
class Parameter:
    """One unknown of a model."""

    name: str  # unique within a model
    unit: str  # SI unit
    scale: float  # a typical size, by which it is scaled in solving and in judging rank
    # manufacturing tolerance (paper, Section II.C), or None where it has none
    tolerance: float | None = None
    # lower and upper: ends of the range with a physical meaning, or None
    lower: float | None = None
    upper: float | None = None
    # size to be expected of an effect, a standard deviation about zero, or None
    plausible: float | None = None


@dataclass(frozen=True)
class Report:
    """Parameters in the form readers know them, from those a term is solved in."""

    parameters: tuple[Parameter, ...]  # k' reported parameters
    values: Array  # (k',) their values
    jacobian: Array  # (k', k) derivative by the solved parameters, for uncertainties


class Term(Protocol):
    """A part of the model that adds to chain coordinates."""

    @property
    def id(self) -> str:
        """Return the name of its kind, by which a file names it."""

    @property
    def of(self) -> str:
        """Return where it sits: `joint 2`, `forearm`, `base`, ..."""

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type, by the parameters it reports."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the k parameters it is solved in."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the m chain coordinates it adds to."""

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return what it adds to its coordinates, (P, m) or (1, m)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by x, (P, m, k) or (1, m, k)."""

    def report(self, x: Array) -> Report:
        """Return the parameters in the form readers know them."""


class Yielding(Term, Protocol):
    """A term that turns a joint under the torque it carries."""

    @property
    def joint(self) -> int:
        """Return the joint, 1 … n, whose angle is the term's only coordinate."""

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by the joint's torque, (P,) [rad/(N m)]."""


class TorqueTerm(Term, Protocol):
    """A term that shows in the logged torques."""

    @property
    def carried(self) -> bool:
        """Return whether the joint carries that torque; else only the log shows it."""

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return what the log shows beyond the weights, (P, n)."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""


def yields(term: Term) -> TypeGuard[Yielding]:
    """Return whether a term turns a joint under the torque it carries."""
    return hasattr(type(term), "by_torque")


def shows_torque(term: Term) -> TypeGuard[TorqueTerm]:
    """Return whether a term shows in the logged torques."""
    return hasattr(type(term), "torque_derivative")


def falsifies_log(term: Term) -> bool:
    """Return whether a term shows in a log of torques alone, and moves no robot."""
    of_calculated = getattr(term, "of_calculated", False)
    return shows_torque(term) and not term.carried and not of_calculated


def report_as_solved(parameters: tuple[Parameter, ...], x: Array) -> Report:
    """Report parameters that readers know in the form they are solved in."""
    return Report(parameters, x, np.eye(len(x)))
