"""Periodic errors of a joint's angle: encoder disks and harmonic drives."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms.effects.effect import CandidateContext, Effect, joint_of, turning_joints
from pa10cal.terms.term import Parameter, Report


@dataclass(frozen=True)
class JointHarmonic(Effect):
    """A sin(order q_j + phi), solved in its parts A cos phi (sine) and A sin phi (cosine)."""

    order: float  # cycles a turn of the joint
    plausible_rad: ClassVar[float] = 3e-4

    @classmethod
    @abstractmethod
    def order_of(cls, context: CandidateContext, joint: int) -> float:
        """Return the cycles a turn at a joint, from 1."""

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns."""
        return tuple(
            cls(f"joint {joint}", cls.order_of(context, joint)) for joint in turning_joints(context)
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the sine and the cosine part."""
        joint = joint_of(self.of)
        return tuple(
            Parameter(f"{self.id}_{joint}_{part}", "rad", 1e-5, plausible=self.plausible_rad)
            for part in ("sin", "cos")
        )

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        joint = joint_of(self.of)
        return f"theta_{joint} += A sin({self.order:g} q_{joint} + phi)"

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the joint's angle."""
        return (f"theta_{joint_of(self.of)}",)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return sine and cosine of order q_j, (P, 1, 2)."""
        del x
        phase = self.order * states.q_rad[:, joint_of(self.of) - 1]
        return np.stack([np.sin(phase), np.cos(phase)], axis=-1)[:, None, :]

    def report(self, x: Array) -> Report:
        """Return amplitude and phase."""
        return amplitude_and_phase(x, "rad")


def amplitude_and_phase(x: Array, unit: str) -> Report:
    """Report a sine and a cosine part (2,) as A and phi of A sin(... + phi)."""
    amplitude = float(np.hypot(*x))
    phase = float(np.arctan2(x[1], x[0]))
    size = max(amplitude, np.finfo(float).tiny)
    jacobian = np.array(
        [[np.cos(phase), np.sin(phase)], [-np.sin(phase) / size, np.cos(phase) / size]]
    )
    names = (Parameter("A", unit, 1e-5), Parameter("phi", "rad", 1.0))
    return Report(names, np.array([amplitude, phase]), jacobian)


@dataclass(frozen=True)
class TransmissionError(JointHarmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id: ClassVar[str] = "transmission_error"

    @classmethod
    def order_of(cls, context: CandidateContext, joint: int) -> float:
        """Return twice the gear ratio; nan where that is not known."""
        return 2.0 * float(context.arm.gear_ratio[joint - 1])

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return sine and cosine of order q_j, (P, 1, 2).

        Raises:
            CalibrationError: when the gear ratio is not known.
        """
        if np.isnan(self.order):
            raise CalibrationError(
                "the gear ratio of the joint is not known",
                where=f"{self.id} of {self.of}",
                allowed="an arm description with gear_ratio",
                remedy="add it to the joint's row",
            )
        return super().derivative(states, x)


@dataclass(frozen=True)
class EncoderEccentricity(JointHarmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id: ClassVar[str] = "encoder_eccentricity"

    @classmethod
    def order_of(cls, context: CandidateContext, joint: int) -> float:
        """Return one."""
        del context, joint
        return 1.0


@dataclass(frozen=True)
class EncoderEllipticity(JointHarmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id: ClassVar[str] = "encoder_ellipticity"

    @classmethod
    def order_of(cls, context: CandidateContext, joint: int) -> float:
        """Return two."""
        del context, joint
        return 2.0
