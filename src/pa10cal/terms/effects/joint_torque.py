"""Effects by which the log shows another torque than the joint carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import (
    CandidateContext,
    JointEffect,
    static_loads_in,
)
from pa10cal.terms.term import JointTorqueOnly, Parameter, Report


@dataclass(frozen=True)
class FalseTorque(JointTorqueOnly, JointEffect):
    """A single parameter by which the logged torque of one joint is off; no joint carries it."""

    carried: ClassVar[bool] = False


@dataclass(frozen=True)
class FrictionTorque(FalseTorque):
    """What friction holds of a load: logged torque = tau_j + tau_c s_j, tau_c in N m."""

    rated_Nm: float  # rated torque of the joint
    id: ClassVar[str] = "friction_torque"
    words: ClassVar[str] = "logged tau_{0.joint} = tau_{0.joint} + tau_c s_{0.joint}"
    positive: ClassVar[bool] = True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return (context.rated_at(joint),)

    @property
    def reported(self) -> tuple[Parameter, ...]:
        return (Parameter("tau_c", "N m", 1e-3 * self.rated_Nm, plausible=0.03 * self.rated_Nm),)

    def per_unit(self, states: PoseStates) -> Array:
        return states.arrival[:, self.joint - 1]


@dataclass(frozen=True)
class TorqueGain(FalseTorque):
    """A wrong scale of the torque: logged torque = (1 + g) tau_j, g without unit.

    tau_j is the torque of the weights: taken from the log, its noise would explain itself.
    """

    id: ClassVar[str] = "torque_gain"
    words: ClassVar[str] = "logged tau_{0.joint} = (1 + g) tau_{0.joint}"
    reported: ClassVar[tuple[Parameter, ...]] = (Parameter("g", "1", 1e-3, plausible=0.05),)

    def per_unit(self, states: PoseStates) -> Array:
        return static_loads_in(states, self).joint_Nm[:, self.joint - 1]


# Deflections of a joint under its torque beyond the springs of the model.

#: A joint so stiff counts as rigid: its reported stiffness stays finite [rad/(N m)].
_RIGID = 1e-12


@dataclass(frozen=True)
class JointCompliance(JointEffect):
    """A spring at a joint that the model holds rigid: deflection tau_j / K, K in N m/rad.

    Solved in the compliance 1/K [rad/(N m)], zero for a rigid joint.
    """

    rated_Nm: float  # rated torque of the joint
    id: ClassVar[str] = "joint_compliance"
    words: ClassVar[str] = "theta_{0.joint} -= tau_{0.joint} / K"
    positive: ClassVar[bool] = True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the rated torque of a joint without a spring."""
        return None if joint in context.flexible_joints else (context.rated_at(joint),)

    @property
    def reported(self) -> tuple[Parameter, ...]:
        return (Parameter("K", "N m/rad", 100.0 * self.rated_Nm),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        plausible = 1.0 / (100.0 * self.rated_Nm)
        name = f"{self.id}_{self.joint}_compliance"
        scale = 0.01 * plausible
        return (Parameter(name, "rad/(N m)", scale, lower=0.0, plausible=plausible),)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return -states.tau_Nm[:, self.joint - 1, None, None]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        return np.full(len(states), -x[0])

    def report(self, x: Array) -> Report:
        stiffness = 1.0 / max(float(x[0]), _RIGID)
        return Report(self.reported, np.array([stiffness]), np.array([[-(stiffness**2)]]))


@dataclass(frozen=True)
class SoftWindup(JointEffect):
    """A drive softer near zero torque: it deflects further by A tanh(tau_j / tau0).

    A in rad, tau0 in N m.
    """

    rated_Nm: float  # rated torque of the joint
    span_Nm: float  # largest torque that the joint carried
    id: ClassVar[str] = "soft_windup"
    words: ClassVar[str] = "theta_{0.joint} -= A tanh(tau_{0.joint} / tau0)"
    positive: ClassVar[bool] = True
    linear: ClassVar[int] = 1  # proportional to A; tau0 shapes it

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the torques, rated and carried, of a joint that carried any."""
        carried_Nm = context.carried_at(joint)
        return (context.rated_at(joint), carried_Nm) if carried_Nm else None

    @property
    def reported(self) -> tuple[Parameter, ...]:
        span_Nm = self.span_Nm
        return (
            Parameter("A", "rad", 1e-5, plausible=3e-4),
            Parameter("tau0", "N m", 0.1 * span_Nm, lower=1e-3 * span_Nm, upper=3.0 * span_Nm),
        )

    def shift(self, states: PoseStates, x: Array) -> Array:
        shift: Array = -x[0] * np.tanh(self._tau_Nm(states) / x[1])[:, None]
        return shift

    def derivative(self, states: PoseStates, x: Array) -> Array:
        tau_Nm = self._tau_Nm(states)
        full = np.tanh(tau_Nm / x[1])
        by_tau0 = x[0] * (1.0 - full**2) * tau_Nm / x[1] ** 2
        return np.stack([-full, by_tau0], axis=-1)[:, None, :]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        slope: Array = -x[0] / x[1] * (1.0 - np.tanh(self._tau_Nm(states) / x[1]) ** 2)
        return slope

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return zero amount at a tenth, a third and the whole of the torque carried."""
        turns_Nm = np.maximum(self.span_Nm * np.array([0.1, 0.3, 1.0]), 0.005 * self.rated_Nm)
        return tuple(np.array([0.0, tau0]) for tau0 in np.unique(turns_Nm))

    def _tau_Nm(self, states: PoseStates) -> Array:
        return states.tau_Nm[:, self.joint - 1]
