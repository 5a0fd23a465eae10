"""Repeats of the same pose and load: their mean, and how much single readings scatter about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.errors import RawDataError
from pa10cal.observe.instrument import Instrument, group_means
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

M = TypeVar("M", bound=Instrument)

#: Degrees of freedom below which the scatter of repeats says too little about six components.
LEAST_DOF = 12


@dataclass(frozen=True)
class RepeatScatter:
    """Scatter of single readings of a pose about their mean, pooled over poses and loads."""

    # (6, 6) covariance of one reading: position [m] and small rotation [rad], both along the
    # end-effector's own axes
    cov_ee: Array
    dof: int  # readings less averaged poses; 0 where nothing was repeated

    @property
    def is_known(self) -> bool:
        """Whether there were enough repeats."""
        return self.dof >= LEAST_DOF


def average_repeats(single: Observations[M], cuts_s: Sequence[float] = ()) -> Observations[M]:
    """Average the readings of the same pose and load.

    Args:
        single: one reading a row; covariances are those of the reading.
        cuts_s: times that part the campaign: readings on either side are not averaged.

    Returns:
        One row for each pose and load, ordered by them: means of joints, torques, arrivals (a joint
        that arrived from either side has one between -1 and 1), temperature and time, and of what
        was measured, with the covariance of that mean for independent readings.
    """
    return average_groups(single, reading_groups(single, cuts_s))


def average_groups(single: Observations[M], code: Index) -> Observations[M]:
    """Average the readings of each group.

    Args:
        single: one reading a row; readings of a group are of one pose and load.
        code: (P,) number of each reading's group, from 0, none omitted.

    Returns:
        One row a group, in the order of their numbers; see `average_repeats`.
    """
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    return Observations(
        pose=single.pose[first],
        states=average_states(single.states, code),
        measured=single.measured.averaged(code),
        kind=single.kind[first],
        repeat=single.repeat[first],
        readings=count,
    )


def average_states(states: PoseStates, code: Index) -> PoseStates:
    """Average the states of each group of readings; see `average_repeats` and `average_groups`."""
    first = np.unique(code, return_index=True)[1]
    return PoseStates(
        q_rad=group_means(states.q_rad, code),
        tau_Nm=group_means(states.tau_Nm, code),
        arrival=group_means(states.arrival, code),
        load_N=states.load_N[first],
        temperature_C=group_means(states.temperature_C, code),
        time_s=group_means(states.time_s, code),
        campaign=None if states.campaign is None else states.campaign[first],
        moved=None if states.moved is None else group_means(states.moved, code),
        timed=None if states.timed is None else states.timed[first],
    )


def poses_of(
    every: Observations,
    kind: str = "grid",
    *,
    average: bool = True,
    covariance: Literal["repeats", "instrument"] = "repeats",
) -> Observations[Pose]:
    """Return the poses of one kind as the paper's model takes them, ordered by pose and load.

    Args:
        every: single readings of a campaign.
        kind: `grid`, `holdout`, `line_x` or `line_y`.
        average: whether repeats of the same pose and load become one row (see `average_repeats`).
        covariance: where it comes from. `repeats`: the scatter of repeats, pooled over all poses
            and loads of this kind along the end-effector's axes (the instrument's where too little
            is repeated); `instrument`: its stated uncertainty, propagated. Either is divided by the
            readings averaged.

    Returns:
        P poses; none when there are no such rows.

    Raises:
        RawDataError: when the instrument measures no poses.
    """
    single = measured_as_poses(every).of_kind(kind)
    poses = average_repeats(single) if average else single
    if covariance == "instrument":
        return poses
    scatter = repeat_scatter(single)
    return with_scatter(poses, scatter) if scatter.is_known else poses


def measured_as_poses(observations: Observations) -> Observations[Pose]:
    """Return observations of an instrument that measures position and attitude.

    Raises:
        RawDataError: when it measures less.
    """
    if not observations.measured.measures_pose:
        raise RawDataError(
            "the instrument does not measure the pose of the end-effector",
            where=f"instrument.kind of the campaign: {', '.join(observations.measured.kinds)}",
            allowed="an instrument that measures position and attitude",
            remedy="calibrate this campaign with its general model",
        )
    return cast("Observations[Pose]", observations)


def repeat_scatter(single: Observations[Pose]) -> RepeatScatter:
    """Pool the scatter of readings about the mean of their pose and load.

    Deviations are taken along the end-effector's axes, in which the noise of balls, tool and wrist
    is the same in every pose.
    """
    code = reading_groups(single)
    T = single.measured.T_instr_target
    mean = average_repeats(single).measured.T_instr_target[code]
    R_ee_instr = np.swapaxes(mean[:, :3, :3], 1, 2)
    shift = R_ee_instr @ (T[:, :3, 3] - mean[:, :3, 3])[..., None]
    turn = Rotation.from_matrix(R_ee_instr @ T[:, :3, :3]).as_rotvec()
    deviation = np.hstack([shift[..., 0], turn])
    dof = len(single) - len(np.unique(code))
    return RepeatScatter(deviation.T @ deviation / max(dof, 1), dof)


def with_scatter(poses: Observations[Pose], scatter: RepeatScatter) -> Observations[Pose]:
    """Give averaged poses the covariance that the scatter of single readings implies."""
    R = poses.measured.T_instr_target[:, :3, :3]
    turn = np.zeros((len(poses), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    covariance = turn @ scatter.cov_ee @ np.swapaxes(turn, 1, 2)
    return poses.with_measured(cov=covariance / poses.readings[:, None, None])


def reading_groups(single: Observations, cuts_s: Sequence[float] = ()) -> Index:
    """Return, for every reading, its row in `average_repeats`: by pose label, load, then part."""
    _, label = np.unique(single.pose, return_inverse=True)
    loads, load = np.unique(single.states.load_N, return_inverse=True)
    part = part_of(single.states.time_s, cuts_s)
    code = (label * len(loads) + load) * (len(cuts_s) + 1) + part
    return np.asarray(np.unique(code, return_inverse=True)[1], dtype=np.intp)


def part_of(time_s: Array, cuts_s: Sequence[float]) -> Index:
    """Return in which part of a campaign each time lies, from 0, (P,)."""
    return np.searchsorted(np.sort(np.asarray(cuts_s, dtype=float)), time_s, side="left")
