"""Stage: one figure or table of a study of blind trials, drawn from its scores."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage
from pa10cal.stages.study_pictures import describe_picture, draw_picture


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("trial_figures", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    describe_picture(parser)
    parser.add_argument("--scores", type=Path, required=True, help="scores of the trials")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.figures.catalogue import TRIAL_FIGURES, TRIAL_TABLES
    from pa10cal.figures.trial_scores import read_scores

    draw_picture(
        arguments,
        TRIAL_FIGURES,
        TRIAL_TABLES,
        lambda: read_scores(arguments.scores),
        "blind trials",
    )


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
