"""Figures of the pages with two axes, each a function of the records that it shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.reports import theme
from pa10cal.reports.blocks import Drawing
from pa10cal.reports.formatting import sentence
from pa10cal.results.calibration import EffectByCampaign, PosesNeeded
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal.results.fleet import FleetCampaign
from pa10cal.results.montecarlo import PlaneRecord
from pa10cal.results.record import HALF_WIDTH_95

if TYPE_CHECKING:
    import pandas as pd


def _axis(title: str, **more: Any) -> dict[str, Any]:
    return {"title": {"text": title}, **more}


def _short(values: Iterable[float]) -> list[float | None]:
    """Return values with four figures, which keep a page small; None for nan."""
    return [None if np.isnan(value) else float(f"{value:.4g}") for value in values]


def _add_line(figure: Any, x: Any, y: Iterable[float], name: str, hover: str, **look: Any) -> None:
    """Add a line; `hover` is what a point says of itself, `look` plotly's `line`."""
    hover = f"{hover}<extra></extra>"
    figure.add_scatter(x=x, y=_short(y), name=name, mode="lines", line=look, hovertemplate=hover)


def _add_band(
    figure: Any, x: Array, middle: Array, half: Array, color: str, opacity: float
) -> None:
    """Add a band about a line, of which no legend speaks."""
    figure.add_scatter(
        x=[*x, *reversed(x)],
        y=_short((*(middle - half), *(middle + half)[::-1])),
        fill="toself",
        opacity=opacity,
        line={"width": 0},
        fillcolor=color,
        mode="lines",
        hoverinfo="skip",
        showlegend=False,
    )


# Shares of the held-out poses by error.

#: Of more poses only so many steps of a distribution are drawn.
_MOST_STEPS = 100
_DASHES = {"uncalibrated": "solid", "geometry": "dash", "linear": "dashdot"}


def shares_drawing(held_out: HoldoutRecord, titles: Mapping[str, str], unit: str) -> Drawing | None:
    """Return which share of the held-out poses errs by less than so much, under each model.

    Args:
        held_out: errors of the models.
        titles: models to draw, as readers see them.
        unit: `mm` of positions, `deg` of orientations.
    """
    what = {"mm": "position", "deg": "orientation"}[unit]
    figure = theme.new_figure(
        360,
        _axis(f"{what} error [{unit}]", type="log", dtick=1),
        _axis("share of the poses [%]", range=[0, 102]),
    )
    for name, title in titles.items():
        rows = held_out.models[name].rows
        errors = rows.error_mm
        if unit == "deg":
            if rows.rotation_deg is None:
                return None
            errors = np.linalg.norm(rows.rotation_deg, axis=1)
        beyond = rows.extrapolated
        if beyond is None or not beyond.any() or beyond.all():
            beyond = np.zeros(len(rows), dtype=bool)
        for apart in (False, True) if beyond.any() else (False,):
            ordered = np.sort(errors[beyond == apart])
            count = len(ordered)
            rank = np.unique(np.linspace(1, count, min(count, _MOST_STEPS)).round().astype(int))
            dash = "dot" if apart else _DASHES.get(name, "solid")
            figure.add_scatter(
                x=_short(ordered[rank - 1]),
                y=(100.0 * rank / count).round(2).tolist(),
                mode="lines",
                line={"color": theme.MODELS[name], "dash": dash, "shape": "hv"},
                name=f"{title}{', extrapolated' if apart else ''} ({count})",
                hovertemplate=f"%{{y:.0f}} % below %{{x:.4g}} {unit}<extra></extra>",
            )
    return Drawing(
        figure,
        f"Distribution of the {what} errors of held-out poses",
        "For each model, the share of the held-out poses with a smaller error; in brackets how "
        "many poses. Dotted: poses beyond the joint angles of the fit.",
        f"shares-{what}",
    )


# Motion of the base over time.

#: Motion of the base: unit shown, columns of the table of poses, their scale and first covariance.
_MOTIONS = {"shift": ("mm", "motion_{}_mm", 1.0, 0), "turn": ("mrad", "motion_r{}_rad", 1e3, 3)}


def motion_drawing(poses: pd.DataFrame, word: str, knocks_s: Sequence[float]) -> Drawing:
    """Return the motion that targets on the base show, over time, with two standard uncertainties.

    Args:
        poses: the table of poses, with columns `motion_…`.
        word: `shift` or `turn`.
        knocks_s: when a target moved against the others.
    """
    unit, column, scale, at = _MOTIONS[word]
    first = poses["time_s"].min()
    hours = ((poses["time_s"] - first) / 3600.0).round(4).to_numpy()
    figure = theme.new_figure(320, _axis("time [h]"), _axis(f"{word} [{unit}]"))
    looks = (("x", theme.BLUE, "solid"), ("y", theme.VERMILLION, "dash"), ("z", theme.GREEN, "dot"))
    for k, (name, color, dash) in enumerate(looks):
        value = scale * poses[column.format(name)].to_numpy()
        u = scale * np.sqrt(poses[f"motion_cov_{at + k}{at + k}"].to_numpy())
        _add_band(figure, hours, value, 2 * u, color, 0.2)
        hover = f"{word} {name} %{{y:.4g}} {unit}"
        _add_line(figure, hours, value, name, hover, color=color, dash=dash, width=1.5)
    for knock_s in knocks_s:
        line = {"color": theme.PURPLE, "dash": "longdash"}
        figure.add_vline((knock_s - first) / 3600.0, line=line)
    return Drawing(
        figure,
        f"Motion of the instrument against targets on the base: {word}",
        "About its mean, along the instrument's axes; bands of two standard uncertainties. All "
        "readings were turned back by it. Upright dashes: a target moved against the others.",
        f"base-motion-{word}",
    )


# How many poses are enough.

#: Marks of a logarithmic axis, each written out: digits without their decade are not read.
_TICKS = [digit * 10.0**decade for decade in range(-4, 5) for digit in (1, 2, 5)]


def poses_drawing(poses: PosesNeeded) -> Drawing | None:
    """Return the uncertainty to be expected by number of poses, and the one that is enough."""
    if len(poses.expected) < 2:
        return None
    ticks: dict[str, Any] = {"type": "log", "tickmode": "array"}
    ticks |= {"tickvals": _TICKS, "ticktext": [f"{tick:g}" for tick in _TICKS]}
    x, y = _axis("poses", **ticks), _axis("expected uncertainty [mm]", **ticks)
    figure = theme.new_figure(340, x, y)
    for name, key, color, symbol, dash in (
        ("best poses first", "u_optimal_mm", theme.BLUE, "circle", "solid"),
        ("in the order measured", "u_measured_mm", theme.VERMILLION, "x", "dash"),
    ):
        figure.add_scatter(
            x=[expected.poses for expected in poses.expected],
            y=[getattr(expected, key) for expected in poses.expected],
            mode="lines+markers",
            name=name,
            line={"color": color, "dash": dash},
            marker={"symbol": symbol, "size": 7},
            hovertemplate="%{x} poses: %{y:.4f} mm<extra></extra>",
        )
    figure.add_hline(y=poses.u_needed_mm, line={"color": theme.GREY, "width": 2, "dash": "dot"})
    enough = "is wanted."
    if poses.wanted_mm is None:
        enough = "adds hardly anything to the remaining error."
    return Drawing(
        figure,
        "Uncertainty of a prediction by number of poses",
        "Solid with circles: the most informative poses first; dashed with crosses: as measured. "
        f"The dotted line, {poses.u_needed_mm:.3f} mm, {enough}",
        "poses-needed",
    )


# Errors that depend on a joint's angle: maps over a turn, and as each campaign of a group has them.

_ARC_SECONDS_A_MRAD = 206.265
#: Points of a line over a turn, about, a whole number for every knot.
_POINTS = 360
#: Common angles from which campaigns are drawn about one mean [deg].
_LEAST_COMMON_DEG = 10
_LOOKS_OF_CAMPAIGNS = (
    (theme.BLUE, "solid"),
    (theme.ORANGE, "solid"),
    (theme.GREEN, "dash"),
    (theme.PURPLE, "dashdot"),
)


def joint_map_drawings(verdict: VerdictRecord) -> Iterator[Drawing]:
    """Yield the error of every joint that has a map over its turn, with its 95 % band."""
    from scipy.interpolate import CubicSpline  # late: a third of a second, for few campaigns

    maps: dict[int, tuple[int, Array, Array, Array]] = {}
    for effect in verdict.effects:
        if knots := effect.knots:
            around = (*knots, knots[0])
            knots_deg = np.linspace(0.0, 360.0, len(around))
            angle = np.linspace(0.0, 360.0, max(_POINTS // len(knots), 2) * len(knots) + 1)
            spline = CubicSpline(knots_deg, [knot.value for knot in around], bc_type="periodic")
            half = HALF_WIDTH_95 * np.interp(angle, knots_deg, [knot.std for knot in around])
            joint = int(effect.of.removeprefix("joint "))
            maps[joint] = len(knots), angle, 1e3 * np.asarray(spline(angle)), 1e3 * half
    limit = 1.1 * max((float(np.abs(line).max()) for _, _, line, _ in maps.values()), default=1.0)
    for joint, (count, angle, line, half) in sorted(maps.items()):
        unseen = np.zeros(len(angle), dtype=bool)
        if verdict.angles_seen is not None:
            low, high = np.degrees(verdict.angles_seen[joint - 1].stretches).T[:, None]
            unseen = ~((angle[:, None] >= low) & (angle[:, None] <= high)).any(axis=1)
        figure = _turn_figure(limit)
        for begin, end in np.flatnonzero(np.diff(unseen, prepend=False, append=False)).reshape(
            -1, 2
        ):
            x0, x1 = float(angle[begin]), float(angle[end - 1])
            figure.add_vrect(x0=x0, x1=x1, fillcolor=theme.GREY, opacity=0.25, line_width=0)
        _add_band(figure, angle, line, half, theme.SKY, 0.45)
        for name, hidden, dash in (("map", unseen, "solid"), ("extrapolated", ~unseen, "dot")):
            shown, hover = np.where(hidden, np.nan, line), "%{x:.0f}°: %{y:.3f} mrad"
            _add_line(figure, angle, shown, name, hover, color=theme.AFTER, dash=dash, width=2)
        known, over = (line, "turn") if unseen.all() else (line[~unseen], "measured angles")
        rms = float(np.sqrt(np.mean(known**2)))
        yield Drawing(
            figure,
            f"Joint {joint}: error over its angle",
            f"Rms {rms:.3f} mrad ({_ARC_SECONDS_A_MRAD * rms:.1f} arc seconds) over the {over}; "
            f"{100.0 * np.mean(~unseen):.0f} % of the turn measured; knots {360.0 / count:.3g}° "
            "apart.",
            f"joint-error-{joint}",
        )


def campaigns_drawings(verdict: VerdictRecord) -> Iterator[Drawing]:
    """Yield every joint's error by its angle, the campaigns of a group on top of each other."""
    of_joints = sorted((e for e in verdict.by_campaign or () if e.errors), key=lambda e: e.of)
    names = dict.fromkeys(name for effect in of_joints for name in effect.errors or ())
    looks = dict(zip(names, _LOOKS_OF_CAMPAIGNS, strict=False))
    effects = {(effect.id, effect.of): effect for effect in verdict.effects}
    shown = [_errors_about_mean(effect) for effect in of_joints]
    every = [error for errors in shown for error in errors.values()]
    limit = 1.05 * float(np.nanmax(np.abs(every))) if every else 1.0
    for effect, errors in zip(of_joints, shown, strict=True):
        figure = _turn_figure(limit)
        for name, error in errors.items():
            color, dash = looks.get(name, (theme.GREY, "dot"))
            hover = f"{name} at %{{x:.0f}}°: %{{y:.3f}} mrad"
            _add_line(figure, None, error, name, hover, color=color, dash=dash, width=1.5)
        said = [
            f"r {pair.correlation:.2f} ({pair.correlation95[0]:.2f} to {pair.correlation95[1]:.2f})"
            for pair in effect.agreement
            if pair.correlation is not None and pair.correlation95 is not None
        ]
        witness = getattr(effects.get((effect.id, effect.of)), "witness", None)
        if witness is not None and witness.ripple is not None:
            low, high = witness.ripple.interval95
            said.append(f"α {witness.ripple.alpha:.2f} ({low:.2f} to {high:.2f})")
        yield Drawing(
            figure,
            f"{effect.of.capitalize()}: error over its angle, campaign by campaign",
            f"Agreement: {', '.join(said) or 'seen by the campaigns at other angles'}.",
            f"campaigns-{effect.id}-{effect.of}".replace(" ", "-").replace("_", "-"),
        )


def _errors_about_mean(effect: EffectByCampaign) -> dict[str, Array]:
    """Return the error of every campaign at whole degrees [mrad], nan where it has no poses.

    Less its mean over the angles that all campaigns visited, or else over its own.
    """
    errors = effect.errors or {}
    common = np.all([alone.visited for alone in errors.values()], axis=0)
    shown = {}
    for name, alone in errors.items():
        error = np.where(alone.visited, alone.error_mrad, np.nan)
        about = common if common.sum() >= _LEAST_COMMON_DEG else alone.visited
        shown[name] = np.asarray(error - error[about].mean() if about.any() else error)
    return shown


def _turn_figure(limit_mrad: float) -> Any:
    """Return an empty figure of an error over a turn of a joint."""
    x = _axis("joint angle [deg], by the turn", range=[0, 360], dtick=45)
    y = _axis("error [mrad]", range=[-limit_mrad, limit_mrad], zeroline=True)
    return theme.new_figure(280, x, y)


# The error that resolver uncertainty alone causes, plane by plane.


def plane_drawings(planes: Sequence[PlaneRecord]) -> Iterator[Drawing]:
    """Yield the expected error over every plane of the Monte Carlo."""
    every = np.concatenate([plane.map.rows[:, 2] for plane in planes])
    for plane in planes:
        x, y, error = plane.map.rows.T
        limit = 1.08e3 * plane.reach_m[1]
        sides = {"range": [-limit, limit], "showgrid": False, "zeroline": False}
        x_axis = _axis("x [mm]", constrain="domain", **sides)
        figure = theme.new_figure(330, x_axis, _axis("y [mm]", scaleanchor="x", **sides))
        if len(error):
            figure.add_heatmap(
                x=x,
                y=y,
                z=_short(error),
                zmin=float(every.min()),
                zmax=float(every.max()),
                colorscale="Cividis",
                colorbar={"title": {"text": "mm"}, "outlinewidth": 0},
                hovertemplate="(%{x}, %{y}): %{z:.3f} mm<extra></extra>",
            )
        for radius in (1e3 * reach_m for reach_m in plane.reach_m):
            ends = {"x0": -radius, "x1": radius, "y0": -radius, "y1": radius}
            figure.add_shape(type="circle", line={"color": theme.GREY, "width": 1}, **ends)
        mean = f"mean {error.mean():.3f} mm" if len(error) else "no grid point in reach"
        yield Drawing(
            figure,
            f"Monte Carlo: error over the plane z = {plane.plane_mm} mm",
            f"{sentence(mean)} Circles: requested reach. No colour between them: no posture within "
            "the joint limits.",
            f"plane-{plane.plane_mm}",
        )


# Errors of every arm of a fleet.

_ROW_PX, _LEAST_PX, _MOST_PX = 16, 300, 1600


def fleet_drawing(judged: Sequence[FleetCampaign]) -> Drawing:
    """Return the errors before and after of the last campaign of each arm."""
    figure = theme.new_figure(
        int(np.clip(_ROW_PX * len(judged) + 90, _LEAST_PX, _MOST_PX)),
        _axis("mean position error [mm]", type="log"),
        _axis("arm", type="category"),
    )
    for name, model, color, symbol in (
        ("before_mm", "uncalibrated", theme.BEFORE, "diamond"),
        ("after_mm", "final model", theme.AFTER, "circle"),
    ):
        figure.add_scatter(
            x=[getattr(campaign.became, name) for campaign in judged],
            y=[campaign.arm for campaign in judged],
            mode="markers",
            name=model,
            marker={"color": color, "symbol": symbol, "size": 7},
            hovertemplate=f"%{{y}}: %{{x:.4f}} mm<extra>{model}</extra>",
        )
    return Drawing(
        figure,
        "Mean position error of every arm",
        "Last campaign of each arm, the most accurate below. Over held-out poses where a campaign "
        "has some, else over the poses fitted.",
        "fleet-errors",
    )
