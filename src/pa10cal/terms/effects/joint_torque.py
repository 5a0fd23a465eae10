"""Effects by which the log shows another torque than the joint carries."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import (
    CandidateContext,
    JointEffect,
    static_loads_in,
    turning_joints,
)
from pa10cal.terms.term import Parameter
from pa10cal.terms.torque_only import TorqueOnly


@dataclass(frozen=True)
class FalseTorque(TorqueOnly, JointEffect):
    """A single parameter by which the logged torque of one joint is off; no joint carries it."""

    @property
    def carried(self) -> bool:
        """Return that only the log shows it."""
        return False

    @abstractmethod
    def per_unit(self, states: PoseStates) -> Array:
        """Return how much too much the log shows a unit of the parameter, (P,) [N m]."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return its derivative by the parameter, (P, n, 1)."""
        derivative = np.zeros((*states.tau_Nm.shape, len(x)))
        derivative[:, self.joint - 1, 0] = self.per_unit(states)
        return derivative


@dataclass(frozen=True)
class FrictionTorque(FalseTorque):
    """What friction holds of a load: logged torque = tau_j + tau_c s_j, tau_c in N m."""

    rated_Nm: float  # rated torque of the joint
    id: ClassVar[str] = "friction_torque"
    positive: ClassVar[bool] = True

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"logged tau_{self.joint} = tau_{self.joint} + tau_c s_{self.joint}"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns."""
        rated_Nm = context.rated_Nm
        return tuple(
            cls(f"joint {joint}", float(rated_Nm[joint - 1])) for joint in turning_joints(context)
        )

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the torque that friction holds."""
        return (Parameter("tau_c", "N m", 1e-3 * self.rated_Nm, plausible=0.03 * self.rated_Nm),)

    def per_unit(self, states: PoseStates) -> Array:
        """Return s_j, (P,)."""
        return states.arrival[:, self.joint - 1]


@dataclass(frozen=True)
class TorqueGain(FalseTorque):
    """A wrong scale of the torque: logged torque = (1 + g) tau_j, g without unit.

    tau_j is the torque of the weights: taken from the log, its noise would explain itself.
    """

    id: ClassVar[str] = "torque_gain"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"logged tau_{self.joint} = (1 + g) tau_{self.joint}"

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the gain."""
        return (Parameter("g", "1", 1e-3, plausible=0.05),)

    def per_unit(self, states: PoseStates) -> Array:
        """Return the torque of the weights, (P,)."""
        return static_loads_in(states, self).joint_Nm[:, self.joint - 1]
