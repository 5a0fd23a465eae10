"""Faults of what a campaign states: units, gravity, masses, lengths, places of targets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field

from pa10cal.arm.description import Arm
from pa10cal.cell.disturbances.disturbance import Disturbance
from pa10cal.cell.disturbances.stressors import state_times
from pa10cal.cell.effects.effect import Finite, FinitePositive
from pa10cal.cell.raw_log import RawLog

Wrong = Literal["uncertainty_um", "uncertainty_m", "mass_g", "kelvin", "fahrenheit", "gravity_mm"]
#: Rows no longer than this are no links [m].
_LINK_M = 0.1


class Unit(Disturbance):
    """A figure is in another unit than its key says."""

    id = "unit"

    of: Wrong = Field(description="which figure, and the unit that it is in")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return any of them."""
        del joints
        return {"of": str(rng.choice(get_args(Wrong)))}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Write the figure in that unit."""
        del rng
        said = log.description
        if self.of.startswith("uncertainty"):
            state_times(log, 1e3 if self.of.endswith("um") else 1e-3)
            return ["instrument.uncertainty_mm"]
        if self.of == "mass_g":
            said["tool"]["mass_kg"] *= 1e3
            return ["tool.mass_kg"]
        if self.of == "gravity_mm":
            said["gravity_m_s2"] = [1e3 * each for each in said["gravity_m_s2"]]
            return ["gravity_m_s2"]
        reference_C = float(said["reference_temperature_C"])
        table = log.joints
        if "temperature_C" not in table:
            table["temperature_C"] = np.full(len(table), reference_C)
        if self.of == "kelvin":
            table["temperature_C"] = table["temperature_C"] + 273.15
        else:
            table["temperature_C"] = (1.8 * table["temperature_C"] + 32.0).round(2)
        return ["temperature_C"]


class UncertaintyOff(Disturbance):
    """The stated uncertainty is off by much more than a factor of three."""

    id = "uncertainty_off"
    needs = ("repeats", "tracker")

    factor: FinitePositive = Field(10.0, description="stated over true")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return a factor of 6 to 20, up or down."""
        del joints
        factor = float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(*np.log([6.0, 20.0]))))
        return {"factor": round(factor, 3)}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Multiply every statement."""
        del rng
        state_times(log, self.factor)
        return ["instrument.uncertainty_mm"]


class Gravity(Disturbance):
    """Gravity points another way than stated."""

    id = "gravity"
    needs = ("masses", "springs")

    way: Literal["up", "sideways"] = Field("up", description="where it is stated to point")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return either."""
        del joints
        return {"way": str(rng.choice(["up", "sideways"]))}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Turn the sign round, or write it under another axis."""
        del rng
        x, y, z = log.description["gravity_m_s2"]
        log.description["gravity_m_s2"] = [x, y, -z] if self.way == "up" else [z, x, y]
        return ["gravity_m_s2"]


class PayloadOff(Disturbance):
    """The stated mass of the tool is off."""

    id = "payload_off"
    measured = True
    kinds = ("payload",)
    needs = ("masses", "springs")

    factor: FinitePositive = Field(1.2, description="stated over true")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return 20 % more or less."""
        del joints
        return {"factor": float(rng.choice([0.8, 1.2]))}

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """State another mass."""
        del rng
        log.description["tool"]["mass_kg"] *= self.factor
        return ["tool"]


class PayloadCentreOff(Disturbance):
    """The stated centre of mass of the tool is off."""

    id = "payload_centre_off"
    measured = True
    kinds = ("payload",)
    needs = ("masses", "springs")

    off_mm: Finite = Field(50.0, description="along any axis of the flange")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """State another place."""
        axis = int(rng.integers(3))
        log.description["tool"]["com_mm"][axis] += self.off_mm * float(rng.choice([-1.0, 1.0]))
        return ["tool"]


class LengthTypo(Disturbance):
    """A length in the description of the arm is a typing error."""

    id = "length_typo"

    off_mm: Finite = Field(27.0, description="by how much")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Name an arm of one's own, with another length of one of its longer rows."""
        arm = log.arm
        # That of the first row along z is the height of the base, and the last is the tool's.
        rows = np.flatnonzero(np.abs(arm.a_m[:-1]) > _LINK_M)
        along_x = len(rows) > 0
        along_z = 1 + np.flatnonzero(np.abs(arm.d_m[1:-1]) > _LINK_M)
        row = int(rng.choice(rows if along_x else along_z))
        off_m = 1e-3 * self.off_mm * (np.arange(arm.n) == row)
        wrong = replace(arm, a_m=arm.a_m + off_m) if along_x else replace(arm, d_m=arm.d_m + off_m)
        _describe(log, wrong)
        return [f"delta_{'a' if along_x else 'd'}_{row + 1}"]


class PlacesExchanged(Disturbance):
    """The places of two balls or targets are exchanged in the description."""

    id = "places_exchanged"
    needs = ("targets",)

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange two places."""
        places = log.description["tool"]["balls_mm"]
        first, second = rng.choice(sorted(places), 2, replace=False).tolist()
        places[first], places[second] = places[second], places[first]
        return [f"tool.balls_mm {first}, {second}"]


class LinkMassesOff(Disturbance):
    """The masses of the links in the description of the arm are off."""

    id = "link_masses_off"
    stressor = True
    measured = True
    kinds = ("payload",)
    needs = ("masses", "springs")

    part: FinitePositive = Field(0.1, description="by which part each is off, more or less")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Name an arm of one's own, with other masses."""
        masses_kg = log.arm.mass_kg
        if masses_kg is not None:
            off = self.part * rng.choice([-1.0, 1.0], log.arm.n)
            _describe(log, replace(log.arm, mass_kg=masses_kg * (1.0 + off)))
        return ["mass_kg"]


def _describe(log: RawLog, arm: Arm) -> None:
    """Describe an arm in the folder of the campaign, under a name of its own."""
    log.arm = replace(arm, name=f"{arm.name.removesuffix('_own')}_own")
    log.description["robot"] = log.arm.name
