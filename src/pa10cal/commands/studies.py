"""Commands for studies: `coverage`, `curve`, `curve_calibration`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.curve.options import CurveOptions, CurveStudyOptions
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
    from pa10cal.lab.coverage import coverage_study, coverage_table
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
    import pandas as pd

    from pa10cal.curve.gait import curve_through, laid, shape_of
    from pa10cal.errors import SettingsError
    from pa10cal.files.curve_points import read_curve_points
    from pa10cal.files.output import whole_files
    from pa10cal.results.codec import write

    if points is not None and settings.curve is None:
        shape = curve_through(read_curve_points(points), settings.through)
    elif points is None and settings.curve is not None:
        shape = shape_of(settings.curve)
    else:
        raise SettingsError(
            "the curve is given twice or not at all",
            where="--points, curve",
            allowed="points, or a shape by name",
            remedy="give one of them",
        )
    record, tables = laid(shape, settings)
    paths = [*(out_dir / f"{name}.csv" for name in tables), out_dir / "curve.json"]
    with whole_files(*paths) as (*besides, record_beside):
        for beside, columns in zip(besides, tables.values(), strict=True):
            pd.DataFrame(columns).to_csv(beside, index=False, lineterminator="\n")
        write(record, record_beside)
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
