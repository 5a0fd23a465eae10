"""A campaign whose input is checked: misfits and quick calibrations, as logged or changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general, find_start
from pa10cal.calibration.general.fit import fit
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import CHECKS, GRADES
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.conventions import EXPECTED_M, puts_right
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.terms.effects.joint import EncoderEccentricity, GearRatioError


def spread_rows(count: int) -> Index:
    """Return the rows, evenly spaced, that a check uses of `count` poses."""
    return np.unique(np.linspace(0, count - 1, min(count, CHECKS.most_poses)).astype(int))


def scatter_of_repeats_mm(single: Observations) -> float:
    """Return the median distance of readings from the mean of their repeats; 0 without repeats."""
    code = reading_groups(single)
    repeated = np.bincount(code)[code] > 1
    p_m = single.measured.places_m
    off_m = p_m - group_means(p_m.reshape(len(p_m), -1), code)[code].reshape(p_m.shape)
    size_m = np.linalg.norm(off_m[repeated], axis=2)
    return 1e3 * float(np.nanmedian(size_m)) if np.isfinite(size_m).any() else 0.0


@dataclass(frozen=True, eq=False)
class CheckedCampaign:
    """A campaign whose input is checked, with the names of its columns."""

    campaign: CampaignDescription
    arm: Arm
    options: CalibrationOptions
    words: ColumnMap  # columns by the names that the user gave them
    grid: Observations  # the poses that checks use, averaged
    repeats_mm: float  # scatter of repeats; 0 where that is not known

    @property
    def payload(self) -> Payload | None:
        """Return what the arm carries; None where it is not known."""
        return self.campaign.payload(self.arm)

    @property
    def expected_m(self) -> float:
        """Return the misfit that is expected of the nominal arm, base and targets fitted."""
        return EXPECTED_M * self.arm.size_ratio

    @property
    def not_departures_m(self) -> float:
        """Return the misfit of the nominal arm that no departures of its links explain."""
        return CHECKS.not_departures_m * self.arm.size_ratio

    @property
    def axes(self) -> Array:
        """Return the positions of the axes that the controller counts, (P, m) [rad, m]."""
        return self.arm.coupling.to_axes(self.grid.states.q_rad)

    @property
    def without_coupling(self) -> CheckedCampaign:
        """Return the campaign as of an arm whose joints are the axes that the controller counts."""
        states = replace(self.grid.states, q_rad=self.axes)
        arm = replace(self.arm, coupled=())
        return replace(self, arm=arm, grid=self.grid.with_states(states))

    @property
    def logs_torques(self) -> bool:
        """Return whether every pose has torques."""
        return bool(np.isfinite(self.grid.states.tau_Nm).all())

    @property
    def signs(self) -> list[int]:
        """Return the signs of the axes that campaign.yaml states, (m,)."""
        return list(self.campaign.joint_signs or [1] * len(self.arm.axes_slide))

    @property
    def offsets_deg(self) -> list[float]:
        """Return the offsets of the axes that campaign.yaml states, (m,)."""
        return list(self.campaign.joint_offsets_deg or [0.0] * len(self.arm.axes_slide))

    @cached_property
    def above_noise(self) -> bool:
        """Return whether a calibrated rigid arm leaves much more than the stated noise."""
        found = self.calibration(None)
        if found is None:
            return False  # too few poses; the calibration itself will be refused
        residual, variances, seen = positions_of(found)
        return bool(
            np.median((residual**2 / variances)[seen])
            > CHECKS.above_noise**2 * GRADES.median_square
        )

    def nominal_misfit_m(self, q: Array) -> float:
        """Return the rms misfit of the nominal arm, base and targets fitted; inf if none fits."""
        return self.grid.measured.misfit_m(Chain.of(self.arm).forward(q))

    def least_misfit_m(self, q: Array) -> float:
        """Return a lower bound of the misfit of the nominal arm, without a fit."""
        return self.grid.measured.least_misfit_m(Chain.of(self.arm).forward(q))

    def calibration(
        self, payload: Payload | None, q: Array | None = None
    ) -> GeneralCalibration | None:
        """Return a quick calibration; None where the poses are too few.

        Args:
            payload: what the arm carries; None for rigid joints.
            q: (P, n) joint positions in place of those logged.
        """
        grid, options = self.grid, self.options
        if q is not None:
            grid = grid.with_states(replace(grid.states, q_rad=q))
        if payload is None:
            options = options.with_springs(())
        try:
            return calibrate_general(self.arm, grid, find_start(self.arm, grid), payload, options)
        except CalibrationError:
            return None

    def calibrated_mm(self, payload: Payload | None, q: Array | None = None) -> tuple[float, float]:
        """Return the rms position error of a quick calibration, and the noise [mm].

        The noise is the stated one, or the scatter of repeats if that is larger. Both are infinite
        where the poses are too few.
        """
        found = self.calibration(payload, q)
        if found is None:
            return np.inf, np.inf
        _, variances, seen = positions_of(found)
        stated_mm = 1e3 * float(np.sqrt(min(3, seen.shape[1]) * np.mean(variances[seen])))
        return _rms_mm(found), max(stated_mm, self.repeats_mm)

    def with_errors_of_joints_mm(self, payload: Payload | None) -> float:
        """Return the rms position error of a quick calibration if angles of joints err, too [mm].

        By gear ratios and by sensors off centre: the plain errors of joints that change with their
        angles, as sags do. Infinite where the poses are too few.
        """
        found = self.calibration(payload)
        if found is None:
            return np.inf
        own, model = self.arm.coupling.own, found.problem.model
        joints = [f"joint {joint}" for joint in own[~self.arm.prismatic[own]] + 1]
        errors = [
            error for of in joints for error in (GearRatioError(of), EncoderEccentricity(of, 1.0))
        ]
        problem = replace(found.problem, model=replace(model, terms=(*model.terms, *errors)))
        at = len(model.parameters)
        x_start = np.insert(found.fit.x, at, np.zeros(len(problem.model.parameters) - at))
        fitted = fit(problem, x_start, robust=self.options.general.robust)
        return _rms_mm(replace(found, problem=problem, fit=fitted))

    def may_be_offered(self, q: Array, nominal_m: float) -> bool:
        """Return whether changed joints fit the nominal arm, and a calibrated one.

        Args:
            q: (P, n) the joints, changed.
            nominal_m: misfit of the nominal arm with them.
        """
        if not puts_right(nominal_m, self.expected_m):
            return False
        left_mm, noise_mm = self.calibrated_mm(self.payload, q)
        # With too few poses the nominal arm alone decides.
        return left_mm == np.inf or puts_right(left_mm, 1e3 * self.expected_m, noise_mm)


def _rms_mm(found: GeneralCalibration) -> float:
    """Return the weighted rms position error of a calibration, of one target [mm]."""
    residual, _, _ = positions_of(found)
    # The error is that of one target; a distance is one component.
    squares = np.sum(residual**2, axis=1) / found.problem.observations.measured.targets_seen
    return 1e3 * float(np.sqrt(np.average(squares, weights=found.fit.weights)))


def positions_of(found: GeneralCalibration) -> tuple[Array, Array, Mask]:
    """Return residuals [m] and stated variances [m^2] of positions, and which were seen, (P, c)."""
    problem, columns = found.problem, found.problem.observations.measured.position_columns
    variances = np.diagonal(problem.stated_covariance, axis1=1, axis2=2)[:, columns]
    return found.fit.residual[:, columns], variances, problem.components_seen[:, columns]
