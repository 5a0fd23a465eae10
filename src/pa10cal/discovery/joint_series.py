"""What a model leaves of each joint's angle, pose by pose, as the ripple of its motor needs it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.discovery.linear import by_every_joint
from pa10cal.discovery.motor_ripple import JointSeries
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.joint_error_map import JointErrorMap

#: Scatter of a joint's angle to begin with [rad], and rounds in which variances are found.
_JOINT_RAD = 5e-5
_ROUNDS = 20
#: A torque that varies by less than this part of the rated one does not turn the motor.
_LEAST_LOADED = 0.02


def joint_series(
    at: FittedModel, poses: Observations, left: Array, whitener: Array, joints: Sequence[int]
) -> list[list[JointSeries]]:
    """Return each joint's residual in every campaign; none of joints that are not asked for.

    The residual of a pose is that of all its joints and of its reading at once; their variances are
    found from all poses (expectation and maximisation). What a joint makes of it, the others being
    noise, is its score.

    Args:
        at: the model, with its maps.
        poses: P poses.
        left: (P, b) predicted minus measured components.
        whitener: (P, b, b) makes the residuals of a pose independent and of unit size.
        joints: from 1.
    """
    score, weight = _scores(
        whitener @ by_every_joint(at, poses),
        -(whitener @ left[:, :, None])[:, :, 0],
        poses.measured.components_seen,
    )
    states, arm = poses.states, at.arm
    error_rad = np.zeros_like(score)
    for term in at.model.terms:
        if isinstance(term, JointErrorMap):
            values = at.x[at.model.columns_of(term)]
            error_rad[:, term.joint - 1] += term.shift(states, values)[:, 0]
    torque_Nm = np.where(
        states.tau_Nm.std(axis=0) > _LEAST_LOADED * arm.rated_Nm(np.abs(states.tau_Nm).max(axis=0)),
        states.tau_Nm,
        np.nan,
    )
    campaign = np.zeros(len(poses), int) if states.campaign is None else states.campaign
    found: list[list[JointSeries]] = []
    for j in range(score.shape[1]):
        whole = JointSeries(
            q_rad=states.q_rad[:, j],
            left_rad=score[:, j] / weight[:, j],
            weight=weight[:, j],
            error_rad=error_rad[:, j],
            torque_Nm=torque_Nm[:, j],
            moved=states.since_before[:, j] != 0.0,
        )
        here = [whole.where(campaign == number) for number in np.unique(campaign)]
        found.append(here if j + 1 in joints else [])
    return found


def _scores(screws: Array, left: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return score and weight of each joint in each pose, (P, n): their ratio is its residual.

    Args:
        screws: (P, b, n) how whitened components follow the joints.
        left: (P, b) whitened components measured less predicted.
        seen: (P, b) which components were seen.
    """
    count = max(int(seen.sum()), 1)
    joint, reading = np.full(screws.shape[2], _JOINT_RAD**2), 1.0
    across = screws.transpose(0, 2, 1)
    unit = np.eye(left.shape[1])
    for _ in range(_ROUNDS):
        precision = np.linalg.inv((screws * joint) @ across + reading * unit)
        pulled = (precision @ left[:, :, None])[:, :, 0]
        score = (across @ pulled[:, :, None])[:, :, 0]
        weight = np.einsum("pij,pik,pkj->pj", screws, precision, screws, optimize=True)
        joint = np.mean((joint * score) ** 2 + joint - joint**2 * weight, axis=0)
        alone = np.diagonal(precision, axis1=1, axis2=2)
        reading = float(
            np.sum(seen * ((reading * pulled) ** 2 + reading - reading**2 * alone)) / count
        )
    usual = np.sum(score**2, axis=0) / np.maximum(np.sum(weight, axis=0), 1e-300)
    weight = np.maximum(weight, 1e-12 * weight.max())
    return score / usual, weight / usual
