"""Every arm of a fleet in one picture: errors before and after, and which need attention."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from pa10cal.figures.style import (
    AFTER,
    BEFORE,
    BLACK,
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
from pa10cal.results.fleet import FleetRecord

#: What asks for attention, the most urgent first, in words and in a colour.
_ATTENTION = {
    "no_result": ("no result", BLACK),
    "input": ("check the data", VERMILLION),
    "moved": ("the arm has changed", PURPLE),
    "incomplete": ("an effect is missing", ORANGE),
    "none": ("needs none", GREEN),
}
_SYNTHETIC = "synthetic"
_HIGH_MM, _LEFT_MM, _WIDE_MM = 78.0, 16.0, 92.0
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
        figure = new_figure(_HIGH_MM, title)
        axes = panel(figure, _LEFT_MM, 22.0, _WIDE_MM, 46.0)
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
