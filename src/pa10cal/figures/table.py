"""Tables: as CSV to compute with, as Markdown and HTML to read."""

from __future__ import annotations

import csv
import html
import io
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from pa10cal.files.output import whole_file

Row = tuple[str, ...]

_STYLE = (
    "body{font:14px/1.4 sans-serif;margin:1.5em}table{border-collapse:collapse;margin:1em 0}"
    "td,th{border-bottom:1px solid #ccc;padding:.2em .6em;text-align:left;vertical-align:top}"
    "caption{text-align:left;font-weight:bold}.footer{color:#666}"
)


@dataclass(frozen=True)
class Grid:
    """Rows of text under a header.

    Attributes:
        header: one entry a column.
        rows: each as long as the header.
        caption: what the rows are; empty where the table's title says it.
    """

    header: Row
    rows: tuple[Row, ...]
    caption: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"rows of {self.caption or self.header[0]} differ from the header")


@dataclass(frozen=True)
class Table:
    """A table of results.

    Attributes:
        title: what it shows.
        data: the CSV.
        shown: what Markdown and HTML show.
        notes: said below it.
    """

    title: str
    data: Grid
    shown: tuple[Grid, ...]
    notes: tuple[str, ...] = ()


def write_table(table: Table, footer: str, folder: Path, name: str) -> None:
    """Write a table as CSV, Markdown and HTML: all three or none."""
    texts = {
        "csv": _csv(table.data),
        "md": _markdown(table, footer),
        "html": _html(table, footer),
    }
    with ExitStack() as stack:
        for ending, text in texts.items():
            path = stack.enter_context(whole_file(folder / f"{name}.{ending}"))
            path.write_text(text, encoding="utf-8", newline="\n")


def _csv(grid: Grid) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([grid.header, *grid.rows])
    return text.getvalue()


def _markdown(table: Table, footer: str) -> str:
    parts = [f"# {table.title}", footer]
    for grid in table.shown:
        if grid.caption:
            parts.append(f"## {grid.caption}")
        lines = [grid.header, tuple("---" for _ in grid.header), *grid.rows]
        parts.append("\n".join(_markdown_row(line) for line in lines))
    if table.notes:
        parts.append("\n".join(f"- {note}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def _markdown_row(row: Row) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


def _html(table: Table, footer: str) -> str:
    title = html.escape(table.title)
    parts = [
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>",
        f'<p class="footer">{html.escape(footer)}</p>',
    ]
    for grid in table.shown:
        caption = f"<caption>{html.escape(grid.caption)}</caption>" if grid.caption else ""
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in grid.header)
        parts.append(f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>")
        for row in grid.rows:
            cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in row)
            parts.append(f"<tr>{cells}</tr>")
        parts.append("</tbody></table>")
    if table.notes:
        parts.append("<ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in table.notes) + "</ul>")
    return "\n".join([*parts, "</body></html>"]) + "\n"
