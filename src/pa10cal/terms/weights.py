"""Weights that are not known exactly: what they do to torques that were calculated from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.errors import CalibrationError
from pa10cal.terms.term import Parameter, Report, report_as_solved
from pa10cal.terms.torque_only import TorqueOnly

Array = NDArray[np.float64]

#: Start of the names of its parameters.
WEIGHT = "weight_"
_PARTS = (("mass", "kg"), ("moment_x", "kg m"), ("moment_y", "kg m"), ("moment_z", "kg m"))


@dataclass(frozen=True)
class WeightSizes:
    """Standard uncertainties of the weights of an arm.

    Attributes:
        link_mass: of a link's mass, relative.
        link_com_m: of a link's centre of mass, per axis.
        payload_kg: of the mass that the last link carries.
        payload_kg_m: of its first moment in the end-effector frame, per axis.
        level_rad: of the direction of gravity in the base frame.
    """

    link_mass: float
    link_com_m: float
    payload_kg: float
    payload_kg_m: float
    level_rad: float

    def columns(self, arm: Arm) -> Array:
        """Return the uncertainty of each column of `StaticLoads.by_weights`, (4 n + 3,)."""
        mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
        sizes = np.tile(mass_kg[:, None], (1, 4)) * [self.link_mass, *[self.link_com_m] * 3]
        sizes[-1, 1:] = np.hypot(sizes[-1, 1:], self.payload_kg_m)
        return np.concatenate([sizes.ravel(), [self.payload_kg], np.full(2, self.level_rad)])


@dataclass(frozen=True)
class Weights(TorqueOnly):
    """Masses, first moments and level as unknowns about what is described.

    For torques that were calculated from the masses described: the joints carry those torques and,
    beyond them, what the weights differ by. It moves the arm by way of the springs alone.

    Attributes:
        n: joints of the arm.
        columns: which columns of `StaticLoads.by_weights` are unknowns.
        sizes: standard uncertainty of each, about what is described.
        unknown_tool: whether the mass of the tool is not known at all.
    """

    n: int
    columns: tuple[int, ...]
    sizes: tuple[float, ...]
    unknown_tool: bool = False
    id: ClassVar[str] = "weights"
    of: ClassVar[str] = "arm"
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
        """Return the form in words a reader can type."""
        return "tau_j = calculated tau_j + derivative of tau_j by masses, moments and level"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return what each weight differs by."""
        return tuple(
            Parameter(
                *self._name(column),
                scale=size,
                plausible=size,
                # A tool weighs something, or nothing where that is what is stated.
                lower=0.0 if column == 4 * self.n and self.unknown_tool else None,
            )
            for column, size in zip(self.columns, self.sizes, strict=True)
        )

    @property
    def carried(self) -> bool:
        """Return that the calculated torques do not have it."""
        return False

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return nothing, (P, 0)."""
        del x
        return np.zeros((len(states), 0))

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return nothing, (P, 0, k)."""
        return np.zeros((len(states), 0, len(x)))

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return its derivative by the parameters, (P, n, k).

        Raises:
            CalibrationError: when what weights do was not computed for these poses.
        """
        del x
        if states.static_loads is None:
            raise CalibrationError(
                "the torques of the weights were not computed for these poses",
                where=f"{self.id} of {self.of}",
                allowed="poses of an arm whose masses are known",
                remedy="describe the masses",
            )
        return -states.static_loads.by_weights[:, :, list(self.columns)]

    def report(self, x: Array) -> Report:
        """Return what each weight differs by."""
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
