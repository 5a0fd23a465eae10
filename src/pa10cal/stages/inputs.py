"""Reads what stages need of earlier ones: a measured campaign, its calibration, its extended model.

Not among the commands, whose modules import nothing that takes time until a command is called.
"""

from __future__ import annotations

from pathlib import Path

from pa10cal.arm.description import Arm
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.description import CampaignDescription, read_description
from pa10cal.campaign.table import arm_of, read_observations
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.verdict_records import Extended
from pa10cal.fit.covariance_file import covariance_beside
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.logged_torques import without_torque_errors
from pa10cal.fit.model_reading import model_from_plain, models_of
from pa10cal.observe.observations import Observations
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord
from pa10cal.settings_reading import parse_section


def read_measured(folder: Path, poses: Path) -> tuple[CampaignDescription, Arm, Observations]:
    """Read a campaign's description, its arm with weights, and its table of poses.

    Zeros that logged torques show are taken out of these.

    Raises:
        Pa10calError: when one of them cannot be used.
    """
    campaign = read_description(folder)
    observations = read_observations(poses, campaign)
    arm = arm_of(campaign, folder, observations)
    return campaign, arm, without_torque_errors(observations, arm)


def read_calibrated(
    path: Path, campaign: str | None = None
) -> tuple[CalibrationRecord, dict[str, FittedModel], CalibrationOptions]:
    """Read a calibration: its record, its models by name, its own last, and its options.

    Raises:
        RecordError: when it is of another campaign or lacks a key.
        SettingsError: when its options are not such.
        ModelError: when a model cannot be made of what is written.
        TermError: when it has a term that is not known.
    """
    record = read(CalibrationRecord, path, campaign)
    options = parse_section(CalibrationOptions, record.settings, where=str(path))
    return record, models_of(record, str(path)), options


def read_extended(path: Path, campaign: str) -> Extended:
    """Read `discovery/extended.json` and the covariance beside it.

    Raises:
        RecordError: when it is of another campaign or lacks a key.
        ModelError: when its model cannot be made of what is written.
        TermError: when it has a term that is not known.
    """
    record = read(ExtendedRecord, path, campaign)
    model = model_from_plain(
        record.fitted_model,
        where=f"{path}: fitted_model",
        covariance=covariance_beside(path),
    )
    seen = model.seen if record.angles_seen is not None else None
    moved = None if record.moved_zeros is None else MovedZeros.of_record(record.moved_zeros)
    return Extended(model, seen, record.steps_s or (), moved)
