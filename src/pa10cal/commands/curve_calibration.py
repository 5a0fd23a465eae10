"""Command `curve_calibration`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.curve.options import CurveStudyOptions


def curve_calibration(
    *,
    out: Path,
    settings: CurveStudyOptions = CurveStudyOptions(),
    calibration: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Calibrate a chain of links posed along curves, in the virtual cell.

    Args:
        out: record to write (.json).
        settings: section curve.
        calibration: section calibration.

    Examples:
        pa10cal curve_calibration --out calibration.json
    """
    from pa10cal.results.codec import write
    from pa10cal.studies.chain import chain_study

    record = chain_study(settings, calibration)
    write(record, out)
    for each in record.summaries:
        fitted, held_out = each.fitted, each.held_out
        print(
            f"{each.departs}, {each.model}: rank {each.rank} of {each.unknowns}, "
            f"{each.converged} of {each.individuals} converged; mean error over the noise "
            f"floor {fitted.mean:.2f} ({fitted.largest:.2f} at most) fitted, "
            f"{held_out.mean:.2f} ({held_out.largest:.2f}) held out"
        )
