"""The picture of an arm's parameters over its campaigns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.ticker import MaxNLocator

from pa10cal.figures.style import new_figure, panel, theme, write_figure
from pa10cal.reports.formatting import display_name, shown_in
from pa10cal.reports.theme import BLUE, GREY, VERMILLION
from pa10cal.results.comparison import DriftRecord

#: Panels side by side; their width, height and distance [mm].
_COLUMNS, _WIDE_MM, _HIGH_MM, _APART_MM = 4, 30.0, 20.0, 10.0


def write_drift(record: DriftRecord, folder: Path, name: str, png_dpi: int) -> None:
    """Draw every parameter less its value in the first campaign, as SVG, PDF and PNG.

    Args:
        record: the parameters, and what moved from campaign to campaign.
        folder: to write to.
        name: of the files.
        png_dpi: resolution of the PNG [dots per inch].
    """
    rows, count = record.parameters, len(record.campaigns)
    keys = list(dict.fromkeys(zip(rows.term, rows.of, rows.parameter, strict=True)))
    moved = {thing.of for step in record.steps for thing in step.what_moved.moved}
    height_mm = 26.0 - (-len(keys) // _COLUMNS) * (_HIGH_MM + _APART_MM)
    with theme():
        title = f"{record.robot}: parameters over {count} campaigns, less the first"
        figure = new_figure(height_mm, title)
        for k, (term, of, parameter) in enumerate(keys):
            line, column = divmod(k, _COLUMNS)
            x_mm = 12.0 + column * (_WIDE_MM + _APART_MM)
            y_mm = height_mm - 4.0 - (line + 1) * (_HIGH_MM + _APART_MM)
            axes = panel(figure, x_mm, y_mm, _WIDE_MM, _HIGH_MM)
            at = (rows.term == term) & (rows.of == of) & (rows.parameter == parameter)
            unit, scale = shown_in(str(rows.unit[at][0]))
            joint = f"joint {parameter.rpartition('_')[2]}"
            of_joint = joint in moved and parameter.startswith(("delta_theta", "K_lin"))
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            axes.errorbar(
                [record.campaigns.index(campaign) for campaign in rows.campaign[at]],
                scale * (rows.value[at] - rows.value[at][0]),
                scale * (rows.high[at] - rows.value[at]),
                color=VERMILLION if parameter in moved or of_joint else BLUE,
                marker="o",
                markersize=2.5,
                linewidth=0.8,
                capsize=1.5,
            )
            axes.set(title=f"{display_name(parameter)} [{unit}]", xlim=(-0.4, count - 0.6))
            axes.set_xticks(np.arange(count), [""] * count)
            axes.yaxis.set_major_locator(MaxNLocator(3))
        names = ", ".join(f"{k + 1} {campaign}" for k, campaign in enumerate(record.campaigns))
        footer = f"Bars: 95 % intervals. Campaigns from left to right: {names}. {record.line}"
        write_figure(figure, footer, folder, name, png_dpi)
