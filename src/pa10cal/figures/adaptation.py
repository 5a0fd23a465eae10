"""Errors of a model adapted to another campaign, by the number of poses measured there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pa10cal.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    legend_at,
    looks,
    new_figure,
    panel,
    plain_log,
    write_figure,
)
from pa10cal.results.comparison import AdaptationRecord

_LOOKS: dict[str, dict[str, Any]] = {
    "prior": {"color": BLUE, "marker": "o", "label": "started from the model"},
    "frames": {"color": ORANGE, "marker": "^", "label": "base and tool alone fitted"},
    "alone": {"color": GREY, "marker": "s", "label": "general model without the prior"},
}


def write_adaptation(record: AdaptationRecord, folder: Path, name: str, png_dpi: int) -> None:
    """Draw held-out errors against configurations fitted, as SVG, PDF and PNG.

    Args:
        record: what was found.
        folder: to write to.
        name: of the files.
        png_dpi: resolution of the PNG.
    """
    with looks():
        title = f"{record.campaign}: how many poses a model of {record.from_ or 'another'} needs"
        figure = new_figure(85.0, title)
        axes = panel(figure, 20.0, 24.0, 145.0, 50.0)
        shown = []
        for key, look in _LOOKS.items():
            found = [
                (step.configurations, getattr(step, key).rms_mm)
                for step in record.steps
                if getattr(step, key) is not None
            ]
            if found:
                axes.plot(*zip(*found, strict=True), markersize=3.5, linewidth=0.9, **look)
                shown += [error for _, error in found]
        counts = [step.configurations for step in record.steps]
        plain_log(axes, "x", min(counts) / 1.3, max(counts) * 1.3)
        plain_log(axes, "y", min(shown) / 1.3, max(shown) * 1.3)
        axes.set_xlabel("configurations fitted, the first of the campaign")
        axes.set_ylabel("held-out error, rms [mm]")
        legend_at(figure, 18.0, 5.0, axes.get_legend_handles_labels()[0], ncols=3)
        write_figure(figure, record.provenance[:300], folder, name, png_dpi)
