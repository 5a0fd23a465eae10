"""Command `draw_curve_calibration`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.figures.options import FigureOptions


def draw_curve_calibration(
    *, figure: str, record: Path, out_dir: Path, settings: FigureOptions = FigureOptions()
) -> None:
    """Draw one figure or table of the chain calibrated along curves.

    Args:
        figure: name of a figure or table.
        record: what the command curve_calibration wrote (.json).
        out_dir: folder for the figure or table.
        settings: section figures.
    """
    from pa10cal.figures.catalogue import CURVE_FIGURES, CURVE_TABLES
    from pa10cal.figures.curve_calibration_results import read_curve_study
    from pa10cal.stages.study_pictures import draw_picture

    draw_picture(
        figure,
        out_dir,
        settings.png_dpi,
        CURVE_FIGURES,
        CURVE_TABLES,
        lambda: read_curve_study(record),
        "chain along curves",
    )
