"""Errors that are fitted together with a model and belong neither to the robot nor to its effects.

Motion of the instrument or the base in the course of time, by sudden jumps and a random walk; a lag
of measured orientations behind the motion of the arm; zeros of joints that moved; and how these are
reported. All but the last have Gaussian priors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Self

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array, Mask, rms
from pa10cal.discovery import jacobians
from pa10cal.discovery.log_faults import DiagnosedFault
from pa10cal.discovery.rules import BLOCKS, MOTION
from pa10cal.discovery.target_wander import TargetWander
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import MovedZero, Unexplained
from pa10cal.results.number_text import plain_number
from pa10cal.terms.effects.context import CandidateContext, turning_joints


class Nuisance(ABC):
    """An error of the readings that is linear in k amounts."""

    amounts: Array | None  # (k,) most likely amounts, in units of `sizes`; None until fitted

    @property
    @abstractmethod
    def sizes(self) -> Array:
        """Return the prior standard deviation of each amount, (k,)."""

    @abstractmethod
    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return the derivative of predicted less measured components by the amounts, (P, b, k)."""

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return the contribution of the fitted amounts to these components, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)


@dataclass(frozen=True)
class Jump:
    """A sudden motion of the base against the instrument."""

    time_s: float  # its most likely time
    before_s: float  # time of the last reading that is surely before it
    after_s: float  # time of the first reading that is surely after it
    size_m: float = 0.0  # prior standard deviation of its shift along each axis
    turn: float = 0.0  # prior standard deviation of its turn, over that of its shift [rad/m]
    pause: bool = False  # whether it happened in a pause, suddenly or gradually


@dataclass(frozen=True, eq=False)
class Wander(Nuisance):
    """Motion of the base in the course of time, with a mean of zero over the readings.

    Each of c time courses, a unit step for every jump and then the waves of a walk, has six small
    motions of the base as amounts. The walk is a random walk in its leading Karhunen-Loève waves.
    """

    times_s: Array  # (P,) times of the readings, in order; the walk advances from one to the next
    jumps: tuple[Jump, ...]  # the most certain first
    # root mean square of the walk's shift that is expected along each axis; 0 without a walk
    walk_m: float = 0.0
    walk_turn: float = 0.0  # its expected turn over its shift [rad/m]
    amounts: Array | None = None  # (6 c,)
    # root mean squares over the readings of the whole motion, and of the walk alone
    rms_mm: tuple[float, float] = (0.0, 0.0)

    def courses(self, time_s: Array) -> Array:
        """Return the time courses at times (P,), (P, c)."""

        def not_centred(at_s: Array) -> Array:
            steps = [(at_s > jump.time_s).astype(float) for jump in self.jumps]
            part = np.interp(at_s, self.times_s, np.linspace(0.0, 1.0, len(self.times_s)))
            number = np.arange(1, MOTION.walk_waves + 1 if self.walk_m else 1)
            waves = np.sqrt(2.0) * np.cos(np.pi * np.outer(part, number))
            return np.column_stack([*steps, waves])

        return np.asarray(not_centred(time_s) - not_centred(self.times_s).mean(axis=0))

    @property
    @override
    def sizes(self) -> Array:
        parts = [sizes_of_motions(jump.size_m, jump.turn) for jump in self.jumps]
        if self.walk_m:
            waves = self.walk_m * np.sqrt(6.0) / (np.pi * np.arange(1, MOTION.walk_waves + 1))
            parts += [sizes_of_motions(size, self.walk_turn) for size in waves]
        return np.concatenate([np.zeros(0), *parts])

    @override
    def columns(self, at: FittedModel, poses: Observations) -> Array:
        courses = self.courses(poses.states.time_s)
        return motions_along(jacobians.by_base(at, poses), courses) * self.sizes

    @override
    def shift(self, at: FittedModel, poses: Observations) -> Array:
        motions = self.motions(poses.states.time_s)
        return np.asarray((jacobians.by_base(at, poses) @ motions[:, :, None])[:, :, 0])

    def motions(self, time_s: Array) -> Array:
        """Return the most likely motions of the base at times (P,), (P, 6) [m, rad]."""
        return self.courses(time_s) @ self.motions_by_course

    @property
    def motions_by_course(self) -> Array:
        """Return the most likely motions of each time course, (c, 6) [m, rad]."""
        assert self.amounts is not None
        return (self.amounts * self.sizes).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class AttitudeLag(Nuisance):
    """Rotation of orientations about each joint's axis, by the direction of its last move.

    It is as large after any move of a joint, and none where the joint stayed.
    """

    joints: tuple[int, ...]  # the joints with a lag, from 1
    campaigns: int = 1  # campaigns of a group, each with lags of its own
    amounts: Array | None = None  # (campaigns * joints,)

    @property
    @override
    def sizes(self) -> Array:
        return np.full(self.campaigns * len(self.joints), BLOCKS.lag_rad)

    @override
    def columns(self, at: FittedModel, poses: Observations) -> Array:
        by_lag = jacobians.by_joints(at, poses, self.joints)
        by_lag[:, poses.measured.position_columns] = 0.0
        move = poses.states.move_from_previous[:, [joint - 1 for joint in self.joints]]
        by_lag = by_lag * move[:, None, :] * BLOCKS.lag_rad
        campaign = poses.states.campaign
        if campaign is None:
            campaign = np.zeros(len(poses), dtype=np.intp)
        parts = [by_lag * (campaign == k)[:, None, None] for k in range(self.campaigns)]
        return np.concatenate(parts, axis=2)

    def unexplained(self, mean_error_mm: float) -> Unexplained:
        """Return the lag as an unexplained part of the error, with the remaining mean error."""
        assert self.amounts is not None
        lags_rad = np.abs(self.amounts * self.sizes).reshape(self.campaigns, -1).max(axis=0)
        joints = " and ".join(
            f"joint {joint} ({1e6 * lag_rad:.0f} µrad)"
            for joint, lag_rad in zip(self.joints, lags_rad.tolist(), strict=True)
            if lag_rad >= BLOCKS.told_share * lags_rad.max()
        )
        why = (
            f"orientations go with the way that {joints} came, and positions do not: it is the "
            "reader of orientations or its mount that lags, and no joint that stops short"
        )
        return Unexplained(
            of="instrument", form="attitude_lag", shared_error_mm=mean_error_mm, why=why
        )


def attitude_lag(context: CandidateContext, poses: Observations) -> AttitudeLag | None:
    """Return the lag to be fitted; None where joints were read back or no orientations measured."""
    measured = poses.measured
    has_orientations = measured.components_seen.shape[1] > len(measured.position_columns)
    if not (context.commanded and has_orientations):
        return None
    return AttitudeLag(turning_joints(context), max(len(context.campaigns), 1))


@dataclass(frozen=True, eq=False)
class TimeFindings:
    """What the readings show of motion in the course of time."""

    wander: Wander | None  # None where neither jumps nor a walk were found
    has_drift: bool  # whether an effect of time is significant besides
    # joints, rails and loads, in words, that the order of the poses follows: errors that depend on
    # them explain the motion as well
    rivals: tuple[str, ...] = ()
    rivals_mm: float = 0.0  # root mean square of the motion found before these were considered
    # errors of single readings that look like a walk; None where there are none
    of_targets: TargetWander | None = None


NO_MOTION = TimeFindings(None, has_drift=False)


def motions_along(by_motions: Array, courses: Array) -> Array:
    """Return columns (P, b, 6 c) of six motions (P, b, 6) in each time course (P, c)."""
    both = courses[:, None, :, None] * by_motions[:, :, None, :]
    return np.asarray(both.reshape(*by_motions.shape[:2], -1))


def sizes_of_motions(size_m: float, turn: float) -> Array:
    """Return the sizes (6,) of three shifts, and of three turns by the ratio `turn` [rad/m]."""
    return np.array([size_m] * 3 + [size_m * turn] * 3)


# How motion in time is reported: jumps as faults of the log, all else as unexplained.

_REMEDY = (
    "measure reference targets before and after, or calibrate the readings before and after as two "
    "campaigns"
)


def between_rows(readings: Observations, before_s: float, after_s: float) -> str:
    """Return in words between which readings something happened, by the times of these.

    The readings may end before it, or begin after it.
    """
    order = np.argsort(readings.states.time_s, kind="stable")
    time_s, pose = readings.states.time_s[order], readings.pose[order]

    def shown(k: int) -> str:
        return f"{pose[k]} at {time_s[k]:.10g} s"

    last = int(np.searchsorted(time_s, before_s, side="right")) - 1
    next_ = int(np.searchsorted(time_s, after_s))
    if last < 0:
        return f"before {shown(next_)}"
    if next_ == len(order):
        return f"after {shown(last)}"
    return f"between {shown(last)} and {shown(next_)}"


def steps_in_time(
    wander: Wander | None,
    at: FittedModel,
    readings: Observations,
    rivals: Mapping[float, tuple[str, ...]] = MappingProxyType({}),
    explained_s: Collection[float] = (),
) -> tuple[DiagnosedFault, ...]:
    """Return the jumps of the base as faults of the log.

    Args:
        rivals: other explanations of a jump, in words, by its time; such a jump is not certain.
        explained_s: times of jumps that are none, as something else explains them better.
    """
    if wander is None or not wander.jumps:
        return ()
    faults = []
    for jump, motion in zip(wander.jumps, wander.motions_by_course, strict=False):  # walks follow
        if jump.time_s in explained_s:
            continue
        size_mm = rms(
            position_error_mm(readings.measured, jacobians.by_base(at, readings) @ motion)
        )
        turn_mrad = 1e3 * float(np.linalg.norm(motion[3:]))
        size = f"{plain_number(size_mm, 2)} mm and {turn_mrad:.2f} mrad"
        what = f"the instrument or the base moved by {size}"
        if jump.pause:
            hours = (jump.after_s - jump.before_s) / 3600.0
            what += f" in a pause of {plain_number(hours, 2)} h, at once or in the course of it"
        others = rivals.get(jump.time_s, ())
        if others:
            what = f"something changed: {what}, or {' or '.join(others)} does as well"
        faults.append(
            DiagnosedFault(
                kind="step_in_time",
                where=between_rows(readings, jump.before_s, jump.after_s),
                what=what,
                remedy=_REMEDY,
                at_s=None if others else jump.time_s,
            )
        )
    return tuple(faults)


def motion_unexplained(
    in_time: TimeFindings, wander: Wander | None, floor_mm: float
) -> tuple[Unexplained, ...]:
    """Return what exceeds the noise floor of a walk, and of motion that joints explain as well."""
    found = []
    if wander is not None and wander.walk_m and wander.rms_mm[1] > floor_mm:
        hours = float(np.ptp(wander.times_s)) / 3600.0
        why = (
            f"the instrument or the base wandered by {plain_number(wander.rms_mm[1])} mm "
            f"(root mean square) in {plain_number(hours, 2)} h, neither steadily nor at once"
        )
        found.append(Unexplained(of="base", form=None, shared_error_mm=wander.rms_mm[1], why=why))
    if in_time.rivals and in_time.rivals_mm > floor_mm:
        why = (
            f"{plain_number(in_time.rivals_mm)} mm (root mean square) go with the order of the "
            f"poses, and with {' and '.join(in_time.rivals)} alike: the arm errs by that, or the "
            "instrument or the base moved; measure the poses in random order"
        )
        found.append(Unexplained(of=None, form=None, shared_error_mm=in_time.rivals_mm, why=why))
    return tuple(found)


# Zeros of joints that moved during a campaign. The arm as it is after the last step is that of the
# readings since. Those before tell of it as well once their joint positions are corrected; what the
# correction is uncertain by, the model is uncertain by, too.


@dataclass(frozen=True, eq=False)
class MovedZeros:
    """Steps in the zeros of joints, each at a time of its own."""

    joints: tuple[int, ...]  # (k,) from 1; a joint may have several
    times_s: tuple[float, ...]  # (k,) of the steps
    # (k, 2) of the last reading surely before each and of the first surely after it
    between_s: Array
    moved: Array  # (k,) by how much [rad, m]
    covariance: Array  # (k, k) of these

    @classmethod
    def of_record(cls, steps: Sequence[MovedZero]) -> Self:
        """Return them as they were written, without their covariance."""
        return cls(
            joints=tuple(step.joint for step in steps),
            times_s=tuple(step.at_s for step in steps),
            between_s=np.array([(step.before_s, step.after_s) for step in steps]),
            moved=np.array([step.moved for step in steps]),
            covariance=np.zeros((len(steps), len(steps))),
        )

    @property
    def record(self) -> tuple[MovedZero, ...]:
        """Return them as they are written."""
        steps = zip(
            self.joints, self.times_s, self.between_s.tolist(), self.moved.tolist(), strict=True
        )
        return tuple(
            MovedZero(joint=joint, at_s=at_s, before_s=before_s, after_s=after_s, moved=moved)
            for joint, at_s, (before_s, after_s), moved in steps
        )

    def corrected(self, observations: Observations) -> Observations:
        """Return readings with the joint positions that they would have since the last step."""
        states = observations.states
        q_rad = states.q_rad.copy()
        for joint, time_s, moved in zip(
            self.joints, self.times_s, self.moved.tolist(), strict=True
        ):
            q_rad[states.time_s <= time_s, joint - 1] -= moved
        return observations.with_states(replace(states, q_rad=q_rad))

    def of_unknown_side(self, readings: Observations) -> Mask:
        """Return which of P readings may be before or after a step, (P,): they judge no model."""
        time_s = readings.states.time_s[:, None]
        before_s, after_s = self.between_s.T
        return np.asarray(np.any((time_s > before_s) & (time_s < after_s), axis=1))

    def covariance_of_fit(self, at: FittedModel, poses: Observations, known: Array) -> Array:
        """Return the covariance (k, k) that the fit has by them, beside what it has by noise.

        Args:
            at: the model that was fitted to corrected readings.
            poses: these, complete.
            known: (k, k) the covariance of its unknowns by noise.
        """
        white = whitener_of(poses.measured.stated_covariance)
        before = poses.states.time_s[:, None] <= np.array(self.times_s)
        by_moved = -jacobians.by_joints(at, poses, self.joints) * before[:, None, :]
        by_unknowns = jacobians.residual_and_jacobian(at, poses)[1]
        # Along directions of unit uncertainty the precision is 1, of which readings give as much as
        # they show of a direction, and priors the rest. That of noise other than stated is as
        # much smaller as the direction shows that readings determine most.
        scale, turned = np.linalg.eigh(known)
        along = turned * np.sqrt(np.maximum(scale, 0.0))
        rows = (white @ (by_unknowns @ along)).reshape(-1, len(known))
        wanted = (white @ by_moved).reshape(len(rows), -1)
        taken = -along @ (rows.T @ wanted) / np.linalg.norm(rows, 2) ** 2
        return np.asarray(taken @ self.covariance @ taken.T)
