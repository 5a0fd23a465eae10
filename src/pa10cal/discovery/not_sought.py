"""The verdict on a campaign that can be calibrated, and in which effects cannot be sought."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import ClassVar

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array
from pa10cal.discovery.gap import Gap, Named, gap
from pa10cal.discovery.lack_of_fit import CellResiduals, LackOfFit, lack_of_fit
from pa10cal.discovery.linear import mean_error_of_noise_mm, residual
from pa10cal.discovery.noise import Noise, mean_covariance, noise_of_near_poses
from pa10cal.discovery.preparation import Prepared, complete, context_of
from pa10cal.discovery.verdict import Plan, Verdict, Word
from pa10cal.discovery.with_effects import ModelWithEffects, with_base_term
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.averages import average_repeats, reading_groups
from pa10cal.observe.observations import Observations


@dataclass(frozen=True)
class TooLittle:
    """What a campaign lacks for a search, and what would do."""

    why: str
    remedy: str


@dataclass(frozen=True, eq=False, kw_only=True)
class NotSought(Verdict[object]):
    """A campaign in which effects cannot be sought: its calibrated model stays as it is."""

    reason: TooLittle  # what the campaign lacks
    calibrated: FittedModel  # the calibrated model
    poses: Observations  # the averaged poses of the fit, complete
    cov: Array  # (P, b, b) covariance of their components by noise
    noise: Noise  # of single readings: of nearly equal poses, or as stated

    method: ClassVar[None] = None

    @property
    @override
    def verdict(self) -> Word:
        return "not_sought"

    @property
    @override
    def why(self) -> str:
        return self.reason.why

    @property
    @override
    def remedy(self) -> str:
        return self.reason.remedy

    @property
    @override
    def covariance(self) -> Array:
        known = self.calibrated.covariance
        count = len(self.extended.at.x)
        return np.full((count, count), np.nan) if known is None else known

    @property
    @override
    def noise_floor_from(self) -> str:
        return self.noise.origin

    @cached_property
    @override
    def model(self) -> FittedModel:
        return self.calibrated

    @override
    def next_poses(self, count: int, random_seed: int = 0) -> Plan:
        return Plan(())

    @override
    def lack_of_fit(self) -> tuple[LackOfFit, LackOfFit]:
        found = lack_of_fit(CellResiduals.about(self.baseline, self.poses, self.cov))
        return found, found

    @override
    def errors_by_name(self) -> tuple[Named, ...]:
        return (
            Named(
                (),
                self.train.found_before,
                None if self.holdout is None else self.holdout.found_before,
            ),
        )

    @override
    def _repr_html_(self) -> str:
        return f"<p>effects were not sought: {escape(self.why)}; {escape(self.remedy)}</p>"


def not_sought(
    campaign: Prepared, calibrated: FittedModel, reason: TooLittle, error_rate: float
) -> NotSought:
    """Return the verdict on a campaign in which effects cannot be sought.

    Args:
        campaign: made ready.
        calibrated: the calibrated model, as it was given.
        reason: what the campaign lacks.
        error_rate: probability allowed of naming anything where nothing is missing.
    """
    # Weights other than described are unknowns of a search; here the model stays as it was given.
    campaign = replace(campaign, baseline=calibrated.with_bends())
    baseline, setup = campaign.baseline, campaign.setup
    readings = complete(campaign.trusted, baseline, setup)
    noise = noise_of_near_poses(readings, residual(baseline, readings))
    measured, group = readings.measured, reading_groups(readings)
    cov = mean_covariance(noise.cov, measured.components_seen, group)
    poses = complete(average_repeats(readings), baseline, setup)
    floor_mm = mean_error_of_noise_mm(poses.measured, cov)

    def unchanged(poses: Observations) -> Gap:
        return gap(poses, baseline, baseline, floor_mm)

    held_out = campaign.held_out
    x = np.concatenate([baseline.x, np.zeros(6)])
    return NotSought(
        prepared=campaign,
        context=context_of(poses, baseline, setup),
        error_rate=error_rate,
        candidates=0,
        findings=(),
        unexplained=(),
        not_testable=(),
        extended=ModelWithEffects((), replace(baseline, model=with_base_term(baseline), x=x), True),
        noise_floor_mm=floor_mm,
        train=unchanged(poses),
        holdout=None if held_out is None else unchanged(complete(held_out, baseline, setup)),
        steps=(),
        reason=reason,
        calibrated=calibrated,
        poses=poses,
        cov=cov,
        noise=noise,
    )
