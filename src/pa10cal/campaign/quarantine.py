"""Rows of raw files that are not used, each with its file, line and reason."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RawDataError
from pa10cal.files.cells import csv_cell
from pa10cal.observe.observations import Observations


@dataclass(frozen=True, order=True)
class Quarantined:
    """One row that is not used."""

    file: str  # name of the raw file
    line: int  # line in it, the header being line 1
    reason: str  # why it is not used
    value: str = ""  # what was found, as text
    place: str = ""  # the configuration that it is of, in words; empty where that is not known


@dataclass(frozen=True)
class Ingested:
    """A campaign's readings and what is quarantined."""

    observations: Observations  # single readings of all kinds, in order of time
    quarantined: tuple[Quarantined, ...]  # rows that are not used, each once
    notes: tuple[str, ...]  # what the reader should know, one clause each
    warnings: tuple[str, ...] = ()  # what the reader should mend before going on, one sentence each
    timed: bool = True  # whether the file has a column of times


def quarantined(
    file: str,
    lines: NDArray[np.int64] | Sequence[int],
    reason: str,
    values: Iterable[object] | None = None,
    places: Iterable[object] | None = None,
) -> tuple[Quarantined, ...]:
    """List rows quarantined for one reason, with the value found in each, and its place."""
    found, there = (
        [""] * len(lines) if each is None else [str(value) for value in each]
        for each in (values, places)
    )
    return tuple(
        Quarantined(file, int(line), reason, value, place)
        for line, value, place in zip(lines, found, there, strict=True)
    )


def configurations(readings: Observations) -> list[str]:
    """Return which configurations readings are of, in words."""
    parts = (readings.pose, readings.states.load_N, readings.repeat)
    return [f"pose {pose}, {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]


def quarantine_csv(rows: Iterable[Quarantined]) -> str:
    """Return the quarantine table as CSV text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("file", "line", "reason", "value"))
    writer.writerows((row.file, row.line, row.reason, csv_cell(row.value)) for row in rows)
    return text.getvalue()


def joined_listings(listings: Mapping[str, Path]) -> str:
    """Return the quarantine tables of a group's campaigns as one, files by `campaign/file`.

    Args:
        listings: of each campaign by its name; one that is not there has no rows.
    """
    rows = []
    for name, path in listings.items():
        if path.is_file():
            with path.open(encoding="utf-8", newline="") as file:
                rows += [
                    Quarantined(
                        f"{name}/{row['file']}", int(row["line"]), row["reason"], row["value"]
                    )
                    for row in csv.DictReader(file)
                ]
    return quarantine_csv(rows)


def refuse_too_many(
    rows: Iterable[Quarantined], totals: dict[str, int], max_fraction: float
) -> None:
    """Stop when more of a file's rows are quarantined than the settings allow, or all of them.

    Args:
        rows: rows quarantined.
        totals: rows in each file.
        max_fraction: `ingest.max_quarantined_fraction`.

    Raises:
        RawDataError: naming the file, the commonest reason and the first line it struck.
    """
    by_file: dict[str, list[Quarantined]] = {name: [] for name in totals}
    for row in sorted(rows):
        by_file[row.file].append(row)
    for name, listed in by_file.items():
        if len(listed) <= max_fraction * totals[name] and len(listed) < totals[name]:
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        first = next(row for row in listed if row.reason == reason)
        columns = Counter(row.value.partition(" = ")[0] for row in listed if row.reason == reason)
        column, in_column = columns.most_common(1)[0]
        one = 2 * in_column > times and " = " in first.value
        look = f"look at column {column} first ({in_column} rows); " if one else ""
        raise RawDataError(
            f"{len(listed)} of {totals[name]} rows would be quarantined, "
            f"{times} of them because: {reason}",
            where=f"{name}:{first.line}",
            value=first.value or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=f"{look}correct the file, or raise the setting if the other rows suffice",
        )
