"""The arm of a campaign, or of poses, calibrated in memory, without the checks of its input."""

from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.files.arms import load_arm
from pa10cal.fit.model_reading import models_of


def calibrated(campaign, *readings_and_options, **more):
    """Return the fitted model; see `calibrated_record`."""
    record = calibrated_record(LoadCase(campaign, *readings_and_options, **more))
    *_, model = models_of(record, campaign.name).values()
    return model


def general(arm, every, payload=None, **options):
    """Return the general calibration of an arm, or of one by name, from frames found by it."""
    arm = load_arm(arm) if isinstance(arm, str) else arm
    start = find_start(arm, every)
    return calibrate_general(arm, every, start, payload, CalibrationOptions(**options))
