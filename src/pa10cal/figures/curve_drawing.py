"""What pictures and films of a chain are made of: it in space beside its curve, and its angles."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.curve_results import CurveResults
from pa10cal.figures.style import BLACK, BLUE, GREY, ORANGE, SKY, VERMILLION, panel

#: Links of longer chains are drawn without a mark at every joint, and without their axes.
_MOST_MARKS = 120
#: Length of a link's z axis as drawn, as a part of the link.
_AXIS = 0.45
_MARGIN = 0.05


def space(
    figure: Figure,
    results: CurveResults,
    shape: int,
    place_mm: tuple[float, float, float, float],
    *,
    numbers: bool,
) -> Axes:
    """Add axes in space with one shape of the chain, equal scales and room for all shapes.

    Args:
        figure: to add to.
        results: the chain.
        shape: which.
        place_mm: x, y, width and height in the figure.
        numbers: whether the axes have numbers and names.
    """
    axes = panel(figure, *place_mm, projection="3d")
    draw_chain(axes, results, shape)
    every = np.concatenate([results.curve_m.reshape(-1, 3), results.p_m.reshape(-1, 3)])
    low, high = every.min(axis=0), every.max(axis=0)
    reach = float((high - low).max())
    middle, half = (low + high) / 2.0, np.maximum(high - low, 0.25 * reach) / 2.0
    half = half + _MARGIN * reach
    solid = cast(Any, axes)  # matplotlib's axes in space are not typed
    for name, m, h in zip("xyz", middle, half, strict=True):
        getattr(solid, f"set_{name}lim")(m - h, m + h)
        if numbers:
            getattr(solid, f"set_{name}label")(f"{name} [m]")
            getattr(solid, f"{name}axis").get_major_locator().set_params(nbins=3)
        else:
            getattr(solid, f"{name}axis").set_ticklabels([])
    solid.set_box_aspect(half)
    return axes


def draw_chain(axes: Axes, results: CurveResults, shape: int) -> None:
    """Draw one shape of the chain, the curve under it and the z axes of its links."""
    curve_m, p_m = results.curve_m[shape], results.p_m[shape]
    axes.plot(*curve_m.T, color=SKY, linewidth=2.5, alpha=0.7, label="curve")
    few = len(p_m) <= _MOST_MARKS
    mark = "o" if few else None
    axes.plot(*p_m.T, color=BLUE, marker=mark, markersize=2.5, linewidth=1.2, label="links")
    if few:
        begin = (p_m[:-1] + p_m[1:]) / 2.0
        end = begin + _AXIS * results.record.link_m * results.z_axis[shape]
        gap = np.full_like(begin, np.nan)  # lifts the pen
        ticks = np.stack([begin, end, gap], axis=1).reshape(-1, 3)
        axes.plot(*ticks.T, color=VERMILLION, linewidth=0.9, label="their z")
    axes.plot(*p_m[:1].T, color=BLACK, marker="s", markersize=4.0, linestyle="none", label="begin")


def draw_angles(axes: Axes, results: CurveResults, shape: int) -> None:
    """Draw the angles of all joints of one shape, scaled for all shapes."""
    joint = np.arange(1, results.a_deg.shape[1] + 1)
    mark = "." if len(joint) <= _MOST_MARKS else ""
    axes.plot(joint, results.a_deg[shape], color=BLUE, marker=mark, label="a, about z")
    axes.plot(joint, results.b_deg[shape], color=ORANGE, marker=mark, label="b, about y")
    most = 1.1 * float(np.abs([results.a_deg, results.b_deg]).max(initial=1e-3))
    for limit in {each for each in results.limits_deg if abs(each) < 2.0 * most}:
        axes.axhline(limit, color=GREY, linestyle="--", linewidth=0.8)
        most = max(most, 1.05 * abs(limit))
    axes.set_ylim(-most, most)
    axes.set_xlabel("joint")
    axes.set_ylabel("angle [°]")
