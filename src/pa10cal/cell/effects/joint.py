"""Effects that sit in joints: transmissions, encoders, windup and the torque log."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline

from pa10cal.cell.effects.kinds import (
    Array,
    DriveEffect,
    Finite,
    FinitePositive,
    Motion,
    TorqueLogEffect,
    WindupEffect,
)
from pa10cal.errors import SimulationError


class _Harmonic(DriveEffect):
    """A sine of the joint's angle."""

    A: Finite = Field(description="amplitude [rad]")
    phi: Finite = Field(description="phase [rad]")

    def _sine(self, motion: Motion, cycles: float) -> Array:
        """Return A sin(cycles q_j + phi) in the column of the joint."""
        phase = cycles * motion.q_rad[:, self.joint] + self.phi
        return self.at_joint(self.A * np.sin(phase), motion.q_rad.shape[1])


class TransmissionError(_Harmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id: ClassVar[str] = "transmission_error"

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(2 N_j q_j + phi), N_j the gear ratio.

        Raises:
            SimulationError: when the gear ratio is not known.
        """
        ratio = float(motion.gear_ratio[self.joint])
        if np.isnan(ratio):
            raise SimulationError(
                "the gear ratio is not known",
                where=f"{self.id} of joint {self.joint + 1}",
                allowed="an arm description with gear_ratio in the joint's row",
                remedy="add it, or hide another effect",
            )
        return self._sine(motion, 2.0 * ratio)


class EncoderEccentricity(_Harmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id: ClassVar[str] = "encoder_eccentricity"

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(q_j + phi)."""
        return self._sine(motion, 1.0)


class EncoderEllipticity(_Harmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id: ClassVar[str] = "encoder_ellipticity"

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(2 q_j + phi)."""
        return self._sine(motion, 2.0)


class JointErrorMap(DriveEffect):
    """An error that depends on the joint's angle, smooth and periodic in a turn.

    The knots are evenly spaced over one turn from q_j = 0; a cubic spline joins them.
    """

    id: ClassVar[str] = "joint_error_map"

    knots: Annotated[tuple[Finite, ...], Field(min_length=3)] = Field(
        description="errors at the knots [rad]"
    )

    def turn_rad(self, motion: Motion) -> Array:
        """Return the periodic spline through the knots at q_j."""
        closed = [*self.knots, self.knots[0]]
        angles = np.linspace(0.0, 2.0 * np.pi, len(closed))
        spline = CubicSpline(angles, closed, bc_type="periodic")
        q_rad = motion.q_rad[:, self.joint]
        return self.at_joint(spline(q_rad), motion.q_rad.shape[1])


class GearRatioError(DriveEffect):
    """A joint that turns by a little more than its ratio says."""

    id: ClassVar[str] = "gear_ratio_error"

    eps: Finite = Field(description="relative excess")

    def turn_rad(self, motion: Motion) -> Array:
        """Return eps q_j."""
        q_rad = motion.q_rad[:, self.joint]
        return self.at_joint(self.eps * q_rad, motion.q_rad.shape[1])


class Backlash(DriveEffect):
    """Lost motion: the link leads or lags by the direction in which the joint arrived."""

    id: ClassVar[str] = "backlash"

    b: Finite = Field(description="half the lost motion [rad]")

    def turn_rad(self, motion: Motion) -> Array:
        """Return b s_j."""
        s = motion.arrival[:, self.joint]
        return self.at_joint(self.b * s, motion.q_rad.shape[1])


class WristCoupling(DriveEffect):
    """The last joint turns along with the joint before it."""

    id: ClassVar[str] = "wrist_coupling"
    places: ClassVar[tuple[str, ...]] = ("wrist",)

    c: Finite = Field(description="turn of the last joint a turn of the one before")

    def turn_rad(self, motion: Motion) -> Array:
        """Return c q_(n-1) for joint n."""
        turn = np.zeros_like(motion.q_rad)
        turn[:, -1] = self.c * motion.q_rad[:, -2]
        return turn


class JointCompliance(WindupEffect):
    """A joint held rigid by the paper's model yields after all."""

    id: ClassVar[str] = "joint_compliance"
    places: ClassVar[tuple[str, ...]] = ("rigid joint",)

    K: FinitePositive = Field(description="stiffness [N m/rad]")

    def deflection_rad(self, tau_Nm: Array) -> Array:
        """Return tau_j / K."""
        deflection = np.zeros_like(tau_Nm)
        deflection[self.joint] = tau_Nm[self.joint] / self.K
        return deflection


class SoftWindup(WindupEffect):
    """Extra deflection, softer near zero torque."""

    id: ClassVar[str] = "soft_windup"
    places: ClassVar[tuple[str, ...]] = ("joint",)

    A: Finite = Field(description="extra deflection under large torque [rad]")
    tau0: FinitePositive = Field(description="torque by which most of it has come [N m]")

    def deflection_rad(self, tau_Nm: Array) -> Array:
        """Return A tanh(tau_j / tau0)."""
        deflection = np.zeros_like(tau_Nm)
        deflection[self.joint] = self.A * np.tanh(tau_Nm[self.joint] / self.tau0)
        return deflection


class FrictionTorque(TorqueLogEffect):
    """Friction holds part of the load or adds to it, by the direction of arrival."""

    id: ClassVar[str] = "friction_torque"

    tau_c: Finite = Field(description="torque that friction holds [N m]")

    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return tau_c s_j."""
        return self.at_joint(self.tau_c * arrival[:, self.joint], tau_Nm.shape[1])


class TorqueGain(TorqueLogEffect):
    """The motor's torque constant is not what the log assumes."""

    id: ClassVar[str] = "torque_gain"

    g: Finite = Field(description="relative excess of the logged torque")

    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:  # noqa: ARG002
        """Return g tau_j."""
        return self.at_joint(self.g * tau_Nm[:, self.joint], tau_Nm.shape[1])
