"""What a disturbance of a log is; its classes are found by looking through this folder.

A stressor is what ordinary logs have: a verdict must stand it. A fault is an error in the log:
somebody must be told of it, by kind and place.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.cell import disturbances
from pa10cal.cell.classes import classes_in
from pa10cal.cell.effects.effect import Finite, FinitePositive
from pa10cal.cell.options import DisturbanceOptions
from pa10cal.cell.raw_log import RawLog
from pa10cal.errors import SettingsError
from pa10cal.options import Section
from pa10cal.settings_reading import parse_section

#: What a campaign must have for a disturbance to mean anything.
Need = Literal["loads", "masses", "springs", "repeats", "touches", "attitude", "targets", "tracker"]

#: Draws one parameter, for an arm of so many joints.
Draw = Callable[[int, np.random.Generator], Any]


def one_of(*values: str | float) -> Draw:
    """Return what draws one of some values."""
    return lambda _joints, rng: rng.choice(values).item()


def between(low: float, high: float) -> Draw:
    """Return what draws a number between two, to three decimals."""
    return lambda _joints, rng: round(float(rng.uniform(low, high)), 3)


def log_between(low: float, high: float, decimals: int = 3) -> Draw:
    """Return what draws a number between two, evenly in its logarithm."""
    bounds = np.log([low, high])
    return lambda _joints, rng: round(float(np.exp(rng.uniform(*bounds))), decimals)


def off_by(low: float, high: float) -> Draw:
    """Return what draws a factor between two, or its inverse."""

    def draw(_joints: int, rng: np.random.Generator) -> float:
        return round(float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(*np.log([low, high])))), 3)

    return draw


class Disturbance(Section):
    """Something that changes the raw files of a campaign. Its fields are its parameters."""

    id: ClassVar[str]
    #: Whether ordinary logs have it, so that nobody need be told.
    stressor: ClassVar[bool] = False
    #: Whether it moves what the model leaves only where it is large, so that trials measure by how
    #: much; else it is far above the noise.
    measured: ClassVar[bool] = False
    #: Kinds of fault of a verdict that tell it.
    kinds: ClassVar[tuple[str, ...]] = ()
    #: What the campaign must have.
    needs: ClassVar[tuple[Need, ...]] = ()
    #: How a trial draws parameters, in turn; the others have their defaults.
    usual: ClassVar[Mapping[str, Draw]] = {}

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return parameters drawn for a trial, for an arm of so many joints."""
        return {name: draw(joints, rng) for name, draw in cls.usual.items()}

    @abstractmethod
    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Change the raw files, and return where: poses, joints, loads or keys.

        Args:
            log: the raw files, changed in place.
            rng: draws what the parameters leave open.
        """


@cache
def all_disturbances() -> dict[str, type[Disturbance]]:
    """Return every disturbance by its id, module by module, each in the order of its file."""
    return classes_in(disturbances, Disturbance)


def disturb(
    log: RawLog, entries: Sequence[DisturbanceOptions], seed: int
) -> tuple[tuple[str, ...], ...]:
    """Put disturbances into raw files, one after the other, and return where each is.

    Args:
        log: the raw files, changed in place.
        entries: which, with their parameters.
        seed: of the campaign; what a disturbance draws is its own.

    Raises:
        SettingsError: for a disturbance or a parameter that does not exist.
    """
    known = all_disturbances()
    places = []
    for number, entry in enumerate(entries):
        where = f"disturbances[{number}]"
        if entry.id not in known:
            raise SettingsError(
                "unknown disturbance",
                where=f"{where}.id",
                value=entry.id,
                allowed=", ".join(known),
                remedy="correct the name",
            )
        disturbance = parse_section(known[entry.id], entry.parameters, where=f"{where}.parameters")
        rng = np.random.default_rng([seed, 1 + number, len(entry.id)])
        places.append(tuple(disturbance.put_into(log, rng)))
    return tuple(places)


# What ordinary logs have: noise that is not normal, an instrument that moves, wrong statements.
#
# The readings are changed after they were taken; nothing here knows a model of the arm.


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
            describe(log, replace(log.arm, mass_kg=masses_kg * (1.0 + off)))
        return ["mass_kg"]


class HeavyTails(Disturbance):
    """Readings scatter by Student's t besides; the campaign states the whole of it."""

    id = "heavy_tails"
    stressor = True

    dof: FinitePositive = Field(3.0, description="degrees of freedom, above 2")
    times: FinitePositive = Field(1.0, description="its standard deviation over the stated one")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Add the scatter, and state what both come to."""
        instrument = log.description["instrument"]
        u_mm = float(instrument["uncertainty_mm"])
        unit = 1.0 / np.sqrt(self.dof / (self.dof - 2.0))
        of_touches = 0.3 if log.touched else 1.0  # touches repeat better than is stated of them

        def scatter(shape: tuple[int, ...]) -> Array:
            drawn: Array = self.times * unit * rng.standard_t(self.dof, shape)
            return drawn

        for columns in log.points:
            values = log.readings[columns]
            log.readings[columns] = values + of_touches * u_mm * scatter(values.shape)
        grown = float(np.hypot(1.0, self.times))
        if "u_qw" in log.readings:
            turn = 2.0 * log.readings["u_qw"].to_numpy()[:, None] * scatter((len(log.readings), 3))
            _turn(log, turn)
        for name in log.uncertainties:
            log.readings[name] *= grown
        instrument["uncertainty_mm"] = round(u_mm * (1.0 if log.touched else grown), 6)
        return ["instrument"]


class RandomWalk(Disturbance):
    """The instrument walks: independent steps from configuration to configuration."""

    id = "random_walk"
    stressor = True
    measured = True
    kinds = ("step_in_time",)
    needs = ("tracker",)
    usual: ClassVar = {"size_mm": between(0.1, 0.25)}

    size_mm: FinitePositive = Field(0.15, description="walked in the mean at the end, each axis")
    turn_mrad: Finite = Field(0.0, description="turned likewise; of instruments of positions")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Add up normal steps in the order of time."""
        count = len(log.configurations)
        steps = self.size_mm / np.sqrt(count) * rng.standard_normal((count, 3))
        log.move(np.cumsum(steps, axis=0))
        if self.turn_mrad and log.kind == "points":
            turns = 1e-3 * self.turn_mrad / np.sqrt(count) * rng.standard_normal((count, 3))
            log.turn(np.cumsum(turns, axis=0))
        return ["instrument"]


class TemperatureRamp(Disturbance):
    """The hall warms up through the whole campaign; the arm does not mind."""

    id = "temperature_ramp"
    stressor = True
    needs = ("tracker",)

    rise_C: Finite = Field(6.0, description="from beginning to end")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Log the temperature of a ramp."""
        start_C = float(log.description["reference_temperature_C"]) + rng.uniform(-1.0, 1.0)
        ramp_C = start_C + self.rise_C * np.linspace(0.0, 1.0, len(log.readings))
        log.readings["temperature_C"] = ramp_C.round(2)
        return ["temperature_C"]


class MisstatedNoise(Disturbance):
    """The campaign states a wrong uncertainty, by less than a factor of three."""

    id = "misstated_noise"
    stressor = True
    usual: ClassVar = {"factor": off_by(1.3, 2.3)}

    factor: FinitePositive = Field(2.0, description="stated over true")

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Multiply every statement."""
        state_times(log, self.factor)
        return ["instrument.uncertainty_mm"]


class OneUncertainty(Disturbance):
    """No uncertainties stand beside the readings; the description states that of a coordinate."""

    id = "one_uncertainty"
    stressor = True
    needs = ("tracker",)

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """Leave out the columns of uncertainties."""
        log.tables["poses"] = log.readings.drop(columns=log.uncertainties)
        return ["u_ columns"]


class GrossErrors(Disturbance):
    """Some readings of calibration poses are wrong by much: a beam broken, a reflector taken."""

    id = "gross_errors"
    stressor = True
    kinds = ("outlier",)

    share: FinitePositive = Field(0.02, description="share of the configurations")
    size_mm: FinitePositive = Field(8.0, description="by how much")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Move readings in any direction."""
        grid = log.of_kind("grid")
        wrong = rng.choice(grid, max(1, round(self.share * len(grid))), replace=False)
        shift_mm = np.zeros((len(log.configurations), 3))
        for number in wrong.tolist():
            shift_mm[number] = displaced(log.kind, self.size_mm, rng)
        log.move(shift_mm, base=False)
        return [log.label(number) for number in sorted(wrong.tolist())]


class LevelOff(Disturbance):
    """The base stands by a degree off the level that gravity is stated for."""

    id = "level_off"
    stressor = True
    needs = ("masses",)

    off_deg: Finite = Field(0.5, description="tilt about a horizontal axis")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """State gravity turned."""
        about = rng.uniform(-np.pi, np.pi)
        turn = np.radians(self.off_deg) * np.array([np.cos(about), np.sin(about), 0.0])
        gravity = Rotation.from_rotvec(turn).apply(log.description["gravity_m_s2"])
        log.description["gravity_m_s2"] = gravity.round(6).tolist()
        return ["gravity_m_s2"]


class UnknownTool(Disturbance):
    """The tool's mass is not known, and 0 is stated: that is what 0 means."""

    id = "unknown_tool"
    stressor = True
    needs = ("masses",)

    def put_into(self, log: RawLog, _rng: np.random.Generator) -> Iterable[str]:
        """State no mass."""
        log.description["tool"]["mass_kg"] = 0.0
        return ["tool"]


def state_times(log: RawLog, factor: float) -> None:
    """Multiply every stated uncertainty."""
    instrument = log.description["instrument"]
    instrument["uncertainty_mm"] = float(f"{factor * instrument['uncertainty_mm']:.4g}")
    for name in log.uncertainties:
        log.readings[name] *= factor


def displaced(kind: str, size_mm: float, rng: np.random.Generator) -> Array:
    """Draw a displacement (3,) of some size; a distance takes all of it, either way."""
    if kind == "distance":
        return np.array([size_mm * rng.choice([-1.0, 1.0]), 0.0, 0.0])
    direction = rng.standard_normal(3)
    shift_mm: Array = size_mm * direction / np.linalg.norm(direction)
    return shift_mm


def _turn(log: RawLog, turn_rad: Array) -> None:
    """Turn what the instrument read by small rotation vectors (C, 3)."""
    read = Rotation.from_quat(log.quaternions(), scalar_first=True)
    turned = Rotation.from_rotvec(turn_rad) * read
    log.set_quaternions(turned.as_quat(canonical=True, scalar_first=True))


def describe(log: RawLog, arm: Arm) -> None:
    """Describe an arm in the folder of the campaign, under a name of its own."""
    log.arm = replace(arm, name=f"{arm.name.removesuffix('_own')}_own")
    log.description["robot"] = log.arm.name
