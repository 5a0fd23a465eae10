"""Tables: as CSV to compute with, as Markdown and HTML to read."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pa10cal.files.output import csv_cell, markdown_cell, whole_file
from pa10cal.reports.blocks import Grid

Row = tuple[str, ...]

_STYLE = (
    "body{font:14px/1.4 sans-serif;margin:1.5em}table{border-collapse:collapse;margin:1em 0}"
    "td,th{border-bottom:1px solid #ccc;padding:.2em .6em;text-align:left;vertical-align:top}"
    "caption{text-align:left;font-weight:bold}.footer{color:#666}"
)


@dataclass(frozen=True)
class Table:
    """A table of results."""

    title: str  # what it shows
    data: pd.DataFrame  # the CSV; what is not known is missing
    # what Markdown and HTML show; empty where it is the data as they are
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


def _html(table: Table, footer: str) -> str:
    title = html.escape(table.title)
    parts = [
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>",
        f'<p class="footer">{html.escape(footer)}</p>',
    ]
    for title_of_part, header, rows in _parts(table):
        caption = f"<caption>{html.escape(title_of_part)}</caption>" if title_of_part else ""
        parts.append(f"<table>{caption}<thead>{_html_row(header, 'th')}</thead><tbody>")
        parts += [_html_row(row, "td") for row in rows]
        parts.append("</tbody></table>")
    if table.notes:
        parts.append("<ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in table.notes) + "</ul>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _html_row(row: Iterable[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"
