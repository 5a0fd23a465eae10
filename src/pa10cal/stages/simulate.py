"""Write a campaign with the virtual cell."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.settings import SimulateSettings, read_settings_argument
from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage on `argv` and return its exit code."""
    return run_stage("simulate", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--name", required=True, help="name of the campaign")
    parser.add_argument("--settings", default="{}", help="settings section simulate.<name>")
    parser.add_argument(
        "--kcub-reading",
        choices=("text_e7", "table_e8"),
        default="text_e7",
        help="exponent of the paper's cubic stiffness",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the campaign")
    parser.add_argument("--truth", type=Path, required=True, help="file for what is hidden")


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.cell.campaign import simulate_campaign
    from pa10cal.cell.sighted import measure_sighted
    from pa10cal.cell.sighted_write import write_sighted
    from pa10cal.cell.write import write_campaign
    from pa10cal.files.arms import load_arm

    settings = read_settings_argument(SimulateSettings, arguments.settings)
    arm = load_arm(settings.robot)
    if settings.without_touches is not None:
        sighted = measure_sighted(arm, settings.without_touches, settings.random_seed)
        write_sighted(sighted, arguments.out, arguments.name, arguments.truth)
    else:
        campaign = simulate_campaign(arguments.name, arm, settings, arguments.kcub_reading)
        write_campaign(campaign, arguments.out, arguments.truth)
    print(f"{arguments.name}: {arm.title} in {arguments.out}, what is hidden in {arguments.truth}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
