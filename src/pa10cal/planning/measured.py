"""A glance at a table of poses: what of it decides which pictures there are."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def has_held_out(poses: Path) -> bool:
    """Tell whether poses were held out.

    Args:
        poses: the table that ingest wrote (`ingest/poses.parquet`).
    """
    return any(row["kind"] == "holdout" for row in _rows(poses, "kind"))


def has_repeats(poses: Path) -> bool:
    """Tell whether a pose was measured at a load more than once, among those to be fitted.

    Args:
        poses: the table that ingest wrote (`ingest/poses.parquet`).
    """
    grid = [
        (row["pose"], row["load_N"])
        for row in _rows(poses, "kind", "pose", "load_N")
        if row["kind"] == "grid"
    ]
    return len(set(grid)) < len(grid)


def _rows(poses: Path, *columns: str) -> list[dict[str, Any]]:
    import pyarrow.parquet as pq  # late: most plans need no table

    found: list[dict[str, Any]] = pq.read_table(poses, columns=list(columns)).to_pylist()
    return found
