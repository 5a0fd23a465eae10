"""The residual field: from every measured position, how far the prediction is off and where to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Beside, Callout, Drawing, PageBlock, Paragraph, grid
from pa10cal.reports.formatting import mm, sentence
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLUE, VERMILLION, new_space

#: The longest line is this part of what the positions span.
_LONGEST_PART = 0.25
_STEPS = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0])
#: Of more configurations of a kind an even selection is drawn.
_MOST_LINES = 300
_MOST_ROWS = 8
#: More configurations than this get thinner lines.
_CROWD = 150
_MARGIN_MM = 10.0
_LOOKS = {"fitted": (BLUE, "circle"), "held out": (VERMILLION, "diamond")}
_BEFORE, _AFTER = "calibrated", "with the effects found"


@dataclass(frozen=True)
class _Field:
    """Residuals of N configurations along the base's axes."""

    poses: str  # `fitted` or `held out`
    label: NDArray[np.str_]  # (N,) labels of the poses
    load_N: Array
    place_mm: Array  # (N, 3) where they are
    residual_mm: dict[str, Array]  # (N, 3) by what the model is: `_BEFORE`, `_AFTER`


def residuals(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the residual field, before and after effects joined the model."""
    fields = list(_fields(results))
    if not fields:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    # A round number by which the longest residual fills its part of the picture.
    places = np.concatenate([field.place_mm for field in fields])
    before = np.concatenate([field.residual_mm[_BEFORE] for field in fields])
    longest = max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    wanted = max(_LONGEST_PART * float(np.ptp(places, axis=0).max()) / longest, 1.0)
    steps = _STEPS * 10.0 ** np.floor(np.log10(wanted))
    scale = float(steps[steps <= wanted].max())
    ends = np.concatenate([places, places + scale * before])
    ranges_mm = np.stack([ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM], axis=1)
    words = results.words
    lines = "" if words is None else f" {words.arrows.replace('Arrows', 'Lines')}"
    yield Paragraph(
        "Residuals of every configuration in the robot's base frame: each line begins at the "
        f"position of the end-effector and shows its residual {scale:g} times enlarged, the same "
        "in every picture. Lines that agree or turn steadily from place to place show an effect "
        f"that the model lacks; noise has no common direction.{lines}"
    )
    models = list(fields[0].residual_mm)
    drawings = tuple(_drawing(fields, model, scale, ranges_mm) for model in models)
    yield Beside(drawings) if len(drawings) > 1 else drawings[0]
    last = models[-1]
    rows = [
        (float(np.linalg.norm(vector)), str(label), f"{load_N:g}", field.poses, vector)
        for field in fields
        for label, load_N, vector in zip(
            field.label, field.load_N, field.residual_mm[last], strict=True
        )
    ]
    rows.sort(key=lambda row: -row[0])
    yield grid(
        f"The largest residuals, {last} [mm]",
        ("pose", "load [N]", "poses", "x", "y", "z", "length"),
        [(*words, *map(mm, vector), mm(length)) for length, *words, vector in rows[:_MOST_ROWS]],
        (1, 3, 4, 5, 6),
    )


def _fields(results: ResultsBundle) -> Iterator[_Field]:
    if results.analysis is not None:
        gap = results.analysis.gap
        with_effects = results.verdict is not None and bool(results.verdict.effects)
        for poses, rows in (("fitted", gap.train), ("held out", gap.holdout)):
            if rows is not None and len(rows):
                after = {_AFTER: rows.after_mm} if with_effects else {}
                residual_mm = {_BEFORE: rows.before_mm, **after}
                yield _Field(poses, rows.pose, rows.load_N, rows.place_mm, residual_mm)
    elif results.calibration is not None:
        fit = results.calibration.residuals
        residual_mm = {_BEFORE: fit.position_mm}
        yield _Field("fitted", fit.pose, fit.load_N, fit.place_mm, residual_mm)


def _drawing(fields: list[_Field], model: str, scale: float, ranges_mm: Array) -> Drawing:
    figure = new_space(460, ranges_mm)
    crowded = sum(len(field.label) for field in fields) > _CROWD
    rms_of = []
    for field in fields:
        color, symbol = _LOOKS[field.poses]
        count = len(field.label)
        rows = np.unique(np.linspace(0, count - 1, _MOST_LINES).round().astype(int))
        places, residual = field.place_mm[rows], field.residual_mm[model][rows]
        # A line from each place to its end, nan between the lines.
        lines = np.stack([places, places + scale * residual, np.full_like(places, np.nan)], axis=1)
        xyz = dict(zip("xyz", lines.reshape(-1, 3).round(2).T, strict=True))
        figure.add_scatter3d(
            **xyz,
            mode="lines",
            line={"color": color, "width": 3 if crowded else 5},
            name=f"residual, {field.poses}",
            hoverinfo="skip",
            showlegend=False,
        )
        some = f" ({len(rows)} of {count})" if len(rows) < count else ""
        figure.add_scatter3d(
            **dict(zip("xyz", places.round(1).T, strict=True)),
            mode="markers",
            marker={"color": color, "size": 1.8 if crowded else 2.5, "symbol": symbol},
            name=f"{field.poses}{some}",
            text=[
                f"{label}, {load:g} N: {np.linalg.norm(vector):.3f} mm"
                f"<br>({vector[0]:.3f}, {vector[1]:.3f}, {vector[2]:.3f})"
                for label, load, vector in zip(
                    field.label[rows], field.load_N[rows], residual, strict=True
                )
            ],
            hoverinfo="text",
        )
        rms_mm = np.sqrt(np.mean(np.sum(field.residual_mm[model] ** 2, axis=1)))
        rms_of.append(f"{field.poses} {rms_mm:.3f} mm rms")
    shapes = "Circles: fitted; diamonds: held out. " if len(fields) > 1 else ""
    return Drawing(
        figure,
        f"Residuals, {model}",
        f"{shapes}{sentence(', '.join(rms_of))} Drag to turn, point at a mark for its numbers.",
        f"residuals-{model.replace(' ', '-')}",
        in_space=True,
    )
