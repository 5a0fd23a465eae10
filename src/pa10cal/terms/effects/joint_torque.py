"""Effects by which the log shows another torque than the joint carries."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import (
    CandidateContext,
    JointEffect,
    static_loads_in,
    turning_joints,
)
from pa10cal.terms.term import Parameter, Report, TorqueOnly


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


# Deflections of a joint under its torque beyond the springs of the model.

#: A joint so stiff counts as rigid: its reported stiffness stays finite [rad/(N m)].
_RIGID = 1e-12
#: A joint that never carried this share of its rated torque cannot show how it winds up.
_LOADED_SHARE = 0.01


@dataclass(frozen=True)
class JointCompliance(JointEffect):
    """A spring at a joint that the model holds rigid: deflection tau_j / K, K in N m/rad.

    Solved in the compliance 1/K [rad/(N m)], zero for a rigid joint.
    """

    rated_Nm: float  # rated torque of the joint
    id: ClassVar[str] = "joint_compliance"
    positive: ClassVar[bool] = True

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.joint} -= tau_{self.joint} / K"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns and has no spring."""
        rated_Nm = context.rated_Nm
        return tuple(
            cls(f"joint {joint}", float(rated_Nm[joint - 1]))
            for joint in turning_joints(context)
            if joint not in context.flexible_joints
        )

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the stiffness."""
        return (Parameter("K", "N m/rad", 100.0 * self.rated_Nm),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the compliance."""
        plausible = 1.0 / (100.0 * self.rated_Nm)
        return (
            Parameter(
                f"{self.id}_{self.joint}_compliance",
                "rad/(N m)",
                0.01 * plausible,
                lower=0.0,
                plausible=plausible,
            ),
        )

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return minus the torque, (P, 1, 1)."""
        del x
        return -states.tau_Nm[:, self.joint - 1, None, None]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by the joint's torque, (P,) [rad/(N m)]."""
        return np.full(len(states), -x[0])

    def report(self, x: Array) -> Report:
        """Return the stiffness."""
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
    positive: ClassVar[bool] = True

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.joint} -= A tanh(tau_{self.joint} / tau0)"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns and carried torque."""
        rated_Nm, span_Nm = context.rated_Nm, context.tau_span_Nm
        return tuple(
            cls(f"joint {joint}", float(rated_Nm[joint - 1]), float(span_Nm[joint - 1]))
            for joint in loaded_joints(context)
        )

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the deflection under a large torque and the torque where it turns over."""
        span_Nm = self.span_Nm
        return (
            Parameter("A", "rad", 1e-5, plausible=3e-4),
            Parameter("tau0", "N m", 0.1 * span_Nm, lower=1e-3 * span_Nm, upper=3.0 * span_Nm),
        )

    @property
    def linear(self) -> int:
        """Return one: it is proportional to A, and tau0 shapes it."""
        return 1

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return minus the extra deflection, (P, 1)."""
        shift: Array = -x[0] * np.tanh(self._tau_Nm(states) / x[1])[:, None]
        return shift

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by A and tau0, (P, 1, 2)."""
        tau_Nm = self._tau_Nm(states)
        full = np.tanh(tau_Nm / x[1])
        by_tau0 = x[0] * (1.0 - full**2) * tau_Nm / x[1] ** 2
        return np.stack([-full, by_tau0], axis=-1)[:, None, :]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by the joint's torque, (P,) [rad/(N m)]."""
        slope: Array = -x[0] / x[1] * (1.0 - np.tanh(self._tau_Nm(states) / x[1]) ** 2)
        return slope

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return zero amount at a tenth, a third and the whole of the torque carried."""
        turns_Nm = np.maximum(self.span_Nm * np.array([0.1, 0.3, 1.0]), 0.005 * self.rated_Nm)
        return tuple(np.array([0.0, tau0]) for tau0 in np.unique(turns_Nm))

    def _tau_Nm(self, states: PoseStates) -> Array:
        return states.tau_Nm[:, self.joint - 1]


def loaded_joints(context: CandidateContext) -> tuple[int, ...]:
    """Return the joints, from 1, that turn and carried torque worth the name."""
    loaded = context.tau_span_Nm > _LOADED_SHARE * context.rated_Nm
    return tuple(joint for joint in turning_joints(context) if loaded[joint - 1])
