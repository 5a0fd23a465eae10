"""From the folder of a campaign to a verdict, in memory: all that judging a trial may know."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import Calibration, calibrate, fitted_model
from pa10cal.calibration.campaign import calibration_record
from pa10cal.calibration.load_case import COMBINED
from pa10cal.calibration.options import CalibrationOptions, takes_general_model
from pa10cal.calibration.uncertainty import ErrorSources, deviations
from pa10cal.campaign.read import Campaign, read_campaign
from pa10cal.discovery.discover import discover
from pa10cal.discovery.preparation import setup_of
from pa10cal.discovery.records import verdict_keys
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.fit.fitted_model import FittedModel, models_of
from pa10cal.observe.observations import average_repeats, poses_of
from pa10cal.observe.seed import locate_base
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.trials import JudgedTrialRecord
from pa10cal.terms.joint_spring import JointSpring, baseline


@dataclass(frozen=True)
class CalibratedCampaign:
    """A campaign with its calibrated model, ready to be judged."""

    campaign: Campaign  # as it was read
    model: FittedModel  # fitted to all its loads
    residual_mm: Array  # (C, 3) what the model leaves at averaged grid poses, along the base axes
    seconds: float  # of the processor that reading and calibrating took
    options: JudgingOptions  # by which it is judged

    def verdict(self, seconds_simulating: float) -> JudgedTrialRecord:
        """Return the verdict, without suggestions.

        Args:
            seconds_simulating: time that simulating the campaign took.
        """
        began = time.process_time()
        campaign, options, terms = self.campaign, self.options, self.model.model.terms
        setup = setup_of(campaign.description, campaign.arm, options.calibration, options.discovery)
        every, wrong = campaign.observations, campaign.wrong_rows
        found = discover(every, self.model, setup, wrong)
        return JudgedTrialRecord(
            **dict(verdict_keys(found)),
            campaign=campaign.name,
            springs=tuple(term.joint for term in terms if isinstance(term, JointSpring)),
            seconds=self.seconds + time.process_time() - began,
            seconds_simulating=seconds_simulating,
        )


def calibrated_campaign(raw: Path, options: JudgingOptions) -> CalibratedCampaign:
    """Read a raw campaign and calibrate it on all its loads.

    Touched balls are calibrated with the paper's model, all else with the general one.

    Args:
        raw: folder of the campaign.
        options: how to ingest, to calibrate and to judge.

    Raises:
        RawDataError: when the campaign cannot be read.
        CalibrationError: when it is not enough to calibrate with.
    """
    began = time.process_time()
    campaign = read_campaign(raw, options.ingest)
    settings = options.calibration
    if campaign.description.instrument.type.from_touches:
        found = _papers(campaign, settings)
        model = fitted_model(found, campaign.description.payload(campaign.arm))
        poses = poses_of(campaign.observations, covariance="instrument")
        T_base_ee = model.model.predict(poses.states, model.x)
        residual_mm = deviations(T_base_ee, model.T_instr_base, poses).position_mm
    else:
        record = record_of(campaign, settings)
        *_, model = models_of(record, campaign.name).values()
        residual_mm = record.residuals.position_mm
    return CalibratedCampaign(campaign, model, residual_mm, time.process_time() - began, options)


def record_of(
    campaign: Campaign, settings: CalibrationOptions, load: str = COMBINED
) -> CalibrationRecord:
    """Locate base and targets of a campaign, and calibrate a load case.

    Args:
        campaign: as it was read.
        settings: with which model, and how.
        load: `combined` for all loads together, or a load such as `44N`.

    Raises:
        CalibrationError: when it is not enough to calibrate with.
    """
    said, every = campaign.description, campaign.observations
    seed = locate_base(
        every, campaign.arm, BaseFrameOptions(), campaign.folder, said.name, said.provenance
    )
    general = takes_general_model(settings.model, from_touches=said.instrument.type.from_touches)
    return calibration_record(said, campaign.arm, every, seed, load, settings, general=general)


def _papers(campaign: Campaign, settings: CalibrationOptions) -> Calibration:
    """Calibrate from the nominal arm, and from more starts where that does not converge."""
    readings = poses_of(campaign.observations, average=False)
    poses = average_repeats(readings)
    model = baseline(
        campaign.arm,
        settings.flexible_joints,
        settings.tolerances,
        tau_ref_Nm=np.abs(poses.states.tau_Nm).max(axis=0),
    )
    errors = ErrorSources(readings, 1e-3 * settings.apparatus_uncertainty_mm)
    found = calibrate(model, poses, settings.model_copy(update={"starts": 1}), errors)
    return found if found.converged else calibrate(model, poses, settings, errors)
