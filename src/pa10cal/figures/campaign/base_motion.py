"""How the instrument moved against targets on the base while the campaign lasted."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.campaign.table import read_base_motion
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import FILES, Results
from pa10cal.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    legend_at,
    new_figure,
    panel,
    write_text_at,
)
from pa10cal.observe.instrument import MotionFound

PICTURE = Picture(
    title="Motion of the instrument against targets on the base",
    needs=("base_motion",),
    caption="""
What targets on the base of ``{name}`` show of the instrument while the campaign lasted: their
common shift, and turn where three of them are not in line, about their mean, along the
instrument's axes, with bands of two standard uncertainties. All readings were turned back by it
before anything else was done with them. Dashed lines: a target moved against the others there,
and its readings of the shorter stretch are not used.
""",
)

_COLOURS = {"x": BLUE, "y": ORANGE, "z": GREEN}
_BELOW_MM, _PANEL_MM, _APART_MM, _ABOVE_MM = 26.0, 42.0, 8.0, 10.0
_FORMS = {
    "walk": "smoothed in time",
    "each": "each configuration by itself",
    "still": "no motion shows",
}


def draw(results: Results) -> Figure:
    """Draw shift and turn over time."""
    poses = results.poses()
    found = read_base_motion(results.folder / FILES["poses"])
    if found is None:
        raise NothingToShowError("the motion of the targets was not looked at")
    rows = [("shift", "mm", "{}_mm", 1.0, 0)]
    if found.turns:
        rows.append(("turn", "mrad", "r{}_rad", 1e3, 3))
    height = _BELOW_MM + len(rows) * _PANEL_MM + (len(rows) - 1) * _APART_MM + _ABOVE_MM
    figure = new_figure(height, "Motion of the instrument against targets on the base")
    hours = (poses["time_s"] - poses["time_s"].min()).to_numpy() / 3600.0
    for k, (word, unit, column, scale, first) in enumerate(rows):
        up = len(rows) - 1 - k
        axes = panel(figure, 20.0, _BELOW_MM + up * (_PANEL_MM + _APART_MM), 146.0, _PANEL_MM)
        for i, axis in enumerate("xyz"):
            name = f"motion_{column.format(axis)}"
            value = scale * poses[name].to_numpy()
            at = first + i
            u = scale * np.sqrt(poses[f"motion_cov_{at}{at}"].to_numpy())
            axes.fill_between(hours, value - 2 * u, value + 2 * u, color=_COLOURS[axis], alpha=0.2)
            axes.plot(hours, value, color=_COLOURS[axis], linewidth=0.8)
        _mark(axes, found, poses)
        axes.set_ylabel(f"{word} [{unit}]")
        if up:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("time [h]")
    handles = [Line2D([], [], color=colour, label=axis) for axis, colour in _COLOURS.items()]
    legend_at(figure, 4.0, 11.0, handles, ncols=3)
    write_text_at(figure, 2.0, 8.0, _said(found, poses), color=GREY)
    return figure


def _mark(axes: Axes, found: MotionFound, poses: pd.DataFrame) -> None:
    for knock in found.knocked:
        at = (knock.time_s - poses["time_s"].min()) / 3600.0
        axes.axvline(at, color=VERMILLION, linestyle="--", linewidth=0.8)


def _said(found: MotionFound, poses: pd.DataFrame) -> str:
    shift = poses[[f"motion_{axis}_mm" for axis in "xyz"]].to_numpy()
    largest = float(np.linalg.norm(shift, axis=1).max())
    parts = [f"{_FORMS[found.form]}: up to {largest:.3f} mm"]
    if found.turns:
        turn = 1e3 * poses[[f"motion_r{axis}_rad" for axis in "xyz"]].to_numpy()
        parts[0] += f" and {float(np.linalg.norm(turn, axis=1).max()):.3f} mrad"
    parts.append(f"targets scatter by {found.noise:.2f} of the stated uncertainty")
    parts += [str(each) for each in found.knocked]
    return "; ".join(parts)
