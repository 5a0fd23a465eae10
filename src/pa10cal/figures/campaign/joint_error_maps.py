"""Errors that depend on a joint's angle, as discovery found them, over a whole turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    GREY,
    SEPARATOR,
    SKY,
    legend_at,
    new_figure,
    panel,
    write_text_at,
)
from pa10cal.results.discovery import FoundEffect

PICTURE = Picture(
    title="Where: error maps of the joints",
    needs=("verdict",),
    caption="""
Errors that depend on a joint angle, as discovery found them in ``{name}``: the position error
of each joint over a whole turn, with a 95 % band from the uncertainty of the knots. A constant
over the measured angles can hardly be separated from the joint zero or the base and widens the
band equal at all knots. Shaded: angles without fitted poses, where the line is a smooth
continuation of its neighbours and the model extrapolates. A map shows at which joint an error
is and how it depends on the angle, not whether encoder, gear or controller causes it. Joints
without a map showed no need of one.
""",
)


_TITLE = "Errors that depend on a joint angle, as found"
_MAPS = ("joint_error_map", "sensor_error", "gear_error")
_HALF_WIDTH_95 = 1.96
_ROW_MM, _BETWEEN_MM, _BELOW_MM, _ABOVE_MM = 24.0, 7.0, 28.0, 14.0
_ARC_SECONDS_A_MRAD = 206.265
#: Points of a line over a turn, about, a whole number for every knot.
_POINTS = 720
#: How strongly the band is drawn over angles seen and over others.
_STRONG, _WEAK = 0.6, 0.25


@dataclass(frozen=True)
class _Map:
    """The map of one joint: errors (K,) at even knots of a turn, and their standard deviations."""

    joint: int
    error_mrad: Array
    std_mrad: Array

    @property
    def angle_deg(self) -> Array:
        """Return the angles at which it is drawn, over a turn."""
        knots = len(self.error_mrad)
        return np.linspace(0.0, 360.0, max(_POINTS // knots, 2) * knots + 1)

    @property
    def line_mrad(self) -> Array:
        """Return the error at these angles: a periodic cubic spline through the knots."""
        around = np.append(self.error_mrad, self.error_mrad[0])
        spline = CubicSpline(np.linspace(0.0, 360.0, len(around)), around, bc_type="periodic")
        return np.asarray(spline(self.angle_deg))

    @property
    def half_width_mrad(self) -> Array:
        """Return half the 95 % interval at these angles, between knots that of its neighbours."""
        around = np.append(self.std_mrad, self.std_mrad[0])
        knots = np.linspace(0.0, 360.0, len(around))
        return np.asarray(_HALF_WIDTH_95 * np.interp(self.angle_deg, knots, around))


def draw(results: Results) -> Figure:
    """Draw every map with its band, a row a joint; what is extrapolated is shaded and dotted."""
    found = results.verdict()
    maps = [_map(effect) for effect in found.effects if effect.id in _MAPS]
    if not maps:
        raise NothingToShowError("no error that depends on a joint's angle was named")
    maps.sort(key=lambda each: each.joint)
    rows = len(maps) * (_ROW_MM + _BETWEEN_MM) - _BETWEEN_MM
    figure = new_figure(_BELOW_MM + rows + _ABOVE_MM, _TITLE)
    limit = 1.1 * max(float(np.abs(each.line_mrad).max()) for each in maps)
    for k, each in enumerate(reversed(maps)):
        bottom = _BELOW_MM + k * (_ROW_MM + _BETWEEN_MM)
        axes = panel(figure, 20.0, bottom, 130.0, _ROW_MM)
        stretches = found.angles_seen[each.joint - 1].stretches if found.angles_seen else None
        _draw_map(axes, each, stretches)
        axes.set_ylim(-limit, limit)
        axes.tick_params(labelbottom=k == 0)
        if k == 0:
            axes.set_xlabel("joint angle [deg], by the turn")
    _draw_legend(figure)
    return figure


def _map(effect: FoundEffect) -> _Map:
    """Return the map of an effect, its knots in order."""
    knots = sorted(
        (int(name.rpartition("_")[2]), parameter) for name, parameter in effect.parameters.items()
    )
    return _Map(
        joint=int(effect.of.removeprefix("joint ")),
        error_mrad=1e3 * np.array([parameter.value for _, parameter in knots]),
        std_mrad=1e3 * np.array([parameter.std for _, parameter in knots]),
    )


def _draw_map(axes: Axes, each: _Map, stretches: Array | None) -> None:
    """Draw a map; `stretches` are the angles seen [rad], None where that is not known."""
    angle, line, half = each.angle_deg, each.line_mrad, each.half_width_mrad
    unseen = np.zeros(len(angle), dtype=bool)
    if stretches is not None:
        unseen = ~_within(angle, np.degrees(stretches))
    axes.fill_between(
        angle, 0.0, 1.0, where=unseen, transform=axes.get_xaxis_transform(), color=SEPARATOR,
        alpha=0.45, linewidth=0.0,
    )  # fmt: skip
    band: dict[str, Any] = {"color": SKY, "linewidth": 0.0}
    axes.fill_between(angle, line - half, line + half, where=~unseen, alpha=_STRONG, **band)
    axes.fill_between(angle, line - half, line + half, where=unseen, alpha=_WEAK, **band)
    axes.plot(angle, np.where(unseen, np.nan, line), color=AFTER)
    axes.plot(angle, np.where(unseen, line, np.nan), color=AFTER, linestyle=":")
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    spacing = 360.0 / len(each.error_mrad)
    shown, over = (line, "the turn") if unseen.all() else (line[~unseen], "the measured angles")
    axes.set_title(
        f"joint {each.joint}: rms {np.sqrt(np.mean(shown**2)):.3f} mrad over {over}; "
        f"{100.0 * np.mean(~unseen):.0f} % of the turn measured; knots {spacing:.3g}° apart"
    )
    axes.set_xlim(0.0, 360.0)
    axes.set_xticks(range(0, 361, 45))
    axes.set_ylabel("error [mrad]")
    right = axes.secondary_yaxis("right", functions=(_to_arc_seconds, _to_mrad))
    right.set_ylabel("arc seconds")


def _to_arc_seconds(mrad: ArrayLike) -> ArrayLike:
    return np.asarray(mrad) * _ARC_SECONDS_A_MRAD


def _to_mrad(arc_seconds: ArrayLike) -> ArrayLike:
    return np.asarray(arc_seconds) / _ARC_SECONDS_A_MRAD


def _within(angle: Array, stretches: Array) -> NDArray[np.bool_]:
    """Return which angles (N,) lie in any of the stretches (m, 2)."""
    low, high = stretches.T[:, None]
    return np.asarray(((angle[:, None] >= low) & (angle[:, None] <= high)).any(axis=1))


def _draw_legend(figure: Figure) -> None:
    handles = [
        Line2D([], [], color=AFTER, label="map"),
        Patch(color=SKY, alpha=_STRONG, label="95 % band"),
        Line2D([], [], color=AFTER, linestyle=":", label="extrapolated"),
        Patch(color=SEPARATOR, alpha=0.45, label="angles without fitted poses"),
    ]
    legend_at(figure, 4.0, 11.0, handles, ncols=4, columnspacing=1.4)
    note = "A map shows at which joint an error is and how it depends on the angle, not its cause."
    write_text_at(figure, 2.0, 6.5, note, color=GREY)
