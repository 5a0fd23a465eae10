"""What the grade of a calibration rests on, and what follows from it: errors, noise, departures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.calibration.accuracy import HeldOut
from pa10cal.calibration.departures import common_lengthening, impossible_departures
from pa10cal.calibration.fit_summary import FitSummary, poses_needed
from pa10cal.calibration.noisy_campaign import NoisyCampaign
from pa10cal.calibration.rules import GRADES
from pa10cal.calibration.serial_correlation import SerialCorrelation
from pa10cal.results import calibration as records
from pa10cal.results.calibration import InputFinding

#: Least remaining error [mm]: exact data leave none, and ratios to it are formed (computing).
_LEAST_ERROR_MM = 1e-6
#: What readings show whose repeats are identical.
NO_NOISE = "repeats do not differ at all, as copied readings do"


@dataclass(frozen=True)
class GradeEvidence:
    """What a grade rests on: a fit summary, and the remaining errors of the calibrated model.

    Of the errors, all rms of positions: `train_rms_mm` remains at the poses fitted, `error_mm` is
    that per degree of freedom, `single_mm` of one reading. Of the noise: `noise_mm` as stated or
    found, `reading_noise_mm` as repeats show it, `noise_with_apparatus_mm` with the places of
    targets on their apparatus. Of predictions: `u_model_mm` by the parameters, `u_promised_mm` with
    what the model lacks and uncertain joints.
    """

    ended: FitSummary  # how the fit ended
    # root mean square position error of the poses fitted, without suspected outliers
    train_rms_mm: float
    held_out: HeldOut | None  # errors of poses held out, None where there are none
    noise_mm: float | None  # the error that the noise of readings makes, None where not known
    spread_mm: float  # root mean square distance of the measured positions from their mean
    suspected_outliers: int = 0  # number of poses far outside the scatter of the others
    rigid_outliers: int = 0  # of these, those whose targets keep their distances
    # where in time these lie, in words; empty where chance spreads them
    at_one_end: str = ""
    # the same as `train_rms_mm` with them; None where there are none
    all_rms_mm: float | None = None
    noise_is_found: bool = False  # whether `noise_mm` is estimated from repeats, and not stated
    # error by the places of the targets on an apparatus, common to all poses, that the fit leaves
    apparatus_mm: float = 0.0
    discrepancy_mm: float = 0.0  # rms of what the model lacks, in the poses fitted
    # rms error of predictions, by torques of the weights, beyond that with logged torques
    lost_without_log_mm: float = 0.0
    joints_mm: float = 0.0  # rms by which stated uncertainties of joint positions put these off
    # scatter of repeats and stated uncertainty, by kind of component
    repeats: tuple[records.RepeatScatter, ...] = ()
    from_touches: bool = False  # whether the instrument touches balls
    findings: tuple[records.InputFinding, ...] = ()  # what checks of the input found
    # the same as `train_rms_mm` with rigid joints; None where the model has no springs
    without_springs_mm: float | None = None
    # origin of weights that nobody stated: the lengths of the links (`assumed`), or the mass of the
    # whole arm (`total`); empty where they are stated or not needed
    weights: str = ""
    # standard uncertainty of the tool's centre of mass, where it is not stated and springs need it
    com_u_m: float | None = None
    # required standard uncertainty of predicted positions; None where none is required
    wanted_mm: float | None = None
    # the same as `train_rms_mm` of the nominal arm, base and targets fitted; None where not known
    nominal_mm: float | None = None
    arm: Arm | None = None  # as described; None where that is not known
    # largest turn of the end-effector between two poses [rad]; None where not known
    turned_rad: float | None = None
    # joints that hardly moved, in words with where they stood
    hardly_moved: tuple[str, ...] = ()
    # the campaign of a group that alone is noisier than stated; None for none
    noisy_campaign: NoisyCampaign | None = None
    # tilts of parallel axes that the readings do not show and the fit left at zero, by name
    not_shown: tuple[str, ...] = ()
    # how alike errors of poses are that follow each other in time; None where they are not
    alike: SerialCorrelation | None = None

    # The remaining error, and the noise.

    @property
    def error_mm(self) -> float:
        """Return the remaining error, corrected for the degrees of freedom that the fit took."""
        fitted_share = min(self.ended.taken / max(self.rows, 1), GRADES.most_taken_share)
        return max(self.train_rms_mm / float(np.sqrt(1.0 - fitted_share)), _LEAST_ERROR_MM)

    @property
    def single_mm(self) -> float:
        """Return the error of a single reading: the remaining one, or a much larger stated one."""
        return (self.noise_with_apparatus_mm or 0.0) if self.below_noise else self.error_mm

    @property
    def noise_with_apparatus_mm(self) -> float | None:
        """Return the error that readings and apparatus make; None where it is not known."""
        noise_mm = self.reading_noise_mm
        return None if noise_mm is None else float(np.hypot(noise_mm, self.apparatus_mm))

    @property
    def reading_noise_mm(self) -> float | None:
        """Return the noise of the poses fitted: as repeats show it, else as stated."""
        if self.noise_mm is None or self.noise_is_found or not self.repeats:
            return self.noise_mm
        ratios = [scatter.ratio for scatter in self.repeats if not scatter.is_of_attitude]
        return self.noise_mm * ratios[0] if ratios else self.noise_mm

    @property
    def noise_by_repeats(self) -> bool:
        """Return whether repeats show the noise, and not what is stated."""
        return self.noise_is_found or self.reading_noise_mm != self.noise_mm

    @property
    def over_noise(self) -> float | None:
        """Return the remaining error over the noise; None where that is not known, or zero."""
        noise_mm = self.noise_with_apparatus_mm
        return self.error_mm / noise_mm if noise_mm else None

    @property
    def most_over_noise(self) -> float:
        """Return the largest remaining error over the noise that chance explains."""
        own_mm, reading_mm = self.noise_with_apparatus_mm, self.reading_noise_mm
        dof = max(self.rows - self.ended.taken, 1.0)
        by_chance = GRADES.chance_errors / float(np.sqrt(2.0 * dof))
        limit = 1.0 + float(np.hypot(GRADES.over_noise - 1.0, by_chance))
        if not own_mm or reading_mm is None:
            return limit
        of_targets_mm = GRADES.apparatus_ratio * self.apparatus_mm
        return limit * float(np.hypot(reading_mm, of_targets_mm)) / own_mm

    @property
    def within_noise(self) -> bool:
        """Return whether the remaining error is not far above the noise."""
        over = self.over_noise
        return over is not None and over < GRADES.stated_ratio

    @property
    def below_noise(self) -> bool:
        """Return whether the remaining error is much smaller than the stated noise."""
        over = self.over_noise
        return over is not None and over < 1.0 / GRADES.stated_ratio

    @property
    def fits_to_noise(self) -> bool:
        """Return whether poses that leave nothing but noise stand in for held-out ones.

        None are held out then, or too few, and the readings are twice as many as the unknowns.
        """
        held_out, over = self.held_out, self.over_noise
        if held_out is not None and held_out.accuracy.configurations >= GRADES.few_held_out:
            return False
        if not self.ended.solution.converged or over is None or self.below_noise:
            return False
        enough = self.rows >= GRADES.rows_an_unknown * self.ended.taken
        return enough and not self.misfits_arm and over <= self.most_over_noise

    @property
    def misfits_arm(self) -> bool:
        """Return whether the error is larger than calibrated arms have, and than the noise."""
        return self.train_rms_mm > GRADES.no_fit_share * self.spread_mm and not self.within_noise

    def accepted_scatter(self, scatter: records.RepeatScatter) -> tuple[float, float]:
        """Return the least and the most that repeats may scatter by, as stated [m or rad]."""
        attitude = scatter.is_of_attitude
        ratio = GRADES.attitude_ratio if attitude else GRADES.stated_ratio
        # Readings of the joints scatter, too.
        joints = GRADES.joint_rad * (1.0 if attitude else 1e-3 * self.spread_mm)
        least = scatter.stated / most_stated(ratio, from_touches=self.from_touches)
        return least, ratio * float(np.hypot(scatter.stated, joints))

    # What the poses determine.

    @property
    def rank(self) -> int:
        """Return the number of directions that are identified."""
        return self.ended.identifiability.rank

    @cached_property
    def rows(self) -> int:
        """Return the number of scalar readings that were fitted."""
        return int(np.count_nonzero(np.any(self.ended.white != 0.0, axis=2)))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Return the parameters that these poses do not determine, and other poses could."""
        return tuple(sorted(self.ended.not_identifiable - self.ended.hidden))

    @property
    def is_determined(self) -> bool:
        """Return whether these poses determine what others could, and so a predicted position."""
        return bool(np.isfinite(self.u_model_mm)) and not self.undetermined

    @property
    def held_at_bounds(self) -> tuple[str, ...]:
        """Return the parameters at the end of their physical range.

        A linear spring at its lower bound is not: it is a joint as rigid as the readings can show.
        """
        rigid = {*self.ended.having("windup")} - {*self.ended.at_upper_bound}
        return tuple(name for name in self.ended.at_bound if name not in rigid)

    @property
    def springs_explain_most(self) -> bool:
        """Return whether springs explain a large part of the squared error with rigid joints."""
        rigid_mm = self.without_springs_mm
        return rigid_mm is not None and self.train_rms_mm**2 < GRADES.mostly_share * rigid_mm**2

    @cached_property
    def poses(self) -> records.PosesNeeded:
        """Return how many poses there are, and how many the required uncertainty needs.

        If none is required, it is one that hardly adds to the error.
        """
        wanted_mm = self.wanted_mm
        single_mm = self.single_mm if self.below_noise else self.train_rms_mm
        small_mm = GRADES.small_share * single_mm if wanted_mm is None else wanted_mm
        return poses_needed(self.ended, small_mm, wanted_mm)

    # Predictions, and held-out poses.

    @property
    def u_model_mm(self) -> float:
        """Return the standard uncertainty of a predicted position; inf where not determined."""
        return float("inf") if self.poses.u_model_mm is None else self.poses.u_model_mm

    @property
    def u_promised_mm(self) -> float:
        """Return the rms standard uncertainty that predictions state in the poses fitted."""
        return float(
            np.linalg.norm([self.ended.u_positions_mm, self.discrepancy_mm, self.joints_mm])
        )

    @property
    def required_mm(self) -> float:
        """Return the uncertainty of predictions that is required: else that of one reading."""
        return self.wanted_mm or self.single_mm

    @property
    def without_log_mm(self) -> float:
        """Return the error of predictions, which have no torque log, at the poses fitted."""
        return float(np.hypot(self.error_mm, self.lost_without_log_mm))

    @property
    def loses_without_log(self) -> bool:
        """Return whether predictions lose more without the log than chance and noise explain."""
        least_mm = max(self.error_mm, self.noise_with_apparatus_mm or 0.0)
        return self.without_log_mm > self.most_over_noise * least_mm

    def _promised_mm2(self, held_out: HeldOut) -> tuple[float, float]:
        """Return the mean squares that errors and uncertain predictions make in held-out poses.

        Errors are the model error of the fit and the noise, larger where fewer readings were
        averaged.
        """
        noise_mm = min(self.reading_noise_mm or self.error_mm, self.error_mm)
        model_mm2 = self.error_mm**2 - noise_mm**2
        u_mm = self.u_model_mm if held_out.u_mm is None else held_out.u_mm
        return model_mm2 + noise_mm**2 / held_out.repeats, u_mm**2

    @property
    def over_promised(self) -> float | None:
        """Return the held-out error over the one that the fit promises; None without either."""
        if self.held_out is None:
            return None
        promised_mm = float(np.sqrt(sum(self._promised_mm2(self.held_out))))
        return self.held_out.accuracy.rms_mm / promised_mm if np.isfinite(promised_mm) else None

    @property
    def most_over_promised(self) -> float:
        """Return the largest held-out error over the promised one that chance explains.

        Poses err alike by uncertain parameters: of these errors few are independent (effective
        degrees of freedom, JCGM 100:2008, G.4.1).
        """
        held_out = self.held_out
        if held_out is None:
            return GRADES.over_expected
        count = max(held_out.accuracy.configurations, 1)
        errors_mm2, u_mm2 = self._promised_mm2(held_out)
        independent = min(held_out.independent or count, count)
        dof = (errors_mm2 + u_mm2) ** 2 / (errors_mm2**2 / count + u_mm2**2 / independent)
        by_chance = GRADES.chance_errors / float(np.sqrt(2.0 * min(dof, count)))
        return max(GRADES.over_expected, 1.0 + by_chance)

    @property
    def over_expected(self) -> float | None:
        """Return the held-out error over the promised one, if chance does not explain it."""
        ratio = self.over_promised
        return ratio if ratio is not None and ratio > self.most_over_promised else None

    @property
    def confirmed(self) -> bool:
        """Return whether held-out poses are predicted as well as the fitted ones are explained.

        A fit that did not converge has nothing to confirm.
        """
        held_out = self.held_out
        if not self.ended.solution.converged or held_out is None:
            return False
        if held_out.accuracy.configurations < GRADES.few_held_out:
            return False
        # With a large error, another cause may look like a departure.
        if self.misfits_arm or not (self.over_noise is None or self.within_noise):
            return False
        known_mm = max(self.error_mm, self.noise_with_apparatus_mm or 0.0)
        # Few poses leave predictions uncertain, whatever the departures: these are known by u.
        explained_mm = float(np.hypot(known_mm, held_out.u_mm or 0.0))
        return held_out.accuracy.rms_mm < GRADES.confirmed_ratio * explained_mm

    # Departures from the arm as described.

    @property
    def zeros_off(self) -> tuple[records.InputFinding, ...]:
        """Return zeros of joints that are off by checks of the input, or between campaigns."""
        return tuple(finding for finding in self.findings if finding.kind == "joint_zero")

    @property
    def large_departures(self) -> tuple[records.InputFinding, ...]:
        """Return the departures that no arm was built with, confirmed or not."""
        return impossible_departures(self.ended, self.arm, max(self.over_noise or 1.0, 1.0))

    @cached_property
    def departures(self) -> tuple[records.InputFinding, ...]:
        """Return the departures that no arm was built with, where poses confirm them.

        Held-out poses confirm all of them; where none are held out, poses that fit to the noise
        confirm zeros of joints. Zeros that the checks of the input found come first, in place of
        the fit's own departure of that joint's zero: these say what to set.
        """
        if not (self.confirmed or self.fits_to_noise):
            return ()
        zeros = self.zeros_off
        others = (
            each
            for each in self.large_departures
            if (self.confirmed or each.joint is not None)
            and not any(_is_of_zero(each, zero) for zero in zeros)
        )
        return (*zeros, *others)

    @property
    def longer_by(self) -> float | None:
        """Return the share by which all long links are longer than described; None if they differ.

        Arms are not built so: the scale of the instrument goes with their lengths, which no
        readings of one campaign can tell. None as well where fewer than two long links are known
        well enough, or they are hardly longer.
        """
        return None if self.arm is None else common_lengthening(self.ended, self.arm)


def most_stated(factor: float = GRADES.stated_ratio, *, from_touches: bool) -> float:
    """Return the largest stated uncertainty over the scatter of repeats that is accepted."""
    return max(factor, GRADES.touches_ratio) if from_touches else factor


def _is_of_zero(departure: InputFinding, zero: InputFinding) -> bool:
    """Return whether a departure is that of a joint's zero which a check found off."""
    return departure.joint is not None and departure.joint == zero.joint
