"""What became of a campaign, from its results."""

from __future__ import annotations

from pathlib import Path

from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.fleet import ChainRecord, ChainStatus
from pa10cal.running.summary import summarise


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
