"""Repeats of the same pose and load: their mean, and how much single readings scatter about it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.state import PoseStates
from pa10cal.campaign.observations import PoseObservations

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Freedoms below which the scatter of repeats says too little about six components.
LEAST_DOF = 12


@dataclass(frozen=True)
class RepeatScatter:
    """Scatter of single readings of a pose about their mean, pooled over poses and loads.

    Attributes:
        cov_ee: (6, 6) covariance of one reading: position [m] and small rotation [rad], both along
            the end-effector's own axes.
        dof: readings less averaged poses; 0 where nothing was repeated.
    """

    cov_ee: Array
    dof: int

    @property
    def is_known(self) -> bool:
        """Whether there were enough repeats."""
        return self.dof >= LEAST_DOF


def average_repeats(single: PoseObservations) -> PoseObservations:
    """Average the readings of the same pose and load.

    Args:
        single: one reading a row; `cov_ee` is that of the reading.

    Returns:
        One row for each pose and load, ordered by them: means of joints, torques, arrivals (a joint
        that arrived from either side has one between -1 and 1), temperature, time and position, the
        chordal mean of the attitude, and the covariance of that mean for independent readings.
    """
    return average_groups(single, reading_groups(single))


def average_groups(single: PoseObservations, code: Index) -> PoseObservations:
    """Average the readings of each group.

    Args:
        single: one reading a row; readings of a group are of one pose and load.
        code: (P,) number of each reading's group, from 0, none left out.

    Returns:
        One row a group, in the order of their numbers; see `average_repeats`.
    """
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    T = group_means(single.T_instr_ee, code)
    U, _, Vt = np.linalg.svd(T[:, :3, :3])
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    T[:, :3, :3] = U @ Vt
    return PoseObservations(
        pose=single.pose[first],
        states=average_states(single.states, code),
        T_instr_ee=T,
        cov_ee=group_means(single.cov_ee, code) / count[:, None, None],
        by_apparatus=group_means(single.by_apparatus, code),
        repeats=count,
    )


def average_states(states: PoseStates, code: Index) -> PoseStates:
    """Average the states of each group of readings; see `average_repeats` and `average_groups`."""
    return PoseStates(
        q_rad=group_means(states.q_rad, code),
        tau_Nm=group_means(states.tau_Nm, code),
        arrival=group_means(states.arrival, code),
        load_N=states.load_N[np.unique(code, return_index=True)[1]],
        temperature_C=group_means(states.temperature_C, code),
        time_s=group_means(states.time_s, code),
    )


def group_means(values: Array, code: Index) -> Array:
    """Return the mean (G, ...) of the values (P, ...) of each group."""
    count = np.bincount(code)
    total = np.zeros((len(count), *values.shape[1:]))
    np.add.at(total, code, values)
    return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))


def repeat_scatter(single: PoseObservations) -> RepeatScatter:
    """Pool the scatter of readings about the mean of their pose and load.

    Deviations are taken along the end-effector's axes, in which the noise of balls, tool and wrist
    looks alike in every pose.
    """
    code = reading_groups(single)
    mean = average_repeats(single).T_instr_ee[code]
    R_ee_instr = np.swapaxes(mean[:, :3, :3], 1, 2)
    shift = R_ee_instr @ (single.T_instr_ee[:, :3, 3] - mean[:, :3, 3])[..., None]
    turn = Rotation.from_matrix(R_ee_instr @ single.T_instr_ee[:, :3, :3]).as_rotvec()
    deviation = np.hstack([shift[..., 0], turn])
    dof = len(single) - len(np.unique(code))
    return RepeatScatter(deviation.T @ deviation / max(dof, 1), dof)


def with_scatter(poses: PoseObservations, scatter: RepeatScatter) -> PoseObservations:
    """Give averaged poses the covariance that the scatter of single readings implies."""
    R = poses.T_instr_ee[:, :3, :3]
    turn = np.zeros((len(poses), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    covariance = turn @ scatter.cov_ee @ np.swapaxes(turn, 1, 2)
    return replace(poses, cov_ee=covariance / poses.repeats[:, None, None])


def reading_groups(single: PoseObservations) -> Index:
    """Return, for every reading, its row in `average_repeats`."""
    return same_pose_and_load(single.pose, single.states.load_N)


def same_pose_and_load(pose: NDArray[np.str_], load_N: Array) -> Index:
    """Return (P,) the group of each reading, numbered by pose label, then load."""
    _, label = np.unique(pose, return_inverse=True)
    loads, load = np.unique(load_N, return_inverse=True)
    _, code = np.unique(label * len(loads) + load, return_inverse=True)
    return np.asarray(code, dtype=np.intp)
