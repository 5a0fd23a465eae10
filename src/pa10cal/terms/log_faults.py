"""Faults of a log as terms: what a whole log is wrong by, told and never named as an effect."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.results.record import HALF_WIDTH_95, FaultKind
from pa10cal.terms.effects.effect import (
    CandidateContext,
    Effect,
    everywhere_but,
    static_loads_in,
)
from pa10cal.terms.term import Term, TermParameter, TorqueOnly

#: Part by which a load may well be misstated.
_LOAD_PART = 0.1
#: Part of its mass by which a tool may well be misstated, and its centre [m].
_TOOL_PART = 0.3
_TOOL_M = 0.05


@dataclass(frozen=True)
class FaultText:
    """A fault in words."""

    where: str  # column, joint, load, pose, row or time
    what: str  # what is wrong and by how much, one clause
    remedy: str  # what to do about it


@dataclass(frozen=True)
class LogFault(Effect):
    """A fault of the whole log, such as a load that is stated wrongly."""

    kind: ClassVar[FaultKind]

    @abstractmethod
    def fault_text(self, x: Array, std: Array) -> FaultText:
        """Return it in words, by its reported parameters and their standard uncertainties."""


@dataclass(frozen=True)
class WeightStated(TorqueOnly, LogFault):
    """A weight that is not what is stated: the joints hold more than the weights described.

    A log of torques shows it, and the springs know of it. Torques that were calculated lack it,
    and it moves the arm by way of the springs.
    """

    of_calculated: bool  # whether torques were calculated

    @property
    def acts_on_joint(self) -> bool:
        """Return whether the joints are known to carry it, by their log."""
        return not self.of_calculated

    @abstractmethod
    def per_unit(self, states: PoseStates) -> Array:
        """Return what the joints hold beyond what is stated, a unit of each parameter (P, n, k)."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        held = self.per_unit(states)
        return -held if self.of_calculated else held


@dataclass(frozen=True)
class LoadStated(WeightStated):
    """One external load is not what is stated, in all poses: true load = (1 + part) load."""

    load_N: float  # the load as stated
    id = "load_stated"
    kind = "load"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        if context.torques == "none" or len(context.loads_N) < 2:
            return ()
        calculated = context.torques == "masses"
        return tuple(cls(f"load {load:g} N", calculated, load) for load in context.loads_N if load)

    words = "true load = (1 + part) {0.load_N:g} N"
    reported = (TermParameter("part", "1", 1e-2, plausible=_LOAD_PART),)

    def per_unit(self, states: PoseStates) -> Array:
        load_N = np.where(states.load_N == self.load_N, self.load_N, 0.0)
        return (load_N[:, None] * static_loads_in(states, self).by_load)[..., None]

    def fault_text(self, x: Array, std: Array) -> FaultText:
        true_N, std_N = self.load_N * (1.0 + x[0]), self.load_N * std[0]
        return FaultText(
            f"load_N = {self.load_N:g}",
            f"the load stated as {self.load_N:g} N seems to be {true_N:.1f} ± "
            f"{HALF_WIDTH_95 * std_N:.1f} N",
            "weigh the load, and correct load_N in its rows",
        )


@dataclass(frozen=True)
class ToolStated(WeightStated):
    """Mass or centre of the tool are not what is stated, where torques were logged."""

    n: int  # joints of the arm
    tool_kg: float  # mass as stated
    id = "tool_stated"
    sits = "tool"
    kind = "payload"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        stated = context.torques == "logged" and context.tool_kg != 0.0
        return (False, context.arm.n, context.tool_kg) if stated else None

    words = "true mass = stated + mass, true first moment = stated + moment"

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return mass and first moment about the stated centre, along the flange's axes."""
        mass = TermParameter("mass", "kg", 1e-2, plausible=_TOOL_PART * self.tool_kg)
        size = _TOOL_M * self.tool_kg
        return (mass, *(TermParameter(f"moment_{k}", "kg m", 1e-3, plausible=size) for k in "xyz"))

    def per_unit(self, states: PoseStates) -> Array:
        last = 4 * self.n
        return static_loads_in(states, self).by_weights[..., [last, last - 3, last - 2, last - 1]]

    def fault_text(self, x: Array, std: Array) -> FaultText:
        true_kg = self.tool_kg + x[0]
        off_mm = 1e3 * x[1:] / max(true_kg, 0.1 * self.tool_kg)
        axis = int(np.argmax(np.abs(off_mm)))
        return FaultText(
            "tool.mass_kg, tool.com_mm",
            f"the tool stated as {self.tool_kg:.3g} kg seems to be {true_kg:.3g} ± "
            f"{HALF_WIDTH_95 * std[0]:.1g} kg, its centre {off_mm[axis]:+.0f} mm along "
            f"{'xyz'[axis]}",
            "weigh the tool, and correct its mass and centre in campaign.yaml",
        )


#: Every class of fault.
FAULTS: tuple[type[LogFault], ...] = (LoadStated, ToolStated)


def fault_candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every fault wherever a log may have it, but those that a model has."""
    return everywhere_but(FAULTS, context, held)
