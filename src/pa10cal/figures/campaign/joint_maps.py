"""Errors by a joint's angle as discovery found them, of all campaigns and of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import legend_at, new_figure, note, panel
from pa10cal.reports.theme import AFTER, BLUE, GREEN, GREY, ORANGE, PURPLE, SEPARATOR, SKY
from pa10cal.results.calibration import EffectByCampaign
from pa10cal.results.discovery import FoundEffect
from pa10cal.results.record import HALF_WIDTH_95

_TITLE = "Errors that depend on a joint angle, as found"
_MAPS = ("joint_error_map", "sensor_error", "gear_error")
_ROW_MM, _BETWEEN_MM, _BELOW_MM, _ABOVE_MM = 24.0, 7.0, 28.0, 14.0
_ARC_SECONDS_A_MRAD = 206.265
#: Points of a line over a turn, about, a whole number for every knot.
_POINTS = 720
#: How strongly the band is drawn over angles seen and over others.
_STRONG, _WEAK = 0.6, 0.25


@dataclass(frozen=True)
class _Map:
    """The map of one joint over a turn: error and half its 95 % interval at angles (N,)."""

    joint: int
    knots: int  # even knots of a turn
    angle_deg: Array
    line_mrad: Array  # a periodic cubic spline through the knots
    half_width_mrad: Array  # between knots that of its neighbours


@picture(
    title="Where: error maps of the joints",
    needs=("verdict",),
    section="verdict",
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
def draw_joint_error_maps(results: Results) -> Figure:
    """Draw every map with its band, a row a joint; what is extrapolated is shaded and dotted."""
    found = results.verdict()
    maps = [_map(effect) for effect in found.effects if effect.id in _MAPS]
    if not maps:
        raise NothingToShowError("no error that depends on a joint's angle was named")
    maps.sort(key=lambda each: each.joint)
    limit = 1.1 * max(float(np.abs(each.line_mrad).max()) for each in maps)
    figure, rows = _turns(_TITLE, len(maps), 130.0, limit)
    for axes, each in zip(rows, reversed(maps), strict=True):
        stretches = found.angles_seen[each.joint - 1].stretches if found.angles_seen else None
        _draw_map(axes, each, stretches)
        axes.axhline(0.0, color=GREY, linewidth=0.6)
    handles = [
        Line2D([], [], color=AFTER, label="map"),
        Patch(color=SKY, alpha=_STRONG, label="95 % band"),
        Line2D([], [], color=AFTER, linestyle=":", label="extrapolated"),
        Patch(color=SEPARATOR, alpha=0.45, label="angles without fitted poses"),
    ]
    legend_at(figure, 4.0, 11.0, handles, ncols=4, columnspacing=1.4)
    said = "A map shows at which joint an error is and how it depends on the angle, not its cause."
    note(figure, said, 6.5, color=GREY)
    return figure


def _turns(title: str, count: int, width_mm: float, limit: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with rows of errors over a turn, from the lowest upward."""
    height_mm = _BELOW_MM + count * (_ROW_MM + _BETWEEN_MM) - _BETWEEN_MM + _ABOVE_MM
    figure, rows = new_figure(height_mm, title), []
    for k in range(count):
        bottom = _BELOW_MM + k * (_ROW_MM + _BETWEEN_MM)
        axes = panel(figure, 20.0, bottom, width_mm, _ROW_MM)
        axes.set(xlim=(0.0, 360.0), ylim=(-limit, limit), ylabel="error [mrad]")
        axes.set_xticks(range(0, 361, 45))
        axes.tick_params(labelbottom=k == 0)
        rows.append(axes)
    rows[0].set_xlabel("joint angle [deg], by the turn")
    return figure, rows


def _map(effect: FoundEffect) -> _Map:
    """Return the map of an effect, whose parameters are the errors at its knots."""
    from scipy.interpolate import CubicSpline  # late: a third of a second, for few campaigns

    names = sorted(effect.parameters, key=lambda name: int(name.rpartition("_")[2]))
    around = [effect.parameters[name] for name in (*names, names[0])]
    knots_deg = np.linspace(0.0, 360.0, len(around))
    angle_deg = np.linspace(0.0, 360.0, max(_POINTS // len(names), 2) * len(names) + 1)
    error_mrad = 1e3 * np.array([knot.value for knot in around])
    std_mrad = 1e3 * np.array([knot.std for knot in around])
    return _Map(
        joint=int(effect.of.removeprefix("joint ")),
        knots=len(names),
        angle_deg=angle_deg,
        line_mrad=np.asarray(CubicSpline(knots_deg, error_mrad, bc_type="periodic")(angle_deg)),
        half_width_mrad=HALF_WIDTH_95 * np.interp(angle_deg, knots_deg, std_mrad),
    )


def _draw_map(axes: Axes, each: _Map, stretches: Array | None) -> None:
    """Draw a map; `stretches` are the angles seen [rad], None where that is not known."""
    angle, line, half = each.angle_deg, each.line_mrad, each.half_width_mrad
    unseen = np.zeros(len(angle), dtype=bool)
    if stretches is not None:
        low, high = np.degrees(stretches).T[:, None]
        unseen = ~((angle[:, None] >= low) & (angle[:, None] <= high)).any(axis=1)
    axes.fill_between(
        angle, 0.0, 1.0, where=unseen, transform=axes.get_xaxis_transform(), color=SEPARATOR,
        alpha=0.45, linewidth=0.0,
    )  # fmt: skip
    band: dict[str, Any] = {"color": SKY, "linewidth": 0.0}
    axes.fill_between(angle, line - half, line + half, where=~unseen, alpha=_STRONG, **band)
    axes.fill_between(angle, line - half, line + half, where=unseen, alpha=_WEAK, **band)
    axes.plot(angle, np.where(unseen, np.nan, line), color=AFTER)
    axes.plot(angle, np.where(unseen, line, np.nan), color=AFTER, linestyle=":")
    shown, over = (line, "the turn") if unseen.all() else (line[~unseen], "the measured angles")
    axes.set_title(
        f"joint {each.joint}: rms {np.sqrt(np.mean(shown**2)):.3f} mrad over {over}; "
        f"{100.0 * np.mean(~unseen):.0f} % of the turn measured; "
        f"knots {360.0 / each.knots:.3g}° apart"
    )
    functions = (lambda mrad: _ARC_SECONDS_A_MRAD * mrad, lambda arc: arc / _ARC_SECONDS_A_MRAD)
    axes.secondary_yaxis("right", functions=functions).set_ylabel("arc seconds")


# Every joint's error by its angle, the campaigns of a group on top of each other.

#: Common angles from which campaigns are drawn about one mean [deg].
_LEAST_COMMON_DEG = 10
#: Colour and line of one campaign after the other.
_LINES: tuple[tuple[str, Literal["-", "--", "-."]], ...] = (
    (BLUE, "-"),
    (ORANGE, "-"),
    (GREEN, "--"),
    (PURPLE, "-."),
)


@picture(
    title="Where: one robot, several campaigns",
    needs=("verdict",),
    section="verdict",
    caption="""
The errors by joint angles that discovery found in ``{name}``, as each campaign alone has them,
where it has poses. Where campaigns lie on top of each other the error
belongs to the robot. Above each joint: the correlation of the campaigns with its 95 % interval,
and α, the share of the error that the joint's motor followed, with its 95 % interval, where the
motor's own ripple shows it: 0 if the gear makes the error, 1 if the sensor does.
""",
)
def draw_joint_errors_by_campaign(results: Results) -> Figure:
    """Draw every joint that has such an error, a row each."""
    verdict = results.verdict()
    found = [each for each in verdict.by_campaign or () if each.errors]
    found.sort(key=lambda each: each.of)
    if not found:
        raise NothingToShowError("no group, or no error by a joint's angle was found in it")
    names = dict.fromkeys(name for each in found for name in each.errors or ())
    looks = dict(zip(names, _LINES, strict=False))
    effects = {(effect.id, effect.of): effect for effect in verdict.effects}
    errors = [error for each in found for error in _shown(each).values()]
    limit = 1.05 * float(np.nanmax(np.abs(errors)))
    title = "Errors by joint angles, as each campaign alone has them"
    figure, rows = _turns(title, len(found), 144.0, limit)
    for axes, each in zip(rows, reversed(found), strict=True):
        shown = _shown(each)
        for name, (color, line) in looks.items():
            if name in shown:
                axes.plot(np.arange(360), shown[name], color=color, linestyle=line, alpha=0.85)
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_title(_said(each, effects.get((each.id, each.of))))
    handles = [
        Line2D([], [], color=color, linestyle=line, label=name)
        for name, (color, line) in looks.items()
    ]
    legend_at(figure, 4.0, 11.0, handles, ncols=4, columnspacing=1.4)
    said = "Less the mean over the angles that all visited, or else its own; gaps: no poses there."
    note(figure, said, 6.5, color=GREY)
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
