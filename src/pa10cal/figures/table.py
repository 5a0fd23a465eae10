"""Tables: as CSV to compute with, as Markdown to read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pa10cal.files.output import csv_cell, markdown_cell, whole_files, write_text
from pa10cal.reports.blocks import Grid

Row = tuple[str, ...]


@dataclass(frozen=True)
class ResultTable:
    """A table of results."""

    title: str  # what it shows
    data: pd.DataFrame  # the CSV; what is not known is missing
    # what Markdown shows; empty where it is the data as they are
    shown: tuple[Grid, ...] = ()
    notes: tuple[str, ...] = ()  # said below it


def figures(value: float | None, count: int) -> float:
    """Return a number with so many significant figures, nan for None."""
    return math.nan if value is None else float(f"{value:.{count}g}")


def frame_of(header: Sequence[str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Return rows under a header, each as long as it."""
    return pd.DataFrame([list(row) for row in rows], columns=list(header))


def write_table(table: ResultTable, footer: str, folder: Path, name: str) -> None:
    """Write a table as CSV and Markdown: both or none.

    Args:
        table: to write; a part without rows says `none`.
        footer: where its data come from, below the title.
        folder: to write to.
        name: of the files.
    """
    data = table.data.copy()
    for column in data.select_dtypes("bool"):
        data[column] = data[column].map({True: "true", False: "false"})
    for column in data.select_dtypes(["object", "str"]):
        data[column] = data[column].map(csv_cell)
    parts = [f"# {table.title}", footer]
    cells = table.data.astype(object).where(table.data.notna(), "").astype(str).to_numpy()
    as_it_is = Grid("", tuple(table.data.columns), tuple(map(tuple, cells)))
    for grid in table.shown or (as_it_is,):
        none = ("none", *["–"] * (len(grid.header) - 1))
        rows = [grid.header, ["---"] * len(grid.header), *(grid.rows or [none])]
        parts += [f"## {grid.caption}"] if grid.caption else []
        parts.append("\n".join(f"| {' | '.join(map(markdown_cell, row))} |" for row in rows))
    if table.notes:
        parts.append("\n".join(f"- {note}" for note in table.notes))
    with whole_files(folder / f"{name}.csv", folder / f"{name}.md") as (csv, markdown):
        write_text(csv, data.to_csv(index=False, float_format="%.10g", lineterminator="\n"))
        write_text(markdown, "\n\n".join(parts) + "\n")
