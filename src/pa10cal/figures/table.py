"""Tables: as CSV to compute with, as Markdown to read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pa10cal.files.output import csv_cell, markdown_cell, whole_files, write_text
from pa10cal.reports.blocks import Grid

Row = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table of results."""

    title: str  # what it shows
    data: pd.DataFrame  # the CSV; what is not known is missing
    # what Markdown shows; empty where it is the data as they are
    shown: tuple[Grid, ...] = ()
    notes: tuple[str, ...] = ()  # said below it


def frame_of(header: Sequence[str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Return rows under a header, each as long as it."""
    return pd.DataFrame([list(row) for row in rows], columns=list(header))


def _parts(table: Table) -> Iterator[tuple[str, Row, Sequence[Row]]]:
    """Yield caption, header and rows of what is shown; a row says where there are none."""
    cells = table.data.astype(object).where(table.data.notna(), "")
    rows = tuple(tuple(map(str, row)) for row in cells.to_numpy())
    as_it_is = (Grid("", tuple(table.data.columns), rows),)
    for part in table.shown or as_it_is:
        none = ("none", *["–"] * (len(part.header) - 1))
        yield part.caption, part.header, part.rows or [none]


def write_table(table: Table, footer: str, folder: Path, name: str) -> None:
    """Write a table as CSV and Markdown: both or none."""
    with whole_files(folder / f"{name}.csv", folder / f"{name}.md") as (data, shown):
        write_text(data, _csv(table.data))
        write_text(shown, _markdown(table, footer))


def _csv(data: pd.DataFrame) -> str:
    data = data.copy()
    for name in data.select_dtypes("bool"):
        data[name] = data[name].map({True: "true", False: "false"})
    for name in data.select_dtypes(["object", "str"]):
        data[name] = data[name].map(csv_cell)
    return data.to_csv(index=False, float_format="%.10g", lineterminator="\n")


def _markdown(table: Table, footer: str) -> str:
    parts = [f"# {table.title}", footer]
    for caption, header, rows in _parts(table):
        if caption:
            parts.append(f"## {caption}")
        every = [header, ["---"] * len(header), *rows]
        parts.append("\n".join(_markdown_row(row) for row in every))
    if table.notes:
        parts.append("\n".join(f"- {note}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def _markdown_row(row: Iterable[str]) -> str:
    return "| " + " | ".join(markdown_cell(cell) for cell in row) + " |"
