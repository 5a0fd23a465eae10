"""The arm of a campaign calibrated in memory, without the checks of its input."""

from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.load_case import LoadCase
from pa10cal.fit.fitted_model import models_of


def calibrated(campaign, *readings_and_options, **more):
    """Return the fitted model; see `calibrated_record`."""
    record = calibrated_record(LoadCase(campaign, *readings_and_options, **more))
    *_, model = models_of(record, campaign.name).values()
    return model
