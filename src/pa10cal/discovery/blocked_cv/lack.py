"""Where a model and the poses of a survey disagree, in the form in which repeats are looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.blocked_cv.noise import Noise
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.clustered import mean, slope
from pa10cal.discovery.evidence.pure_error import ChannelTest
from pa10cal.discovery.joint_space import POSSIBLE_RAD, JointErrors, periodogram
from pa10cal.discovery.lack_of_fit import AXES, Arrival, Drift, JointPart, LackOfFit, Part
from pa10cal.discovery.operating_point import by_joints, left
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]

#: Of more poses only so many, spread evenly over time, stand for all where each is looked at.
MOST_CELLS = 1200
_HOUR_S = 3600.0


def lack_of_fit(survey: Survey, place: FittedModel, noise: Noise) -> LackOfFit:
    """Work out where a model and the poses disagree.

    There are no tests against pure error, and nothing of torques: those need repeats.

    Args:
        survey: the campaign.
        place: the model; its chain coordinates are those of the survey's.
        noise: of single readings.
    """
    every = np.arange(len(survey.poses))
    position_mm = -1e3 * left(place, survey.poses)[:, :3]
    noise_mm2 = 1e6 * np.diagonal(noise.cov_ee, axis1=1, axis2=2)[:, :3]
    squares, floor = (position_mm**2).sum(axis=1), noise_mm2.sum(axis=1)
    load_N = survey.poses.states.load_N
    kept = np.unique(np.linspace(0, every[-1], min(len(every), MOST_CELLS)).round().astype(int))
    cells = survey.poses.take(kept)
    joints = _joint_errors(place, cells, noise.cov_ee[kept])
    return LackOfFit(
        pose=ChannelTest(None, None, 0.0),
        torque=None,
        rms_mm=_root_mean(squares),
        floor_mm=_root_mean(floor),
        by_load=tuple(
            _part(f"{load:g} N", squares[load_N == load], floor[load_N == load])
            for load in np.unique(load_N)
        ),
        by_pose=(),
        by_axis=tuple(
            _part(axis, position_mm[:, k] ** 2, noise_mm2[:, k]) for k, axis in enumerate(AXES)
        ),
        by_joint=tuple(_joint_part(survey, cells, joints, j) for j in range(cells.states.n)),
        by_torque=(),
        drifts=tuple(_drift(survey.poses, axis, position_mm[:, k]) for k, axis in enumerate(AXES)),
        cells=cells,
        position_mm=position_mm[kept],
        joints=joints,
        torque_left_Nm=None,
    )


def _joint_errors(place: FittedModel, cells: Observations[Pose], cov_ee: Array) -> JointErrors:
    """Turn what a model leaves into errors of the joints' positions, by least squares."""
    whiten = np.linalg.inv(np.linalg.cholesky(cov_ee))
    rows = whiten @ by_joints(place, cells, range(1, cells.states.n + 1))
    white = -whiten @ left(place, cells)[:, :, None]
    across = rows.transpose(0, 2, 1)
    covariance = np.linalg.inv(across @ rows + np.eye(cells.states.n) / POSSIBLE_RAD**2)
    return JointErrors(
        error_rad=(covariance @ (across @ white))[:, :, 0],
        std_rad=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
    )


def _joint_part(
    survey: Survey, cells: Observations[Pose], joints: JointErrors, j: int
) -> JointPart:
    arm, states = survey.context.arm, cells.states
    error, weight = joints.error_rad[:, j], joints.weight[:, j]
    share = weight / weight.sum()
    sides = [(sign, np.sign(states.arrival[:, j]) == sign) for sign in (-1, 1)]
    return JointPart(
        joint=j + 1,
        rms_rad=float(np.sqrt(share @ error**2)),
        floor_rad=float(np.sqrt(share @ joints.std_rad[:, j] ** 2)),
        arrivals=tuple(
            Arrival(sign, int(rows.sum()), mean(error[rows], weight[rows], cells.pose[rows]))
            for sign, rows in sides
            if rows.any()
        ),
        periodogram=None
        if arm.prismatic[j]
        else periodogram(states.q_rad[:, j], error, weight, float(arm.gear_ratio[j])),
    )


def _drift(poses: Observations[Pose], axis: str, position_mm: Array) -> Drift:
    weight = poses.readings.astype(float)
    hours, kelvin = poses.states.time_s / _HOUR_S, poses.states.temperature_C
    logged = bool(np.isfinite(kelvin).all()) and float(np.ptp(kelvin)) > 0.0
    return Drift(
        axis=axis,
        mm_per_h=slope(hours, position_mm, weight, poses.pose),
        mm_per_K=slope(kelvin, position_mm, weight, poses.pose) if logged else None,
    )


def _part(of: str, squares: Array, floor: Array) -> Part:
    return Part(of, len(squares), _root_mean(squares), _root_mean(floor))


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(np.mean(squares)))
