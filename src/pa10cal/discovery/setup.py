"""What the search needs to know of a campaign, from its description and the settings."""

from __future__ import annotations

from pa10cal.arm.description import Arm
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.description import CampaignDescription
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.discovery.preparation import MeasurementSetup

MM = 1e-3


def setup_of(
    campaign: CampaignDescription,
    arm: Arm,
    calibration: CalibrationOptions,
    discovery: DiscoveryOptions,
) -> MeasurementSetup:
    """Return what the search needs to know besides the poses."""
    return MeasurementSetup(
        payload=campaign.payload(arm),
        p_ee_targets_m=MM * campaign.p_ee_balls_mm,
        reference_temperature_C=campaign.reference_temperature_C,
        apparatus_m=MM * calibration.apparatus_uncertainty_mm,
        options=discovery,
        commanded=campaign.joints == "commanded",
    )
