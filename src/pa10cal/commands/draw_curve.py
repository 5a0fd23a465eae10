"""Command `draw_curve`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.figures.options import FigureOptions


def draw_curve(
    *,
    curve_dir: Path,
    out_dir: Path,
    movie: Path | None = None,
    settings: FigureOptions = FigureOptions(),
) -> None:
    """Draw what the command curve found, or show it moving.

    Args:
        curve_dir: folder that the command curve wrote.
        out_dir: folder for curve_shape or curve_gait.
        movie: film of the gait to write: .gif or .mp4.
        settings: section figures.
    """
    from pa10cal.figures import curve_gait, curve_shape
    from pa10cal.figures.curve_movie import write_movie
    from pa10cal.figures.curve_results import read_curve
    from pa10cal.figures.style import looks, write_figure

    results = read_curve(curve_dir)
    module, name = (
        (curve_shape, "curve_shape") if len(results.time_s) == 1 else (curve_gait, "curve_gait")
    )
    with looks():
        if movie is not None:
            write_movie(results, movie, settings.png_dpi)
        figure = module.draw(results)
        write_figure(figure, results.footer, out_dir, name, settings.png_dpi)
    print(f"{curve_dir}: {name}" + (", film" if movie else ""))
