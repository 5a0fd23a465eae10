"""Commands for studies: `coverage`, `curve`, `curve_calibration`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.curve.options import CurveOptions
from pa10cal.evaluation.options import CoverageOptions, CurveStudyOptions


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
    from pa10cal.lab.simulated import coverage_study, coverage_table
    from pa10cal.results.codec import write

    record = coverage_study(settings, calibration, partial(print, flush=True))
    write_text(table, coverage_table(record))
    write(record, out)


def curve(*, settings: CurveOptions, out_dir: Path, points: Path | None = None) -> None:
    """Lay a chain of links along a curve, and compute its joint angles and how it moves.

    Args:
        settings: curve, link_m, links, roll, limits, gait.
        out_dir: folder for curve.json, angles.csv, points.csv, links.csv and shape.csv.
        points: points of the curve (.csv): x_m,y_m,z_m or x_mm,y_mm,z_mm.

    Examples:
        pa10cal curve --out-dir helix --settings '{"curve": {"shape": "helix", "radius_m": 0.2, \\
          "pitch_m": 0.4, "turns": 1.5}, "link_m": 0.1}'
    """
    from pa10cal.curve.tables import write_curve

    record = write_curve(settings, points, out_dir)
    print(f"{out_dir}: {record.line}")


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
    from pa10cal.curve.study import chain_study
    from pa10cal.results.codec import write

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
