"""Stage import: a data set of another layout to campaigns under the raw-data contract."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.settings import IngestSettings, read_settings_argument
from pa10cal.stages.command import limit_threads, run_stage

#: Rows left out that are shown one by one; all of them are in the campaign's left_out.csv.
SHOWN = 10


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("import", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", help="name of the data set")
    parser.add_argument("folder", type=Path, help="folder of its files")
    parser.add_argument("--out", type=Path, required=True, help="folder of campaigns to write to")
    parser.add_argument("--settings", default="{}", help="the ingest section: JSON or YAML file")
    parser.add_argument(
        "--any-version",
        action="store_true",
        help="take files that are not the published ones, and say so in the provenance",
    )


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.datasets.campaign_folder import write_campaigns
    from pa10cal.datasets.catalogue import dataset_named
    from pa10cal.datasets.importing import import_campaigns

    settings = read_settings_argument(IngestSettings, arguments.settings)
    campaigns = import_campaigns(
        dataset_named(arguments.dataset),
        arguments.folder,
        max_left_out=settings.max_quarantined_fraction,
        any_version=arguments.any_version,
    )
    places = write_campaigns(campaigns, arguments.out)
    for campaign, place in zip(campaigns, places, strict=True):
        parts = [f"{len(campaign.left_out)} rows left out", *campaign.notes]
        print(f"{place}: {'; '.join(parts)}")
        for row in campaign.left_out[:SHOWN]:
            print(f"  left out: {row.file}:{row.line}: {row.reason} {row.value}".rstrip())
        if len(campaign.left_out) > SHOWN:
            print(f"  … and {len(campaign.left_out) - SHOWN} more in {place / 'left_out.csv'}")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
