"""Stage: one figure or table of a campaign, drawn from its results."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("figures", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--figure", required=True, help="name of a figure or table")
    parser.add_argument("--campaign-dir", type=Path, required=True, help="folder of raw files")
    parser.add_argument("--results-dir", type=Path, required=True, help="results of this campaign")
    parser.add_argument(
        "--settings",
        default="{}",
        help="sections figures, kcub_reading, montecarlo and evaluation: JSON or YAML file",
    )
    parser.add_argument("--out-dir", type=Path, required=True)


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.campaign.description import read_campaign
    from pa10cal.errors import SettingsError
    from pa10cal.figures.catalogue import FIGURES, TABLES
    from pa10cal.figures.results import PictureSettings, Results
    from pa10cal.settings import read_settings_argument

    name = arguments.figure
    if name not in (*FIGURES, *TABLES):
        raise SettingsError(
            "no such figure or table",
            where="--figure",
            value=name,
            allowed=", ".join((*FIGURES, *TABLES)),
            remedy="correct the name",
        )
    settings = read_settings_argument(PictureSettings, arguments.settings)
    campaign = read_campaign(arguments.campaign_dir)
    results = Results(
        folder=arguments.results_dir,
        raw=arguments.campaign_dir,
        campaign=campaign.name,
        provenance=campaign.provenance,
        robot=campaign.robot,
        instrument=campaign.instrument.kind,
        instrument_uncertainty_mm=campaign.instrument.uncertainty_mm,
        settings=settings,
    )
    # By name, so that a picture is drawn anew only when its own module changes.
    module = import_module(f"pa10cal.figures.{name}")
    if name in TABLES:
        from pa10cal.figures.table import write_table

        write_table(module.tabulate(results), results.footer, arguments.out_dir, name)
    else:
        from pa10cal.figures.style import looks, write_figure

        with looks():
            figure = module.draw(results)
            write_figure(figure, results.footer, arguments.out_dir, name, settings.figures.png_dpi)
    print(f"{campaign.name}: {name}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
