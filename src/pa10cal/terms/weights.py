"""Weights of an arm as unknowns, and faults of a log by a load or a tool stated wrongly."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeGuard

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates, StaticLoads, across
from pa10cal.arrays import Array, Mask
from pa10cal.errors import CalibrationError
from pa10cal.results.discovery import FaultKind
from pa10cal.results.number_text import plain_number, with_half_width_95
from pa10cal.rules import MASSES
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, static_loads_in
from pa10cal.terms.effects.vocabulary import everywhere_but
from pa10cal.terms.term import (
    OPTIONAL,
    ErrorOf,
    Report,
    Role,
    Term,
    TermParameter,
    TorqueOnly,
    report_as_solved,
)
from pa10cal.terms.wrapped import OF

_PARTS = (("mass", "kg"), ("moment_x", "kg m"), ("moment_y", "kg m"), ("moment_z", "kg m"))


@dataclass(frozen=True)
class WeightSizes:
    """Standard uncertainties of the weights of an arm."""

    link_mass: Array  # (n,) of the links' masses, relative
    link_com_m: Array  # (n,) of their centres of mass, per axis
    payload_kg: float  # of the mass that the last link carries
    payload_kg_m: float  # of its first moment in the end-effector frame, per axis
    level_rad: float  # of the direction of gravity in the base frame

    def columns(self, arm: Arm) -> Array:
        """Return the uncertainty of each column of `StaticLoads.by_weights`, (4 n + 3,).

        A link's mass and its first moments about the described centre of mass, link by link; the
        mass of the tool; two tilts of gravity.
        """
        mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
        relative = np.column_stack([self.link_mass, *[self.link_com_m] * 3])
        sizes = mass_kg[:, None] * relative
        sizes[-1, 1:] = np.hypot(sizes[-1, 1:], self.payload_kg_m)
        return np.concatenate([sizes.ravel(), [self.payload_kg], np.full(2, self.level_rad)])


@dataclass(frozen=True)
class Weights(TorqueOnly):
    """Masses, first moments and direction of gravity as unknowns: differences from the described.

    For torques that were calculated from the described masses. Joints, links and base carry the
    loads of the differences too, which move the arm through springs and bends. `torque_Nm` is the
    excess of the calculated torques over the true ones, hence its minus sign.
    """

    n: int  # joints of the arm
    # (k,) which columns of `StaticLoads.by_weights` are unknowns; see `WeightSizes.columns`
    columns: tuple[int, ...]
    sizes: tuple[float, ...]  # standard uncertainty of each, about what is described
    unknown_tool: bool = False  # whether nobody stated the mass of the tool
    # column that is a linear function of the others, so that the torques keep their overall size:
    # stiffness is then relative to the described weights. None where a load of known size
    # determines the scale.
    held: int | None = field(default=None, metadata={OPTIONAL: True})
    # derivative of the held column by each of `columns`
    by_held: tuple[float, ...] = field(default=(), metadata={OPTIONAL: True})
    # relative standard uncertainty of the weights as a whole, where a column is held
    u_scale: float = field(default=0.0, metadata={OPTIONAL: True})
    id: ClassVar[str] = "weights"
    of: ClassVar[str] = "arm"
    acts_on_joint: ClassVar[bool] = False  # calculated torques do not have it

    @classmethod
    def about(cls, arm: Arm, sizes: WeightSizes) -> Weights:
        """Return the uncertain weights of an arm."""
        every = sizes.columns(arm)
        chosen = np.flatnonzero(every > 0.0)
        return cls(arm.n, tuple(chosen.tolist()), tuple(every[chosen].tolist()))

    @property
    def of_last_moment(self) -> Mask:
        """Return which columns (k,) are the first moment of the last link, and of the tool."""
        return self._between(4 * self.n - 3, 4 * self.n)

    @property
    def of_tool_mass(self) -> Mask:
        """Return which columns (k,) are the mass of the tool, one at most."""
        return self._between(4 * self.n, 4 * self.n + 1)

    @property
    def of_level(self) -> Mask:
        """Return which columns (k,) are tilts of gravity."""
        return self._between(4 * self.n + 1, 4 * self.n + 3)

    @property
    def formula(self) -> str:
        formula = "tau_j = calculated tau_j + derivative of tau_j by masses, moments and level"
        if self.held is None:
            return formula
        factors = " + ".join(
            f"({factor:.6g}) {self._name(column)[0]}"
            for factor, column in zip(self.by_held, self.columns, strict=True)
            if factor
        )
        return f"{formula}; {self._name(self.held)[0]} = {factors}"

    def relative(self, torque_Nm: Array, by_weights: Array) -> Weights:
        """Return the weights with their overall size held.

        With springs of unknown stiffness, poses determine only torque over stiffness. So torques
        that the weights add are held orthogonal to the calculated ones, over poses and joints.

        Args:
            torque_Nm: (P, n) calculated torques.
            by_weights: (P, n, 4 n + 3) their derivative, see `StaticLoads.by_weights`.
        """
        grows = np.einsum("pj,pjc->c", torque_Nm, by_weights)[list(self.columns)]
        has_mass = ~self.of_level
        size = np.where(has_mass, np.abs(grows) * self.sizes, 0.0)
        held = int(np.argmax(size))
        if size[held] <= 0.0:
            return self
        kept = [k for k in range(len(self.columns)) if k != held]
        by_held = np.where(has_mass, -grows / grows[held], 0.0)[kept]
        return replace(
            self,
            columns=tuple(self.columns[k] for k in kept),
            sizes=tuple(self.sizes[k] for k in kept),
            held=self.columns[held],
            u_scale=float(np.linalg.norm(size) / np.sum(torque_Nm**2)),
            by_held=tuple(by_held.tolist()),
        )

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            TermParameter(
                *self._name(column),
                scale=size,
                plausible=size,
                # The mass of a tool that nobody stated is counted from 0.
                lower=0.0 if column == 4 * self.n and self.unknown_tool else None,
            )
            for column, size in zip(self.columns, self.sizes, strict=True)
        )

    @property
    def roles(self) -> tuple[Role, ...]:
        role: Role = "weight"
        return (role,) * len(self.columns)

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(-(self._loads(states).by_weights @ self.amounts(x)))

    def carried(self, states: PoseStates, x: Array) -> PoseStates:
        """Return states with the loads of links and base by these weights."""
        return replace(states, static_loads=self._loads(states).with_weights(self.amounts(x)))

    def amounts(self, x: Array) -> Array:
        """Return the difference of each weight from what is described, (4 n + 3,)."""
        amounts = np.zeros(4 * self.n + 3)
        amounts[list(self.columns)] = x
        if self.held is not None:
            amounts[self.held] += np.array(self.by_held) @ x
        return amounts

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        every = self._loads(states).by_weights
        by_weights: Array = every[:, :, list(self.columns)]
        if self.held is not None:
            by_weights = by_weights + every[:, :, self.held, None] * np.array(self.by_held)
        return -by_weights

    def _loads(self, states: PoseStates) -> StaticLoads:
        """Return the static loads of the poses.

        Raises:
            CalibrationError: when they were not computed for these poses.
        """
        if states.static_loads is None:
            raise CalibrationError(
                "the torques of the weights were not computed for these poses",
                where=f"{self.id} of {self.of}",
                allowed="poses of an arm whose masses are known",
                remedy="describe the masses",
            )
        return states.static_loads

    def report(self, x: Array) -> Report:
        return report_as_solved(self.parameters, x)

    def _between(self, first: int, stop: int) -> Mask:
        """Return which of `columns` (k,) are from `first` on and before `stop`."""
        columns = np.array(self.columns, dtype=np.intp)
        return (first <= columns) & (columns < stop)

    def _name(self, column: int) -> tuple[str, str]:
        """Return the name of a column's parameter, and its unit."""
        beyond = column - 4 * self.n
        if beyond == 0:
            return "weight_tool_mass", "kg"
        if beyond > 0:
            return f"weight_level_{beyond}", "rad"
        part, unit = _PARTS[column % 4]
        return f"weight_{column // 4 + 1}_{part}", unit


def holds_weights(term: Term) -> TypeGuard[Weights]:
    """Return whether a term is that of unknown weights."""
    return "weight" in term.roles


# Faults of a whole log as terms: reported as faults, never named as effects.

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
