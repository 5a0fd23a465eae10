"""Effects outside the vocabulary: what a robot may do that no name of it covers.

What `at_joint` returns is added to the link's angle [rad], or to the torque that the joint holds
[N m] where an effect says so (`adds_to`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from pa10cal.arrays import Array
from pa10cal_lab.cell.effects import effect
from pa10cal_lab.cell.effects.joint import STIFFNESS_PER_RATED, Harmonic
from pa10cal_lab.cell.mechanism import Strain

Axis = Annotated[int, Field(ge=0, le=2)]

#: How lopsided a bowed axis is: its cubic part, of the quadratic one.
BOW_CUBIC = 0.2


class ThirdHarmonic(Harmonic):
    """An error of three cycles a turn of the joint, as of a disk clamped by three screws."""

    id = "third_harmonic"
    named = False
    by_angle = True
    cycles = 3.0


class BowedAxis(effect.SimulatedEffect):
    """A guideway that is not straight: one axis reads a bow along another."""

    id = "bowed_axis"
    named = False
    forms = ("quadratic", "cubic")
    places = ("instrument",)

    axis: Axis = Field(description="axis that reads wrong, 0 to 2")
    along: Axis = Field(description="axis along which it does, another one, 0 to 2")
    sag: effect.Finite = Field(
        description="reading error half_m from the centre, its even part [m]"
    )
    half_m: effect.FinitePositive = Field(description="half the length of the bow [m]")
    centre_m: effect.Finite = Field(description="coordinate of its middle [m]")

    @classmethod
    def at_size(cls, site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a bow of 25 micrometres over the measured volume, along any axis."""
        axis, along = rng.permutation(3)[:2].tolist()
        return {
            "axis": axis,
            "along": along,
            "sag": effect.either_sign(size * 2.5e-5, rng),
            "half_m": site.half_m,
            "centre_m": site.middle_m[along],
        }

    @classmethod
    def formula_numbers(cls, parameters: Mapping[str, Any]) -> tuple[float, ...]:
        return parameters["axis"], parameters["along"]

    @field_validator("along")
    @classmethod
    def _another_axis(cls, along: int, info: ValidationInfo) -> int:
        if along == info.data.get("axis"):
            raise ValueError("another axis than `axis`")
        return along

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        u = (p_instr_m[..., self.along] - self.centre_m) / self.half_m
        extra = np.zeros_like(p_instr_m)
        extra[..., self.axis] = self.sag * (u**2 + BOW_CUBIC * u**3)
        return extra


class DressPack(effect.LoadedJointEffect):
    """Cables and hoses along the arm pull a joint towards the angle at which they hang free.

    The pull usually is 2 % of the rated torque a radian.
    """

    id = "dress_pack"
    named = False
    by_angle = True
    forms = ("pull",)
    adds_to = "carried"
    by_spring = True
    trial_places = ("rated joint",)
    usual = effect.draws(
        k=lambda site, size, _rng: size * 0.02 * site.rated_Nm,
        q0=lambda _site, _size, rng: float(rng.uniform(-0.5, 0.5)),
    )

    k: effect.FinitePositive = Field(description="stiffness of the pull [N m/rad]")
    q0: effect.Finite = Field(description="angle of the joint without pull [rad]")

    def at_joint(self, joint: effect.JointState) -> Array:
        return self.k * (joint.q_rad - self.q0)


class Hysteresis(effect.LoadedJointEffect):
    """The link lags behind the motor by more where the joint carries more."""

    id = "hysteresis"
    named = False
    forms = ("arrival_by_torque",)
    trial_places = ("loaded joint",)
    # A sign is drawn and not taken, so that what is drawn after it stays as it was.
    usual = effect.draws(
        h=lambda _site, size, rng: -abs(effect.either_sign(60.0 * effect.ARC_SECOND * size, rng))
    )

    h: effect.Finite = Field(
        description="lead in the direction of arrival under the rated torque [rad]; negative: lag"
    )

    def at_joint(self, joint: effect.JointState) -> Array:
        return self.h * joint.arrival * np.abs(joint.tau_Nm / joint.rated_Nm)


# Effects outside the vocabulary that wild trials alone draw: what else a robot may do.


class SoftByAngle(effect.LoadedJointEffect):
    """A joint whose compliance varies with its angle, usually by half of that of such joints."""

    id = "soft_by_angle"
    named = False
    by_angle = True
    forms = ("torque_by_angle",)
    wild = True
    places: ClassVar[tuple[str, ...]] = ("rated joint",)
    trial_places = ("rated loaded joint",)
    usual = effect.draws(
        compliance=lambda site, size, _: 0.5 * size / (STIFFNESS_PER_RATED * site.rated_Nm),
        cycles=lambda _site, _size, rng: float(rng.integers(1, 3)),
        phi=lambda _site, _size, rng: float(rng.uniform(-np.pi, np.pi)),
    )

    compliance: effect.FinitePositive = Field(description="amplitude of the compliance [rad/(N m)]")
    cycles: effect.FinitePositive = Field(description="cycles a turn of the joint")
    phi: effect.Finite = Field(description="phase [rad]")

    @classmethod
    def formula_numbers(cls, parameters: Mapping[str, Any]) -> tuple[float, ...]:
        return (parameters["cycles"],)

    def at_joint(self, joint: effect.JointState) -> Array:
        compliance = self.compliance * joint.tau_Nm * np.sin(self.cycles * joint.q_rad + self.phi)
        return np.asarray(-compliance)


class Sawtooth(effect.SimulatedJointEffect):
    """An error that grows along a sector of the joint's turn and jumps back at its end."""

    id = "sawtooth"
    named = False
    by_angle = True
    forms = ("sawtooth",)
    wild = True
    usual = effect.draws(
        A=effect.sized(50.0 * effect.ARC_SECOND),
        sector=lambda _site, _size, rng: float(np.radians(rng.choice([24.0, 36.0, 60.0]))),
    )

    A: effect.Finite = Field(description="amplitude [rad]")
    sector: effect.FinitePositive = Field(description="sector [rad]")

    @classmethod
    def formula_numbers(cls, parameters: Mapping[str, Any]) -> tuple[float, ...]:
        """Return the teeth a turn."""
        return (float(np.rint(2.0 * np.pi / parameters["sector"])),)

    def at_joint(self, joint: effect.JointState) -> Array:
        turns = joint.q_rad / self.sector
        return np.asarray(self.A * (2.0 * (turns - np.floor(turns)) - 1.0))


class PedestalTilt(effect.SimulatedEffect):
    """A pedestal, bolted down loosely, that tilts about an axis with the cube of its moment."""

    id = "pedestal_tilt"
    named = False
    forms = ("moment_cubed",)
    wild = True
    places = ("base",)
    strains = True
    by_weights = True
    usual = effect.draws(tilt=effect.sized(2e-4))

    tilt: effect.Finite = Field(
        description="tilt under the campaign's largest moment, about an axis [rad]"
    )

    def strain(self, loading: effect.Loading) -> Strain:
        moment_Nm = loading.statics.base_Nm * np.array([1.0, 1.0, 0.0])
        largest_Nm = np.linalg.norm(moment_Nm, axis=1).max(initial=1e-9)
        turn = self.tilt * (moment_Nm / largest_Nm) ** 3
        return replace(loading.none, base_turn_rad=turn)


# What measured arms have in most of their joints, and trials of many effects put in besides.


class SoftBearing(effect.SimulatedEffect):
    """A bearing gives way across its axis, in one direction more than in the other."""

    id = "soft_bearing"
    named = False
    drawn = False
    also_called = ("lateral_compliance",)
    places = ("turning joint",)
    strains = True
    by_weights = True
    usual = effect.draws(
        soft=effect.sized(6e-6),
        stiff=effect.sized(2e-6),
        phi=lambda _site, _size, rng: float(rng.uniform(0.0, np.pi)),
    )

    soft: effect.Finite = Field(description="tilt per unit moment about the soft axis [rad/(N m)]")
    stiff: effect.Finite = Field(description="the same about the stiff axis, at right angles")
    phi: effect.Finite = Field(description="angle of the soft axis about the joint's [rad]")

    def strain(self, loading: effect.Loading) -> Strain:
        """Turn what the bearing sits on, whose z is the joint's axis."""
        link = self.joint - 1  # of the first joint the base
        moment_Nm = loading.moment_Nm(link)
        cos, sin = np.cos(self.phi), np.sin(self.phi)
        soft, stiff = np.array([cos, sin, 0.0]), np.array([-sin, cos, 0.0])
        tilt = self.soft * np.outer(moment_Nm @ soft, soft)
        return loading.strain_of(link, tilt + self.stiff * np.outer(moment_Nm @ stiff, stiff))


#: Lines of a joint's waves, their highest order, and how far an order is from a whole number.
_WAVES, _HIGHEST, _OFF_WHOLE = (1, 3), 6, (0.3, 0.7)
#: Part of the joints whose gear shows as well, the ratios of gears, and the lines of one.
_GEARED, _GEARS, _GEAR_LINES = 0.3, (30, 160), (1, 2)


class SmallWaves(effect.SimulatedJointEffect):
    """Waves of the joint's angle whose orders are no whole numbers, or those of a gear."""

    id = "small_waves"
    named = False
    drawn = False
    by_angle = True

    orders: Annotated[tuple[effect.FinitePositive, ...], Field(min_length=1)] = Field(
        description="cycles a joint turn"
    )
    A: tuple[effect.Finite, ...] = Field(description="amplitude of each [rad]")
    phi: tuple[effect.Finite, ...] = Field(description="phase of each [rad]")

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return some waves of 10 arc seconds, root of the sum of their squares."""
        count = int(rng.integers(*_WAVES, endpoint=True))
        whole = rng.choice(_HIGHEST, count, replace=False)
        orders = (whole + rng.uniform(*_OFF_WHOLE, count)).round(3).tolist()
        if rng.random() < _GEARED:
            orders.append(float(rng.integers(*_GEARS, endpoint=True) * rng.choice(_GEAR_LINES)))
        A = rng.rayleigh(1.0, len(orders))
        return {
            "orders": orders,
            "A": (size * 10.0 * effect.ARC_SECOND * A / np.linalg.norm(A)).tolist(),
            "phi": rng.uniform(-np.pi, np.pi, len(orders)).tolist(),
        }

    @field_validator("A", "phi")
    @classmethod
    def _one_each(cls, values: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(values) != len(info.data.get("orders", values)):
            raise ValueError("as many as orders")
        return values

    def at_joint(self, joint: effect.JointState) -> Array:
        """Return sum A sin(order q + phi)."""
        phase = np.outer(joint.q_rad, self.orders) + np.array(self.phi)
        return np.asarray(np.sin(phase) @ np.array(self.A))
