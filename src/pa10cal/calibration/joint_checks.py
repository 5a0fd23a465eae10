"""Signs and order of the joints: would much less error be left if they were changed?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.findings import InputFinding
from pa10cal.errors import CalibrationError
from pa10cal.frame.target_fit import LEVER_M
from pa10cal.observe.observations import Observations

#: Misfit of the nominal arm, base and target fitted, that no departures explain [m].
NOT_DEPARTURES_M = 0.01
#: A change must leave so much less to be believed, by the nominal arm and by a calibrated one.
NOMINAL_LEFT = 1.0 / 3.0
CALIBRATED_LEFT = 0.4
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

    @property
    def where(self) -> str:
        """Say which columns are meant."""
        return ", ".join(f"q{joint}" for joint in self.joints)

    @property
    def remedy(self) -> str:
        """Say what to do."""
        if self.kind == "joint_sign":
            return f"multiply {self.where} by -1, or reverse the axis in the arm's description"
        return f"exchange the columns {self.where}"


def _changes(arm: Arm) -> Iterator[_Change]:
    yield _Change("joint_sign", tuple(range(1, arm.n + 1)))
    for joint in range(1, arm.n + 1):
        yield _Change("joint_sign", (joint,))
    for joint in range(1, arm.n):
        if arm.prismatic[joint - 1] == arm.prismatic[joint]:
            yield _Change("joint_order", (joint, joint + 1))


def signs_and_order(arm: Arm, grid: Observations) -> tuple[InputFinding, ...]:
    """Change signs and order of joints one after the other, as long as much less is left."""
    q = grid.states.q_rad
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
    return (_changed(made, 1e3 * first_m, 1e3 * left_m, "the nominal arm fits to"),)


def _changed(made: Sequence[_Change], now_mm: float, left_mm: float, fits: str) -> InputFinding:
    return InputFinding(
        kind=made[0].kind,
        where="; ".join(change.where for change in made),
        what=f"{' and '.join(change.text for change in made)}: {fits} {now_mm:.3g} mm as logged, "
        f"{left_mm:.3g} mm if that is put right",
        remedy=" and ".join(change.remedy for change in made),
        would_leave_mm=left_mm,
    )


def _nominal_misfit(arm: Arm, grid: Observations, q: Array) -> float:
    """Return the rms misfit of the nominal arm, base and targets fitted [m]; inf if none fits."""
    try:
        found = grid.measured.locate(Chain.of(arm).forward(q))
    except CalibrationError:
        return np.inf
    return float(np.hypot(found.scatter_m, LEVER_M * (found.scatter_rad or 0.0)))


def small_signs(
    arm: Arm, some: Observations, options: CalibrationOptions
) -> tuple[InputFinding, ...]:
    """Try signs and order whose error departures partly take up, as of a wrist, by calibrating."""
    q = some.states.q_rad
    as_logged_m = _nominal_misfit(arm, some, q)
    tried = []
    for change in _changes(arm):
        if _nominal_misfit(arm, some, change.of(q)) < WORTH_TRYING * as_logged_m:
            states = replace(some.states, q_rad=change.of(q))
            tried.append((calibrated_rms_mm(arm, some.with_states(states), None, options), change))
    if not tried:
        return ()
    now_mm = calibrated_rms_mm(arm, some, None, options)
    left_mm, best = min(tried, key=lambda each: each[0])
    if not left_mm < CALIBRATED_LEFT * now_mm < np.inf:
        return ()
    return (_changed([best], now_mm, left_mm, "the arm calibrates to"),)


def calibrated_rms_mm(
    arm: Arm, grid: Observations, payload: Payload | None, options: CalibrationOptions
) -> float:
    """Return the rms position error of the general model fitted to poses; rigid without payload."""
    try:
        found = _calibrated(arm, grid, payload, options)
    except CalibrationError:
        return np.inf
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
