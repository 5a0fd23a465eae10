"""The settings that a campaign reads on its way from raw files to a model."""

from __future__ import annotations

from pydantic import Field

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.options import IngestOptions
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.evaluation.options import EvaluationOptions
from pa10cal.frame.options import BaseFrameOptions
from pa10cal.settings_section import Section


class ChainOptions(Section):
    """The settings of every stage from raw files to a model."""

    ingest: IngestOptions = Field(IngestOptions(), description="raw logs to a table of poses")
    base_frame: BaseFrameOptions = Field(
        BaseFrameOptions(), description="from the straight-line moves"
    )
    calibration: CalibrationOptions = Field(
        CalibrationOptions(), description="two levels, and the general model"
    )
    evaluation: EvaluationOptions = Field(
        EvaluationOptions(), description="held-out points and loads"
    )
    discovery: DiscoveryOptions = Field(
        DiscoveryOptions(), description="the search for missing effects"
    )
