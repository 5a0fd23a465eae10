"""Campaigns in which effects cannot be sought: why, what to do, and the verdict all the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import least_for_blocks
from pa10cal.discovery.gap import gap
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit
from pa10cal.discovery.model_with_effects import ModelWithEffects, with_base_motion
from pa10cal.discovery.near_poses import noise_of_near_poses
from pa10cal.discovery.preparation import Prepared, complete, context_of
from pa10cal.discovery.repeats import repeated
from pa10cal.discovery.rules import JUDGING, NOISE
from pa10cal.discovery.verdict import Basis, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import mean_noise_error_mm
from pa10cal.fit.uncertain_weights import open_unknowns
from pa10cal.numerics.covariances import mean_covariance
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.results.analysis import LackOfFit
from pa10cal.terms.effects.effect import Effect


class CannotSearch(NamedTuple):
    """Why effects cannot be sought in a campaign, and what to do about it."""

    why: str
    remedy: str


#: Of a calibration that started from a model with maps: a search would have to fit them anew.
HAS_MAPS = CannotSearch(
    "the calibrated model has maps of joints already, of the model that it started from",
    "calibrate without the prior to search; or use the model as it is",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class NotSought(Basis):
    """The basis of a verdict without a search: the calibrated model stays as it is."""

    calibrated: FittedModel
    cov: Array  # (P, b, b) noise covariance of the components of the poses fitted

    @property
    @override
    def searched_from(self) -> FittedModel:
        return self.calibrated.with_bends()

    @override
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        residuals = lack_of_fit(CellResiduals.about(found.baseline, found.train.poses, self.cov))
        return residuals, residuals

    @override
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        del effects  # there are none
        return self.calibrated


def not_sought(
    campaign: Prepared, calibrated: FittedModel, reason: CannotSearch
) -> Verdict[NotSought]:
    """Return the verdict on a campaign in which effects cannot be sought.

    The extended model is the calibrated one, with six base motions of zero. Where torques are those
    of uncertain weights a search fits these; here the model stays as it was given.
    """
    campaign = replace(campaign, baseline=calibrated.with_bends())
    baseline, setup = campaign.baseline, campaign.setup
    readings = complete(campaign.trusted, baseline, setup)
    slides = bool(baseline.arm.prismatic.any())
    noise = noise_of_near_poses(readings, baseline.compared(readings).residual, slides)
    measured, group = readings.measured, reading_groups(readings)
    cov = mean_covariance(noise.cov, measured.components_seen, group)
    poses, held_out = complete(average_repeats(readings), baseline, setup), campaign.held_out
    floor_mm = mean_noise_error_mm(poses.measured, cov)
    compared = partial(gap, before=baseline, after=baseline, noise_floor_mm=floor_mm)
    x, covariance = np.concatenate([baseline.x, np.zeros(6)]), calibrated.covariance
    at = replace(baseline, model=with_base_motion(baseline), x=x)
    unknowns = len(x) + len(baseline.targets_m)
    return Verdict(
        prepared=campaign,
        scorer=NotSought(
            extended=ModelWithEffects(effects=(), at=at, converged=True, iterations=0),
            covariance=np.full((unknowns, unknowns), np.nan) if covariance is None else covariance,
            calibrated=calibrated,
            cov=cov,
        ),
        context=context_of(poses, baseline, setup),
        noise_floor_mm=floor_mm,
        noise_floor_from=noise.origin,
        train=compared(poses),
        holdout=None if held_out is None else compared(complete(held_out, baseline, setup)),
        why=reason.why,
        remedy=reason.remedy,
    )


def orientations_off(readings: Observations, baseline: FittedModel) -> CannotSearch | None:
    """Return that measured orientations are not the arm's, by convention say; None if they are."""
    for kind, columns in readings.measured.component_kinds:
        if not kind.startswith("attitude"):
            continue
        residual_rad = np.abs(baseline.compared(readings).residual[:, columns])
        seen = readings.measured.components_seen[:, columns]
        typical_rad = float(np.median(residual_rad[seen]))
        variance = np.diagonal(readings.measured.stated_covariance, axis1=1, axis2=2)[:, columns]
        stated_rad = float(np.sqrt(np.median(variance[seen])))
        if typical_rad > max(JUDGING.no_attitude_rad, stated_rad):
            return CannotSearch(
                f"the orientations are {np.degrees(typical_rad):.0f} deg off those of the "
                "calibrated model, typically",
                "check the order and the sense of qw, qx, qy, qz, and the findings of the "
                "calibration",
            )
    return None


def too_few_poses(readings: Observations, baseline: FittedModel) -> CannotSearch | None:
    """Return that poses or repeats are too few for a search judged by repeats; None if not."""
    repeats = repeated(readings)
    if repeats < NOISE.least_differences:
        return CannotSearch(
            f"{len(readings)} readings of calibration poses are too few to hold out blocks of "
            f"them, and with {repeats} repeats the repeatability is not known",
            f"measure at least {least_for_blocks(readings)} calibration poses, or repeat at least "
            f"{NOISE.least_differences} readings at the same pose, load and direction of "
            "arrival, moving the arm in between",
        )
    poses = len(np.unique(readings.pose))
    unknowns = open_unknowns(baseline.model) + 6 + len(baseline.targets_m)
    components = float(readings.measured.components_seen.sum(axis=1).mean())
    needed = int(np.ceil(JUDGING.rows_an_unknown * unknowns / components))
    if poses < needed:
        return CannotSearch(
            f"{poses} calibration poses are too few to separate an effect from the {unknowns} "
            "unknowns of the model",
            f"measure at least {needed} calibration poses, well spread over the joints' ranges",
        )
    return None
