"""Signs, order and zeros of the joints: would much less error be left if they were changed?

By the nominal arm, and by quick calibrations of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.conventions import EXPECTED_M, STILL_WRONG, puts_right
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.own_columns import RotationColumns
from pa10cal.campaign.own_words import OwnWords
from pa10cal.errors import CalibrationError
from pa10cal.frame.hand_eye import LEVER_M
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.results.health import InputFinding


@dataclass(frozen=True)
class Asked:
    """What is looked at, and how its user calls it."""

    campaign: CampaignDescription
    arm: Arm
    options: CalibrationOptions
    words: OwnWords
    repeats_mm: float  # how far repeats scatter; 0 where that is not known

    @property
    def rotation(self) -> RotationColumns | None:
        """Return what campaign.yaml states of the columns of orientations."""
        columns = self.campaign.columns
        each = () if columns is None else (columns.poses, columns.readings)
        return next((one.rotation for one in each if one is not None and one.rotation), None)

    @property
    def signs(self) -> list[int]:
        """Return the signs of the joints that campaign.yaml states."""
        return list(self.campaign.joint_signs or [1] * self.arm.n)

    @property
    def offsets_deg(self) -> list[float]:
        """Return the offsets of the joints that campaign.yaml states."""
        return list(self.campaign.joint_offsets_deg or [0.0] * self.arm.n)

    def puts_right(self, states: PoseStates, grid: Observations, nominal_m: float) -> bool:
        """Return whether changed joints are right: for the nominal arm, and for a calibrated one.

        Args:
            states: what was read, with the joints changed.
            grid: the readings.
            nominal_m: misfit of the nominal arm with them.
        """
        if not puts_right(nominal_m, EXPECTED_M):
            return False
        payload = self.campaign.payload(self.arm)
        left_mm, noise_mm = self.calibrated_mm(grid.with_states(states), payload)
        # Of too few poses the nominal arm is all that judges.
        return left_mm == np.inf or puts_right(left_mm, 1e3 * EXPECTED_M, noise_mm)

    def calibrated_mm(self, grid: Observations, payload: Payload | None) -> tuple[float, float]:
        """Return the rms position error of a calibration, and the noise stated or found."""
        try:
            found = _calibrated(self.arm, grid, payload, self.options)
        except CalibrationError:
            return np.inf, np.inf
        columns = found.problem.measured.position_columns
        variances = np.diagonal(found.problem.stated_covariance, axis1=1, axis2=2)[:, columns]
        seen = found.problem.components_seen[:, columns]
        axes = min(3, seen.shape[1])
        stated_mm = 1e3 * float(np.sqrt(axes * np.mean(variances[seen])))
        return rms_mm(found), max(stated_mm, self.repeats_mm)


def scatter_of_repeats_mm(single: Observations) -> float:
    """Return how far readings lie from the mean of their repeats; 0 without any."""
    code = reading_groups(single)
    repeated = np.bincount(code)[code] > 1
    p_m = single.measured.places_m
    off_m = p_m - group_means(p_m.reshape(len(p_m), -1), code)[code].reshape(p_m.shape)
    size_m = np.linalg.norm(off_m[repeated], axis=2)
    return 1e3 * float(np.nanmedian(size_m)) if np.isfinite(size_m).any() else 0.0


#: Misfit of the nominal arm, base and target fitted, that no departures explain [m].
NOT_DEPARTURES_M = 0.01
#: A change must leave so much less to be believed, by the nominal arm and by a calibrated one.
NOMINAL_LEFT = 1.0 / 3.0
CALIBRATED_LEFT = 0.4
#: Masters of joints are never so far off [rad].
NO_MASTERING_RAD = float(np.radians(1.0))
#: A change that puts the nominal arm so much further off is not tried with a calibration.
WORTH_TRYING = 3.0
MOST_CHANGES = 3
#: Error left over that of the stated noise above which the input is searched for a cause.
ABOVE_NOISE = 5.0
_MEDIAN_SQUARE = float(ndtri(0.75)) ** 2


def above_noise(arm: Arm, grid: Observations, options: CalibrationOptions) -> bool:
    """Return whether the rigid arm, calibrated, is off by much more than the stated noise."""
    try:
        found = _calibrated(arm, grid, None, options)
    except CalibrationError:
        return False  # too few poses: the calibration says how many it needs
    columns = found.problem.measured.position_columns
    variances = np.diagonal(found.problem.stated_covariance, axis1=1, axis2=2)[:, columns]
    seen = found.problem.components_seen[:, columns]
    squares = (found.fit.residual[:, columns] ** 2 / variances)[seen]
    return bool(np.median(squares) > ABOVE_NOISE**2 * _MEDIAN_SQUARE)


@dataclass(frozen=True)
class _Change:
    """A change of the joint columns."""

    kind: str  # `joint_sign` or `joint_order`
    joints: tuple[int, ...]  # from 1; the one that is reversed, or the two that are exchanged

    def of(self, q: Array) -> Array:
        """Return joint columns (P, n) with the change made."""
        q, at = q.copy(), [joint - 1 for joint in self.joints]
        if self.kind == "joint_sign":
            q[:, at] *= -1.0
        else:
            q[:, at] = q[:, at[::-1]]
        return q

    @property
    def text(self) -> str:
        """Say what seems wrong."""
        if self.kind == "joint_sign" and len(self.joints) > 1:
            return "the signs of all joints are reversed"
        if self.kind == "joint_sign":
            return f"the sign of joint {self.joints[0]} is reversed"
        return f"joints {self.joints[0]} and {self.joints[1]} are exchanged"

    def where(self, words: OwnWords) -> str:
        """Say which columns are meant."""
        return ", ".join(words.joint(joint) for joint in self.joints)


def _remedies(made: Sequence[_Change], asked: Asked) -> str:
    """Say what to state, so that the changes are made."""
    signs, offsets, words = asked.signs, asked.offsets_deg, asked.words
    order, moved = list(range(asked.arm.n)), ""
    for change in made:
        at = [joint - 1 for joint in change.joints]
        if change.kind == "joint_sign":
            for k in at:
                signs[k], offsets[k] = -signs[k], -offsets[k]
        else:
            one, two = at
            order[one], order[two] = order[two], order[one]
            signs[one], signs[two] = signs[two], signs[one]
            offsets[one], offsets[two] = offsets[two], offsets[one]
            moved = moved or change.where(words)
    remedies = []
    if order != sorted(order):
        units = np.where(asked.arm.prismatic, "mm", "deg")
        names = [f"q{k + 1}_{units[k]}" for k in order]
        own = words.key(names[0])
        remedies.append(words.set_names(names) if own else f"exchange the columns {moved}")
    if signs != asked.signs:
        remedies.append(f"set joint_signs: [{', '.join(map(str, signs))}]")
    if offsets != asked.offsets_deg:
        remedies.append(_set_offsets(offsets))
    also = "" if order != sorted(order) else ", or reverse the axis in the arm's description"
    return " and ".join(remedies) + also


def _set_offsets(offsets_deg: Sequence[float]) -> str:
    return f"set joint_offsets_deg: [{', '.join(f'{each + 0.0:.6g}' for each in offsets_deg)}]"


def _changes(arm: Arm) -> Iterator[_Change]:
    yield _Change("joint_sign", tuple(range(1, arm.n + 1)))
    for joint in range(1, arm.n + 1):
        yield _Change("joint_sign", (joint,))
    for joint in range(1, arm.n):
        if arm.prismatic[joint - 1] == arm.prismatic[joint]:
            yield _Change("joint_order", (joint, joint + 1))


def signs_and_order(asked: Asked, grid: Observations) -> tuple[InputFinding, ...]:
    """Change signs and order of joints one after the other, as long as much less is left."""
    arm, q = asked.arm, grid.states.q_rad
    first_m = left_m = _nominal_misfit(arm, grid, q)
    if first_m < NOT_DEPARTURES_M:
        return ()
    made: list[_Change] = []
    for _ in range(MOST_CHANGES):
        tried = [(_nominal_misfit(arm, grid, change.of(q)), change) for change in _changes(arm)]
        least_m, best = min(tried, key=lambda each: each[0])
        if least_m > 0.7 * left_m:
            break
        q, left_m = best.of(q), least_m
        made.append(best)
    if left_m > NOMINAL_LEFT * first_m or left_m > max(NOT_DEPARTURES_M, 0.1 * first_m):
        return ()
    right = asked.puts_right(replace(grid.states, q_rad=q), grid, left_m)
    return (_changed(made, asked, 1e3 * first_m, 1e3 * left_m, "the nominal arm fits to", right),)


def _changed(
    made: Sequence[_Change],
    asked: Asked,
    now_mm: float,
    left_mm: float,
    fits: str,
    right: bool,
) -> InputFinding:
    text = " and ".join(change.text for change in made)
    then = "that is put right" if right else f"so, {STILL_WRONG}"
    return InputFinding(
        kind=made[0].kind,
        where="; ".join(change.where(asked.words) for change in made),
        what=f"{text}: {fits} {now_mm:.3g} mm as logged, {left_mm:.3g} mm if {then}",
        remedy=_remedies(made, asked)
        if right
        else "check robot, and order, signs, zeros and units of all joints",
        would_leave_mm=left_mm,
    )


def joint_zeros(asked: Asked, grid: Observations) -> tuple[InputFinding, ...]:
    """Find the zero of a joint that is off by more than any mastering, by calibrating."""
    arm, q = asked.arm, grid.states.q_rad
    first_m = _nominal_misfit(arm, grid, q)
    if first_m < NOT_DEPARTURES_M:
        return ()
    try:
        found = _calibrated(arm, grid, asked.campaign.payload(arm), asked.options)
    except CalibrationError:
        return ()
    names = [parameter.name for parameter in found.problem.model.parameters]
    zeros = {
        joint: float(found.fit.x[names.index(name)])
        for joint in range(1, arm.n + 1)
        if (name := f"delta_theta_{joint}") in names and not arm.prismatic[joint - 1]
    }
    joint = max(zeros, key=lambda each: abs(zeros[each]), default=0)
    if not joint or abs(zeros[joint]) < NO_MASTERING_RAD:
        return ()
    moved = q.copy()
    moved[:, joint - 1] += zeros[joint]
    left_m = _nominal_misfit(arm, grid, moved)
    if left_m > NOMINAL_LEFT * first_m:
        return ()
    right = asked.puts_right(replace(grid.states, q_rad=moved), grid, left_m)
    off_deg, offsets = float(np.degrees(zeros[joint])), asked.offsets_deg
    offsets[joint - 1] = round(offsets[joint - 1] + off_deg, 3)
    then = "" if right else f", {STILL_WRONG}"
    return (
        InputFinding(
            kind="joint_zero",
            where=asked.words.joint(joint),
            what=f"the zero of joint {joint} is {abs(off_deg):.3g} deg off: the nominal arm fits "
            f"to {1e3 * first_m:.3g} mm as logged, {1e3 * left_m:.3g} mm without that{then}",
            remedy=f"check the zero of this joint in the log, or {_set_offsets(offsets)}"
            if right
            else "check robot, and order, signs, zeros and units of all joints",
            would_leave_mm=1e3 * left_m,
        ),
    )


def _nominal_misfit(arm: Arm, grid: Observations, q: Array) -> float:
    """Return the rms misfit of the nominal arm, base and targets fitted [m]; inf if none fits."""
    try:
        found = grid.measured.locate(Chain.of(arm).forward(q))
    except CalibrationError:
        return np.inf
    return float(np.hypot(found.scatter_m, LEVER_M * (found.scatter_rad or 0.0)))


def small_signs(asked: Asked, some: Observations) -> tuple[InputFinding, ...]:
    """Try signs and order whose error departures partly take up, as of a wrist, by calibrating."""
    arm, options, q = asked.arm, asked.options, some.states.q_rad
    as_logged_m = _nominal_misfit(arm, some, q)
    tried = []
    for change in _changes(arm):
        nominal_m = _nominal_misfit(arm, some, change.of(q))
        if nominal_m < WORTH_TRYING * as_logged_m:
            states = replace(some.states, q_rad=change.of(q))
            left_mm = calibrated_rms_mm(arm, some.with_states(states), None, options)
            tried.append((left_mm, nominal_m, change))
    if not tried:
        return ()
    now_mm = calibrated_rms_mm(arm, some, None, options)
    left_mm, nominal_m, best = min(tried, key=lambda each: each[0])
    if not left_mm < CALIBRATED_LEFT * now_mm < np.inf:
        return ()
    right = asked.puts_right(replace(some.states, q_rad=best.of(q)), some, nominal_m)
    return (_changed([best], asked, now_mm, left_mm, "the arm calibrates to", right),)


def calibrated_rms_mm(
    arm: Arm, grid: Observations, payload: Payload | None, options: CalibrationOptions
) -> float:
    """Return the rms position error of the general model fitted to poses; rigid without payload."""
    try:
        return rms_mm(_calibrated(arm, grid, payload, options))
    except CalibrationError:
        return np.inf


def rms_mm(found: GeneralCalibration) -> float:
    """Return the rms position error of a calibration, of several targets that of one."""
    columns = found.problem.measured.position_columns
    # Of several targets the error of one is meant; a distance is one component.
    targets = np.maximum(1, found.problem.components_seen[:, columns].sum(axis=1) // 3)
    squares = np.sum(found.fit.residual[:, columns] ** 2, axis=1) / targets
    return 1e3 * float(np.sqrt(np.average(squares, weights=found.fit.weights)))


def _calibrated(
    arm: Arm, grid: Observations, payload: Payload | None, options: CalibrationOptions
) -> GeneralCalibration:
    start = grid.measured.find_start(Chain.of(arm).forward(grid.states.q_rad))
    rigid = options if payload is not None else options.with_springs(())
    return calibrate_general(arm, grid, start, payload, rigid)
