"""Rows of raw files that were left out, each with its file, line and reason."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RawDataError


@dataclass(frozen=True, order=True)
class LeftOut:
    """One row that was left out.

    Attributes:
        file: name of the raw file.
        line: line in it, the header being line 1.
        reason: why it was left out.
        value: what was found, as text.
    """

    file: str
    line: int
    reason: str
    value: str = ""


def left_out(
    file: str,
    lines: NDArray[np.int64] | Sequence[int],
    reason: str,
    values: Iterable[object] | None = None,
) -> tuple[LeftOut, ...]:
    """List rows left out for one reason, with the value found in each."""
    found = [""] * len(lines) if values is None else [str(value) for value in values]
    return tuple(
        LeftOut(file, int(line), reason, value) for line, value in zip(lines, found, strict=True)
    )


def quarantine_csv(rows: Iterable[LeftOut]) -> str:
    """Return the quarantine table as CSV text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("file", "line", "reason", "value"))
    writer.writerows((row.file, row.line, row.reason, row.value) for row in rows)
    return text.getvalue()


def refuse_too_many(rows: Iterable[LeftOut], totals: dict[str, int], max_fraction: float) -> None:
    """Stop when more of a file's rows are left out than the settings allow, or all of them.

    Args:
        rows: rows left out.
        totals: rows in each file.
        max_fraction: `ingest.max_quarantined_fraction`.

    Raises:
        RawDataError: naming the file, the commonest reason and the first line it struck.
    """
    by_file: dict[str, list[LeftOut]] = {name: [] for name in totals}
    for row in sorted(rows):
        by_file[row.file].append(row)
    for name, listed in by_file.items():
        if len(listed) <= max_fraction * totals[name] and len(listed) < totals[name]:
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        first = next(row.line for row in listed if row.reason == reason)
        raise RawDataError(
            f"{len(listed)} of {totals[name]} rows would be left out, "
            f"{times} of them because: {reason}",
            where=f"{name}:{first}",
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy="mend the file, or raise the setting if the rest is enough",
        )
