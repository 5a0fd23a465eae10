"""Pictures over campaigns: parameters in time, all arms of a fleet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.ticker import MaxNLocator

from pa10cal.figures.style import looks, new_figure, panel, write_figure
from pa10cal.reports.formatting import shown_in, written
from pa10cal.reports.theme import BLUE, GREY, VERMILLION
from pa10cal.results.comparison import DriftRecord

_COLUMNS, _WIDE_MM, _HIGH_MM, _APART_MM = 4, 30.0, 20.0, 10.0


def write_drift(record: DriftRecord, folder: Path, name: str, png_dpi: int) -> None:
    """Draw every parameter less its value in the first campaign, as SVG, PDF and PNG.

    Args:
        record: what was found.
        folder: to write to.
        name: of the files.
        png_dpi: resolution of the PNG.
    """
    rows = record.parameters
    keys = list(dict.fromkeys(zip(rows.term, rows.of, rows.parameter, strict=True)))
    moved = {thing.of for step in record.steps for thing in step.what_moved.moved}
    lines = -(-len(keys) // _COLUMNS)
    with looks():
        height_mm = 26.0 + lines * (_HIGH_MM + _APART_MM)
        title = f"{record.robot}: parameters over {len(record.campaigns)} campaigns, less the first"
        figure = new_figure(height_mm, title)
        for k, key in enumerate(keys):
            line, column = divmod(k, _COLUMNS)
            axes = panel(
                figure,
                12.0 + column * (_WIDE_MM + 10.0),
                height_mm - 8.0 - (line + 1) * (_HIGH_MM + _APART_MM) + 4.0,
                _WIDE_MM,
                _HIGH_MM,
            )
            term, of, parameter = key
            at = (rows.term == term) & (rows.of == of) & (rows.parameter == parameter)
            unit, times = shown_in(str(rows.unit[at][0]))
            where = [record.campaigns.index(each) for each in rows.campaign[at]]
            first = rows.value[at][0]
            joint = f"joint {parameter.rpartition('_')[2]}"
            told = parameter in moved or (
                joint in moved and parameter.startswith(("delta_theta", "K_lin"))
            )
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            axes.errorbar(
                where,
                times * (rows.value[at] - first),
                times * (rows.high[at] - rows.value[at]),
                color=VERMILLION if told else BLUE,
                marker="o",
                markersize=2.5,
                linewidth=0.8,
                capsize=1.5,
            )
            axes.set_title(f"{written(parameter)} [{unit}]")
            axes.set_xlim(-0.4, len(record.campaigns) - 0.6)
            axes.set_xticks(np.arange(len(record.campaigns)))
            axes.set_xticklabels([])
            axes.yaxis.set_major_locator(MaxNLocator(3))
        names = ", ".join(f"{k + 1} {each}" for k, each in enumerate(record.campaigns))
        footer = f"Bars: 95 % intervals. Campaigns from left to right: {names}. {record.line}"
        write_figure(figure, footer, folder, name, png_dpi)
