"""Every joint's error by its angle, the campaigns of a group on top of each other."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    legend_at,
    new_figure,
    panel,
    write_text_at,
)
from pa10cal.results.discovery import FoundEffect
from pa10cal.results.group import EffectByCampaign

PICTURE = Picture(
    title="Where: one robot, several campaigns",
    needs=("verdict",),
    caption="""
The errors by joint angles that discovery found in ``{name}``, as each campaign alone has them,
where it has poses. Where campaigns lie on top of each other the error
belongs to the robot. Above each joint: the correlation of the campaigns with its 95 % interval,
and α, the share of the error that the joint's motor followed, with its 95 % interval, where the
motor's own ripple shows it: 0 if the gear makes the error, 1 if the sensor does.
""",
)


#: Common angles from which campaigns are drawn about one mean [deg].
_LEAST_COMMON_DEG = 10
_ROW_MM, _BETWEEN_MM, _BELOW_MM, _ABOVE_MM = 26.0, 8.0, 24.0, 14.0
#: Colour and line of one campaign after the other.
_LINES: tuple[tuple[str, Literal["-", "--", "-."]], ...] = (
    (BLUE, "-"),
    (ORANGE, "-"),
    (GREEN, "--"),
    (PURPLE, "-."),
)


def draw(results: Results) -> Figure:
    """Draw every joint that has such an error, a row each."""
    verdict = results.verdict()
    found = sorted(
        (each for each in verdict.by_campaign or () if each.errors), key=lambda each: each.of
    )
    if not found:
        raise NothingToShowError("no group, or no error by a joint's angle was found in it")
    names = list(dict.fromkeys(name for each in found for name in each.errors or ()))
    effects = {(effect.id, effect.of): effect for effect in verdict.effects}
    rows = len(found) * (_ROW_MM + _BETWEEN_MM) - _BETWEEN_MM
    figure = new_figure(
        _BELOW_MM + rows + _ABOVE_MM, "Errors by joint angles, as each campaign alone has them"
    )
    errors = [error for each in found for error in _shown(each).values()]
    limit = 1.05 * float(np.nanmax(np.abs(errors)))
    for k, each in enumerate(reversed(found)):
        bottom = _BELOW_MM + k * (_ROW_MM + _BETWEEN_MM)
        axes = panel(figure, 16.0, bottom, 148.0, _ROW_MM)
        _draw_joint(axes, each, names)
        axes.set_title(_said(each, effects.get((each.id, each.of))))
        axes.set_ylim(-limit, limit)
        axes.tick_params(labelbottom=k == 0)
        if k == 0:
            axes.set_xlabel("joint angle [deg], by the turn")
    handles = [
        Line2D([], [], color=color, linestyle=line, label=name)
        for name, (color, line) in zip(names, _LINES, strict=False)
    ]
    legend_at(figure, 4.0, 11.0, handles, ncols=4, columnspacing=1.4)
    note = "Less the mean over the angles that all visited, or else its own; gaps: no poses there."
    write_text_at(figure, 2.0, 6.5, note, color=GREY)
    return figure


def _shown(each: EffectByCampaign) -> dict[str, Array]:
    """Return the error of every campaign at whole degrees, nan where it has no poses.

    Less its mean over the angles that all campaigns visited, or else over its own.
    """
    errors = each.errors or {}
    common = np.all([alone.visited for alone in errors.values()], axis=0)
    shown = {}
    for name, alone in errors.items():
        error = np.where(alone.visited, alone.error_mrad, np.nan)
        about = common if common.sum() >= _LEAST_COMMON_DEG else alone.visited
        shown[name] = np.asarray(error - error[about].mean() if about.any() else error)
    return shown


def _draw_joint(axes: Axes, each: EffectByCampaign, names: list[str]) -> None:
    shown = _shown(each)
    for name, (color, line) in zip(names, _LINES, strict=False):
        if name in shown:
            axes.plot(np.arange(360), shown[name], color=color, linestyle=line, alpha=0.85)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.set_xlim(0.0, 360.0)
    axes.set_xticks(range(0, 361, 45))
    axes.set_ylabel("error [mrad]")


def _said(each: EffectByCampaign, effect: FoundEffect | None) -> str:
    """Return what stands above a joint."""
    parts = []
    for pair in each.agreement:
        if pair.correlation is None or pair.correlation95 is None:
            continue
        low, high = pair.correlation95
        parts.append(f"r {pair.correlation:.2f} ({low:.2f} to {high:.2f})")
    ripple = effect.witness.ripple if effect is not None and effect.witness else None
    if ripple is not None:
        low, high = ripple.interval95
        parts.append(f"α {ripple.alpha:.2f} ({low:.2f} to {high:.2f})")
    return f"{each.of}: {', '.join(parts) or 'seen by the campaigns at other angles'}"
