"""Configurations that could be measured next: where the arm may go, and what is foreseen there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import end_pose_with_screws, frames
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import statics
from pa10cal.calibration.levels import OneLevel
from pa10cal.discovery.evidence.cells import shared_error
from pa10cal.discovery.evidence.fit import Fit
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import Problem, common_torques
from pa10cal.discovery.evidence.repeatability import same_circumstances
from pa10cal.discovery.preparation import MeasurementSetup, complete
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]

_DRAWN_AT_ONCE = 20_000
_MOST_DRAWS = 15


class Measured(Protocol):
    """What is known of a campaign whose context are asked for."""

    @property
    def baseline(self) -> FittedModel:
        """Return the calibrated model."""

    @property
    def setup(self) -> MeasurementSetup:
        """Return what is known besides the poses."""

    @property
    def cells(self) -> Observations[Pose]:
        """Return the measured poses."""


@dataclass(frozen=True)
class Room:
    """Where arm and tool may go.

    Attributes:
        limit_margin: part of each joint's range kept clear at either end.
        volume_factor: the end stays in the box of the measured places, so many times as large ...
        least_margin_m: ... and at least so much larger on every side.
        floor_m: end and targets stay so far above the base's origin, along the base's z axis.
        column_m: end and targets stay so far off the base's axis.
        clearance_m: targets stay so far off the line from joint to joint.
    """

    limit_margin: float = 0.05
    volume_factor: float = 2.0
    least_margin_m: float = 0.3
    floor_m: float = 0.15
    column_m: float = 0.25
    clearance_m: float = 0.15


def draw_admissible(problem: Measured, count: int, room: Room, rng: np.random.Generator) -> Array:
    """Draw configurations evenly in joint space, and keep those within the room.

    Whether links, rods and instrument collide otherwise is not looked at.

    Args:
        problem: gives arm, tool and measured places.
        count: N, how many are wanted.
        room: where arm and tool may go.
        rng: draws them.

    Returns:
        (N, n) joint angles [rad, or m of a sliding joint].

    Raises:
        DiscoveryError: when none is found.
    """
    low, high = problem.baseline.model.chain.arm.limits_rad.T
    margin = room.limit_margin * (high - low)
    found: list[Array] = []
    for _ in range(_MOST_DRAWS):
        q_rad = rng.uniform(low + margin, high - margin, (_DRAWN_AT_ONCE, len(low)))
        found.append(q_rad[_is_admissible(problem, q_rad, room)])
        if sum(map(len, found)) >= count:
            break
    if not sum(map(len, found)):
        raise DiscoveryError(
            "no configuration keeps clear of floor, column and limits near the measured places",
            where="configurations to measure next",
            value=f"none of {_MOST_DRAWS * _DRAWN_AT_ONCE}",
            allowed="at least one",
            remedy="allow more room",
        )
    return np.concatenate(found)[:count]


def _is_admissible(problem: Measured, q_rad: Array, room: Room) -> NDArray[np.bool_]:
    """Tell which configurations (P, n) keep within the room, (P,), by the nominal chain."""
    chain = problem.baseline.model.chain
    at = frames(chain, chain.coordinates(q_rad))
    T_instr_base = problem.baseline.T_instr_base
    p_base_end = at.T_base_ee[:, :3, 3]
    p_instr_end = p_base_end @ T_instr_base[:3, :3].T + T_instr_base[:3, 3]
    low, high = _box(problem, room)
    within: NDArray[np.bool_] = np.all((p_instr_end > low) & (p_instr_end < high), axis=1)
    p_base_targets = p_base_end[:, None] + np.einsum(
        "pij,bj->pbi", at.T_base_ee[:, :3, :3], problem.setup.p_ee_targets_m.reshape(-1, 3)
    )
    tool = np.concatenate([p_base_end[:, None], p_base_targets], axis=1)
    within &= tool[..., 2].min(axis=1) > room.floor_m
    within &= np.hypot(tool[..., 0], tool[..., 1]).min(axis=1) > room.column_m
    joints = at.T_base_joints[:, :, :3, 3]
    for start, end in pairwise(joints):
        distance = _distance(p_base_targets, start[:, None], end[:, None])
        within &= distance.min(axis=1, initial=np.inf) > room.clearance_m
    return within


def _box(problem: Measured, room: Room) -> tuple[Array, Array]:
    """Return the corners (3,), (3,) of where the end may be, in the instrument's frame."""
    measured = problem.cells.measured.T_instr_target[:, :3, 3]
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = np.maximum(0.5 * (room.volume_factor - 1.0) * (high - low), room.least_margin_m)
    return low - margin, high + margin


def _distance(points: Array, start: Array, end: Array) -> Array:
    """Return the distances (P, B) of points (P, B, 3) from lines start to end (P, 1, 3)."""
    along = end - start
    length2 = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    share = np.clip(np.sum((points - start) * along, axis=-1) / length2, 0.0, 1.0)
    distance: Array = np.linalg.norm(points - start - share[..., None] * along, axis=-1)
    return distance


def foresee(
    problem: Problem, found: Fit, q_rad: Array, load_N: Array, arrival: Array
) -> tuple[Problem, Fit]:
    """Return problem and fit as they would be of other configurations, measured at the end.

    The poses are those that the fit predicts; each is read as often as the campaign's were.

    Args:
        problem: the campaign.
        found: a fit to it.
        q_rad: (N, n) joint angles.
        load_N: (N,) loads.
        arrival: (N, n) directions of arrival.

    Raises:
        DiscoveryError: when torques were logged but the weights that make them are not known.
    """
    baseline, setup, measured = problem.baseline, problem.setup, problem.readings.states
    if setup.payload is None and np.all(np.isfinite(measured.tau_Nm)):
        raise DiscoveryError(
            "torques cannot be foreseen in configurations that were not measured",
            where=baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )
    count, last = len(q_rad), int(np.argmax(measured.time_s))
    states = PoseStates(
        q_rad=q_rad,
        tau_Nm=np.full(q_rad.shape, np.nan if setup.payload is None else 0.0),
        arrival=arrival,
        load_N=load_N,
        temperature_C=np.full(count, measured.temperature_C[last]),
        time_s=np.full(count, measured.time_s[last]),
    )
    repeats = round(len(problem.readings) / (1 + int(same_circumstances(problem.readings).max())))
    poses = Observations(
        pose=np.array([f"next {k}" for k in range(count)]),
        states=states,
        measured=Pose(
            baseline.T_instr_base @ baseline.model.predict(states, baseline.x),
            np.zeros((count, 6, 6)),
            np.zeros((count, *problem.readings.measured.by_apparatus.shape[1:])),
        ),
        kind=np.full(count, "grid"),
        repeat=np.ones(count, dtype=np.int64),
        readings=np.full(count, repeats),
    )
    poses = _on_apparatus(poses, problem)
    states = complete(poses, baseline, setup).states
    if states.static_loads is not None:
        tau_Nm = states.static_loads.joint_Nm + found.model.torque_Nm(states, found.x)
        states = replace(states, tau_Nm=tau_Nm)
    T_instr_ee = found.level.T_instr_base @ found.model.predict(states, found.x)
    poses = poses.with_states(states).with_measured(T_instr_target=T_instr_ee)
    poses = _on_apparatus(poses, problem)
    poses = poses.with_measured(cov=_reading_cov(poses, problem) / repeats)
    level = OneLevel(found.model, poses, found.level.T_instr_base, found.level.r_max_m)
    return _weighed(problem, poses), replace(found, level=level)


def _weighed(problem: Problem, poses: Observations[Pose]) -> Problem:
    """Return the problem of other poses."""
    baseline, setup, shared = problem.baseline, problem.setup, shared_error(poses)
    pose = NoiseModel.of(
        np.linalg.inv(np.linalg.cholesky(poses.measured.cov)),
        shared,
        setup.apparatus_m * poses.measured.by_apparatus,
    )
    torque = None
    if problem.torque is not None and setup.payload is not None:
        coordinates = baseline.model.chain_coordinates(poses.states, baseline.x)
        weights = statics(baseline.model.chain, coordinates, poses.states.load_N, setup.payload)
        scale = np.sqrt(poses.readings)[:, None] / problem.noise.torque_Nm
        loads_N = np.unique(problem.cells.states.load_N)
        common = common_torques(
            poses, weights, baseline, setup.payload, setup.options, loads_N[loads_N > 0]
        )
        torque = NoiseModel.of(scale[:, :, None] * np.eye(poses.states.n), shared, common)
    left = np.zeros_like(poses.states.tau_Nm)
    return replace(
        problem, readings=poses, cells=poses, pose=pose, torque=torque, torque_left_Nm=left
    )


def _on_apparatus(poses: Observations[Pose], problem: Problem) -> Observations[Pose]:
    """Return poses with what places of targets do to them.

    That is about the same along the end's own axes everywhere: the mean of the readings.
    """
    readings = problem.readings
    own = np.mean(_turns(readings).transpose(0, 2, 1) @ readings.measured.by_apparatus, axis=0)
    return poses.with_measured(by_apparatus=_turns(poses) @ own)


def _reading_cov(poses: Observations[Pose], problem: Problem) -> Array:
    """Return the covariance of one reading of poses, (P, 6, 6), from its sources."""
    readings, noise = problem.readings, problem.noise
    by_joint = noise.joint_rad**2
    of_joints = _spread(_screws(readings, problem), by_joint)
    stated = noise.instrument**2 * readings.measured.cov
    # What neither joints nor instrument account for is alike in all poses and directions.
    rest = np.mean(np.diagonal(noise.cov_ee - of_joints - stated, axis1=1, axis2=2), axis=0)
    rest = np.repeat(np.maximum(rest.reshape(2, 3).mean(axis=1), 0.0), 3)
    turn = _turns(readings)
    own = np.mean(turn.transpose(0, 2, 1) @ stated @ turn, axis=0)
    turn = _turns(poses)
    of_instrument: Array = turn @ own @ turn.transpose(0, 2, 1)
    return _spread(_screws(poses, problem), by_joint) + of_instrument + np.diag(rest)


def _spread(screws: Array, variance: Array) -> Array:
    """Return what variances (n,) of the joints make of poses, (P, 6, 6)."""
    spread: Array = (screws * variance) @ screws.transpose(0, 2, 1)
    return spread


def _turns(poses: Observations[Pose]) -> Array:
    """Return (P, 6, 6) what turns position and rotation from the end's axes to the instrument's."""
    turn = np.zeros((len(poses), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = poses.measured.T_instr_target[:, :3, :3]
    return turn


def _screws(poses: Observations[Pose], problem: Problem) -> Array:
    """Return how poses follow each joint's angle, (P, 6, n), along the instrument's axes."""
    baseline = problem.baseline
    chain = baseline.model.chain
    coordinates = baseline.model.chain_coordinates(poses.states, baseline.x)
    screws = end_pose_with_screws(chain, coordinates).screws[:, :, chain.joint_columns]
    R = baseline.T_instr_base[:3, :3]
    return np.concatenate([R @ screws[:, :3], R @ screws[:, 3:]], axis=1)
