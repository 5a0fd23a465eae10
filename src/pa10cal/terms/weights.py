"""Weights that are not known exactly: what they do to torques that were calculated from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms.term import OPTIONAL, Report, TermParameter, TorqueOnly, report_as_solved

#: Start of the names of its parameters.
WEIGHT = "weight_"
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
        """Return the uncertainty of each column of `StaticLoads.by_weights`, (4 n + 3,)."""
        mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
        relative = np.column_stack([self.link_mass, *[self.link_com_m] * 3])
        sizes = mass_kg[:, None] * relative
        sizes[-1, 1:] = np.hypot(sizes[-1, 1:], self.payload_kg_m)
        return np.concatenate([sizes.ravel(), [self.payload_kg], np.full(2, self.level_rad)])


@dataclass(frozen=True)
class Weights(TorqueOnly):
    """Masses, first moments and level as unknowns about what is described.

    For torques that were calculated from the masses described: the joints carry those torques and,
    beyond them, what the weights differ by. It moves the arm by way of the springs alone.
    """

    n: int  # joints of the arm
    columns: tuple[int, ...]  # which columns of `StaticLoads.by_weights` are unknowns
    sizes: tuple[float, ...]  # standard uncertainty of each, about what is described
    unknown_tool: bool = False  # whether the mass of the tool is not known at all
    # column that follows the others, so that the weights as a whole stay as heavy as they are
    # described: stiffness is then known relative to these. None where some load of known size sets
    # the scale, and no column is held.
    held: int | None = field(default=None, metadata={OPTIONAL: True})
    # how much it follows each of the columns
    by_held: tuple[float, ...] = field(default=(), metadata={OPTIONAL: True})
    id: ClassVar[str] = "weights"
    of: ClassVar[str] = "arm"
    acts_on_joint: ClassVar[bool] = False  # calculated torques do not have it
    #: Whether calculated torques alone are off by it: it plays a part wherever they are predicted.
    of_calculated: ClassVar[bool] = True

    @classmethod
    def about(cls, arm: Arm, sizes: WeightSizes, only: range | None = None) -> Weights:
        """Return those of an arm that are uncertain, all or only some of the columns."""
        every = sizes.columns(arm)
        chosen = [k for k in only or range(len(every)) if every[k] > 0.0]
        return cls(arm.n, tuple(chosen), tuple(float(every[k]) for k in chosen))

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
        """Return the weights of which only the shape is unknown, not how heavy they are.

        With springs of unknown stiffness poses show torque over stiffness. So the torques that
        weights lead to are kept as large as those calculated: what they add is at right angles to
        these, over poses and joints.

        Args:
            torque_Nm: (P, n) calculated torques.
            by_weights: (P, n, 4 n + 3) their derivative, see `StaticLoads.by_weights`.
        """
        grows = np.einsum("pj,pjc->c", torque_Nm, by_weights)[list(self.columns)]
        of_links = np.array(self.columns) <= 4 * self.n
        size = np.where(of_links, np.abs(grows) * self.sizes, 0.0)
        held = int(np.argmax(size))
        if size[held] <= 0.0:
            return self
        kept = [k for k in range(len(self.columns)) if k != held]
        by_held = np.where(of_links, -grows / grows[held], 0.0)[kept]
        return replace(
            self,
            columns=tuple(self.columns[k] for k in kept),
            sizes=tuple(self.sizes[k] for k in kept),
            held=self.columns[held],
            by_held=tuple(by_held.tolist()),
        )

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            TermParameter(
                *self._name(column),
                scale=size,
                plausible=size,
                # A tool weighs something, or nothing where that is what is stated.
                lower=0.0 if column == 4 * self.n and self.unknown_tool else None,
            )
            for column, size in zip(self.columns, self.sizes, strict=True)
        )

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        every = self._by_weights(states)
        amounts = np.zeros(every.shape[2])
        amounts[list(self.columns)] = x
        if self.held is not None:
            amounts[self.held] += np.array(self.by_held) @ x
        return np.asarray(-(every @ amounts))

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        every = self._by_weights(states)
        by_weights: Array = every[:, :, list(self.columns)]
        if self.held is not None:
            by_weights = by_weights + every[:, :, self.held, None] * np.array(self.by_held)
        return -by_weights

    def _by_weights(self, states: PoseStates) -> Array:
        """Return the derivative of the torques by every weight, (P, n, 4 n + 3).

        Raises:
            CalibrationError: when what weights do was not computed for these poses.
        """
        if states.static_loads is None:
            raise CalibrationError(
                "the torques of the weights were not computed for these poses",
                where=f"{self.id} of {self.of}",
                allowed="poses of an arm whose masses are known",
                remedy="describe the masses",
            )
        return states.static_loads.by_weights

    def report(self, x: Array) -> Report:
        return report_as_solved(self.parameters, x)

    def _name(self, column: int) -> tuple[str, str]:
        """Return the name of a column's parameter, and its unit."""
        beyond = column - 4 * self.n
        if beyond == 0:
            return f"{WEIGHT}tool_mass", "kg"
        if beyond > 0:
            return f"{WEIGHT}level_{beyond}", "rad"
        part, unit = _PARTS[column % 4]
        return f"{WEIGHT}{column // 4 + 1}_{part}", unit
