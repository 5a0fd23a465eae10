"""Weights of an arm as unknowns: masses, first moments and the direction of gravity."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeGuard

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates, StaticLoads
from pa10cal.arrays import Array, Mask
from pa10cal.errors import CalibrationError
from pa10cal.terms.term import (
    OPTIONAL,
    Report,
    Role,
    Term,
    TermParameter,
    TorqueOnly,
    report_as_solved,
)

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
