"""Commands `curve` and `curve_calibration`.

The table of commands of `pa10cal` names them; what takes time is imported when one is called.
"""

from __future__ import annotations

from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal_curve.options import CurveOptions, CurveStudyOptions


def curve(*, settings: CurveOptions, out_dir: Path, points: Path | None = None) -> None:
    """Lay a chain of links along a curve, and compute its joint angles and how it moves.

    Args:
        settings: curve, link_m, links, roll, limits, gait, arm.
        out_dir: folder for curve.json, angles.csv, points.csv, links.csv and shape.csv; with an
            arm also joints.csv and arms/NAME.yaml.
        points: points of the curve (.csv): x_m,y_m,z_m or x_mm,y_mm,z_mm.

    Examples:
        pa10cal curve --out-dir helix --settings '{"curve": {"shape": "helix", "radius_m": 0.2, \\
          "pitch_m": 0.4, "turns": 1.5}, "link_m": 0.1}'
    """
    from pa10cal_curve.tables import write_curve

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
    from pa10cal.results.codec import write
    from pa10cal_curve.study import chain_study

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
