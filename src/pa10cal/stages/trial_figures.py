"""Stage: one figure or table of a study of blind trials, drawn from its scores."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("trial_figures", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--figure", required=True, help="name of a figure or table of trials")
    parser.add_argument("--scores", type=Path, required=True, help="scores of the trials")
    parser.add_argument("--settings", default="{}", help="section figures: JSON or YAML file")
    parser.add_argument("--out-dir", type=Path, required=True)


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.errors import SettingsError
    from pa10cal.figures.catalogue import TRIAL_FIGURES, TRIAL_TABLES
    from pa10cal.figures.trial_scores import read_scores
    from pa10cal.settings import FigureSettings, read_settings_argument

    name = arguments.figure
    if name not in (*TRIAL_FIGURES, *TRIAL_TABLES):
        raise SettingsError(
            "no such figure or table of blind trials",
            where="--figure",
            value=name,
            allowed=", ".join((*TRIAL_FIGURES, *TRIAL_TABLES)),
            remedy="correct the name",
        )
    settings = read_settings_argument(FigureSettings, arguments.settings)
    scores = read_scores(arguments.scores)
    # By name, so that a picture is drawn anew only when its own module changes.
    module = import_module(f"pa10cal.figures.{name}")
    if name in TRIAL_TABLES:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(scores), scores.footer, arguments.out_dir, name)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            figure = module.draw(scores)
            write_figure(figure, scores.footer, arguments.out_dir, name, settings.png_dpi)
    print(f"blind trials: {name}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
