"""Effects that sit in joints: transmissions, encoders, windup and the torque log."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from scipy.interpolate import CubicSpline

from pa10cal.cell.effects.effect import (
    ARC_SECOND,
    Array,
    DriveEffect,
    Finite,
    FinitePositive,
    Motion,
    Site,
    TorqueLogEffect,
    WindupEffect,
    either_sign,
)
from pa10cal.errors import SimulationError

#: Amplitudes are those to expect of harmonic drives of the PA10's class: errors of 10 to 30 arc
#: seconds an order, lost motion up to 1 arc minute, motor torque off by a part of the Coulomb band.
MAP_KNOTS = 8
_MAP_ORDERS = 3
#: Stiffness of a joint for each N m of its rated torque, as of the joints known to yield.
STIFFNESS_PER_RATED = 120.0


class Harmonic(DriveEffect):
    """A sine of the joint's angle."""

    usual_arc_seconds: ClassVar[float] = 30.0

    A: Finite = Field(description="amplitude [rad]")
    phi: Finite = Field(description="phase [rad]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return the usual amplitude and any phase."""
        del site
        return {
            "A": size * cls.usual_arc_seconds * ARC_SECOND,
            "phi": float(rng.uniform(-np.pi, np.pi)),
        }

    def sine(self, motion: Motion, cycles: float) -> Array:
        """Return A sin(cycles q_j + phi) in the column of the joint."""
        phase = cycles * motion.q_rad[:, self.joint] + self.phi
        return self.at_joint(self.A * np.sin(phase), motion.q_rad.shape[1])


class TransmissionError(Harmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id: ClassVar[str] = "transmission_error"
    trial_places: ClassVar[tuple[str, ...]] = ("geared joint",)
    usual_arc_seconds: ClassVar[float] = 20.0
    plausible_size: ClassVar[float] = 3.1

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
        return self.sine(motion, 2.0 * ratio)


class EncoderEccentricity(Harmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id: ClassVar[str] = "encoder_eccentricity"
    plausible_size: ClassVar[float] = 2.1

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(q_j + phi)."""
        return self.sine(motion, 1.0)


class EncoderEllipticity(Harmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id: ClassVar[str] = "encoder_ellipticity"
    plausible_size: ClassVar[float] = 2.1

    def turn_rad(self, motion: Motion) -> Array:
        """Return A sin(2 q_j + phi)."""
        return self.sine(motion, 2.0)


class JointErrorMap(DriveEffect):
    """An error that depends on the joint's angle, smooth and periodic in a turn.

    The knots are evenly spaced over one turn from q_j = 0; a cubic spline joins them.
    """

    id: ClassVar[str] = "joint_error_map"
    plausible_size: ClassVar[float] = 2.1

    knots: Annotated[tuple[Finite, ...], Field(min_length=3)] = Field(
        description="errors at the knots [rad]"
    )

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a map of orders 1 to 3 in equal parts, whose largest knot is 30 arc seconds."""
        del site
        angle = 2.0 * np.pi * np.arange(MAP_KNOTS) / MAP_KNOTS
        phase = rng.uniform(-np.pi, np.pi, _MAP_ORDERS)
        waves = np.cos(np.outer(angle, np.arange(1, _MAP_ORDERS + 1)) + phase).sum(axis=1)
        return {"knots": (size * 30.0 * ARC_SECOND * waves / np.abs(waves).max()).tolist()}

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
    plausible_size: ClassVar[float] = 1.5

    eps: Finite = Field(description="relative excess")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 2e-4 either way."""
        del site
        return {"eps": either_sign(size * 2e-4, rng)}

    def turn_rad(self, motion: Motion) -> Array:
        """Return eps q_j."""
        q_rad = motion.q_rad[:, self.joint]
        return self.at_joint(self.eps * q_rad, motion.q_rad.shape[1])


class Backlash(DriveEffect):
    """Lost motion: the link leads or lags by the direction in which the joint arrived."""

    id: ClassVar[str] = "backlash"
    plausible_size: ClassVar[float] = 3.1

    b: Finite = Field(description="half the lost motion [rad]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 20 arc seconds either way."""
        del site
        return {"b": either_sign(size * (20.0 * ARC_SECOND), rng)}

    def turn_rad(self, motion: Motion) -> Array:
        """Return b s_j."""
        s = motion.arrival[:, self.joint]
        return self.at_joint(self.b * s, motion.q_rad.shape[1])


class FrictionTorque(TorqueLogEffect):
    """Friction holds part of the load or adds to it, by the direction of arrival."""

    id: ClassVar[str] = "friction_torque"
    plausible_size: ClassVar[float] = 2.0

    tau_c: Finite = Field(description="torque that friction holds [N m]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a part of the joint's Coulomb friction."""
        del rng
        return {"tau_c": size * 0.15 * site.coulomb_Nm}

    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return tau_c s_j."""
        return self.at_joint(self.tau_c * arrival[:, self.joint], tau_Nm.shape[1])


class TorqueGain(TorqueLogEffect):
    """The motor's torque constant is not what the log assumes."""

    id: ClassVar[str] = "torque_gain"
    trial_places: ClassVar[tuple[str, ...]] = ("loaded joint",)
    plausible_size: ClassVar[float] = 1.25

    g: Finite = Field(description="relative excess of the logged torque")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 4 % either way."""
        del site
        return {"g": either_sign(size * 0.04, rng)}

    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return g tau_j."""
        del arrival
        return self.at_joint(self.g * tau_Nm[:, self.joint], tau_Nm.shape[1])


class JointCompliance(WindupEffect):
    """A joint held rigid by the paper's model yields after all."""

    id: ClassVar[str] = "joint_compliance"
    places: ClassVar[tuple[str, ...]] = ("rigid joint",)
    trial_places: ClassVar[tuple[str, ...]] = ("rigid loaded joint",)
    plausible_size: ClassVar[float] = 1.2

    K: FinitePositive = Field(description="stiffness [N m/rad]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return the stiffness that joints known to yield have, for the rated torque."""
        del rng
        return {"K": STIFFNESS_PER_RATED * site.rated_Nm / size}

    def deflection_rad(self, tau_Nm: Array) -> Array:
        """Return tau_j / K."""
        return self.at_joint(tau_Nm[:, self.joint] / self.K, tau_Nm.shape[1])


class SoftWindup(WindupEffect):
    """Extra deflection, softer near zero torque."""

    id: ClassVar[str] = "soft_windup"
    places: ClassVar[tuple[str, ...]] = ("turning joint",)
    trial_places: ClassVar[tuple[str, ...]] = ("loaded joint",)
    plausible_size: ClassVar[float] = 3.0

    A: Finite = Field(description="extra deflection under large torque [rad]")
    tau0: FinitePositive = Field(description="torque by which most of it has come [N m]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 0.1 mrad, most of it below a fifth of the joint's typical torque."""
        del rng
        return {"A": size * 1e-4, "tau0": 0.2 * site.typical_Nm}

    def deflection_rad(self, tau_Nm: Array) -> Array:
        """Return A tanh(tau_j / tau0)."""
        bent = self.A * np.tanh(tau_Nm[:, self.joint] / self.tau0)
        return self.at_joint(bent, tau_Nm.shape[1])


class WristCoupling(DriveEffect):
    """The last joint turns along with the joint before it."""

    id: ClassVar[str] = "wrist_coupling"
    places: ClassVar[tuple[str, ...]] = ("wrist",)
    plausible_size: ClassVar[float] = 2.0

    c: Finite = Field(description="turn of the last joint a turn of the one before")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 5e-4 either way."""
        del site
        return {"c": either_sign(size * 5e-4, rng)}

    def turn_rad(self, motion: Motion) -> Array:
        """Return c q_(n-1) for joint n."""
        turn = np.zeros_like(motion.q_rad)
        turn[:, -1] = self.c * motion.q_rad[:, -2]
        return turn
