"""Stage: one figure or table of the study of a chain posed along curves."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("draw_curve_calibration", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--figure", required=True, help="name of a figure or table of the study")
    parser.add_argument("--record", type=Path, required=True, help="of stage curve_calibration")
    parser.add_argument("--settings", default="{}", help="section figures: JSON or YAML file")
    parser.add_argument("--out-dir", type=Path, required=True)


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.errors import SettingsError
    from pa10cal.figures.catalogue import CURVE_FIGURES, CURVE_TABLES
    from pa10cal.figures.curve_calibration_results import read_curve_study
    from pa10cal.settings import FigureSettings, read_settings_argument

    name = arguments.figure
    if name not in (*CURVE_FIGURES, *CURVE_TABLES):
        raise SettingsError(
            "no such figure or table of the chain",
            where="--figure",
            value=name,
            allowed=", ".join((*CURVE_FIGURES, *CURVE_TABLES)),
            remedy="correct the name",
        )
    settings = read_settings_argument(FigureSettings, arguments.settings)
    study = read_curve_study(arguments.record)
    module = import_module(f"pa10cal.figures.{name}")
    if name in CURVE_TABLES:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(study), study.footer, arguments.out_dir, name)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            figure = module.draw(study)
            write_figure(figure, study.footer, arguments.out_dir, name, settings.png_dpi)
    print(f"chain along curves: {name}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
