"""Tables: as CSV to compute with, as Markdown and HTML to read."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.arm.statics import reported_name
from pa10cal.files.output import csv_cell, markdown_cell, whole_file
from pa10cal.results.evaluation import Parameter

Row = tuple[str, ...]

#: Smaller values are written as multiples of a power of ten.
_LEAST_POWER = -2

_STYLE = (
    "body{font:14px/1.4 sans-serif;margin:1.5em}table{border-collapse:collapse;margin:1em 0}"
    "td,th{border-bottom:1px solid #ccc;padding:.2em .6em;text-align:left;vertical-align:top}"
    "caption{text-align:left;font-weight:bold}.footer{color:#666}"
)


@dataclass(frozen=True)
class Shown:
    """A part of a table as readers see it."""

    frame: pd.DataFrame  # texts
    caption: str = ""  # what the rows are; empty where the table's title says it


@dataclass(frozen=True)
class Table:
    """A table of results."""

    title: str  # what it shows
    data: pd.DataFrame  # the CSV; what is not known is missing
    shown: tuple[Shown, ...]  # what Markdown and HTML show
    notes: tuple[str, ...] = ()  # said below it


def frame_of(header: Sequence[str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Return rows under a header, each as long as it."""
    return pd.DataFrame([list(row) for row in rows], columns=list(header))


def shown(header: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> Shown:
    """Return rows of text under a header, or one that says there are none."""
    frame = frame_of(header, rows)
    if frame.empty:
        frame = frame_of(header, [("none", *["–"] * (len(header) - 1))])
    return Shown(frame, caption)


def figures(value: float | None, count: int) -> float:
    """Return a number with so many significant figures, nan for None."""
    return np.nan if value is None else float(f"{value:.{count}g}")


def with_half_width(value: float, half: float) -> str:
    """Return a value and half an interval with the same digits, two of the latter: `0.55 ± 0.12`.

    A value far from one is a multiple of a power of ten: `(3.94 ± 0.17)e-4`.
    """
    if not (half > 0.0 and math.isfinite(half) and math.isfinite(value)):
        return f"{value:.5g} ± {half:.2g}"
    last = math.floor(math.log10(half)) - 1
    power = math.floor(math.log10(max(abs(value), half)))
    if power >= _LEAST_POWER and last <= 0:
        return f"{value:.{-last}f} ± {half:.{-last}f}"
    scale = 10.0**power
    digits = max(power - last, 0)
    return f"({value / scale:.{digits}f} ± {half / scale:.{digits}f})e{power}"


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
    for part in table.shown:
        if part.caption:
            parts.append(f"## {part.caption}")
        rows = [part.frame.columns, ["---"] * part.frame.shape[1], *part.frame.to_numpy()]
        parts.append("\n".join(_markdown_row(row) for row in rows))
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
    for part in table.shown:
        caption = f"<caption>{html.escape(part.caption)}</caption>" if part.caption else ""
        head = _html_row(part.frame.columns, "th")
        parts.append(f"<table>{caption}<thead>{head}</thead><tbody>")
        parts += [_html_row(row, "td") for row in part.frame.to_numpy()]
        parts.append("</tbody></table>")
    if table.notes:
        parts.append("<ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in table.notes) + "</ul>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _html_row(row: Iterable[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"


# How parameters are written in figures and tables: kind, joint, symbol and unit.

_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True)
class Kind:
    """Parameters of one kind, one a joint."""

    key: str  # begins their names in results
    symbol: str  # as the paper writes it
    title: str  # in words
    unit: str  # to show them in
    scale: float  # from the unit of results to the unit shown
    digits: str  # format of a value in that unit

    def name(self, joint: int) -> str:
        """Return the name in results."""
        return f"{self.key}_{joint}"

    def written(self, joint: int) -> str:
        """Return the symbol with the joint as its index; of a spring the name in results."""
        if self.symbol == self.key:
            return self.name(joint)
        return self.symbol + str(joint).translate(_SUBSCRIPTS)


LINKS = (
    Kind("delta_a", "δa", "link lengths", "mm", 1e3, ".3f"),
    Kind("delta_alpha", "δα", "twists", "mrad", 1e3, ".3f"),
    Kind("delta_d", "δd", "offsets", "mm", 1e3, ".3f"),
    Kind("delta_beta", "δβ", "Hayati angle", "mrad", 1e3, ".3f"),
    Kind("delta_theta", "δθ", "joint zeros", "mrad", 1e3, ".3f"),
)
K_LIN = Kind("K_lin", "K_lin", "linear stiffness", "kN m/rad", 1e-3, ".2f")
K_CUB = Kind("K_cub", "K_cub", "cubic stiffness", "MN m/rad³", 1e-6, ".1f")
#: The base frame: the instrument's origin in it, and the turns to the instrument's axes.
_FRAME = {f"base_p_cmm_{axis}": f"p_{axis}" for axis in "xyz"}
_FRAME |= {f"gamma_{axis}": f"γ_{axis}" for axis in "xyz"}
KINDS = (*LINKS, K_LIN, K_CUB)


def joints_of(kind: Kind, names: list[str]) -> list[int]:
    """Return the joints that have a parameter of a kind, in order."""
    begin = f"{kind.key}_"
    return sorted(int(name.removeprefix(begin)) for name in names if name.startswith(begin))


def written(name: str) -> str:
    """Return a parameter's name as readers see it: `δa₂`, `K_lin_2`, `tool x`."""
    name = reported_name(name)
    for kind in KINDS:
        if name.startswith(f"{kind.key}_") and name.removeprefix(f"{kind.key}_").isdigit():
            joint = int(name.removeprefix(f"{kind.key}_"))
            return kind.written(joint)
    return _FRAME.get(name, name.replace("_", " "))


def listed(names: Iterable[str]) -> str:
    """Return parameters' names as readers see them, one after the other, or that there are none."""
    return ", ".join(map(written, names)) or "none"


def written_load(load: str) -> str:
    """Return a load such as `22N`, as results name it, as readers see it: `22 N`."""
    return f"{load.removesuffix('N')} N"


def std_of(parameter: Parameter) -> float:
    """Return the standard uncertainty of a parameter, nan where there is none."""
    return math.nan if parameter.std is None else parameter.std
