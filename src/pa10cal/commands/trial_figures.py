"""Command `trial_figures`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.figures.options import FigureOptions


def trial_figures(
    *, figure: str, scores: Path, out_dir: Path, settings: FigureOptions = FigureOptions()
) -> None:
    """Draw one figure or table of blind trials.

    Args:
        figure: name of a figure or table.
        scores: scores of the trials (.json).
        out_dir: folder for the figure or table.
        settings: section figures.
    """
    from pa10cal.figures.catalogue import TRIAL_FIGURES, TRIAL_TABLES
    from pa10cal.figures.trial_scores import read_scores
    from pa10cal.stages.study_pictures import draw_picture

    draw_picture(
        figure,
        out_dir,
        settings.png_dpi,
        TRIAL_FIGURES,
        TRIAL_TABLES,
        lambda: read_scores(scores),
        "blind trials",
    )
