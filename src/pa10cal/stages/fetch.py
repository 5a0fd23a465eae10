"""Stage fetch: the files of a public data set, of the pinned version and checked."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pa10cal.stages.command import limit_threads, run_stage


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage and return its exit code."""
    return run_stage("fetch", _describe, _run, argv)


def _describe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", help="name of the data set")
    parser.add_argument("--out", type=Path, required=True, help="folder for its files")
    parser.add_argument(
        "--source", help="folder or address to take them from, if not where they are published"
    )


def _run(arguments: argparse.Namespace) -> None:
    from pa10cal.datasets.catalogue import dataset_named
    from pa10cal.datasets.fetching import fetch

    dataset = dataset_named(arguments.dataset)
    fetched = fetch(dataset, arguments.out, arguments.source or None)
    print(f"{arguments.out}: {', '.join(fetched) or 'nothing to fetch'}; all checksums are right")


if __name__ == "__main__":
    limit_threads()
    sys.exit(main())
