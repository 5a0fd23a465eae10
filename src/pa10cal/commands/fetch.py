"""Command `fetch`."""

from __future__ import annotations

from pathlib import Path


def fetch(dataset: str, *, out: Path, source: str | None = None) -> None:
    """Fetch a public data set from its owner, of the pinned version, and check it.

    Under which licence it is, or that none is stated, is said before anything is fetched.

    Args:
        dataset: name of the data set.
        out: folder for its files.
        source: folder or address to take them from, if not where they are published.

    Examples:
        pa10cal fetch ipa-robot-accuracy --out data/ipa
        pa10cal fetch ipa-robot-accuracy --out data/ipa --source /media/copy
    """
    from pa10cal.datasets.dataset import dataset_named
    from pa10cal.datasets.importing import fetch as fetch_files

    asked = dataset_named(dataset)
    if asked.published is not None:
        print(asked.published.terms, flush=True)
    fetched = fetch_files(asked, out, source or None)
    print(f"{out}: {', '.join(fetched) or 'nothing to fetch'}; all checksums are right")
