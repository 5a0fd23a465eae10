"""Who errs in a drive: the sensor behind the gear, or the gear; and where its motor then stops.

A controller turns the motor until the sensor at the output reads what was commanded, so a sensor's
error is one of the true angle, and the motor stands where the gear takes it for that: at its ratio
times the true angle. Where the gear errs, the motor stands at its ratio times the angle commanded.
Cogging keeps the motor a little off where it should stop, by its own angle, in joints that moved.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from pa10cal.arrays import Array
from pa10cal.lab.cell.effects import effect

#: Orders of the band in which such errors lie, and their root mean square over a turn.
_BAND = (6, 30)
_USUAL_ARC_SECONDS = 55.0
#: Multiples of the ratio at which motors cog, how many of them one motor shows, how far they move
#: the joint, and the motor turns a joint turn of a gear. One of them makes so many cycles a joint
#: turn, and none makes more than so many.
_COGS = (4, 8, 10, 12, 16, 20, 24, 36)
_LINES = (3, 5)
_COG_ARC_SECONDS = 8.0
RATIOS = (50.0, 160.0)
_FINE, _FINEST = 1500.0, 4000.0

Amplitudes = tuple[effect.Finite, ...]


def drawn_ratio(rng: np.random.Generator) -> float:
    """Return the ratio of a gear."""
    return float(rng.integers(int(RATIOS[0]), int(RATIOS[1]), endpoint=True))


def drawn_cogs(ratio: float, count: int, rng: np.random.Generator) -> list[int]:
    """Return the cogs of a motor at a gear, one of them fine."""
    cycles = ratio * np.array(_COGS)
    fine = rng.choice(np.flatnonzero((cycles >= _FINE) & (cycles <= _FINEST)))
    others = np.setdiff1d(np.flatnonzero(cycles <= _FINEST), [fine])
    chosen = [fine, *rng.choice(others, count - 1, replace=False)]
    return sorted(int(_COGS[k]) for k in chosen)


class SimulatedMotorRipple(effect.SimulatedJointEffect):
    """A joint stops where the cogging of its motor lets it."""

    id = "motor_ripple"
    named = False
    drawn = False

    ratio: effect.FinitePositive = Field(description="motor turns a joint turn")
    cogs: tuple[Annotated[int, Field(ge=1)], ...] = Field(description="cycles a motor turn")
    ripple: Amplitudes = Field(description="how far each moves the joint [rad]")
    ripple_phi: Amplitudes = Field(description="their phases [rad]")

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return cogging as of servo motors at a gear, at `size` times its usual amplitude."""
        count = int(rng.integers(*_LINES, endpoint=True))
        ratio = drawn_ratio(rng)
        return {
            "ratio": ratio,
            "cogs": drawn_cogs(ratio, count, rng),
            "ripple": (
                size * _COG_ARC_SECONDS * effect.ARC_SECOND * rng.uniform(0.7, 1.4, count)
            ).tolist(),
            "ripple_phi": rng.uniform(-np.pi, np.pi, count).tolist(),
        }

    @field_validator("ripple", "ripple_phi", "A", "phi", check_fields=False)
    @classmethod
    def _one_each(cls, values: Amplitudes, info: ValidationInfo) -> Amplitudes:
        of = "cogs" if str(info.field_name).startswith("ripple") else "orders"
        if len(values) != len(info.data.get(of, values)):
            raise ValueError(f"as many as {of}")
        return values

    def at_joint(self, joint: effect.JointState) -> Array:
        """Return sum a sin(cogs ratio angle + phi) where the joint moved, at the motor's angle."""
        return self.stops_off_rad(joint, joint.q_rad)

    def stops_off_rad(self, joint: effect.JointState, stands_rad: Array) -> Array:
        """Return how far the joint stops off, (P,).

        Args:
            stands_rad: (P,) turns of the motor over the ratio.
        """
        phase = np.outer(stands_rad, self.ratio * np.array(self.cogs, dtype=float))
        off: Array = np.sin(phase + np.array(self.ripple_phi)) @ np.array(self.ripple)
        return np.where(joint.arrival == 0.0, 0.0, off)


class _ErrsByAngle(SimulatedMotorRipple):
    """A drive with an error of many cycles a turn, besides its ripple."""

    #: Whether the motor stands by the true angle; else by the angle commanded.
    by_sensor: ClassVar[bool]

    orders: tuple[Annotated[int, Field(ge=1)], ...] = Field(description="cycles a joint turn")
    A: Amplitudes = Field(description="amplitude of each [rad]")
    phi: Amplitudes = Field(description="phase of each [rad]")

    @classmethod
    def at_size(cls, site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a broad band of cycles, at `size` times its usual size, and ripple."""
        orders = list(range(_BAND[0], _BAND[1] + 1))
        amplitudes = rng.rayleigh(1.0, len(orders))
        usual = np.sqrt(2.0) * _USUAL_ARC_SECONDS * effect.ARC_SECOND
        return {
            **super().at_size(site, 1.0, rng),
            "orders": orders,
            "A": (size * usual * amplitudes / np.linalg.norm(amplitudes)).tolist(),
            "phi": rng.uniform(-np.pi, np.pi, len(orders)).tolist(),
        }

    def at_joint(self, joint: effect.JointState) -> Array:
        """Return the error by the angle, and what cogging adds at the motor's angle."""
        phase = np.outer(joint.q_rad, self.orders) + np.array(self.phi)
        error: Array = np.sin(phase) @ np.array(self.A)
        stands_rad = joint.q_rad + error if self.by_sensor else joint.q_rad
        return error + self.stops_off_rad(joint, stands_rad)


class SimulatedSensorError(_ErrsByAngle):
    """The sensor at the joint's output errs, and the controller follows it."""

    id = "sensor_error"
    drawn = False
    by_sensor = True


class SimulatedGearError(_ErrsByAngle):
    """The gear errs, behind a motor that stands where it was commanded to."""

    id = "gear_error"
    drawn = False
    by_sensor = False
