"""Measured poses, whatever the instrument: the one form in which all that follows takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typing_extensions import TypeVar

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Rows, take_rows
from pa10cal.errors import RawDataError
from pa10cal.observe.base_targets import BaseTargets
from pa10cal.observe.instrument import Instrument, group_means
from pa10cal.observe.pose import Pose
from pa10cal.rules import READINGS

M = TypeVar("M", bound=Instrument)
M_co = TypeVar("M_co", bound=Instrument, default=Instrument, covariant=True)

#: Kinds of poses: straight moves along the base's axes, poses to fit, and poses held out.
KINDS = ("line_x", "line_y", "grid", "holdout")


@dataclass(frozen=True)
class JointLog:
    """How the joints of P configurations were read."""

    q_u: Array  # (P, n) standard uncertainty of the mean position [rad, m], nan where unknown
    tau_u: Array  # (P, n) standard uncertainty of the mean torque [N m, N], nan where unknown
    samples: NDArray[np.int64]  # (P,) samples averaged; 0 where there is no log

    def take(self, rows: Rows) -> JointLog:
        """Return some of the configurations."""
        return take_rows(self, rows)


@dataclass(frozen=True)
class Observations(Generic[M_co]):
    """P measured poses; `Observations[Pose]` where position and orientation were measured."""

    pose: NDArray[np.str_]  # (P,) labels; the same label is the same command
    states: PoseStates  # state of the arm in each pose
    measured: M_co  # what the instrument measured in each
    kind: NDArray[np.str_]  # (P,) one of `KINDS`
    repeat: NDArray[np.int64]  # (P,) number of the repeat; of averages that of the first reading
    readings: NDArray[np.int64]  # (P,) readings averaged into each row
    # how the joints were read; None where that is not known, as of averages
    log: JointLog | None = None
    # targets on the base as they were read, and their motion, which `measured` is without; None
    # where there are none, and of averages
    base: BaseTargets | None = None

    @staticmethod
    def single(
        pose: NDArray[np.str_], states: PoseStates, measured: M, kind: str = "grid"
    ) -> Observations[M]:
        """Return single readings, all of one kind."""
        ones = np.ones(len(pose), dtype=np.int64)
        return Observations(pose, states, measured, np.full(len(pose), kind), ones, ones)

    def __len__(self) -> int:
        return len(self.pose)

    def take(self, rows: Rows) -> Observations[M_co]:
        """Return some of the poses."""
        return take_rows(self, rows)

    def thinned_by_pose(self, most: int) -> Observations[M_co]:
        """Return every n-th pose, with all its rows: all poses where there are few rows enough."""
        _, label = np.unique(self.pose, return_inverse=True)
        step = -(-len(self) // most)
        return self.take(np.flatnonzero(label % step == 0)) if step > 1 else self

    def by_campaign(self) -> dict[str, Observations]:
        """Return the poses of every campaign of a group by its name, each as if it were alone."""
        campaign = self.states.campaign
        if campaign is None:
            return {}
        found: dict[str, Observations] = {}
        for number, (name, part) in enumerate(self.measured.campaigns):
            own: Observations = take_rows(self, campaign == number, "measured")
            states = replace(own.states, campaign=None)
            found[name] = replace(own, states=states, measured=part, base=None)
        return found

    def of_kind(self, kind: str) -> Observations[M_co]:
        """Return the poses of one kind, ordered by pose, load and time."""
        rows = np.flatnonzero(self.kind == kind)
        states = self.states
        order = np.lexsort((states.time_s[rows], states.load_N[rows], self.pose[rows]))
        return self.take(rows[order])

    def turned(self, R_ee_target: Array) -> Observations[M_co]:
        """Return them with orientations of the end-effector in place of the target's."""
        return replace(self, measured=self.measured.turned(R_ee_target))

    def with_states(self, states: PoseStates) -> Observations[M_co]:
        """Return the same measurements with other states of the arm."""
        return replace(self, states=states)

    def with_measured(self, **changes: Any) -> Observations[M_co]:
        """Return the same poses with some fields of what was measured replaced."""
        return replace(self, measured=replace(self.measured, **changes))


# Repeats of the same pose and load: their mean, and how much single readings scatter about it.


def average_repeats(single: Observations[M], cuts_s: Sequence[float] = ()) -> Observations[M]:
    """Average the readings of the same pose and load, between times that part the campaign.

    Returns:
        One row for each pose and load, ordered by them: means of joints, torques, arrivals (a joint
        that arrived from either side has one between -1 and 1), temperature and time, and of what
        was measured, with the covariance of that mean for independent readings.
    """
    return average_groups(single, reading_groups(single, cuts_s))


def average_groups(single: Observations[M], code: Index) -> Observations[M]:
    """Average the readings of each group, of one pose and load; see `average_repeats`.

    Groups are numbered from 0, none omitted: that of each reading is in `code` (P,).
    """
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    states = single.states
    averaged = PoseStates(
        q_rad=group_means(states.q_rad, code),
        tau_Nm=group_means(states.tau_Nm, code),
        arrival=group_means(states.arrival, code),
        load_N=states.load_N[first],
        temperature_C=group_means(states.temperature_C, code),
        time_s=group_means(states.time_s, code),
        campaign=None if states.campaign is None else states.campaign[first],
        moved=None if states.moved is None else group_means(states.moved, code),
        move_share=None if states.move_share is None else group_means(states.move_share, code),
        move_end_m=None if states.move_end_m is None else group_means(states.move_end_m, code),
        timed=None if states.timed is None else states.timed[first],
    )
    return Observations(
        pose=single.pose[first],
        states=averaged,
        measured=single.measured.averaged(code),
        kind=single.kind[first],
        repeat=single.repeat[first],
        readings=count,
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
        average: whether repeats of the same pose and load become one row (see `average_repeats`).
        covariance: where it comes from. `repeats`: the scatter of repeats, pooled over all poses
            and loads of this kind along the end-effector's axes (the instrument's where too little
            is repeated); `instrument`: its stated uncertainty, propagated. Either is divided by the
            readings averaged.

    Raises:
        RawDataError: when the instrument measures no poses.
    """
    single = measured_as_poses(every).of_kind(kind)
    poses = average_repeats(single) if average else single
    return poses if covariance == "instrument" else with_repeat_scatter(poses, single)


def measured_as_poses(observations: Observations) -> Observations[Pose]:
    """Return observations of an instrument that measures position and orientation.

    Raises:
        RawDataError: when it measures less.
    """
    if not observations.measured.measures_pose:
        raise RawDataError(
            "the instrument does not measure the pose of the end-effector",
            where=f"instrument.kind of the campaign: {', '.join(observations.measured.kinds)}",
            allowed="an instrument that measures position and orientation",
            remedy="calibrate this campaign with its general model",
        )
    return cast("Observations[Pose]", observations)


def with_repeat_scatter(
    poses: Observations[Pose], single: Observations[Pose]
) -> Observations[Pose]:
    """Give averaged poses the covariance that the scatter of single readings implies.

    It is pooled over poses and loads along the end-effector's axes, in which the noise of balls,
    tool and wrist is the same in every pose. Where too little is repeated, poses stay as they are.
    """
    code = reading_groups(single)
    dof = len(single) - len(np.unique(code))
    if dof < READINGS.least_dof:
        return poses
    T = single.measured.T_instr_target
    mean = average_repeats(single).measured.T_instr_target[code]
    R_ee_instr = np.swapaxes(mean[:, :3, :3], 1, 2)
    shift = R_ee_instr @ (T[:, :3, 3] - mean[:, :3, 3])[..., None]
    turn = Rotation.from_matrix(R_ee_instr @ T[:, :3, :3], assume_valid=True).as_rotvec()
    deviation = np.hstack([shift[..., 0], turn])
    cov_ee = deviation.T @ deviation / dof
    R = poses.measured.T_instr_target[:, :3, :3]
    along = np.zeros((len(poses), 6, 6))
    along[:, :3, :3] = along[:, 3:, 3:] = R
    covariance = along @ cov_ee @ np.swapaxes(along, 1, 2)
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
