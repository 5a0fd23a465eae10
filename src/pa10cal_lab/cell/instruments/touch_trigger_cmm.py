"""A measuring machine that touches tooling balls, with resolvers, motor currents, temperature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal_lab.cell.effects.effect import JointState, with_added
from pa10cal_lab.cell.instruments import instrument
from pa10cal_lab.cell.mechanism import Departures, Mechanism
from pa10cal_lab.cell.poses import Poses, place_poses
from pa10cal_lab.cell.robot import BALL_DIAMETER_M, Robot
from pa10cal_lab.cell.schedule import Schedule, sweeps

#: Measurement uncertainty of the paper's machine over its whole volume, as a campaign states it.
UNCERTAINTY_MM = 0.0121
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
_TEMPERATURE_NOISE_C = 0.01


class TouchTriggerCmm(instrument.SimulatedInstrument):
    """Touches on tooling balls, and a log of every approach and dwell."""

    kind: ClassVar[str] = "touch_trigger_cmm"
    files: ClassVar[Mapping[str, str]] = {"cmm": "cmm.csv.gz", "resolver": "resolver.csv.gz"}
    streams: ClassVar[tuple[str, ...]] = (
        "robot",
        "order",
        "hall",
        "servo",
        "links",
        "touch",
        "log",
    )
    decimals: ClassVar[Mapping[str, int]] = {"time_s": 2, "_mm": 4, "_deg": 5, "_Nm": 3, "_C": 2}

    def schedule(self, robot: Robot, streams: instrument.Streams) -> tuple[Schedule, Poses]:
        """Return straight moves, the grid once a load and repeat, and held-out points."""
        settings, arm = self.settings, robot.arm
        nominal = Mechanism.of(arm, Departures.none(arm.n), robot.mechanism.payload)
        poses = place_poses(arm, nominal, settings.poses, settings.holdout_points)
        return sweeps(poses, settings, streams["order"]), poses

    @property
    def at_rest_s(self) -> float:
        return float(DWELL_S.mean())

    def motors(self, schedule: Schedule, streams: instrument.Streams) -> tuple[Array, Array]:
        noise, shape = self.settings.noise, schedule.q.shape
        q_motor = schedule.q + noise.servo_rad * streams["servo"].standard_normal(shape)
        return q_motor, q_motor + noise.unseen_rad * streams["links"].standard_normal(shape)

    def measure(
        self, truth: instrument.Truth, streams: instrument.Streams
    ) -> dict[str, pd.DataFrame]:
        return {
            "cmm": self._touches(truth, streams["touch"]),
            "resolver": self._log(truth, streams["log"]),
        }

    def description(self, robot: Robot) -> dict[str, Any]:
        stated_mm = self.settings.stated_uncertainty_mm
        return {
            "instrument": {
                "kind": self.kind,
                "uncertainty_mm": UNCERTAINTY_MM if stated_mm is None else stated_mm,
            },
            "ball_diameter_mm": round(1e3 * BALL_DIAMETER_M, 4),
            "tool": instrument.tool_of(robot),
        }

    def _touches(self, truth: instrument.Truth, rng: np.random.Generator) -> pd.DataFrame:
        """Probe every ball in every configuration."""
        robot, schedule = truth.robot, truth.schedule
        points_m = truth.p_instr_targets_m[:, :, None, :] + 0.5 * BALL_DIAMETER_M * TOUCH_DIRECTIONS
        noise_mm = self.settings.noise.touch_mm * rng.standard_normal(points_m.shape)
        read_mm = 1e3 * truth.as_read(points_m) + noise_mm

        balls, touches = len(robot.targets.names), len(TOUCH_DIRECTIONS)
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
                "ball": np.tile(np.repeat(robot.targets.names, touches), len(schedule)),
                "touch": np.tile(np.arange(1, touches + 1), balls * len(schedule)),
                "x_mm": x_mm,
                "y_mm": y_mm,
                "z_mm": z_mm,
            }
        )

    def _log(self, truth: instrument.Truth, rng: np.random.Generator) -> pd.DataFrame:
        """Log resolvers and motor currents through every approach and dwell."""
        noise, robot, schedule = self.settings.noise, truth.robot, truth.schedule
        n = robot.arm.n
        before_s = np.concatenate([MOVE_S - APPROACH_S, np.zeros(len(DWELL_S))])
        shape = (len(schedule), len(before_s), n)
        move = (schedule.q - schedule.q_from) / MOVE_S
        q = truth.q_motor[:, None, :] - before_s[:, None] * move[:, None, :]
        tau_Nm = np.empty(shape)
        tau_Nm[:, len(APPROACH_S) :] = truth.rest.tau_Nm[:, None, :]
        tau_Nm[:, : len(APPROACH_S)] = _moving_torques(truth, q[:, : len(APPROACH_S)])
        arrival = np.repeat(schedule.arrival, shape[1], axis=0)
        tau_Nm = truth.as_logged(tau_Nm.reshape(-1, n), arrival).reshape(shape)

        sample_q = q + noise.resolver_rad * rng.standard_normal(shape)
        rated_Nm = robot.arm.torque_limit_Nm
        louder = np.where(before_s > 0.0, MOVING_NOISE, 1.0)[:, None]
        sample_tau = tau_Nm + noise.torque_fraction * rated_Nm * louder * rng.standard_normal(shape)
        temperature_C = truth.temperature_C[:, None]
        sample_T = temperature_C + _TEMPERATURE_NOISE_C * rng.standard_normal(shape[:2])
        time_s = np.add.outer(schedule.start_s, np.concatenate([APPROACH_S, DWELL_S]))
        counted = _in_steps(sample_q, noise.resolver_count_rad).reshape(-1, n)
        logged_Nm = _in_steps(sample_tau, rated_Nm / TORQUE_STEPS).reshape(-1, n).round(3)
        return pd.DataFrame(
            {
                "time_s": time_s.ravel().round(2),
                **instrument.position_columns(robot.arm, counted),
                **{f"tau{joint + 1}_Nm": logged_Nm[:, joint] for joint in range(n)},
                "temperature_C": sample_T.ravel().round(2),
            }
        )


def _moving_torques(truth: instrument.Truth, q: Array) -> Array:
    """Return (C, S, n) torques carried along the approaches (C, S, n), as of stiff joints."""
    loads_N = np.repeat(truth.schedule.load_N, q.shape[1])
    flat = q.reshape(-1, q.shape[2])
    held_Nm = truth.robot.mechanism.statics(flat, loads_N).torque_Nm
    tau_Nm = truth.robot.arm.coupling.at_drives(held_Nm)
    motion = JointState(flat, np.zeros_like(flat), truth.robot.arm.gear_ratio)
    return with_added(tau_Nm, "carried", truth.effects, motion).reshape(q.shape)


def _in_steps(values: Array, step: float | Array) -> Array:
    """Round to whole steps; a step of 0 leaves the values as they are."""
    return values if np.all(step == 0.0) else np.round(values / step) * step
