"""The chain of links calibrated: its postures, errors before and after, and against the noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures.registry import picture
from pa10cal.figures.style import evenly, label_space, new_figure, panel, plain_log
from pa10cal.figures.table import ResultTable, Row, frame_of
from pa10cal.reports import theme
from pa10cal.reports.blocks import grid
from pa10cal.reports.formatting import display_name
from pa10cal.results.codec import read
from pa10cal_curve.records import CurveCalibrationRecord, CurveStudySummary, Individual, OverFloor

#: The file of a results folder that these are drawn of.
FROM = "calibration.json"
#: How individuals depart, in short.
DEPARTS = {"rows": "by its rows", "any_way": "in any way"}
_MOST_POSTURES = 24
_COLOURS = {"spline": theme.BLUE, "helix": theme.ORANGE, "wave": theme.GREEN}
#: Of each model its colour, its name, and that in short.
_MODELS = {
    "two_level": (theme.AFTER, "two-level (paper)", "two-level"),
    "two_level_all": (theme.AFTER_COMBINED, "two-level, all poses inside", "all inside"),
    "general": (theme.GREEN, "general", "general"),
}
#: Beside each other: fitted, held out.
_ASIDE = {"fitted": -0.14, "held_out": 0.14}


def read_content(folder: Path) -> tuple[str, CurveCalibrationRecord]:
    """Return the footer of the pictures of a study's folder, and the study.

    Raises:
        RecordError: when it cannot be used.
    """
    study = read(CurveCalibrationRecord, folder / FROM, within=folder)
    asked: Any = study.settings
    footer = (
        f"{study.summaries[0].individuals} arms of {asked['links']} links of "
        f"{asked['link_m']:g} m each way, {asked['postures']} postures each, noise "
        f"{asked['position_mm']:g} mm and {1e3 * asked['attitude_rad']:g} mrad. Synthetic data. "
        f"Provenance: {study.provenance}."
    )
    return footer, study


@picture(
    title="A chain of links, calibrated",
    needs=(),
    caption="""
The chain of links as a serial arm with two joints a link, calibrated. Upper left, some postures
in which one arm was measured: along splines, helices and moments of a travelling wave, at any
roll that its joints allow. Upper right, the position error of each pose before and after
calibration; hollow markers are held-out poses. Dashed: the noise floor, the mean error that the
stated noise alone leaves. Lower left, the mean error of every arm relative to that floor;
dotted, the limit. The two-level model is the paper's, with some or all poses on its inner
level; it has no tool parameters and cannot represent a flange that deviates in any way. Lower
right, the errors of its parameters in standard uncertainties.
""",
)
def draw_curve_calibration(study: CurveCalibrationRecord) -> Figure:
    """Draw postures, errors pose by pose, means over the noise floor, and scores."""
    figure = new_figure(
        150.0, f"A chain of {study.joints} joints, posed along curves and calibrated (synthetic)"
    )
    _draw_postures(panel(figure, 2.0, 82.0, 64.0, 60.0, projection="3d"), study)
    _draw_poses(panel(figure, 88.0, 92.0, 78.0, 44.0), study)
    _draw_means(panel(figure, 16.0, 24.0, 96.0, 42.0), study)
    _draw_scores(panel(figure, 124.0, 24.0, 42.0, 42.0), study)
    return figure


def _draw_postures(axes: Axes, study: CurveCalibrationRecord) -> None:
    places_m, shapes = study.postures_of_first.p_m, study.postures_of_first.shape
    for k in evenly(len(shapes), _MOST_POSTURES):
        axes.plot(*places_m[k].T, color=_COLOURS[shapes[k]], linewidth=0.7, marker=".", ms=2.0)
    for shape, colour in _COLOURS.items():
        axes.plot([], [], color=colour, label=shape)
    axes.plot([0.0], [0.0], [0.0], color=theme.BLACK, marker="s", linestyle="none", label="base")
    label_space(axes, places_m.min(axis=(0, 1)), places_m.max(axis=(0, 1)))
    axes.legend(loc="upper left", bbox_to_anchor=(-0.02, 1.04), ncols=2, columnspacing=1.0)


def _draw_poses(axes: Axes, study: CurveCalibrationRecord) -> None:
    """Draw the errors of the first individual that departs by its rows, pose by pose."""
    poses = _by_rows(study)[0].poses
    held_out, before_mm = poses.held_out, poses.nominal_mm
    place = np.argsort(np.lexsort((before_mm, held_out))) + 1
    shown = (
        ("nominal", before_mm, theme.BEFORE, "o"),
        ("two-level", poses.two_level_mm, theme.AFTER, "o"),
        ("general", poses.general_mm, theme.GREEN, "s"),
    )
    for label, errors_mm, colour, mark in shown:
        look: dict[str, Any] = {"color": colour, "marker": mark, "ms": 2.2, "linestyle": "none"}
        axes.plot(place[~held_out], errors_mm[~held_out], label=label, **look)
        axes.plot(place[held_out], errors_mm[held_out], markerfacecolor="white", **look)
    axes.axhline(study.noise_floor_mm, color=theme.BLACK, linestyle="--", label="noise floor")
    axes.axvline(float((~held_out).sum()) + 0.5, color=theme.GREY, linewidth=0.6)
    every = np.concatenate([errors_mm for _, errors_mm, _, _ in shown])
    plain_log(axes, "y", 0.8 * float(every.min()), 1.3 * float(every.max()))
    axes.set_xlabel("pose, by error before; right: held out (hollow)")
    axes.set_ylabel("position error [mm]")
    axes.set_title("the first arm that departs by its rows")
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.44, -0.24), "ncols": 4}
    axes.legend(**below, columnspacing=1.0, handlelength=1.2)


def _draw_means(axes: Axes, study: CurveCalibrationRecord) -> None:
    """Draw the mean errors of every individual over the noise floor."""
    columns = list(product(DEPARTS, _MODELS))
    for x, (departs, model) in enumerate(columns):
        alike = [each for each in study.individuals if each.departs == departs]
        spread = np.linspace(-0.09, 0.09, len(alike)) if len(alike) > 1 else np.zeros(1)
        for of, aside in _ASIDE.items():
            errors = [getattr(each.errors[model], of) for each in alike]
            times = [error.mean_mm / study.noise_floor_mm for error in errors]
            colour, *_ = _MODELS[model]
            face = colour if of == "fitted" else "white"
            axes.plot(x + aside + spread, times, "o", ms=3.0, color=colour, markerfacecolor=face)
    axes.axhline(1.0, color=theme.BLACK, linestyle="--")
    axes.axhline(study.bar, color=theme.BEFORE, linestyle=":", linewidth=1.2)
    axes.text(len(columns) - 0.45, study.bar, "bar", color=theme.BEFORE, va="bottom", ha="right")
    axes.set_xlim(-0.5, len(columns) - 0.5)
    axes.set_ylim(bottom=0.0)
    names = [f"{_MODELS[model][2]}\n{DEPARTS[departs]}" for departs, model in columns]
    axes.set_xticks(range(len(columns)), names, fontsize=7.0)
    axes.grid(visible=False, axis="x")
    axes.set(ylabel="mean error / noise floor", title="every arm: fitted (full), held out (hollow)")


def _draw_scores(axes: Axes, study: CurveCalibrationRecord) -> None:
    """Draw how far parameters ended from the truth, in their standard uncertainties."""
    scores = np.array(
        [score for each in _by_rows(study) for score in each.models["two_level"].scores.values()]
    )
    edges = np.arange(-4.0, 4.01, 0.5)
    axes.hist(scores.clip(-3.99, 3.99), edges.tolist(), density=True, color=theme.SKY)
    at = np.linspace(-4.0, 4.0, 161)
    axes.plot(at, np.exp(-0.5 * at**2) / np.sqrt(2.0 * np.pi), color=theme.BLACK)
    axes.set_xlim(-4.0, 4.0)
    axes.set_xlabel("(value − truth) / std")
    axes.set_title(
        f"{len(scores)} identifiable parameters,\n"
        f"two-level; rms {np.sqrt(np.mean(scores**2)):.2f}, line: 1"
    )
    axes.set_yticks([])


def _by_rows(study: CurveCalibrationRecord) -> list[Individual]:
    return [each for each in study.individuals if each.departs == "rows"]


# The chain of links calibrated: rank, null directions and errors of both models.

_HEADER = (
    "arm departs",
    "model",
    "unknowns",
    "rank",
    "converged",
    "fitted / floor",
    "held out / floor",
    "arms within the bar, fitted",
    "held out",
    "rms score",
)
_ERRORS_HEADER = ("arm departs", "model", "fitted", "peak", "held out", "peak", "held out, true")


@picture(
    title="Rank, null directions and errors of the chain",
    needs=(),
    caption="""
Results for the chains that were calibrated: unknowns, rank, directions that no pose determines,
and errors relative to the noise floor, for arms that depart by the parameters of their rows and
for arms that depart in any way. Null directions of the two-level model are the height and the
zero of the first joint, which the base frame contains as well; the general model omits
redundant parameters beforehand. Errors are mean distances between predicted and measured
positions, of fitted and of held-out poses.
""",
)
def tabulate_curve_calibration_summary(study: CurveCalibrationRecord) -> ResultTable:
    """Return a row for each way to depart and each model."""
    first = [each for each in study.individuals if each.number == 1]
    redundant = first[0].models["general"].redundant
    data = frame_of(_HEADER, map(_row, study.summaries))
    return ResultTable(
        title=f"A chain of {study.joints} joints, calibrated (synthetic)",
        data=data,
        shown=(
            grid("", _HEADER, map(_row, study.summaries)),
            grid(
                "The first arm of each, position errors [mm]",
                _ERRORS_HEADER,
                [row for each in first for row in _error_rows(each)],
            ),
            grid("Null directions", ("model", "direction"), _directions(study)),
            grid(
                "Omitted: redundant parameters of the general model",
                ("parameter", "the same as"),
                [(display_name(name), _said(said)) for name, said in redundant.items()],
            ),
        ),
        notes=(
            f"Noise floor: {study.noise_floor_mm:.4f} mm, the mean error that the stated noise of "
            f"a position alone leaves. Bar: {study.bar:g} times the floor.",
            "Over the floor: mean over the arms, in brackets the largest. True: against the pose "
            "itself, without the noise of its reading.",
            "The two-level model has no tool parameters: where the flange departs in any way, "
            "it cannot represent two directions. All poses inside: M = N.",
            "Score: (value − truth) / standard uncertainty, of identifiable parameters.",
        ),
    )


def _row(found: CurveStudySummary) -> Row:
    return (
        DEPARTS[found.departs],
        _MODELS[found.model][1],
        str(found.unknowns),
        str(found.rank),
        f"{found.converged} of {found.individuals}",
        _times(found.fitted),
        _times(found.held_out),
        f"{found.fitted.within_bar} of {found.individuals}",
        f"{found.held_out.within_bar} of {found.individuals}",
        "" if found.rms_score is None else f"{found.rms_score:.2f}",
    )


def _error_rows(each: Individual) -> Iterator[Row]:
    for model, of in each.errors.items():
        errors_mm = (
            *(of.fitted.mean_mm, of.fitted.peak_mm),
            *(of.held_out.mean_mm, of.held_out.peak_mm, of.held_out_true.mean_mm),
        )
        name = _MODELS[model][1] if model in _MODELS else model
        yield (DEPARTS[each.departs], name, *(f"{error_mm:.4f}" for error_mm in errors_mm))


def _directions(study: CurveCalibrationRecord) -> tuple[Row, ...]:
    return tuple(
        (_MODELS[found.model][1], _said(weights))
        for found in study.summaries
        if found.departs == study.summaries[0].departs and found.model != "two_level_all"
        for weights in found.null_directions
    )


def _said(weights: Mapping[str, float]) -> str:
    """Return a combination of parameters in words, such as `δd₁ − base z`."""
    parts = []
    for name, weight in weights.items():
        size = f"{abs(weight):.3g}"
        times = "" if size == "1" else f"{size} "
        parts.append(f"{'+' if weight > 0 else '−'} {times}{display_name(name)}")
    return " ".join(parts).removeprefix("+ ")


def _times(found: OverFloor) -> str:
    return f"{found.mean:.2f} ({found.largest:.2f})"
