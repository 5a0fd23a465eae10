"""Stage: a picture, and a film, of what the stage `curve` found."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("draw_curve", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--curve-dir", type=Path, required=True, help="written by the stage curve")
    parser.add_argument("--movie", type=Path, help="film of the gait to write: .gif or .mp4")
    parser.add_argument("--settings", default="{}", help="section figures: JSON or YAML file")
    parser.add_argument(
        "--out-dir", type=Path, required=True, help="folder for curve_shape or curve_gait"
    )


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.figures import curve_gait, curve_shape
    from pa10cal.figures.curve_movie import write_movie
    from pa10cal.figures.curve_results import read_curve
    from pa10cal.figures.style import looks, write_figure
    from pa10cal.settings import FigureSettings, read_settings_argument

    settings = read_settings_argument(FigureSettings, arguments.settings)
    results = read_curve(arguments.curve_dir)
    module, name = (
        (curve_shape, "curve_shape") if len(results.time_s) == 1 else (curve_gait, "curve_gait")
    )
    with looks():
        if arguments.movie is not None:
            write_movie(results, arguments.movie, settings.png_dpi)
        figure = module.draw(results)
        write_figure(figure, results.footer, arguments.out_dir, name, settings.png_dpi)
    print(f"{arguments.curve_dir}: {name}" + (", film" if arguments.movie else ""))


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
