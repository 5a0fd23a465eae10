"""Steps in the zeros of joints: steps that a motor lost, a belt that jumped, a joint mastered anew.

Every joint may have steps of its own, each at its own row of the log. The set of steps is found one
by one by log evidence, and held against steps of the base and against other changes at a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array, Index
from pa10cal.discovery import jacobians
from pa10cal.discovery.changed import (
    WORDS,
    Step,
    StepRows,
    change_columns,
    gradual_courses,
    kinds_of_change,
    nats_needed,
)
from pa10cal.discovery.log_faults import DiagnosedFault
from pa10cal.discovery.nuisances import MovedZeros, Nuisance, between_rows
from pa10cal.discovery.pose_columns import by_pose_and_time
from pa10cal.discovery.rules import CHANGE, MOTION
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    may_show_changes,
    measured_again,
    spread_over_time,
    step_thresholds,
)
from pa10cal.terms.effects.effect import Effect

_CAUSES = "its motor lost steps, its belt jumped, or it was mastered anew"
#: A step from the first row on: columns that hold steps of their own count as they are.
_FROM_FIRST = np.array([0])


class JointStep(NamedTuple):
    """A step in the zero of one joint."""

    joint: int  # from 1
    time_s: float  # its most likely time
    before_s: float  # time of the last reading that is surely before it
    after_s: float  # time of the first reading that is surely after it
    rivals: tuple[str, ...]  # other explanations that fit as well, in words


@dataclass(frozen=True, eq=False)
class JointSteps(Nuisance):
    """Steps in the zeros of joints, each from a time on."""

    steps: tuple[JointStep, ...]  # in order of time
    scale: float  # prior standard deviation of each amount, in units of `CHANGE.size`
    amounts: Array  # (k,) in units of `scale`
    covariance: Array  # (k, k) of the amounts

    @property
    @override
    def sizes(self) -> Array:
        return np.full(len(self.steps), self.scale)

    @override
    def columns(self, at: FittedModel, poses: Observations) -> Array:
        return self.scale * _columns([(each.joint, each.time_s) for each in self.steps], at, poses)

    @property
    def moved(self) -> MovedZeros:
        """Return by how much the zeros moved, and when."""
        unit = CHANGE.size * self.scale
        return MovedZeros(
            joints=tuple(step.joint for step in self.steps),
            times_s=tuple(step.time_s for step in self.steps),
            between_s=np.array([(step.before_s, step.after_s) for step in self.steps]),
            moved=unit * self.amounts,
            covariance=unit**2 * self.covariance,
        )

    def faults(self, at: FittedModel, poses: Observations) -> tuple[DiagnosedFault, ...]:
        """Return a fault of the log for each step."""
        slides = at.arm.prismatic
        amounts = (1e3 * self.moved.moved).tolist()
        return tuple(
            _fault(step, amount, "mm" if slides[step.joint - 1] else "mrad", poses)
            for step, amount in zip(self.steps, amounts, strict=True)
        )


def _fault(step: JointStep, amount: float, unit: str, poses: Observations) -> DiagnosedFault:
    what = f"the zero of joint {step.joint} moved by {amount:+.3g} {unit} from there on"
    if step.rivals:
        what += f"; {' or '.join(step.rivals)} would explain it as well"
    return DiagnosedFault(
        kind="step_in_time",
        where=between_rows(poses, step.before_s, step.after_s),
        what=what,
        remedy=f"home joint {step.joint} ({_CAUSES}), and calibrate the readings before and after "
        "as two campaigns",
        remedy_if_corrected="the model is of the arm since then, the readings before it corrected "
        f"by it; if joint {step.joint} is homed again ({_CAUSES}), calibrate anew",
    )


def likely_joint_steps(at: FittedModel, poses: Observations, whitener: Array) -> JointSteps | None:
    """Return steps in zeros of joints that gain evidence, before they are held against others.

    A model that was fitted to readings on both sides has taken up a part of each.

    Args:
        poses: P readings in order of time.
        whitener: (P, b, b) of the noise of readings.
    """
    if not may_show_changes(poses):
        return None
    chosen = _chosen(at, poses, whitener)
    if not chosen:
        return None
    rows, every = StepRows(at, poses, whitener), _columns(chosen, at, poses)
    scale = rows.best(every, _FROM_FIRST).scale
    steps = tuple(JointStep(joint, time_s, time_s, time_s, ()) for joint, time_s in chosen)
    return JointSteps(steps, scale, *rows.amounts_known(every, scale, 0))


def joint_steps_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    of_readings: Array,
    effects: Sequence[Effect],
    *,
    logged: bool,
) -> JointSteps | None:
    """Return the steps in zeros of joints; None for none.

    None is found where no time was recorded, where poses are in the order of a scan, or where a
    joint or the load passes from one side to the other at the row of a step.

    Args:
        at: the fitted model.
        poses: P poses in order of time.
        whitener: (P, b, b) of the noise of readings and of the error that joints make in a pose.
        of_readings: (P, b, b) of the noise of readings alone.
        effects: what depends on the pose or on time, beside which steps are judged.
        logged: whether torques were logged.
    """
    if not may_show_changes(poses):
        return None
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener, of_readings = poses.take(shown), whitener[shown], of_readings[shown]
    chosen = _chosen(at, poses, whitener)
    if not chosen:
        return None
    slides = at.arm.prismatic
    if any(
        any(step_thresholds(poses.states, time_s, slides)) and not _repeated_across(poses, time_s)
        for _, time_s in chosen
    ):
        return None
    every = _columns(chosen, at, poses)
    unchanged = StepRows(at, poses, whitener)
    together = unchanged.best(every, _FROM_FIRST)
    of_others = _of_others(at, poses, whitener, len(chosen), logged=logged)
    if together.gain < of_others + CHANGE.better_nats:
        return None
    smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    joints = [joint for joint, _ in chosen]
    steps = _Steps(np.array(joints), every, at, poses, of_readings, smooth)
    if not (steps.leave_little() and all(map(steps.are_sudden, set(joints)))):
        return None
    found = []
    for k, step in enumerate(chosen):
        others = together.scale * np.delete(every, k, axis=2)
        rows = StepRows(at, poses, whitener, others)
        found.append(_described(*step, rows, at, poses, logged=logged))
    known = unchanged.amounts_known(every, together.scale, 0)
    return JointSteps(tuple(found), together.scale, *known)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of k joints, to be held against errors that go with the pose or come on gradually."""

    joints: Index  # (k,) from 1
    columns: Array  # (P, b, k)
    at: FittedModel
    poses: Observations
    whitener: Array  # (P, b, b) of the noise of readings alone: steps are errors of joints, too
    smooth: Sequence[Array]  # columns (P, b, c) of all that depends on the pose or on time

    def leave_little(self) -> bool:
        """Return whether they leave little of the squared error, alone and beside `smooth`.

        Of all components, or of positions: orientations may be all noise. Where poses are measured
        again, also of what is beyond the stated noise: their differences show what a step is.
        """
        again = measured_again(self.poses)
        positions = np.isin(np.arange(self.whitener.shape[2]), self.poses.measured.position_columns)

        def little(whitener: Array, beside: Sequence[Array]) -> bool:
            rows = StepRows(self.at, self.poses, whitener, *beside)
            step = rows.best(self.columns, _FROM_FIRST)
            return step.remaining <= CHANGE.most_left_share or (again and rows.leaves_little(step))

        return all(
            any(little(each, beside) for each in (self.whitener, self.whitener * positions))
            for beside in ((), self.smooth)
        )

    def are_sudden(self, joint: int) -> bool:
        """Return whether those of a joint gain beside an error of it that comes on gradually."""
        own = self.joints == joint
        by_joint = CHANGE.size * jacobians.by_joints(self.at, self.poses, (joint,))
        courses = (*gradual_courses(self.poses), *_settling(self.poses))
        gradual = [CHANGE.static_sizes * by_joint * course for course in courses]
        others = CHANGE.static_sizes * self.columns[:, :, ~own]
        rows = StepRows(self.at, self.poses, self.whitener, *self.smooth, *gradual, others)
        gain = rows.best(self.columns[:, :, own], _FROM_FIRST).gain
        return gain >= nats_needed(len(self.poses) * self.at.arm.n)


def _repeated_across(poses: Observations, time_s: float) -> bool:
    """Return whether poses were measured with one load on both sides of a time, which tell more."""
    states, (_, pose) = poses.states, np.unique(poses.pose, return_inverse=True)
    labels = np.column_stack([pose, states.load_N])
    alike = np.unique(labels, axis=0, return_inverse=True)[1].ravel()
    later = states.time_s > time_s
    return len(np.intersect1d(alike[later], alike[~later])) >= CHANGE.least_across


def _settling(poses: Observations) -> list[Array]:
    """Return courses that settle after the first reading, as of an arm that warms up, (P, 1, 1)."""
    time_s = poses.states.time_s
    part = ((time_s - time_s[0]) / (time_s[-1] - time_s[0]))[:, None, None]
    return [np.exp(-part / of_span) for of_span in CHANGE.settling]


def _columns(steps: Sequence[tuple[int, float]], at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of predicted less measured components by steps, (P, b, k)."""
    columns = jacobians.by_joints(at, poses, [joint for joint, _ in steps])
    after = poses.states.time_s[:, None] > np.array([time_s for _, time_s in steps])
    return CHANGE.size * columns * after[:, None, :]


def _chosen(at: FittedModel, poses: Observations, whitener: Array) -> list[tuple[int, float]]:
    """Return the joints and times of steps that gain enough one after the other, by time."""
    joints, time_s = range(1, at.arm.n + 1), poses.states.time_s
    middles_s = 0.5 * (time_s + np.roll(time_s, 1))  # between each row and the one before
    of_each = {joint: CHANGE.size * jacobians.by_joints(at, poses, (joint,)) for joint in joints}
    found: list[tuple[int, float]] = []

    def best(beside: list[tuple[int, float]], among: Sequence[int]) -> tuple[int, Step]:
        others = [CHANGE.static_sizes * _columns(beside, at, poses)] if beside else []
        rows = StepRows(at, poses, whitener, *others)
        steps = {joint: rows.best(of_each[joint]) for joint in among}
        joint = max(steps, key=lambda each: steps[each].gain)
        return joint, steps[joint]

    while len(found) < MOTION.most_jumps:
        joint, step = best(found, joints)
        if step.gain < nats_needed(len(poses) * at.arm.n):
            break
        found.append((joint, float(middles_s[step.row])))
        for k, (known, _) in enumerate(found[:-1]):  # those found before may be at other rows
            _, again = best(found[:k] + found[k + 1 :], [known])
            found[k] = known, float(middles_s[again.row])
    return sorted(found, key=lambda step: step[1])


def _of_others(
    at: FittedModel, poses: Observations, whitener: Array, count: int, *, logged: bool
) -> float:
    """Return the most log evidence of as many steps of the base, or of another change at a row."""
    rows, kinds = StepRows(at, poses, whitener), kinds_of_change(at, poses, logged=logged)
    best = max(rows.best(change_columns(*kind, at, poses)).gain for kind in kinds)
    columns = change_columns("base", 0, at, poses)
    of_bases, beside = 0.0, list[Array]()
    for _ in range(count):
        step = StepRows(at, poses, whitener, *beside).best(columns)
        if step.gain <= 0.0:
            break
        of_bases += step.gain
        after = np.arange(len(poses)) >= step.row
        beside.append(step.scale * columns * after[:, None, None])
    return max(best, of_bases)


def _described(
    joint: int, time_s: float, rows: StepRows, at: FittedModel, poses: Observations, *, logged: bool
) -> JointStep:
    """Return a step with what else explains it, by rows beside the other steps."""
    columns = CHANGE.size * jacobians.by_joints(at, poses, (joint,))
    row = np.searchsorted(poses.states.time_s, [time_s])
    step = rows.best(columns, row)
    when = rows.when(columns, step)
    rivals: dict[str, None] = {}
    for kind, target in kinds_of_change(at, poses, logged=logged):
        of_kind = change_columns(kind, target, at, poses)
        as_well = rows.does_as_well(kind, rows.best(of_kind, row), step)
        if as_well or (kind != "model" and _imitates(of_kind, columns)):
            rivals[WORDS[kind]] = None
    return JointStep(joint, time_s, when.before_s, when.after_s, tuple(rivals))


def _imitates(others: Array, column: Array) -> bool:
    """Return whether columns (P, b, k) can be another one (P, b, 1): a turn about its own axis."""
    by, wanted = others.reshape(-1, others.shape[2]), column.ravel()
    left = wanted - by @ np.linalg.lstsq(by, wanted, rcond=None)[0]
    return bool(np.linalg.norm(left) < CHANGE.same_squares * np.linalg.norm(wanted))
