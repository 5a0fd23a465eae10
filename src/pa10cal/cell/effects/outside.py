"""Effects outside the vocabulary: what a robot may do that no name of it covers."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from pa10cal.cell.effects.kinds import (
    Array,
    CarriedTorqueEffect,
    DriveEffect,
    Effect,
    Finite,
    FinitePositive,
    InstrumentEffect,
    LostMotionEffect,
    Motion,
)

Axis = Annotated[int, Field(ge=0, le=2)]

#: How lopsided a bowed axis is: its cubic part, of the quadratic one.
BOW_CUBIC = 0.2


class ThirdHarmonic(DriveEffect):
    """An error of three cycles a turn of the joint, as of a disk clamped by three screws."""

    id: ClassVar[str] = "third_harmonic"

    A: Finite = Field(description="amplitude [rad]")
    phi: Finite = Field(description="phase [rad]")

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(3 q_j + phi)."""
        phase = 3.0 * motion.q_rad[:, self.joint] + self.phi
        return self.at_joint(self.A * np.sin(phase), motion.q_rad.shape[1])


class Hysteresis(LostMotionEffect):
    """The link lags behind the motor by more where the joint carries more."""

    id: ClassVar[str] = "hysteresis"

    h: Finite = Field(description="lag under the rated torque [rad]")

    def lost_rad(self, tau_Nm: Array, arrival: Array, rated_Nm: Array) -> Array:
        """Return h s_j |tau_j| / rated torque."""
        lost = np.zeros_like(tau_Nm)
        load = np.abs(tau_Nm[self.joint]) / rated_Nm[self.joint]
        lost[self.joint] = self.h * arrival[self.joint] * load
        return lost


class DressPack(CarriedTorqueEffect):
    """Cables and hoses along the arm pull a joint towards the angle at which they hang free."""

    id: ClassVar[str] = "dress_pack"

    k: FinitePositive = Field(description="stiffness of the pull [N m/rad]")
    q0: Finite = Field(description="angle of the joint without pull [rad]")

    def carried_Nm(self, q_rad: Array) -> Array:
        """Return k (q_j - q0)."""
        carried = np.zeros_like(q_rad)
        carried[..., self.joint] = self.k * (q_rad[..., self.joint] - self.q0)
        return carried


class BowedAxis(InstrumentEffect):
    """A guideway that is not straight: one axis reads a bow along another."""

    id: ClassVar[str] = "bowed_axis"

    axis: Axis = Field(description="axis that reads wrong, 0 to 2")
    along: Axis = Field(description="axis along which it does, another one, 0 to 2")
    sag: Finite = Field(description="reading error half_m from the centre, its even part [m]")
    half_m: FinitePositive = Field(description="half the length of the bow [m]")
    centre_m: Finite = Field(description="coordinate of its middle [m]")

    @field_validator("along")
    @classmethod
    def _another_axis(cls, along: int, info: ValidationInfo) -> int:
        if along == info.data.get("axis"):
            raise ValueError("another axis than `axis`")
        return along

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return sag (u^2 + 0.2 u^3), u the distance from the middle over half_m."""
        u = (p_instr_m[..., self.along] - self.centre_m) / self.half_m
        extra = np.zeros_like(p_instr_m)
        extra[..., self.axis] = self.sag * (u**2 + BOW_CUBIC * u**3)
        return extra


#: What can be hidden in a campaign besides the vocabulary.
OUTSIDE: dict[str, type[Effect]] = {
    effect.id: effect for effect in (ThirdHarmonic, BowedAxis, DressPack, Hysteresis)
}
