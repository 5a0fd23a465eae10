"""Command `coverage`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.evaluation.options import CoverageOptions


def coverage(
    *,
    out: Path,
    table: Path,
    settings: CoverageOptions = CoverageOptions(),
    calibration: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Count how often intervals hold the truth of simulated campaigns.

    Args:
        out: record to write (.json).
        table: the same in brief, to write (.csv).
        settings: section coverage.
        calibration: section calibration.

    Examples:
        pa10cal coverage --out coverage.json --table coverage.csv
    """
    from functools import partial

    from pa10cal.files.output import write_text
    from pa10cal.results.codec import write
    from pa10cal.studies.coverage import coverage_study, coverage_table

    record = coverage_study(settings, calibration, partial(print, flush=True))
    write_text(table, coverage_table(record))
    write(record, out)
