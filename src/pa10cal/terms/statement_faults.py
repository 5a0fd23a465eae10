"""Faults of a whole log as terms: a load, the tool or gravity is not what is stated.

They are reported as faults, and never named as effects.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeGuard

import numpy as np

from pa10cal.arm.statics import PoseStates, across
from pa10cal.arrays import Array
from pa10cal.results.discovery import FaultKind
from pa10cal.results.number_text import plain_number, with_half_width_95
from pa10cal.rules import MASSES
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, static_loads_in
from pa10cal.terms.effects.vocabulary import everywhere_but
from pa10cal.terms.term import (
    OPTIONAL,
    ErrorOf,
    Term,
    TermParameter,
    TorqueOnly,
)
from pa10cal.terms.wrapped import OF

#: Plausible relative error of a stated load.
_LOAD_PART = 0.1
#: Plausible relative error of a stated tool mass, and error of its centre [m].
_TOOL_PART = 0.3
_TOOL_M = 0.05
#: Plausible error of a stated direction of gravity [rad].
_LEVEL_RAD = 0.1


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
    error_of: ClassVar[ErrorOf] = "statement"

    @abstractmethod
    def fault_text(self, x: Array, std: Array) -> FaultText:
        """Return the fault in words, by its reported parameters and their uncertainties."""


def is_fault(effect: Effect) -> TypeGuard[LogFault]:
    """Return whether something sought is a fault of the log, and no effect."""
    return effect.error_of == "statement"


@dataclass(frozen=True)
class WeightStated(TorqueOnly, LogFault):
    """A weight that differs from what is stated: the joints carry its torque besides.

    Logged torques contain that torque, as do the deflections of springs. Calculated torques lack
    it: then it moves the arm through the springs.
    """

    of_calculated: bool  # whether torques were calculated

    @property
    def acts_on_joint(self) -> bool:
        """Return whether the torque counts as carried: logged torques contain it already."""
        return not self.of_calculated

    @abstractmethod
    def per_unit(self, states: PoseStates) -> Array:
        """Return the torque beyond the stated weights by each parameter, (P, n, k)."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        extra_Nm = self.per_unit(states)
        return -extra_Nm if self.of_calculated else extra_Nm


@dataclass(frozen=True)
class LoadStated(WeightStated):
    """One external load is not what is stated, in all poses: true load = (1 + part) load."""

    load_N: float  # the load as stated
    id = "load_stated"
    sits = "load"
    nouns = ("load as stated", "loads as stated")
    clauses = ("a load is not what is stated",)
    kind = "load"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        if context.torques == "none" or len(context.loads_N) < 2:
            return ()
        calculated = context.torques == "masses"
        return tuple(cls(f"load {load:g} N", calculated, load) for load in context.loads_N if load)

    words = "true load = (1 + part) {0.load_N:g} N"
    reported = (TermParameter("part", "1", 1e-2, lower=-1.0, plausible=_LOAD_PART),)

    def per_unit(self, states: PoseStates) -> Array:
        load_N = np.where(states.load_N == self.load_N, self.load_N, 0.0)
        return (load_N[:, None] * static_loads_in(states, self).by_load)[..., None]

    def fault_text(self, x: Array, std: Array) -> FaultText:
        true_N = with_half_width_95(self.load_N * (1.0 + x[0]), self.load_N * float(std[0]))
        return FaultText(
            f"load_N = {self.load_N:g}",
            f"the load stated as {self.load_N:g} N seems to be {true_N} N",
            "weigh the load, and correct load_N in its rows",
        )


@dataclass(frozen=True)
class ToolStated(WeightStated):
    """Mass or centre of the tool are not what is stated."""

    n: int  # joints of the arm
    tool_kg: float  # mass as stated
    # mass of the arm's links, where torques were calculated: the tool may then be any; else 0
    arm_kg: float = field(default=0.0, metadata={OPTIONAL: True})
    id = "tool_stated"
    nouns = ("tool as stated", "tools as stated")
    clauses = ("the tool is not what is stated",)
    sits = "tool"
    kind = "payload"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        if context.torques == "none" or context.tool_kg == 0.0:
            return None
        calculated, mass_kg = context.torques == "masses", context.arm.mass_kg
        arm_kg = float(mass_kg.sum()) if calculated and mass_kg is not None else 0.0
        return calculated, context.arm.n, context.tool_kg, arm_kg

    words = "true mass = stated + mass, true first moment = stated + moment"

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return mass and first moment about the stated centre, along the flange's axes."""
        any_kg = MASSES.unknown_tool_share * self.arm_kg
        size_kg = max(_TOOL_PART * self.tool_kg, any_kg)
        mass = TermParameter("mass", "kg", 1e-2, lower=-self.tool_kg, plausible=size_kg)
        size = max(_TOOL_M * self.tool_kg, MASSES.unknown_tool_com_m * any_kg)
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
            f"the tool stated as {plain_number(self.tool_kg)} kg seems to be "
            f"{with_half_width_95(true_kg, float(std[0]))} kg, its centre {off_mm[axis]:+.0f} mm "
            f"along {'xyz'[axis]}",
            "weigh the tool, and correct its mass and centre in campaign.yaml",
        )


@dataclass(frozen=True)
class CampaignToolStated(ToolStated):
    """Mass or centre of the tool of one campaign of a group are not what is stated."""

    campaign: int = 0  # number of the campaign in the group, from 0
    id = "campaign_tool_stated"
    nouns = ("tool as stated", "tools as stated")
    clauses = ("the tool of a campaign is not what is stated",)

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        if context.torques != "masses" or context.arm.mass_kg is None:
            return ()
        arm_kg = float(context.arm.mass_kg.sum())
        return tuple(
            cls(f"tool{OF}{name}", True, context.arm.n, tool_kg, arm_kg, number)
            for number, (name, tool_kg) in enumerate(
                zip(context.campaigns, context.campaign_tools_kg, strict=False)
            )
            if tool_kg
        )

    def moves_in(self, campaign: int) -> bool:
        return campaign == self.campaign

    def per_unit(self, states: PoseStates) -> Array:
        by_tool = super().per_unit(states)
        if states.campaign is None:
            return by_tool
        return np.where((states.campaign == self.campaign)[:, None, None], by_tool, 0.0)

    def fault_text(self, x: Array, std: Array) -> FaultText:
        text, campaign = super().fault_text(x, std), self.of.partition(OF)[2]
        return replace(
            text,
            where=f"{campaign}: {text.where}",
            remedy=f"weigh the tool of {campaign}, and correct its mass and centre in its "
            "campaign.yaml",
        )


@dataclass(frozen=True)
class GravityStated(WeightStated):
    """Gravity acts along another direction of the base than stated."""

    n: int  # joints of the arm
    gravity_m_s2: tuple[float, float, float]  # as stated, in the base frame
    id = "gravity_stated"
    nouns = ("gravity as stated",)
    clauses = ("gravity does not act as stated",)
    sits = "base"
    kind = "gravity"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        if context.torques != "masses" or not any(context.gravity_m_s2):
            return None
        return (True, context.arm.n, context.gravity_m_s2)

    words = "true gravity = stated + tilts across it"
    reported = tuple(TermParameter(f"level_{k}", "rad", 1e-3, plausible=_LEVEL_RAD) for k in (1, 2))

    def per_unit(self, states: PoseStates) -> Array:
        return static_loads_in(states, self).by_weights[..., 4 * self.n + 1 :]

    def fault_text(self, x: Array, std: Array) -> FaultText:
        stated = np.array(self.gravity_m_s2)
        size = np.linalg.norm(stated)
        true = stated + x @ across(stated)
        true *= size / np.linalg.norm(true)
        vector = ", ".join(f"{part + 0.0:.2f}" for part in true)
        tilt = with_half_width_95(*np.degrees([np.arctan(np.linalg.norm(x)), std.max()]))
        return FaultText(
            "campaign.yaml: gravity_m_s2",
            f"gravity seems to act {tilt} deg off its stated direction",
            f"check how the base stands; set gravity_m_s2: [{vector}] if it is so, and run again",
        )


#: Every class of fault.
FAULTS: tuple[type[WeightStated], ...] = (
    LoadStated,
    ToolStated,
    CampaignToolStated,
    GravityStated,
)


def fault_candidates(
    context: CandidateContext, of_model: Iterable[Term] = ()
) -> tuple[WeightStated, ...]:
    """Return every fault at every place that a log may have it, except those that a model has."""
    return everywhere_but(FAULTS, context, of_model)
