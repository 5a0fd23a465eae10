"""Effects outside the vocabulary that wild trials alone draw: what else a robot may do."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal.cell.effects.effect import (
    ARC_SECOND,
    Finite,
    FinitePositive,
    JointDriveEffect,
    Loading,
    Motion,
    StructureEffect,
    WindupEffect,
    draws,
    sized,
)
from pa10cal.cell.effects.joint import STIFFNESS_PER_RATED
from pa10cal.cell.mechanism import Strain


class SoftByAngle(WindupEffect):
    """A joint whose stiffness varies with its angle, usually by half of that of such joints."""

    id = "soft_by_angle"
    named = False
    wild = True
    places: ClassVar[tuple[str, ...]] = ("rated joint",)
    trial_places = ("rated loaded joint",)
    usual = draws(
        compliance=lambda site, size, _: 0.5 * size / (STIFFNESS_PER_RATED * site.rated_Nm),
        cycles=lambda _site, _size, rng: float(rng.integers(1, 3)),
        phi=lambda _site, _size, rng: float(rng.uniform(-np.pi, np.pi)),
    )

    compliance: FinitePositive = Field(description="amplitude of the compliance [rad/(N m)]")
    cycles: FinitePositive = Field(description="cycles a turn of the joint")
    phi: Finite = Field(description="phase [rad]")

    def bent_rad(self, tau_Nm: Array, q_rad: Array) -> Array:
        """Return c tau_j sin(cycles q_j + phi)."""
        bent: Array = self.compliance * tau_Nm * np.sin(self.cycles * q_rad + self.phi)
        return bent


class Sawtooth(JointDriveEffect):
    """An error that grows along a sector of the joint's turn and jumps back at its end."""

    id = "sawtooth"
    named = False
    wild = True
    usual = draws(
        A=sized(50.0 * ARC_SECOND),
        sector=lambda _site, _size, rng: float(np.radians(rng.choice([24.0, 36.0, 60.0]))),
    )

    A: Finite = Field(description="amplitude [rad]")
    sector: FinitePositive = Field(description="sector [rad]")

    def error_rad(self, motion: Motion) -> Array:
        """Return A from -1 to 1 over each sector."""
        turns = motion.q_rad / self.sector
        error: Array = self.A * (2.0 * (turns - np.floor(turns)) - 1.0)
        return error


class PedestalTilt(StructureEffect):
    """A pedestal that tilts with the cube of its moment, as one bolted down loosely does."""

    id = "pedestal_tilt"
    named = False
    wild = True
    places = ("base",)
    by_weights = True
    usual = draws(tilt=sized(2e-4))

    tilt: Finite = Field(description="tilt under the largest moment of the campaign [rad]")

    def strain(self, loading: Loading) -> Strain:
        """Turn the base about x and y by the cube of the moment over its largest."""
        moment_Nm = loading.statics.base_Nm * np.array([1.0, 1.0, 0.0])
        largest_Nm = np.linalg.norm(moment_Nm, axis=1).max(initial=1e-9)
        turn = self.tilt * (moment_Nm / largest_Nm) ** 3
        return replace(loading.none, base_turn_rad=turn)
