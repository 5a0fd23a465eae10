"""A whole campaign of the virtual cell, in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError
from pa10cal_lab.cell import instruments
from pa10cal_lab.cell.effects.effect import JointState, SimulatedEffect, with_added
from pa10cal_lab.cell.effects.vocabulary import classes_in, make_effects
from pa10cal_lab.cell.individual import KcubReading, build_robot
from pa10cal_lab.cell.instruments.instrument import SimulatedInstrument, Truth, rest_poses
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.robot import Robot

REFERENCE_TEMPERATURE_C = 21.0
_DRIFT_PERIOD_S = 24 * 3600.0


@dataclass(frozen=True)
class SimulatedCampaign:
    """Raw tables of a campaign, and its truth."""

    name: str
    settings: SimulateOptions
    instrument: SimulatedInstrument
    # raw tables by their key in campaign.yaml, as in the raw-data contract
    tables: Mapping[str, pd.DataFrame]
    truth: Truth  # never written into the folder of the campaign


def simulate_campaign(
    name: str, arm: Arm, settings: SimulateOptions, kcub_reading: KcubReading = "text_e7"
) -> SimulatedCampaign:
    """Measure one robot in the virtual cell; the same settings give the same campaign.

    Args:
        arm: description of the robot; with masses for springs, torques and touched balls.
        settings: seed, hidden effects, instrument, poses, loads, noise.
        kcub_reading: which of the paper's two cubic stiffnesses is used.

    Raises:
        SettingsError: for a hidden effect that does not exist or is not possible at its place.
        SimulationError: for an arm or poses that the cell cannot use.
    """
    robot = robot_of(arm, settings, kcub_reading)
    return measure_campaign(name, settings, robot, make_effects(settings.hidden_effects, robot))


def robot_of(arm: Arm, settings: SimulateOptions, kcub_reading: KcubReading = "text_e7") -> Robot:
    """Return the robot that a campaign measures; see `simulate_campaign`."""
    rng = _streams(instrument_of(settings), settings.random_seed)["robot"]
    return build_robot(arm, settings, kcub_reading, rng)


def measure_campaign(
    name: str, settings: SimulateOptions, robot: Robot, effects: Sequence[SimulatedEffect] = ()
) -> SimulatedCampaign:
    """Measure a given robot; see `simulate_campaign`.

    Args:
        settings: seed, instrument, poses, loads, noise; not used for the robot or its effects.
        effects: of the robot.
    """
    _need_a_drift(effects, settings)
    instrument = instrument_of(settings)
    streams = _streams(instrument, settings.random_seed)
    schedule, poses = instrument.schedule(robot, streams)

    at_rest_s = schedule.start_s + instrument.at_rest_s
    phase = streams["hall"].uniform(0.0, 2.0 * np.pi)  # of the hall's daily swing
    swing = np.sin(2.0 * np.pi * at_rest_s / _DRIFT_PERIOD_S + phase)
    temperature_C = REFERENCE_TEMPERATURE_C + settings.temperature_drift_C * swing
    q_motor, drive = instrument.motors(schedule, streams)
    move = schedule.q - schedule.q_from
    motion = JointState(
        q_motor,
        schedule.arrival,
        robot.arm.gear_ratio,
        move=move,
        end_goes_m=_end_goes_m(robot, schedule.q, move),
    )
    rest = rest_poses(
        robot,
        effects,
        with_added(drive, "drive", effects, motion),
        schedule.load_N,
        at_rest_s,
        temperature_C - REFERENCE_TEMPERATURE_C,
        schedule.arrival,
    )
    truth = Truth(robot, tuple(effects), poses, schedule, q_motor, rest, temperature_C)
    return SimulatedCampaign(name, settings, instrument, instrument.measure(truth, streams), truth)


def _end_goes_m(robot: Robot, q: Array, move: Array) -> Array:
    """Return the path length (P,) of the end if a whole move went at its final speed."""
    step = 1e-4
    p_m = robot.mechanism.T_base_ee(q)[:, :3, 3]
    p_before_m = robot.mechanism.T_base_ee(q - step * move)[:, :3, 3]
    return np.asarray(np.linalg.norm(p_m - p_before_m, axis=1) / step)


@cache
def instrument_kinds() -> dict[str, type[SimulatedInstrument]]:
    """Return the instruments that can be simulated, by kind."""
    return classes_in(instruments, SimulatedInstrument, "kind")


def instrument_of(settings: SimulateOptions) -> SimulatedInstrument:
    """Return the simulated instrument of settings."""
    plan = settings.without_touches
    return instrument_kinds()["touch_trigger_cmm" if plan is None else plan.instrument](settings)


def _streams(instrument: SimulatedInstrument, seed: int) -> dict[str, np.random.Generator]:
    """Return a random stream for every purpose, so that a change of one does not affect others."""
    children = np.random.SeedSequence(seed).spawn(len(instrument.streams))
    return dict(zip(instrument.streams, map(np.random.default_rng, children), strict=True))


def _need_a_drift(effects: Sequence[SimulatedEffect], settings: SimulateOptions) -> None:
    """Refuse to hide an effect of temperature where temperature does not change."""
    idle = [effect.id for effect in effects if effect.by_temperature]
    if idle and settings.temperature_drift_C == 0.0:
        raise SettingsError(
            f"{idle[0]} does nothing at constant temperature",
            where="temperature_drift_C",
            value=settings.temperature_drift_C,
            allowed=f"a drift above 0 where {idle[0]} is hidden",
            remedy=f"set temperature_drift_C, to a few degrees, or hide no {idle[0]}",
        )
