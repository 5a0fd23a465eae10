"""What the cell logs: touches on the tooling balls, resolvers, motor currents, temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.built import BuiltRobot
from pa10cal.cell.effects.kinds import (
    CarriedTorqueEffect,
    Effect,
    InstrumentEffect,
    ToolEffect,
    TorqueLogEffect,
)
from pa10cal.cell.equilibrium import RestPoses
from pa10cal.cell.mechanism import Mechanism
from pa10cal.cell.schedule import Schedule
from pa10cal.settings import CellNoiseSettings

Array = NDArray[np.float64]

#: Times within a configuration's block [s]: the approach, all of it in motion, then the dwell with
#: all touches in it.
MOVE_S = 4.4
APPROACH_S = 0.4 * np.arange(1, 11)
DWELL_S = np.arange(6.0, 25.0, 2.0)
FIRST_TOUCH_S = 7.0
BALL_STEP_S = 5.5
#: An operator's touches: the top of the ball, then four around its equator.
TOUCH_DIRECTIONS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
#: One torque sample in motion is noisier than at rest by this factor.
MOVING_NOISE = 8.0
#: Torque is logged in 1/4096 of the rated torque.
TORQUE_STEPS = 4096
#: Decimals of logged positions.
DEG_DECIMALS = 5
MM_DECIMALS = 4
_TEMPERATURE_NOISE_C = 0.01


def touch_balls(
    robot: BuiltRobot,
    effects: Sequence[Effect],
    schedule: Schedule,
    T_base_ee: Array,
    noise: CellNoiseSettings,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """Probe every ball in every configuration.

    Args:
        robot: gives the balls as they are and the base's place.
        effects: what else moves the apparatus or falsifies the instrument.
        schedule: the C configurations.
        T_base_ee: (C, 4, 4) flange in the base frame [m].
        noise: standard deviation of a touch.
        rng: draws it.

    Returns:
        The table `cmm` of the raw-data contract, rounded as in its file.
    """
    apparatus = robot.apparatus
    R_base_ee = T_base_ee[:, :3, :3]
    shift_m = np.zeros((len(schedule), 3))
    for effect in effects:
        if isinstance(effect, ToolEffect):
            shift_m = shift_m + effect.shift_m(R_base_ee)
    p_ee_m = apparatus.balls_m + shift_m[:, None, :]
    T_instr_ee = robot.T_instr_base @ T_base_ee
    centres_m = (
        np.einsum("cij,cbj->cbi", T_instr_ee[:, :3, :3], p_ee_m) + T_instr_ee[:, None, :3, 3]
    )
    points_m = centres_m[:, :, None, :] + 0.5 * apparatus.ball_diameter_m * TOUCH_DIRECTIONS
    read_m = points_m.copy()
    for effect in effects:
        if isinstance(effect, InstrumentEffect):
            read_m += effect.read_too_much_m(points_m)
    read_mm = 1e3 * read_m + noise.touch_mm * rng.standard_normal(read_m.shape)

    balls, touches = len(apparatus.ball_names), len(TOUCH_DIRECTIONS)
    each = balls * touches
    within_s = FIRST_TOUCH_S + np.add.outer(BALL_STEP_S * np.arange(balls), np.arange(touches))
    x_mm, y_mm, z_mm = read_mm.reshape(-1, 3).round(4).T
    return pd.DataFrame(
        {
            "time_s": np.add.outer(schedule.start_s, within_s.ravel()).ravel().round(2),
            "kind": np.repeat(schedule.kind, each),
            "pose": np.repeat(schedule.pose, each),
            "load_N": np.repeat(schedule.load_N, each),
            "repeat": np.repeat(schedule.repeat, each),
            "ball": np.tile(np.repeat(apparatus.ball_names, touches), len(schedule)),
            "touch": np.tile(np.arange(1, touches + 1), balls * len(schedule)),
            "x_mm": x_mm,
            "y_mm": y_mm,
            "z_mm": z_mm,
        }
    )


def log_joints(
    robot: BuiltRobot,
    effects: Sequence[Effect],
    schedule: Schedule,
    q_motor_rad: Array,
    rest: RestPoses,
    temperature_C: Array,
    noise: CellNoiseSettings,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """Log resolvers and motor currents through every approach and dwell.

    Args:
        robot: gives the rated torques and, in motion, gravity.
        effects: what else the joints carry, and what falsifies the torque.
        schedule: the C configurations.
        q_motor_rad: (C, n) motor angles at rest.
        rest: torques at rest.
        temperature_C: (C,) temperatures.
        noise: of resolvers and currents.
        rng: draws it.

    Returns:
        The table `resolver` of the raw-data contract, rounded as in its file.
    """
    n = robot.arm.n
    still = np.zeros(len(DWELL_S))
    before_s = np.concatenate([MOVE_S - APPROACH_S, still])
    shape = (len(schedule), len(before_s), n)
    move = (schedule.q_rad - schedule.q_from_rad) / MOVE_S
    q_rad = q_motor_rad[:, None, :] - before_s[:, None] * move[:, None, :]
    tau_Nm = np.empty(shape)
    tau_Nm[:, len(APPROACH_S) :] = rest.tau_Nm[:, None, :]
    in_motion_rad = q_rad[:, : len(APPROACH_S)]
    tau_Nm[:, : len(APPROACH_S)] = _moving_torques(robot, effects, schedule, in_motion_rad)
    tau_Nm = _as_logged(effects, tau_Nm, schedule.arrival)

    sample_q = q_rad + noise.resolver_rad * rng.standard_normal(shape)
    rated_Nm = robot.arm.torque_limit_Nm
    louder = np.where(before_s > 0.0, MOVING_NOISE, 1.0)[:, None]
    sample_tau = tau_Nm + noise.torque_fraction * rated_Nm * louder * rng.standard_normal(shape)
    sample_T = temperature_C[:, None] + _TEMPERATURE_NOISE_C * rng.standard_normal(shape[:2])
    time_s = np.add.outer(schedule.start_s, np.concatenate([APPROACH_S, DWELL_S]))
    counted = _in_steps(sample_q, noise.resolver_count_rad).reshape(-1, n)
    logged_Nm = _in_steps(sample_tau, rated_Nm / TORQUE_STEPS).reshape(-1, n).round(3)
    return pd.DataFrame(
        {
            "time_s": time_s.ravel().round(2),
            **position_columns(robot.arm, counted),
            **{f"tau{joint + 1}_Nm": logged_Nm[:, joint] for joint in range(n)},
            "temperature_C": sample_T.ravel().round(2),
        }
    )


def as_written(arm: Arm, q: Array) -> Array:
    """Return joint positions (N, n) [rad, or m of a sliding joint] as a file says them."""
    mm, deg = (1e3 * q).round(MM_DECIMALS), np.degrees(q).round(DEG_DECIMALS)
    written: Array = np.where(arm.prismatic, 1e-3 * mm, np.radians(deg))
    return written


def position_columns(arm: Arm, q: Array) -> dict[str, Array]:
    """Return the columns of joint positions (N, n) [rad, or m of a sliding joint], as in a file."""
    return {
        f"q{joint}_mm" if slides else f"q{joint}_deg": (
            (1e3 * column).round(MM_DECIMALS) if slides else np.degrees(column).round(DEG_DECIMALS)
        )
        for joint, (slides, column) in enumerate(zip(arm.prismatic, q.T, strict=True), start=1)
    }


def _as_logged(effects: Sequence[Effect], tau_Nm: Array, arrival: Array) -> Array:
    """Return (C, S, n) torques with what the log adds to them."""
    configurations, samples, n = tau_Nm.shape
    flat = tau_Nm.reshape(-1, n)
    arrivals = np.repeat(arrival, samples, axis=0)
    logged = flat.copy()
    for effect in effects:
        if isinstance(effect, TorqueLogEffect):
            logged += effect.logged_too_much_Nm(flat, arrivals)
    return logged.reshape(configurations, samples, n)


def _moving_torques(
    robot: BuiltRobot, effects: Sequence[Effect], schedule: Schedule, q_rad: Array
) -> Array:
    """Return (C, S, n) torques carried along the approaches (C, S, n), as of stiff joints."""
    mechanism = Mechanism.of(robot)
    tau_Nm = np.empty_like(q_rad)
    for configuration, load_N in enumerate(schedule.load_N):
        mechanism.hang(load_N)
        for sample, q in enumerate(q_rad[configuration]):
            tau_Nm[configuration, sample] = mechanism.torques_Nm(q)
    for effect in effects:
        if isinstance(effect, CarriedTorqueEffect):
            tau_Nm += effect.carried_Nm(q_rad)
    return tau_Nm


def _in_steps(values: Array, step: float | Array) -> Array:
    """Round to whole steps; a step of 0 leaves the values as they are."""
    return values if np.all(step == 0.0) else np.round(values / step) * step
