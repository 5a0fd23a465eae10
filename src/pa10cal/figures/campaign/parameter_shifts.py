"""Parameters of the model that had absorbed part of the missing effects."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.arrays import Array
from pa10cal.figures.parameter_names import K_CUB, K_LIN, KINDS, LINKS, Kind, joints_of
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    GREY,
    SEPARATOR,
    name_rows,
    new_figure,
    panel,
    write_text_at,
)
from pa10cal.results.analysis import AnalysisRecord, ParameterShift

PICTURE = Picture(
    title="Gap: parameters that had absorbed the effects",
    needs=("analysis",),
    caption="""
Change of the parameters of ``{name}`` when the named effects were added: a model that lacks an
effect absorbs part of it in the parameters it has. Left, link parameters in units of their
manufacturing tolerance; right, stiffness in percent of the larger of the two values. Lines are
95 % intervals of the value after. A bar much longer than its line is a parameter that was
biased; a bar longer than a tolerance would have suggested a defective part. Where no effect was
named, nothing moved.
""",
)


_HALF_WIDTH_95 = 1.96
_ROW_MM = 4.0
_BELOW_MM, _ABOVE_MM = 24.0, 17.0
_FOUND: dict[str, Any] = {"color": AFTER, "marker": "o", "linestyle": "none"}


def draw(results: Results) -> Figure:
    """Draw the change of each parameter when the effects were added: links left, springs right."""
    found = results.analysis()
    shifts = {
        shift.name: shift
        for shift in found.parameter_shifts
        if shift.identifiable and (shift.before or shift.after or shift.std)
    }  # a linear spring's cubic stiffness is nothing, before and after
    links = [(kind, joint) for kind in LINKS for joint in joints_of(kind, list(shifts))]
    springs = [(kind, joint) for kind in (K_LIN, K_CUB) for joint in joints_of(kind, list(shifts))]
    rows = _ROW_MM * max(len(links), 8)
    figure = new_figure(
        _BELOW_MM + rows + _ABOVE_MM, "Change of the parameters when the named effects were added"
    )
    left = panel(figure, 16.0, _BELOW_MM, 76.0, rows)
    _draw_links(left, links, shifts)
    tall = _ROW_MM * 1.6 * max(len(springs), 2)
    right = panel(figure, 118.0, _BELOW_MM + rows - tall, 48.0, tall)
    _draw_springs(right, springs, shifts)
    write_text_at(figure, 2.0, 7.5, _said(found))
    return figure


def _draw_links(
    axes: Axes, links: list[tuple[Kind, int]], shifts: dict[str, ParameterShift]
) -> None:
    found = [shifts[kind.name(joint)] for kind, joint in links]
    unit = np.array([shift.tolerance or 1.0 for shift in found])
    _draw_shifts(axes, found, unit, [kind.written(joint) for kind, joint in links])
    axes.axvspan(-1.0, 1.0, color=SEPARATOR, alpha=0.35, linewidth=0.0)
    axes.set_title("lengths and angles of the links")
    axes.set_xlabel("after − before, in manufacturing tolerances (grey: within one)")


def _draw_springs(
    axes: Axes, springs: list[tuple[Kind, int]], shifts: dict[str, ParameterShift]
) -> None:
    axes.set_title("stiffness of the joints")
    if not springs:
        axes.text(0.5, 0.5, "all joints held rigid", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    found = [shifts[kind.name(joint)] for kind, joint in springs]
    # The larger of the two: a cubic stiffness may have been, or become, zero.
    unit = np.array([max(abs(s.before), abs(s.after)) or 1.0 for s in found]) / 100.0
    names = [kind.written(joint) for kind, joint in springs]
    _draw_shifts(axes, found, unit, names)
    axes.set_xlabel("after − before [%] of the larger")


def _draw_shifts(axes: Axes, found: list[ParameterShift], unit: Array, names: list[str]) -> None:
    """Draw shifts of n parameters, each in its unit (n,), with their 95 % intervals."""
    y = np.arange(len(found))
    moved = np.array([shift.after - shift.before for shift in found]) / unit
    half = _HALF_WIDTH_95 * np.array([shift.std for shift in found]) / unit
    axes.barh(y, moved, height=0.55, color=AFTER, alpha=0.35)
    axes.errorbar(moved, y, xerr=half, capsize=2.0, **_FOUND)
    axes.axvline(0.0, color=GREY, linewidth=0.6)
    name_rows(axes, names, 0.6, lines=False)
    reach = 1.15 * max(float(np.abs(moved).max() + half.max()), 0.01)
    axes.set_xlim(-reach, reach)


def _said(found: AnalysisRecord) -> str:
    if not found.effects:
        return "No effect was named: any change comes from the weights of the fit."
    names = [shift.name for shift in found.parameter_shifts if not shift.identifiable]
    hidden = [kind.written(joint) for kind in KINDS for joint in joints_of(kind, names)]
    others = f"; not identifiable: {', '.join(hidden)}" if hidden else ""
    return (
        "Bars: change of the value. Lines: 95 % intervals of the value after.\n"
        f"Not shown: base frame, tool and weights{others}."
    )
