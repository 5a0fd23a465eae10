"""Where model and data disagree: what is left against what repeats scatter, and where it sits.

Two channels: poses, measured against predicted, and torques, logged against the weights. Errors
alike in all poses take their part first: places of targets on the apparatus, masses, loads, zeros.
Everything is stated of cells (`cells.gather`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.clustered import Estimate, mean, slope
from pa10cal.discovery.evidence.fit import Fit, pose_rows, torque_rows
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.evidence.pure_error import ChannelTest, channel_tests, left_over
from pa10cal.discovery.joint_space import JointErrors, Periodogram, joint_errors, periodogram
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]

AXES = ("x", "y", "z")
_HOUR_S = 3600.0


@dataclass(frozen=True)
class Part:
    """Position error over some cells, or along one axis.

    Attributes:
        of: which: `22 N`, a pose's label, or `x`, `y`, `z` of the instrument.
        cells: how many.
        rms_mm: root mean square of the error.
        floor_mm: what the noise of these cells alone would leave.
    """

    of: str
    cells: int
    rms_mm: float
    floor_mm: float


@dataclass(frozen=True)
class Arrival:
    """Mean over the cells at which a joint arrived from one side.

    Attributes:
        direction: +1 or -1.
        cells: how many.
        mean: of the joint's angle error [rad] or of its torque left [N m].
    """

    direction: int
    cells: int
    mean: Estimate


@dataclass(frozen=True)
class JointPart:
    """Angle error of one joint.

    Attributes:
        joint: 1 … n.
        rms_rad: root mean square, cells weighted by what they tell of the joint.
        floor_rad: what noise alone would leave.
        arrivals: by direction of arrival.
        periodogram: by the joint's angle, None for a joint that slides or hardly turned.
    """

    joint: int
    rms_rad: float
    floor_rad: float
    arrivals: tuple[Arrival, ...]
    periodogram: Periodogram | None


@dataclass(frozen=True)
class TorquePart:
    """Torque of one joint left over the weights.

    Attributes:
        joint: 1 … n.
        rms_Nm: root mean square.
        noise_Nm: what the noise of the cells alone would leave.
        arrivals: by direction of arrival.
    """

    joint: int
    rms_Nm: float
    noise_Nm: float
    arrivals: tuple[Arrival, ...]


@dataclass(frozen=True)
class Drift:
    """Slope of the measured less the predicted position along one axis of the instrument.

    Attributes:
        axis: `x`, `y` or `z`.
        mm_per_h: with time.
        mm_per_K: with temperature, None where it was not logged or did not change.
    """

    axis: str
    mm_per_h: Estimate
    mm_per_K: Estimate | None


@dataclass(frozen=True)
class LackOfFit:
    """Where a fit and the data disagree.

    Attributes:
        pose: lack of fit of the poses.
        torque: of the torques, None where they or the weights are not known.
        rms_mm, floor_mm: position error over all cells, and what noise alone would leave.
        by_load, by_pose, by_axis: the same by part.
        by_joint: in joint space.
        by_torque: torques left, none where they are not known.
        drifts: along the instrument's axes.
        cells: the C cells.
        position_mm: (C, 3) measured less predicted, along the instrument's axes.
        joints: in joint space, cell by cell.
        torque_left_Nm: (C, n) logged less predicted, None where it is not known.
    """

    pose: ChannelTest
    torque: ChannelTest | None
    rms_mm: float
    floor_mm: float
    by_load: tuple[Part, ...]
    by_pose: tuple[Part, ...]
    by_axis: tuple[Part, ...]
    by_joint: tuple[JointPart, ...]
    by_torque: tuple[TorquePart, ...]
    drifts: tuple[Drift, ...]
    cells: Observations[Pose]
    position_mm: Array
    joints: JointErrors
    torque_left_Nm: Array | None


def lack_of_fit(problem: Problem, found: Fit) -> LackOfFit:
    """Work out where a fit and the data disagree.

    Args:
        problem: the campaign.
        found: the fit, with or without effects.
    """
    cells = problem.cells
    pose, torque = channel_tests(problem, found)
    white = left_over(problem.pose, pose_rows(found.level.linearise(found.x)), pose.shared_variance)
    pose_left = np.linalg.solve(problem.pose.whitener, white[..., None])[:, :, 0]
    position_mm = np.asarray(1e3 * pose_left[:, :3], dtype=np.float64)
    noise_mm2 = 1e6 * np.diagonal(cells.measured.cov, axis1=1, axis2=2)[:, :3]
    squares, noise = (position_mm**2).sum(axis=1), noise_mm2.sum(axis=1)
    joints = joint_errors(problem, found, white)
    torque_left_Nm = _torque_left_Nm(problem, found, torque)
    return LackOfFit(
        pose=pose,
        torque=torque,
        rms_mm=_root_mean(squares),
        floor_mm=_root_mean(noise),
        by_load=_parts([f"{load:g} N" for load in cells.states.load_N], squares, noise),
        by_pose=_parts(cells.pose.tolist(), squares, noise),
        by_axis=tuple(
            Part(axis, len(cells), _root_mean(position_mm[:, k] ** 2), _root_mean(noise_mm2[:, k]))
            for k, axis in enumerate(AXES)
        ),
        by_joint=tuple(_joint_part(problem, joints, j) for j in range(cells.states.n)),
        by_torque=()
        if torque_left_Nm is None
        else tuple(_torque_part(problem, torque_left_Nm[:, j], j) for j in range(cells.states.n)),
        drifts=tuple(_drift(problem, axis, position_mm[:, k]) for k, axis in enumerate(AXES)),
        cells=cells,
        position_mm=position_mm,
        joints=joints,
        torque_left_Nm=torque_left_Nm,
    )


def _torque_left_Nm(problem: Problem, found: Fit, test: ChannelTest | None) -> Array | None:
    """Return logged less predicted torques (C, n)."""
    if problem.torque is None or test is None:
        return None
    rows = torque_rows(problem, found.model, found.x)
    white = left_over(problem.torque, rows, test.shared_variance)
    return np.asarray(np.linalg.solve(problem.torque.whitener, white[..., None])[:, :, 0])


def _joint_part(problem: Problem, joints: JointErrors, j: int) -> JointPart:
    states, arm = problem.cells.states, problem.context.arm
    error, weight = joints.error_rad[:, j], joints.weight[:, j]
    share = weight / weight.sum()
    return JointPart(
        joint=j + 1,
        rms_rad=float(np.sqrt(share @ error**2)),
        floor_rad=float(np.sqrt(share @ joints.std_rad[:, j] ** 2)),
        arrivals=_arrivals(problem, error, weight, j),
        periodogram=None
        if arm.prismatic[j]
        else periodogram(states.q_rad[:, j], error, weight, float(arm.gear_ratio[j])),
    )


def _torque_part(problem: Problem, left_Nm: Array, j: int) -> TorquePart:
    cells = problem.cells
    noise = problem.noise.torque_Nm[j] ** 2 / cells.readings
    return TorquePart(
        joint=j + 1,
        rms_Nm=_root_mean(left_Nm**2),
        noise_Nm=_root_mean(noise),
        arrivals=_arrivals(problem, left_Nm, cells.readings.astype(float), j),
    )


def _arrivals(problem: Problem, values: Array, weight: Array, j: int) -> tuple[Arrival, ...]:
    """Return the mean of values over the cells at which joint j (from 0) came from each side."""
    arrival, pose = problem.cells.states.arrival[:, j], problem.cells.pose
    return tuple(
        Arrival(sign, int(rows.sum()), mean(values[rows], weight[rows], pose[rows]))
        for sign in (-1, 1)
        if (rows := np.sign(arrival) == sign).any()
    )


def _drift(problem: Problem, axis: str, position_mm: Array) -> Drift:
    cells = problem.cells
    weight = cells.readings.astype(float)
    hours, kelvin = cells.states.time_s / _HOUR_S, cells.states.temperature_C
    logged = bool(np.isfinite(kelvin).all()) and float(np.ptp(kelvin)) > 0.0
    return Drift(
        axis=axis,
        mm_per_h=slope(hours, position_mm, weight, cells.pose),
        mm_per_K=slope(kelvin, position_mm, weight, cells.pose) if logged else None,
    )


def _parts(of: list[str], squares: Array, noise: Array) -> tuple[Part, ...]:
    """Return the parts of cells by a label of each, in the order in which labels first come."""
    labels, first, group = np.unique(of, return_index=True, return_inverse=True)
    count = np.bincount(group)
    rms = np.sqrt(np.bincount(group, squares) / count)
    floor = np.sqrt(np.bincount(group, noise) / count)
    return tuple(
        Part(str(labels[k]), int(count[k]), float(rms[k]), float(floor[k]))
        for k in np.argsort(first)
    )


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(np.mean(squares)))
