"""A whole campaign of the virtual cell, in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.built import BuiltRobot
from pa10cal.cell.effects.kinds import DriveEffect, Effect, Motion
from pa10cal.cell.effects.structure import ThermalGrowth
from pa10cal.cell.effects.vocabulary import make_effects
from pa10cal.cell.equilibrium import RestPoses, rest_poses
from pa10cal.cell.individual import KcubReading, build_robot
from pa10cal.cell.mechanism import Mechanism
from pa10cal.cell.poses import Poses, place_poses
from pa10cal.cell.reading import DWELL_S, log_joints, touch_balls
from pa10cal.cell.schedule import Schedule, make_schedule
from pa10cal.errors import SettingsError
from pa10cal.settings import SimulateSettings

Array = NDArray[np.float64]

REFERENCE_TEMPERATURE_C = 21.0
#: Measurement uncertainty of the paper's machine over its whole volume, as a campaign states it.
INSTRUMENT_UNCERTAINTY_MM = 0.0121
_DRIFT_PERIOD_S = 24 * 3600.0


@dataclass(frozen=True)
class Truth:
    """Everything a campaign hides.

    Attributes:
        robot: the robot as built.
        effects: what it does beyond the paper's model.
        poses: commanded joint angles.
        schedule: the C configurations in the order of time.
        q_motor_rad: (C, n) motor angles at rest.
        rest: where the links came to rest.
        temperature_C: (C,) temperatures at rest.
    """

    robot: BuiltRobot
    effects: tuple[Effect, ...]
    poses: Poses
    schedule: Schedule
    q_motor_rad: Array
    rest: RestPoses
    temperature_C: Array


@dataclass(frozen=True)
class Campaign:
    """What a campaign's folder holds, and what it must not.

    Attributes:
        name: its name.
        settings: what was asked of the cell.
        cmm: touches, as in the raw-data contract.
        resolver: joint log, as in the raw-data contract.
        truth: what is hidden; never written beside the rest.
    """

    name: str
    settings: SimulateSettings
    cmm: pd.DataFrame
    resolver: pd.DataFrame
    truth: Truth


def simulate_campaign(
    name: str,
    arm: Arm,
    settings: SimulateSettings,
    kcub_reading: KcubReading = "text_e7",
) -> Campaign:
    """Measure one robot in the virtual cell; the same settings give the same campaign.

    Args:
        name: of the campaign.
        arm: description of the robot, with masses.
        settings: seed, hidden effects, poses, loads, noise.
        kcub_reading: which of the paper's two cubic stiffnesses holds.

    Raises:
        SettingsError: for a hidden effect that does not exist or cannot sit where it is put.
        SimulationError: for an arm or poses that the cell cannot use.
    """
    streams = _Streams.of(settings.random_seed)
    robot = build_robot(arm, settings, kcub_reading, streams.robot)
    return measure_campaign(name, settings, robot, make_effects(settings.hidden_effects, robot))


def measure_campaign(
    name: str,
    settings: SimulateSettings,
    robot: BuiltRobot,
    effects: Sequence[Effect],
) -> Campaign:
    """Measure a robot that is already there; see `simulate_campaign`.

    Args:
        name: of the campaign.
        settings: seed, poses, loads, noise; not asked for the robot or its effects.
        robot: the robot as built.
        effects: what it does beyond the paper's model.
    """
    _need_a_drift(effects, settings)
    streams = _Streams.of(settings.random_seed)
    nominal = Mechanism.nominal(robot)
    poses = place_poses(robot.arm, nominal, settings.poses, settings.holdout_points)
    schedule = make_schedule(poses, settings, streams.order)
    noise = settings.noise

    at_rest_s = schedule.start_s + DWELL_S.mean()
    temperature_C = REFERENCE_TEMPERATURE_C + _warming(
        at_rest_s, settings.temperature_drift_C, streams.hall
    )
    shape = schedule.q_rad.shape
    q_motor_rad = schedule.q_rad + noise.servo_rad * streams.servo.standard_normal(shape)
    drive_rad = q_motor_rad + noise.unseen_rad * streams.unseen.standard_normal(shape)
    motion = Motion(q_motor_rad, schedule.arrival, robot.arm.gear_ratio)
    for effect in effects:
        if isinstance(effect, DriveEffect):
            drive_rad += effect.turn_rad(motion)
    rest = rest_poses(
        robot,
        effects,
        drive_rad,
        schedule.load_N,
        at_rest_s,
        temperature_C - REFERENCE_TEMPERATURE_C,
        schedule.arrival,
    )
    return Campaign(
        name=name,
        settings=settings,
        cmm=touch_balls(robot, effects, schedule, rest.T_base_ee, noise, streams.touch),
        resolver=log_joints(
            robot, effects, schedule, q_motor_rad, rest, temperature_C, noise, streams.log
        ),
        truth=Truth(robot, tuple(effects), poses, schedule, q_motor_rad, rest, temperature_C),
    )


@dataclass(frozen=True)
class _Streams:
    """One stream of random numbers a purpose: switching one noise off leaves the others alone."""

    robot: np.random.Generator
    order: np.random.Generator
    hall: np.random.Generator
    servo: np.random.Generator
    unseen: np.random.Generator
    touch: np.random.Generator
    log: np.random.Generator

    @classmethod
    def of(cls, seed: int) -> _Streams:
        children = np.random.SeedSequence(seed).spawn(len(fields(cls)))
        return cls(*(np.random.default_rng(child) for child in children))


def _warming(time_s: Array, amplitude_C: float, rng: np.random.Generator) -> Array:
    """Return the hall's temperature above the reference: a daily swing of unknown phase."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    warming: Array = amplitude_C * np.sin(2.0 * np.pi * time_s / _DRIFT_PERIOD_S + phase)
    return warming


def _need_a_drift(effects: Sequence[Effect], settings: SimulateSettings) -> None:
    """Refuse to hide a growth with temperature where temperature does not change."""
    grows = any(isinstance(effect, ThermalGrowth) for effect in effects)
    if grows and settings.temperature_drift_C == 0.0:
        raise SettingsError(
            "thermal_growth does nothing at constant temperature",
            where="temperature_drift_C",
            value=settings.temperature_drift_C,
            allowed="a drift above 0 where thermal_growth is hidden",
            remedy="set temperature_drift_C, a few degrees say, or hide no thermal_growth",
        )
