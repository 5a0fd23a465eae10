"""From the folder of touched balls to a verdict, in memory: what judging a trial may know."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.calibration.accuracy import deviations
from pa10cal.calibration.calibrate import Calibration, calibrate
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.records import fitted_model
from pa10cal.calibration.uncertainty import ErrorSources
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.read import read_campaign
from pa10cal.discovery.discover import discover
from pa10cal.discovery.records import verdict_keys
from pa10cal.discovery.setup import setup_of
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.observe.averages import average_repeats, poses_of
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.results.trials import JudgedTrialRecord
from pa10cal.terms.baseline import baseline

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TouchedCampaign:
    """A campaign of touched balls with its calibrated baseline.

    Attributes:
        campaign: its description.
        arm: the nominal arm.
        every: single readings of all kinds, with the instrument's covariance.
        calibration: cubic model on all loads.
        seconds: that this took.
        options: by which it is judged.
    """

    campaign: CampaignDescription
    arm: Arm
    every: Observations
    calibration: Calibration
    seconds: float
    options: JudgingOptions

    @property
    def residual_mm(self) -> Array:
        """Return the baseline's residual at averaged grid poses, along the base axes, (C, 3)."""
        poses = poses_of(self.every, covariance="instrument")
        found = self.calibration
        T_base_ee = found.level.model.predict(poses.states, found.solution.x)
        return deviations(T_base_ee, found.T_instr_base, poses).position_mm

    def verdict(self, seconds_simulating: float) -> JudgedTrialRecord:
        """Return the verdict, without suggestions.

        Args:
            seconds_simulating: time that simulating the campaign took.

        Raises:
            DiscoveryError: when the data do not allow a search.
        """
        began = time.perf_counter()
        options = self.options
        setup = setup_of(self.campaign, self.arm, options.calibration, options.discovery)
        found = discover(self.every, fitted_model(self.calibration, setup.payload), setup)
        return JudgedTrialRecord(
            **dict(verdict_keys(found)),
            campaign=self.campaign.name,
            springs=options.calibration.flexible_joints,
            seconds=self.seconds + time.perf_counter() - began,
            seconds_simulating=seconds_simulating,
        )


@contextmanager
def touched_campaign(raw: Path, options: JudgingOptions) -> Iterator[TouchedCampaign]:
    """Ingest a raw campaign and calibrate the cubic model on all its loads.

    Args:
        raw: folder of the campaign.
        options: how to ingest, to calibrate and to judge.

    Raises:
        RawDataError: when the campaign cannot be read.
        CalibrationError: when it is not enough to calibrate with.
    """
    began = time.perf_counter()
    campaign = read_campaign(raw, options.ingest)
    every = campaign.observations
    calibration = _calibrate(campaign.arm, poses_of(every, average=False), options.calibration)
    yield TouchedCampaign(
        campaign=campaign.description,
        arm=campaign.arm,
        every=every,
        calibration=calibration,
        seconds=time.perf_counter() - began,
        options=options,
    )


def _calibrate(arm: Arm, readings: Observations[Pose], settings: CalibrationOptions) -> Calibration:
    """Calibrate from the nominal arm, and from more starts where that does not converge."""
    poses = average_repeats(readings)
    model = baseline(
        arm,
        settings.flexible_joints,
        settings.tolerances,
        tau_ref_Nm=np.abs(poses.states.tau_Nm).max(axis=0),
    )
    errors = ErrorSources(readings, 1e-3 * settings.apparatus_uncertainty_mm)
    found = calibrate(model, poses, settings.model_copy(update={"starts": 1}), errors)
    return found if found.converged else calibrate(model, poses, settings, errors)
