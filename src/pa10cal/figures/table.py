"""Tables: as CSV to compute with, as Markdown to read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pa10cal.files.output import whole_files, write_text
from pa10cal.files.table_cells import csv_text, markdown_cell, markdown_line
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


def _csv_column(column: pd.Series[Any]) -> list[object]:
    """Return the cells of a column, ten digits of a number."""
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column]
    known = column.astype(object).where(column.notna(), None).tolist()
    if column.dtype.kind != "f":
        return known
    return [None if value is None else f"{value:.10g}" for value in known]


def write_table(table: ResultTable, footer: str, folder: Path, name: str) -> None:
    """Write a table as CSV and Markdown: both or none.

    Args:
        table: to write; a part without rows says `none`.
        footer: where its data come from, below the title.
        folder: to write to.
        name: of the files.
    """
    columns = [_csv_column(column) for _, column in table.data.items()]
    parts = [f"# {markdown_line(table.title)}", markdown_line(footer)]
    cells = table.data.astype(object).where(table.data.notna(), "").astype(str).to_numpy()
    as_it_is = Grid("", tuple(table.data.columns), tuple(map(tuple, cells)))
    for grid in table.shown or (as_it_is,):
        none = ("none", *["–"] * (len(grid.header) - 1))
        header, *rows = (
            list(map(markdown_cell, row)) for row in (grid.header, *(grid.rows or [none]))
        )
        rows = [header, ["---"] * len(grid.header), *rows]
        parts += [f"## {markdown_line(grid.caption)}"] if grid.caption else []
        parts.append("\n".join(f"| {' | '.join(row)} |" for row in rows))
    if table.notes:
        parts.append("\n".join(f"- {markdown_line(note)}" for note in table.notes))
    with whole_files(folder / f"{name}.csv", folder / f"{name}.md") as (csv, markdown):
        write_text(csv, csv_text(table.data.columns, zip(*columns, strict=True)))
        write_text(markdown, "\n\n".join(parts) + "\n")
