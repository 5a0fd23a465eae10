"""The residual field: from every measured position, how far the prediction is off and where to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Beside, Block, Callout, Drawing, Paragraph, grid
from pa10cal.reports.formatting import mm
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLUE, VERMILLION, new_space

#: The longest line is this part of what the positions span.
_LONGEST_PART = 0.25
_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
#: Of more configurations of a kind an even selection is drawn.
_MOST_LINES = 300
_MOST_ROWS = 8
#: More configurations than this get thinner lines.
_CROWD = 150
_MARGIN_MM = 10.0
_LOOKS = {"fitted": (BLUE, "circle"), "held out": (VERMILLION, "diamond")}


@dataclass(frozen=True)
class _Field:
    """Residuals of N configurations along the base's axes."""

    poses: str  # `fitted` or `held out`
    label: NDArray[np.str_]  # (N,) labels of the poses
    load_N: Array
    place_mm: Array  # (N, 3) where they are
    # (N, 3) by what the model is: `calibrated`, `with the effects found`
    residual_mm: dict[str, Array]


def residuals(results: ResultsBundle) -> Iterator[Block]:
    """Yield the residual field, before and after effects joined the model."""
    fields = _fields(results)
    if not fields:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    models = list(fields[0].residual_mm)
    scale = _enlarged(fields, models[0])
    words = results.words
    lines = "" if words is None else f" {words.arrows.replace('Arrows', 'Lines')}"
    yield Paragraph(
        "Residuals of every configuration in the robot's base frame: each line begins at the "
        f"position of the end-effector and shows its residual {scale:g} times enlarged, the same "
        "in every picture. Lines that agree or turn steadily from place to place show an effect "
        f"that the model lacks; noise has no common direction.{lines}"
    )
    ranges = _ranges(fields, models[0], scale)
    drawings = tuple(_drawing(fields, model, scale, ranges) for model in models)
    yield Beside(drawings) if len(drawings) > 1 else drawings[0]
    last = models[-1]
    yield grid(
        f"The largest residuals, {last} [mm]",
        ("pose", "load [N]", "poses", "x", "y", "z", "length"),
        _largest(fields, last),
        (1, 3, 4, 5, 6),
    )


def _fields(results: ResultsBundle) -> list[_Field]:
    before, after = "calibrated", "with the effects found"
    if results.analysis is not None:
        gap = results.analysis.gap
        with_effects = results.verdict is not None and bool(results.verdict.effects)
        return [
            _Field(
                poses,
                rows.pose,
                rows.load_N,
                rows.place_mm,
                {before: rows.before_mm, **({after: rows.after_mm} if with_effects else {})},
            )
            for poses, rows in (("fitted", gap.train), ("held out", gap.holdout))
            if rows is not None and len(rows)
        ]
    if results.calibration is not None:
        rows = results.calibration.residuals
        return [_Field("fitted", rows.pose, rows.load_N, rows.place_mm, {before: rows.position_mm})]
    return []


def _enlarged(fields: list[_Field], model: str) -> float:
    """Return a round number by which the longest residual fills its part of the picture."""
    places = np.concatenate([field.place_mm for field in fields])
    longest = max(float(np.linalg.norm(f.residual_mm[model], axis=1).max()) for f in fields)
    wanted = _LONGEST_PART * float(np.ptp(places, axis=0).max()) / max(longest, 1e-9)
    wanted = max(wanted, 1.0)
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * decade for step in _STEPS if step * decade <= wanted))


def _ranges(fields: list[_Field], model: str, scale: float) -> Array:
    """Return the ends (3, 2) of axes that hold every line, the same in every picture [mm]."""
    begins = np.concatenate([field.place_mm for field in fields])
    ends = begins + scale * np.concatenate([field.residual_mm[model] for field in fields])
    every = np.concatenate([begins, ends])
    return np.stack([every.min(axis=0) - _MARGIN_MM, every.max(axis=0) + _MARGIN_MM], axis=1)


def _drawing(fields: list[_Field], model: str, scale: float, ranges_mm: Array) -> Drawing:
    figure = new_space(460, ranges_mm)
    crowded = sum(len(field.label) for field in fields) > _CROWD
    for field in fields:
        color, symbol = _LOOKS[field.poses]
        rows = np.unique(np.linspace(0, len(field.label) - 1, _MOST_LINES).round().astype(int))
        places, residual = field.place_mm[rows], field.residual_mm[model][rows]
        ends = places + scale * residual
        gaps = np.full_like(places, np.nan)
        x, y, z = np.stack([places, ends, gaps], axis=1).reshape(-1, 3).round(2).T
        figure.add_scatter3d(
            x=_with_gaps(x),
            y=_with_gaps(y),
            z=_with_gaps(z),
            mode="lines",
            line={"color": color, "width": 3 if crowded else 5},
            name=f"residual, {field.poses}",
            hoverinfo="skip",
            showlegend=False,
        )
        figure.add_scatter3d(
            x=places[:, 0].round(1),
            y=places[:, 1].round(1),
            z=places[:, 2].round(1),
            mode="markers",
            marker={"color": color, "size": 1.8 if crowded else 2.5, "symbol": symbol},
            name=f"{field.poses} ({len(rows)} of {len(field.label)})"
            if len(rows) < len(field.label)
            else field.poses,
            text=[
                f"{label}, {load:g} N: {np.linalg.norm(vector):.3f} mm"
                f"<br>({vector[0]:.3f}, {vector[1]:.3f}, {vector[2]:.3f})"
                for label, load, vector in zip(
                    field.label[rows], field.load_N[rows], residual, strict=True
                )
            ],
            hoverinfo="text",
        )
    rms_mm = {f.poses: np.sqrt(np.mean(np.sum(f.residual_mm[model] ** 2, axis=1))) for f in fields}
    told = ", ".join(f"{poses} {rms:.3f} mm rms" for poses, rms in rms_mm.items())
    shapes = "Circles: fitted; diamonds: held out. " if len(fields) > 1 else ""
    return Drawing(
        figure,
        f"Residuals, {model}",
        f"{shapes}{told[:1].upper()}{told[1:]}. Drag to turn, point at a mark for its numbers.",
        f"residuals-{model.replace(' ', '-')}",
        in_space=True,
    )


def _with_gaps(values: Array) -> list[float | None]:
    """Return values as plotly takes them, None between the lines."""
    return [None if np.isnan(value) else float(value) for value in values]


def _largest(fields: list[_Field], model: str) -> Iterator[tuple[str, ...]]:
    rows = [
        (float(np.linalg.norm(vector)), str(label), float(load), field.poses, vector)
        for field in fields
        for label, load, vector in zip(
            field.label, field.load_N, field.residual_mm[model], strict=True
        )
    ]
    for length, label, load, poses, vector in sorted(rows, key=lambda row: -row[0])[:_MOST_ROWS]:
        yield label, f"{load:g}", poses, *(mm(part) for part in vector), mm(length)
