"""What instruments that do not touch have in common: one row a configuration."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal_lab.cell.effects.structure import SimulatedBaseDrift
from pa10cal_lab.cell.individual import need_masses, refuse_unrated
from pa10cal_lab.cell.instruments.instrument import (
    SimulatedInstrument,
    Streams,
    Truth,
    as_written,
    position_columns,
    tool_of,
)
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.poses import commanded_positions, joint_bounds
from pa10cal_lab.cell.robot import Robot
from pa10cal_lab.cell.schedule import Schedule, one_after_another

_TEMPERATURE_NOISE_C = 0.01
#: How far targets on the base stand from its axis [m].
_BASE_RADIUS_M = (0.3, 0.6)


class Tracker(SimulatedInstrument):
    """An instrument that measures targets from afar, while the arm stands in pose after pose.

    Poses are drawn evenly in joint space; whether an arm or its targets collide, or can be seen, is
    not looked at.
    """

    files: ClassVar[Mapping[str, str]] = {"poses": "poses.csv"}
    streams: ClassVar[tuple[str, ...]] = (
        "robot",
        "poses",
        "resolver",
        "torque",
        "position",
        "attitude",
        "visibility",
        "hall",
        "thermometer",
        "links",
        "order",
        "base",
    )
    #: What was measured is written finer than it can be, so that nothing is lost on the way.
    decimals: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys(("x_mm", "y_mm", "z_mm", "d_mm"), 6),
        **dict.fromkeys(("qw", "qx", "qy", "qz"), 9),
        "time_s": 2,
        "_mm": 4,
        "_deg": 5,
        "_Nm": 3,
        "_C": 2,
    }

    def __init__(self, settings: SimulateOptions) -> None:
        super().__init__(settings)
        self.plan = settings.without_touches or TrackerOptions()

    @abstractmethod
    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        """Return columns (C,) of what is read, each with its standard uncertainty."""

    @property
    def stated_mm(self) -> float:
        """Return the standard uncertainty that the campaign states, right or wrong."""
        stated_mm = self.settings.stated_uncertainty_mm
        return self.plan.position_mm if stated_mm is None else stated_mm

    @property
    def states_targets(self) -> bool:
        """Return whether the campaign says where the targets are."""
        return self.plan.states_targets

    def schedule(self, robot: Robot, streams: Streams) -> tuple[Schedule, None]:
        """Return poses within the joint limits, the last ones held out."""
        arm, plan = robot.arm, self.plan
        if plan.commanded:
            q = commanded_positions(arm, plan.commanded, "without_touches.commanded")
        else:
            q = streams["poses"].uniform(*joint_bounds(arm), (plan.poses, arm.n))
        return one_after_another(as_written(arm, q), plan, streams["order"]), None

    @property
    def at_rest_s(self) -> float:
        return self.plan.seconds_a_pose

    def motors(self, schedule: Schedule, streams: Streams) -> tuple[Array, Array]:
        off = self.plan.unseen_rad * streams["links"].standard_normal(schedule.q.shape)
        return schedule.q, schedule.q + off

    def measure(self, truth: Truth, streams: Streams) -> dict[str, pd.DataFrame]:
        arm, schedule = truth.robot.arm, truth.schedule
        off = np.where(arm.prismatic, 1e-3 * self.plan.resolver_mm, self.plan.resolver_rad)
        logged = truth.q_motor + off * streams["resolver"].standard_normal(truth.q_motor.shape)
        time_s = schedule.start_s + self.at_rest_s
        columns: dict[str, Any] = {
            "time_s": np.arange(len(schedule)) if self.plan.clock == "row" else time_s,
            "kind": schedule.kind,
            "pose": schedule.pose,
            "load_N": schedule.load_N,
            "repeat": schedule.repeat,
            **position_columns(arm, as_written(arm, logged)),
        }
        if self.plan.logs_torques:
            tau_Nm = self._logged_torques(truth, streams["torque"])
            columns |= {f"tau{joint}_Nm": tau for joint, tau in enumerate(tau_Nm.T, start=1)}
        if self.settings.temperature_drift_C > 0.0:
            noise_C = _TEMPERATURE_NOISE_C * streams["thermometer"].standard_normal(len(schedule))
            columns["temperature_C"] = (truth.temperature_C + noise_C).round(2)
        read = self.readings(truth, streams) | self._base_readings(truth, streams["base"])
        columns |= {name: values for name, (values, _) in read.items()}
        columns |= {f"u_{name}": np.full(len(schedule), u) for name, (_, u) in read.items()}
        if self.plan.clock == "none":
            del columns["time_s"]
        if self.plan.holdout_every:  # the description says which
            del columns["kind"]
        return {"poses": pd.DataFrame(columns)}

    def description(self, robot: Robot) -> dict[str, Any]:
        every, weighed = self.plan.holdout_every, self.plan.unstated is None
        columns = {"columns": {"poses": self._columns_without_time(robot)}}
        return {
            "instrument": {"kind": self.kind, "uncertainty_mm": self.stated_mm},
            "tool": tool_of(robot, weighed=weighed, measured=self.states_targets),
            **({"holdout": {"every": every}} if every else {}),
            **(columns if self.plan.clock == "none" else {}),
        }

    def _columns_without_time(self, robot: Robot) -> dict[str, Any]:
        """Return `columns` of a file that has no time: all else in it has to be stated."""
        plan, n = self.plan, robot.arm.n
        joints = list(position_columns(robot.arm, np.zeros((0, n))))
        columns = {"joints": {"names": joints}, **self.read_columns(robot)}
        if plan.logs_torques:
            columns["torques"] = {"names": [f"tau{joint}_Nm" for joint in range(1, n + 1)]}
        if self.settings.temperature_drift_C > 0.0:
            columns["temperature"] = {"names": "temperature_C"}
        if any(plan.loads_N):
            columns["load"] = {"names": "load_N"}
        if plan.repeats > 1 or plan.repeat_every:
            columns |= {"pose": "pose", "repeat": "repeat"}
        if not plan.holdout_every:
            columns["kind"] = {"names": "kind"}
        if on_base := [f"base{k + 1}" for k in range(plan.base_targets)]:
            places = {name: xyz_columns(f"{name}_") for name in on_base}
            columns["targets"] = columns.get("targets", {}) | places
        return columns

    @abstractmethod
    def read_columns(self, robot: Robot) -> dict[str, Any]:
        """Return what the columns of `readings` are, as under `columns` of campaign.yaml."""

    def _base_readings(
        self, truth: Truth, rng: np.random.Generator
    ) -> dict[str, tuple[Array, float]]:
        """Return places [mm] of targets on the plate of the base, which carries them along."""
        plan, robot, count = self.plan, truth.robot, self.plan.base_targets
        around = 2.0 * np.pi * (np.arange(count) + rng.uniform(size=count) / 3.0) / max(count, 1)
        radius_m = rng.uniform(*_BASE_RADIUS_M, count)
        p_base_m = np.column_stack(
            [radius_m * np.cos(around), radius_m * np.sin(around), rng.uniform(0.0, 0.1, count)]
        )
        hours = (truth.schedule.start_s + self.at_rest_s) / 3600.0
        rates = [effect.rate for effect in truth.effects if isinstance(effect, SimulatedBaseDrift)]
        moved_m = np.outer(hours, np.sum(rates, axis=0)) if rates else np.zeros((len(hours), 3))
        p_m = p_base_m + moved_m[:, None]
        p_m = p_m @ robot.T_instr_base[:3, :3].T + robot.T_instr_base[:3, 3]
        noise_mm = plan.position_mm * rng.standard_normal(p_m.shape)
        read_mm = 1e3 * truth.as_read(p_m) + noise_mm
        return {
            f"base{k + 1}_{axis}_mm": (read_mm[:, k, i], self.stated_mm)
            for k in range(count)
            for i, axis in enumerate("xyz")
        }

    def _logged_torques(self, truth: Truth, rng: np.random.Generator) -> Array:
        arm = truth.robot.arm
        need_masses(arm, "an arm description with mass_kg and com_m, or logs_torques: false")
        refuse_unrated(arm, range(1, arm.n + 1), "logs_torques")
        tau_Nm = truth.as_logged(truth.rest.tau_Nm, truth.schedule.arrival)
        noise_Nm = (
            self.plan.torque_fraction * arm.torque_limit_Nm * rng.standard_normal(tau_Nm.shape)
        )
        return np.asarray((tau_Nm + noise_Nm).round(3))


def xyz_columns(prefix: str) -> dict[str, list[str]]:
    """Return the columns of a position and its uncertainties, as under `columns`."""
    names = [f"{prefix}{axis}_mm" for axis in "xyz"]
    return {"names": names, "u": [f"u_{name}" for name in names]}


# An instrument that measures the distance of one target from a fixed point.


class SimulatedDistances(Tracker):
    """The fixed point is the origin of its frame."""

    kind: ClassVar[str] = "distance"

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        d_m = np.linalg.norm(truth.as_read(truth.p_instr_targets_m[:, 0]), axis=1)
        d_m = d_m + 1e-3 * self.plan.position_mm * streams["position"].standard_normal(d_m.shape)
        return {"d_mm": (1e3 * d_m, self.stated_mm)}

    def read_columns(self, _robot: Robot) -> dict[str, Any]:
        return {"distance": {"names": "d_mm", "u": "u_d_mm"}}


# A tracker of positions of several targets.


class SimulatedPoints(Tracker):
    """Some targets are not seen in some poses."""

    kind: ClassVar[str] = "points"

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        p_m = truth.as_read(truth.p_instr_targets_m)
        p_m = p_m + 1e-3 * self.plan.position_mm * streams["position"].standard_normal(p_m.shape)
        drawn = streams["visibility"].random(p_m.shape[:2])
        occluded = drawn < self.plan.unseen_share
        occluded[np.arange(len(drawn)), drawn.argmax(axis=1)] = False  # one of each pose always is
        p_m[occluded] = np.nan
        return {
            f"{name}_{axis}_mm": (1e3 * p_m[:, b, k], self.stated_mm)
            for b, name in enumerate(truth.robot.targets.names)
            for k, axis in enumerate("xyz")
        }

    def read_columns(self, robot: Robot) -> dict[str, Any]:
        return {"targets": {name: xyz_columns(f"{name}_") for name in robot.targets.names}}


# A tracker of poses: position and orientation of one target.

_QUATERNION = ("qw", "qx", "qy", "qz")


class SimulatedPoses(Tracker):
    """Its orientation is measured apart from its position: errors of the scales do not turn it."""

    kind: ClassVar[str] = "pose"

    @property
    def states_targets(self) -> bool:
        """Return that the campaign takes the target for the end-effector frame."""
        return False

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        """Return the target's position [mm] and orientation, a unit quaternion."""
        T_base_ee, plan = truth.rest.T_base_ee, self.plan
        T = truth.robot.T_instr_target(T_base_ee)
        R_instr_ee = truth.robot.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]
        moved_m = (R_instr_ee @ truth.tool_shift_m[:, :, None])[:, :, 0]
        noise_m = 1e-3 * plan.position_mm * streams["position"].standard_normal((len(T), 3))
        p_m = truth.as_read(T[:, :3, 3] + moved_m) + noise_m
        turn = plan.attitude_rad * streams["attitude"].standard_normal((len(T), 3))
        R = Rotation.from_rotvec(turn).as_matrix() @ T[:, :3, :3]
        quaternion = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
        # Half a turn's uncertainty in every component is that turn's about every axis.
        return {
            **{f"{axis}_mm": (1e3 * p_m[:, k], self.stated_mm) for k, axis in enumerate("xyz")},
            **{
                name: (quaternion[:, k], 0.5 * plan.attitude_rad)
                for k, name in enumerate(_QUATERNION)
            },
        }

    def read_columns(self, _robot: Robot) -> dict[str, Any]:
        return {
            "position": xyz_columns(""),
            "rotation": {
                "names": list(_QUATERNION),
                "convention": "quaternion_wxyz",
                "u": [f"u_{name}" for name in _QUATERNION],
            },
        }
