"""Figures of the pages in two dimensions, each a function of the records that it shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.reports import theme
from pa10cal.reports.blocks import Drawing
from pa10cal.reports.formatting import named, sentence
from pa10cal.results.calibration import CampaignsAgree, EffectByCampaign, PosesNeeded
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import EffectParameter, HoldoutRecord
from pa10cal.results.montecarlo import PlaneRecord
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.results.outcomes import FleetCampaign
from pa10cal.results.record import EffectName

if TYPE_CHECKING:
    import pandas as pd


def _axis(title: str, **more: Any) -> dict[str, Any]:
    return {"title": {"text": title}, **more}


def _short(values: Iterable[float]) -> list[float | None]:
    """Return values rounded to four digits, which keeps a page small; None for nan."""
    return [None if np.isnan(value) else float(f"{value:.4g}") for value in values]


def _add_line(figure: Any, x: Any, y: Iterable[float], name: str, hover: str, **look: Any) -> None:
    """Add a line; `hover` is the text shown at a point, `look` plotly's `line`.

    Where x is None it is 0, 1, 2, …
    """
    hover = f"{hover}<extra></extra>"
    figure.add_scatter(x=x, y=_short(y), name=name, mode="lines", line=look, hovertemplate=hover)


def _add_band(
    figure: Any, x: Array, middle: Array, half: Array, color: str, opacity: float
) -> None:
    """Add a band about a line, which is not in the legend."""
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


# Distribution of the errors of held-out poses.

#: Most steps of a distribution that are drawn.
_MOST_STEPS = 100
_DASHES = {"uncalibrated": "solid", "geometry": "dash", "linear": "dashdot"}


def shares_drawing(held_out: HoldoutRecord, titles: Mapping[str, str], unit: str) -> Drawing | None:
    """Return the share of held-out configurations with a smaller error, under each model.

    None where the instrument measures no orientation and those are asked for.

    Args:
        held_out: errors of the models.
        titles: titles of the models to draw, by their names.
        unit: `mm` of positions, `deg` of orientations.
    """
    what = {"mm": "position", "deg": "orientation"}[unit]
    figure = theme.new_figure(
        360,
        _axis(f"{what} error [{unit}]", type="log", dtick=1),
        _axis("share of the configurations [%]", range=[0, 102]),
    )
    dotted = False
    for name, title in titles.items():
        rows = held_out.models[name].rows
        errors = rows.error_mm
        if unit == "deg":
            if rows.rotation_deg is None:
                return None
            errors = np.linalg.norm(rows.rotation_deg, axis=1)
        extrapolated = rows.extrapolated
        if extrapolated is None:
            extrapolated = np.zeros(len(rows), dtype=bool)
        for apart in np.unique(extrapolated).tolist():
            dotted |= apart
            ordered = np.sort(errors[extrapolated == apart])
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
        "For each model, the share of the held-out configurations with a smaller error; in "
        f"brackets how many.{' Dotted: those beyond the joint angles of the fit.' * dotted}",
        f"shares-{what}",
    )


# Motion of the base over time.

#: Motion of the base: unit shown, columns of the table of poses, the factor to that unit, and the
#: index of the first component in the covariance.
_MOTIONS = {"shift": ("mm", "motion_{}_mm", 1.0, 0), "turn": ("mrad", "motion_r{}_rad", 1e3, 3)}


def motion_drawing(poses: pd.DataFrame, kind: str, knocks_s: Sequence[float]) -> Drawing:
    """Return the motion that targets on the base show, over time, with two standard uncertainties.

    Args:
        poses: the table of poses, with columns `motion_…`.
        kind: `shift` or `turn`.
        knocks_s: when a target moved against the others.
    """
    unit, column, scale, first_component = _MOTIONS[kind]
    first = poses["time_s"].min()
    hours = ((poses["time_s"] - first) / 3600.0).round(4).to_numpy()
    figure = theme.new_figure(320, _axis("time [h]"), _axis(f"{kind} [{unit}]"))
    looks = (("x", theme.BLUE, "solid"), ("y", theme.VERMILLION, "dash"), ("z", theme.GREEN, "dot"))
    for k, (name, color, dash) in enumerate(looks):
        value = scale * poses[column.format(name)].to_numpy()
        component = first_component + k
        u = scale * np.sqrt(poses[f"motion_cov_{component}{component}"].to_numpy())
        _add_band(figure, hours, value, 2 * u, color, 0.2)
        hover = f"{kind} {name} %{{y:.4g}} {unit}"
        _add_line(figure, hours, value, name, hover, color=color, dash=dash, width=1.5)
    for knock_s in knocks_s:
        line = {"color": theme.PURPLE, "dash": "longdash"}
        figure.add_vline((knock_s - first) / 3600.0, line=line)
    return Drawing(
        figure,
        f"Motion of the instrument against targets on the base: {kind}",
        "About its mean, along the instrument's axes; bands of two standard uncertainties. All "
        "readings were turned back by it. Upright dashes: a target moved against the others.",
        f"base-motion-{kind}",
    )


# How many poses are enough.

#: Ticks of a logarithmic axis, written in full: plotly would leave the decade out.
_TICKS = [digit * 10.0**decade for decade in range(-4, 5) for digit in (1, 2, 5)]


def poses_drawing(poses: PosesNeeded) -> Drawing | None:
    """Return the expected uncertainty by number of poses, and the one that is enough."""
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

_ARC_SECONDS_PER_MRAD = 206.265
#: Approximate number of points of a line over a turn; there is a whole number between two knots.
_POINTS = 360
#: With fewer angles that all campaigns visited each is drawn about its own mean [deg].
_LEAST_COMMON_DEG = 10
#: Colour and dash of each campaign; of more campaigns the others are grey.
_LOOKS_OF_CAMPAIGNS = (
    (theme.BLUE, "solid"),
    (theme.ORANGE, "solid"),
    (theme.GREEN, "dash"),
    (theme.PURPLE, "dashdot"),
)


class _JointMap(NamedTuple):
    """The error of a joint at P angles over a turn."""

    knot_count: int
    angle_deg: Array  # (P,)
    error_mrad: Array  # (P,)
    half_width_mrad: Array  # (P,) of the 95 % interval

    @classmethod
    def of(cls, knots: Sequence[EffectParameter]) -> _JointMap:
        """Return the map of the knots of a periodic spline [rad]."""
        from scipy.interpolate import CubicSpline  # late: a third of a second, for few campaigns

        around = (*knots, knots[0])
        knots_deg = np.linspace(0.0, 360.0, len(around))
        angle_deg = np.linspace(0.0, 360.0, max(_POINTS // len(knots), 2) * len(knots) + 1)
        spline = CubicSpline(knots_deg, [knot.value for knot in around], bc_type="periodic")
        std = np.interp(angle_deg, knots_deg, [knot.std for knot in around])
        error_mrad = 1e3 * np.asarray(spline(angle_deg))
        return cls(len(knots), angle_deg, error_mrad, 1e3 * (HALF_WIDTH_95 * std))


def joint_map_drawings(verdict: VerdictRecord) -> Iterator[Drawing]:
    """Yield the error of every joint that has a map over its turn, with its 95 % band."""
    maps = {
        int(effect.of.removeprefix("joint ")): _JointMap.of(knots)
        for effect in verdict.effects
        if (knots := effect.knots)
    }
    unseen = {joint: _unseen(joint, joint_map, verdict) for joint, joint_map in maps.items()}
    # Where nothing was fitted a band may be many times the map: it is not all shown there.
    largest_mrad = [
        np.max(np.abs(of.error_mrad) + np.where(unseen[joint], 0.0, of.half_width_mrad))
        for joint, of in maps.items()
    ]
    limit_mrad = 1.1 * float(max(largest_mrad)) if largest_mrad else 1.0
    for joint, joint_map in sorted(maps.items()):
        yield _joint_map_drawing(joint, joint_map, unseen[joint], limit_mrad)


def _unseen(joint: int, joint_map: _JointMap, verdict: VerdictRecord) -> Mask:
    """Return at which angles (P,) of a map the poses fitted have not seen its joint."""
    if verdict.angles_seen is None:
        return np.zeros(len(joint_map.angle_deg), dtype=bool)
    # each (1, stretches), beside angles (P, 1)
    low, high = np.degrees(verdict.angles_seen[joint - 1].stretches).T[:, None]
    angle = joint_map.angle_deg[:, None]
    return np.asarray(~((angle >= low) & (angle <= high)).any(axis=1))


def _joint_map_drawing(
    joint: int, joint_map: _JointMap, unseen: Mask, limit_mrad: float
) -> Drawing:
    """Return the map of a joint, dotted and shaded at the angles (P,) that the fit has not seen."""
    angle, error = joint_map.angle_deg, joint_map.error_mrad
    figure = _turn_figure(limit_mrad)
    # first angle of every stretch that was not seen, and the first after it
    changes = np.flatnonzero(np.diff(unseen, prepend=False, append=False))
    for begin, end in changes.reshape(-1, 2):
        x0, x1 = float(angle[begin]), float(angle[end - 1])
        figure.add_vrect(x0=x0, x1=x1, fillcolor=theme.GREY, opacity=0.25, line_width=0)
    _add_band(figure, angle, error, joint_map.half_width_mrad, theme.SKY, 0.45)
    for name, hidden, dash in (("map", unseen, "solid"), ("extrapolated", ~unseen, "dot")):
        shown, hover = np.where(hidden, np.nan, error), "%{x:.0f}°: %{y:.3f} mrad"
        _add_line(figure, angle, shown, name, hover, color=theme.AFTER, dash=dash, width=2)
    known, over = (error, "turn") if unseen.all() else (error[~unseen], "measured angles")
    rms = float(np.sqrt(np.mean(known**2)))
    return Drawing(
        figure,
        f"Joint {joint}: error over its angle",
        f"Rms {rms:.3f} mrad ({_ARC_SECONDS_PER_MRAD * rms:.1f} arc seconds) over the {over}; "
        f"{100.0 * np.mean(~unseen):.0f} % of the turn measured; knots "
        f"{360.0 / joint_map.knot_count:.3g}° apart.",
        f"joint-error-{joint}",
    )


def campaigns_drawings(verdict: VerdictRecord) -> Iterator[Drawing]:
    """Yield every joint's error by its angle, the campaigns of a group on top of each other."""
    maps = [effect for effect in verdict.by_campaign or () if effect.errors]
    by_joint = sorted(maps, key=lambda effect: (int(effect.of.removeprefix("joint ")), effect.id))
    names = dict.fromkeys(name for effect in by_joint for name in effect.errors or ())
    looks = dict(zip(names, _LOOKS_OF_CAMPAIGNS, strict=False))
    found = {(effect.id, effect.of): effect for effect in verdict.effects}
    errors_by_joint = [_errors_about_mean(effect) for effect in by_joint]
    every = [error for errors in errors_by_joint for error in errors.values()]
    limit_mrad = 1.05 * float(np.abs(np.nan_to_num(every)).max(initial=0.0)) or 1.0
    for effect, errors in zip(by_joint, errors_by_joint, strict=True):
        figure = _turn_figure(limit_mrad)
        for name, error in errors.items():
            color, dash = looks.get(name, (theme.GREY, "dot"))
            hover = f"{name} at %{{x:.0f}}°: %{{y:.3f}} mrad"
            _add_line(figure, None, error, name, hover, color=color, dash=dash, width=1.5)
        caption = sentence(f"Agreement: {', '.join(_agreement(effect.agreement))}")
        witness = getattr(found.get((effect.id, effect.of)), "witness", None)
        if witness is not None and witness.ripple is not None:
            low, high = witness.ripple.interval95
            caption += f" Motor's share: α {witness.ripple.alpha:.2f} ({low:.2f} to {high:.2f})."
        yield Drawing(
            figure,
            f"{named(EffectName(id=effect.id, of=effect.of)).capitalize()}, campaign by campaign",
            caption,
            f"campaigns-{effect.id}-{effect.of}".replace(" ", "-").replace("_", "-"),
        )


def _agreement(pairs: Sequence[CampaignsAgree]) -> Iterator[str]:
    """Yield how well campaigns agree, pair by pair; with their names where there are several."""
    for pair in pairs:
        of = f"{pair.first} and {pair.second} " if len(pairs) > 1 else ""
        if pair.correlation is not None and pair.correlation95 is not None:
            low, high = pair.correlation95
            yield f"{of}r {pair.correlation:.2f} ({low:.2f} to {high:.2f})"
        elif pair.share_of_turn > 0.0:
            yield f"{of}r not known, {100.0 * pair.share_of_turn:.0f} % of the turn seen by both"
        else:
            yield f"{of}seen at other angles"


def _errors_about_mean(effect: EffectByCampaign) -> dict[str, Array]:
    """Return the error of every campaign at whole degrees [mrad], nan where it has no poses.

    The mean over the angles that all campaigns visited, or else over its own, is subtracted.
    """
    errors = effect.errors or {}
    common = np.all([of_campaign.visited for of_campaign in errors.values()], axis=0)
    about_mean = {}
    for name, of_campaign in errors.items():
        error = np.where(of_campaign.visited, of_campaign.error_mrad, np.nan)
        angles = common if common.sum() >= _LEAST_COMMON_DEG else of_campaign.visited
        about_mean[name] = np.asarray(error - error[angles].mean() if angles.any() else error)
    return about_mean


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
