"""Stage: one figure or table of the study of a chain posed along curves."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage
from pa10cal.stages.study_pictures import describe_picture, draw_picture


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("draw_curve_calibration", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    describe_picture(parser)
    parser.add_argument("--record", type=Path, required=True, help="of stage curve_calibration")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.figures.catalogue import CURVE_FIGURES, CURVE_TABLES
    from pa10cal.figures.curve_calibration_results import read_curve_study

    draw_picture(
        arguments,
        CURVE_FIGURES,
        CURVE_TABLES,
        lambda: read_curve_study(arguments.record),
        "chain along curves",
    )


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
