"""The residual field: from every measured position, how far the prediction is off and where to."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Beside, Callout, Drawing, PageBlock, Paragraph, grid
from pa10cal.reports.formatting import sentence
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLUE, VERMILLION, new_space
from pa10cal.results.analysis import GapRows

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
#: Models by the residuals that a record has of them.
_MODELS = {"before_mm": "calibrated", "after_mm": "with the effects found"}


def residuals(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the residual field, before and after effects joined the model."""
    fields = _fields(results)
    if not fields:
        yield Callout("missing", results.absent["calibration"])
        return
    # A round number by which the longest residual fills its part of the picture.
    places = np.concatenate([field.place_mm for field in fields.values()])
    before = np.concatenate([field.before_mm for field in fields.values()])
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
    with_effects = results.verdict is not None and bool(results.verdict.effects)
    models = list(_MODELS)[: 1 + (with_effects and results.analysis is not None)]
    drawings = tuple(_drawing(fields, model, scale, ranges_mm) for model in models)
    yield Beside(drawings) if len(drawings) > 1 else drawings[0]
    last = models[-1]
    rows = [
        (label, load_N, poses, *vector, np.linalg.norm(vector))
        for poses, field in fields.items()
        for label, load_N, vector in zip(
            field.pose, field.load_N, getattr(field, last), strict=True
        )
    ]
    rows.sort(key=lambda row: -row[-1])
    title = f"The largest residuals, {_MODELS[last]}"
    head = "pose | load [N] | poses | x [mm] | y [mm] | z [mm] | length [mm]"
    yield grid(title, head, rows[:_MOST_ROWS])


def _fields(results: ResultsBundle) -> dict[str, GapRows]:
    """Return residuals along the base's axes, of the poses fitted and of those held out."""
    if results.analysis is not None:
        gap = results.analysis.gap
        fields = {"fitted": gap.train, "held out": gap.holdout}
        return {poses: rows for poses, rows in fields.items() if rows is not None and len(rows)}
    if results.calibration is None:
        return {}
    fit = results.calibration.residuals
    of = {"pose": fit.pose, "load_N": fit.load_N, "place_mm": fit.place_mm, "extrapolated": None}
    return {"fitted": GapRows(**of, before_mm=fit.position_mm, after_mm=fit.position_mm)}


def _drawing(fields: dict[str, GapRows], model: str, scale: float, ranges_mm: Array) -> Drawing:
    figure = new_space(460, ranges_mm)
    crowded = sum(map(len, fields.values())) > _CROWD
    rms_of = []
    for poses, field in fields.items():
        color, symbol = _LOOKS[poses]
        count = len(field)
        rows = np.unique(np.linspace(0, count - 1, _MOST_LINES).round().astype(int))
        places, residual = field.place_mm[rows], getattr(field, model)[rows]
        # A line from each place to its end, nan between the lines.
        lines = np.stack([places, places + scale * residual, np.full_like(places, np.nan)], axis=1)
        figure.add_scatter3d(
            **dict(zip("xyz", lines.reshape(-1, 3).round(2).T, strict=True)),
            mode="lines",
            line={"color": color, "width": 3 if crowded else 5},
            name=f"residual, {poses}",
            hoverinfo="skip",
            showlegend=False,
        )
        some = f" ({len(rows)} of {count})" if len(rows) < count else ""
        figure.add_scatter3d(
            **dict(zip("xyz", places.round(1).T, strict=True)),
            mode="markers",
            marker={"color": color, "size": 1.8 if crowded else 2.5, "symbol": symbol},
            name=f"{poses}{some}",
            text=[
                f"{label}, {load:g} N: {np.linalg.norm(vector):.3f} mm"
                f"<br>({vector[0]:.3f}, {vector[1]:.3f}, {vector[2]:.3f})"
                for label, load, vector in zip(
                    field.pose[rows], field.load_N[rows], residual, strict=True
                )
            ],
            hoverinfo="text",
        )
        rms_mm = np.sqrt(np.mean(np.sum(getattr(field, model) ** 2, axis=1)))
        rms_of.append(f"{poses} {rms_mm:.3f} mm rms")
    shapes = "Circles: fitted; diamonds: held out. " if len(fields) > 1 else ""
    return Drawing(
        figure,
        f"Residuals, {_MODELS[model]}",
        f"{shapes}{sentence(', '.join(rms_of))} Drag to turn, point at a mark for its numbers.",
        f"residuals-{_MODELS[model].replace(' ', '-')}",
        in_space=True,
    )
