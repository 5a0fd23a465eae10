"""Measured poses with the states of the arm, in one form for all instruments; means of repeats."""

from __future__ import annotations

import hashlib
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
#: Fields of states whose means are taken; all readings of a group have the same others.
_AVERAGED = (
    *("q_rad", "tau_Nm", "arrival", "temperature_C", "time_s", "moved", "move_share", "move_end_m"),
)


#: Joint positions [rad, m] and distances [m] that differ by less are the same reading (computing).
_SAME = 1e-7


@dataclass(frozen=True)
class JointLog:
    """Uncertainty of joint positions and torques in P configurations, by their log."""

    q_u: Array  # (P, n) standard uncertainty of the mean position [rad, m], nan where unknown
    tau_u: Array  # (P, n) standard uncertainty of the mean torque [N m, N], nan where unknown
    samples: NDArray[np.int64]  # (P,) samples averaged; 0 where there is no log
    # (P, n) the part of q_u by rounding, which all samples at rest share; None where none is known
    q_u_rounded: Array | None = None

    @property
    def q_u_stated(self) -> Array:
        """Return the uncertainty of positions that a file states, (P, n); 0 where it states none.

        That of a dwell of several samples is their scatter, which repeats show as well, but for
        their rounding.
        """
        stated = np.where(self.samples[:, None] <= 1, np.nan_to_num(self.q_u), 0.0)
        return stated if self.q_u_rounded is None else np.maximum(stated, self.q_u_rounded)

    @classmethod
    def joined(cls, logs: Sequence[JointLog]) -> JointLog:
        """Return the logs of several campaigns as one."""
        rounded = None
        if any(log.q_u_rounded is not None for log in logs):
            exact = (np.zeros_like(log.q_u) for log in logs)
            parts = zip(logs, exact, strict=True)
            rounded = np.concatenate(
                [none if log.q_u_rounded is None else log.q_u_rounded for log, none in parts]
            )
        return cls(
            q_u=np.concatenate([log.q_u for log in logs]),
            tau_u=np.concatenate([log.tau_u for log in logs]),
            samples=np.concatenate([log.samples for log in logs]),
            q_u_rounded=rounded,
        )

    def take(self, rows: Rows) -> JointLog:
        """Return some of the configurations."""
        return take_rows(self, rows)


@dataclass(frozen=True)
class Observations(Generic[M_co]):
    """P measured poses; `Observations[Pose]` where position and orientation were measured."""

    pose: NDArray[np.str_]  # (P,) labels; poses of one label have one command
    states: PoseStates
    measured: M_co  # measurements of the instrument
    kind: NDArray[np.str_]  # (P,) one of `KINDS`
    repeat: NDArray[np.int64]  # (P,) number of the repeat; of averages that of the first reading
    readings: NDArray[np.int64]  # (P,) number of readings averaged in each row
    # None where not known; of averages what the file states of joint positions, else None
    log: JointLog | None = None
    # targets on the base, whose motion is taken out of `measured`; None without, and for averages
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
        """Return these poses."""
        return take_rows(self, rows)

    def thinned_by_pose(self, most: int) -> Observations[M_co]:
        """Return all rows of every n-th pose, with n such that about `most` rows are left."""
        _, label = np.unique(self.pose, return_inverse=True)
        step = -(-len(self) // most)
        return self.take(np.flatnonzero(label % step == 0)) if step > 1 else self

    def by_campaign(self) -> dict[str, Observations]:
        """Return the observations of every campaign of a group by its name; empty without one."""
        campaign = self.states.campaign
        if campaign is None:
            return {}
        by_name: dict[str, Observations] = {}
        for number, (name, part) in enumerate(self.measured.campaigns):
            rows: Observations = take_rows(self, campaign == number, "measured")
            states = replace(rows.states, campaign=None)
            by_name[name] = replace(rows, states=states, measured=part, base=None)
        return by_name

    def of_kind(self, kind: str) -> Observations[M_co]:
        """Return the poses of one kind, ordered by pose, load and time."""
        rows = np.flatnonzero(self.kind == kind)
        states = self.states
        order = np.lexsort((states.time_s[rows], states.load_N[rows], self.pose[rows]))
        return self.take(rows[order])

    def turned(self, R_ee_target: Array) -> Observations[M_co]:
        """Return the observations with orientations of the end-effector, not of the target."""
        return replace(self, measured=self.measured.turned(R_ee_target))

    def with_states(self, states: PoseStates) -> Observations[M_co]:
        """Return the same measurements with other states of the arm."""
        return replace(self, states=states)

    def with_measured(self, **changes: Any) -> Observations[M_co]:
        """Return the same poses with some fields of the measurements replaced."""
        return replace(self, measured=replace(self.measured, **changes))


def average_repeats(single: Observations[M], cuts_s: Sequence[float] = ()) -> Observations[M]:
    """Average the readings of the same pose and load.

    Args:
        cuts_s: times that divide the campaign into parts, which are averaged separately.

    Returns:
        One row for each pose, load and part, in this order: means of joints, torques, arrivals
        (between -1 and 1 for a joint that arrived from both sides), temperature, time and
        measurements, with the covariance of a mean of independent readings.
    """
    return average_groups(single, reading_groups(single, cuts_s))


def average_groups(single: Observations[M], code: Index) -> Observations[M]:
    """Average the readings of each group, of one pose and load; see `average_repeats`.

    Args:
        code: (P,) number of each reading's group; every number from 0 on occurs.
    """
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    states = replace(single.states, static_loads=None, seen=None)
    means: dict[str, Any] = {
        name: group_means(getattr(states, name), code)
        for name in _AVERAGED
        if getattr(states, name) is not None
    }
    return Observations(
        pose=single.pose[first],
        states=replace(states.take(first), **means),
        measured=single.measured.averaged(code),
        kind=single.kind[first],
        repeat=single.repeat[first],
        readings=count,
        log=_stated_of_averages(single.log, code),
    )


def _stated_of_averages(log: JointLog | None, code: Index) -> JointLog | None:
    """Return the stated uncertainties of averages: repeats at one position have the same error."""
    if log is None or not log.q_u_stated.any():
        return None
    q_u = group_means(log.q_u_stated, code)
    return JointLog(q_u, np.full_like(q_u, np.nan), np.zeros(len(q_u), dtype=np.int64))


def poses_of(
    every: Observations,
    kind: str = "grid",
    *,
    average: bool = True,
    covariance: Literal["repeats", "instrument"] = "repeats",
) -> Observations[Pose]:
    """Return the poses of one kind as the paper's model takes them, ordered by pose and load.

    Args:
        average: whether repeats of the same pose and load are averaged; see `average_repeats`.
        covariance: its source. `repeats`: the scatter of repeats, pooled over all poses and loads
            of this kind along the end-effector's axes, or that of the instrument where there are
            too few repeats; `instrument`: its stated uncertainty, propagated. Either is divided by
            the number of readings averaged.

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
    """Return averaged poses with a covariance estimated from the scatter of single readings.

    It is pooled over poses and loads along the end-effector's axes, in which the noise of balls,
    tool and wrist is the same in every pose. With too few repeats it is not changed.
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
    """Return the row of every reading in `average_repeats`, (P,)."""
    _, label = np.unique(single.pose, return_inverse=True)
    loads, load = np.unique(single.states.load_N, return_inverse=True)
    part = part_of(single.states.time_s, cuts_s)
    code = (label * len(loads) + load) * (len(cuts_s) + 1) + part
    return np.asarray(np.unique(code, return_inverse=True)[1], dtype=np.intp)


def reading_checksums(poses: Observations) -> tuple[str, ...]:
    """Return a checksum of the averaged readings under each load, of a group of each campaign.

    It is of joint positions and of distances of the measured places from their centre: the frame
    of the instrument, times and stated uncertainties do not change it.
    """
    checksums = []
    for part in poses.by_campaign().values() or [poses]:
        for load_N in np.unique(part.states.load_N):
            rows = part.states.load_N == load_N
            places_m = part.measured.places_m[rows]
            seen_m = places_m[np.isfinite(places_m).all(axis=2)]
            distance_m = np.linalg.norm(seen_m - seen_m.sum(axis=0) / max(len(seen_m), 1), axis=1)
            numbers = np.concatenate([np.ravel(part.states.q_rad[rows]), distance_m])
            rounded = np.rint(numbers / _SAME).astype("<i8")
            checksums.append(hashlib.sha256(rounded.tobytes()).hexdigest()[:32])
    return tuple(checksums)


def part_of(time_s: Array, cuts_s: Sequence[float]) -> Index:
    """Return the part of a campaign that each time is in, from 0, (P,)."""
    return np.searchsorted(np.sort(np.asarray(cuts_s, dtype=float)), time_s, side="left")
