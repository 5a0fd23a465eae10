"""Pictures over campaigns: parameters in time, all arms of a fleet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
    legend_at,
    looks,
    name_rows,
    new_figure,
    panel,
    plain_log,
    points,
    write_beside,
    write_figure,
)
from pa10cal.figures.table import written
from pa10cal.results.comparison import DriftRecord
from pa10cal.results.fleet import FleetRecord

_COLUMNS, _WIDE_MM, _HIGH_MM, _APART_MM = 4, 30.0, 20.0, 10.0
#: Unit shown of a unit of the record, and how many make it.
_SHOWN = {"rad": ("mrad", 1e3), "m": ("mm", 1e3), "N m/rad": ("kN m/rad", 1e-3)}


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
            unit, times = _SHOWN.get(str(rows.unit[at][0]), (str(rows.unit[at][0]), 1.0))
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


# Every arm of a fleet in one picture: errors before and after, and which need attention.

#: What asks for attention, the most urgent first, in words and in a colour.
_ATTENTION = {
    "no_result": ("no result", BLACK),
    "input": ("check the data", VERMILLION),
    "moved": ("the arm has changed", PURPLE),
    "incomplete": ("an effect is missing", ORANGE),
    "none": ("needs none", GREEN),
}
_SYNTHETIC = "synthetic"
_HIGH_MM_OF_FLEET, _LEFT_MM, _WIDE_MM_OF_FLEET = 78.0, 16.0, 92.0
#: Room about the smallest and the largest error, as a factor.
_ROOM = 1.5


def write_fleet(record: FleetRecord, folder: Path, name: str, png_dpi: int) -> None:
    """Draw a fleet as SVG, PDF and PNG.

    Args:
        record: the fleet.
        folder: to write to.
        name: of the files.
        png_dpi: resolution of the PNG.
    """
    judged = record.judged
    with looks():
        synthetic = [_SYNTHETIC in (each.became.provenance or "").lower() for each in judged]
        told = f", {_SYNTHETIC} data" if all(synthetic) else f", partly {_SYNTHETIC} data"
        title = f"{len(record.arms)} arms in {len(record.campaigns)} campaigns"
        title += told if any(synthetic) else ""
        figure = new_figure(_HIGH_MM_OF_FLEET, title)
        axes = panel(figure, _LEFT_MM, 22.0, _WIDE_MM_OF_FLEET, 46.0)
        axes.set_xlabel("arm, the most accurate first")
        axes.set_ylabel("mean position error [mm]")
        if judged:
            rank = np.arange(1, len(judged) + 1)
            before, after = (
                np.array([getattr(each.became, key) for each in judged], dtype=float)
                for key in ("before_mm", "after_mm")
            )
            points(axes, rank, before, color=BEFORE, marker="D", markersize=2.5)
            points(axes, rank, after, color=AFTER, marker="o", markersize=2.5)
            axes.set_xlim(0.0, len(judged) + 1.0)
            every = np.concatenate([before, after])
            plain_log(axes, "y", every.min() / _ROOM, every.max() * _ROOM)
        handles = [
            Line2D([], [], linestyle="none", marker=marker, color=color, label=label)
            for marker, color, label in (
                ("D", BEFORE, "uncalibrated"),
                ("o", AFTER, "final model"),
            )
        ]
        legend_at(figure, _LEFT_MM, 6.5, handles, ncols=2)
        counts = [sum(arm.attention == kind for arm in record.arms) for kind in _ATTENTION]
        bars = panel(figure, 143.0, 22.0, 18.0, 46.0)
        bars.barh(range(len(counts)), counts, color=[color for _, color in _ATTENTION.values()])
        name_rows(bars, [label for label, _ in _ATTENTION.values()], lines=False)
        bars.set_xlim(0.0, 1.05 * max(*counts, 1))
        bars.set_xlabel("arms")
        for row, count in enumerate(counts):
            write_beside(bars, row, str(count), color=GREY)
        left_out = len(record.arms) - len(judged)
        footer = (
            "Last campaign of each arm; over held-out poses where a campaign has some, else over "
            "the poses fitted. Right: what asks for attention, the most urgent of each arm."
        )
        if left_out:
            footer += f" Left: without {left_out} of which no error is known."
        write_figure(figure, footer, folder, name, png_dpi)
