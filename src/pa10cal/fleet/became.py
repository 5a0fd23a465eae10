"""What became of a campaign, from its results."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.evaluation.options import EvaluationOptions
from pa10cal.options import BaseFrameOptions, DiscoveryOptions, IngestOptions, Section
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.fleet import ChainRecord, ChainStatus
from pa10cal.running.display import summarise


def became(results: Path, name: str, calibration: str) -> ChainRecord:
    """Return what a campaign that is done came to.

    Args:
        results: its folder.
        name: name of the campaign's folder.
        calibration: load case that was evaluated.

    Raises:
        RecordError: when a result is missing.
    """
    found = summarise(results, calibration)
    fitted = read(CalibrationRecord, results / f"calibration/{calibration}.json")
    _, *notes = found.notes
    return ChainRecord(
        campaign=name,
        status="done",
        robot=fitted.robot,
        provenance=fitted.provenance,
        grade=found.grade,
        line=fitted.health.line,
        verdict=found.verdict,
        notes=tuple(notes),
        before_mm=found.before,
        after_mm=found.after,
        over=found.over,
    )


def ended(name: str, status: ChainStatus, stage: str, message: str) -> ChainRecord:
    """Return what is known of a campaign that a stage ended."""
    return ChainRecord(campaign=name, status=status, stage=stage, message=message)


# The settings that a campaign reads on its way from raw files to a model.


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
