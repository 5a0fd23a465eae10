"""A column a joint: panels in a row, over the angle of each joint."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pa10cal.figures.style import panel, write_text_at

LEFT_MM = 18.0
_RIGHT_MM, _GAP_MM = 168.0, 2.5
#: Part of a panel at either side that has no tick: labels of neighbours stay apart.
_BARE = 0.14
_BEYOND = 0.06
#: Part of the angles that two numbers are apart at least, and more steps until two are.
_APART = 0.5
_STEPS = (5, 10, 20)
#: The least that is shown [deg, mm], of a joint that stood still.
_LEAST = 1.0


def joint_panels(
    figure: Figure, count: int, bottom_mm: float, height_mm: float, label: str
) -> list[Axes]:
    """Return panels side by side, the label and the numbers of their common axis at the first."""
    width = (_RIGHT_MM - LEFT_MM) / count
    panels = [
        panel(figure, LEFT_MM + k * width, bottom_mm, width - _GAP_MM, height_mm)
        for k in range(count)
    ]
    panels[0].set_ylabel(label)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    return panels


def over_angle(axes: Axes, q_deg: NDArray[np.float64]) -> None:
    """Let an axis span the angles of a joint, with two numbers."""
    middle = (float(q_deg.min()) + float(q_deg.max())) / 2.0
    span = max(float(np.ptp(q_deg)), _LEAST)
    low, high = middle - span / 2.0, middle + span / 2.0
    axes.set_xlim(low - _BEYOND * span, high + _BEYOND * span)
    for steps in _STEPS:
        ticks = np.asarray(MaxNLocator(steps, steps=[1, 2, 3, 5, 10]).tick_values(low, high))
        inside = ticks[(ticks > low + _BARE * span) & (ticks < high - _BARE * span)]
        if np.ptp(inside) > _APART * span:
            break
    axes.set_xticks(inside[[0, -1]])


def label_below(figure: Figure, y_mm: float, text: str) -> None:
    """Write a common label below a row of panels."""
    write_text_at(figure, (LEFT_MM + _RIGHT_MM) / 2, y_mm, text, ha="center")
