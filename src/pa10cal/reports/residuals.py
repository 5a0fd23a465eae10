"""Section of the page: the residual vectors, drawn at the measured positions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Callout, Drawing, PageBlock, Paragraph, SideBySide, grid
from pa10cal.reports.formatting import sentence
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.theme import BLUE, VERMILLION, new_space
from pa10cal.results.analysis import GapRows

#: The longest line is at most this part of the largest extent of the positions.
_LONGEST_PART = 0.25
#: Factors of enlargement within a decade.
_ROUND_FACTORS = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0])
#: Residuals are taken to be at least this long, where none differs from zero [mm].
_LEAST_MM = 1e-9
#: Space between the ends of the lines and those of the axes [mm].
_MARGIN_MM = 10.0
#: Of more configurations of one kind an even selection is drawn.
_MOST_LINES = 300
#: Where there are more configurations than this, lines and marks are smaller.
_CROWD = 150
#: Rows of the table of the largest residuals.
_MOST_ROWS = 8
#: Colour and mark of each kind of poses.
_LOOKS = {"fitted": (BLUE, "circle"), "held out": (VERMILLION, "diamond")}
#: Models in words, by the column of `GapRows` that holds their residuals.
_MODELS = {"before_mm": "calibrated", "after_mm": "with the effects found"}


def residuals(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield drawings of the residual vectors, before and after effects joined the model."""
    rows_by_kind = _residual_rows(results)
    if not rows_by_kind:
        yield Callout("missing", results.absent["calibration"])
        return
    places_mm = np.concatenate([rows.place_mm for rows in rows_by_kind.values()])
    before_mm = np.concatenate([rows.before_mm for rows in rows_by_kind.values()])
    scale = _enlargement(places_mm, before_mm)
    ends = np.concatenate([places_mm, places_mm + scale * before_mm])
    ranges_mm = np.stack([ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM], axis=1)
    words = results.words
    lines = "" if words is None else f" {words.arrows.replace('Arrows', 'Lines')}"
    yield Paragraph(
        "Residuals of every configuration in the robot's base frame: each line begins at the "
        f"position of the end-effector and shows its residual {scale:g} times enlarged, the same "
        "in every picture. Lines that agree or turn steadily from place to place show an effect "
        f"that the model lacks; noise has no common direction.{lines}"
    )
    models = ["before_mm"]
    if results.verdict is not None and results.verdict.effects and results.analysis is not None:
        models.append("after_mm")
    drawings = tuple(_drawing(rows_by_kind, model, scale, ranges_mm) for model in models)
    yield SideBySide(drawings) if len(drawings) > 1 else drawings[0]
    yield grid(
        f"The largest residuals, {_MODELS[models[-1]]}",
        "pose | load [N] | poses | x [mm] | y [mm] | z [mm] | length [mm]",
        _largest(rows_by_kind, models[-1]),
    )


def _residual_rows(results: ResultsBundle) -> dict[str, GapRows]:
    """Return residuals along the base's axes, of the poses fitted and of those held out."""
    if results.analysis is not None:
        gap = results.analysis.gap
        by_kind = {"fitted": gap.train, "held out": gap.holdout}
        return {kind: rows for kind, rows in by_kind.items() if rows is not None and len(rows)}
    if results.calibration is None:
        return {}
    fit = results.calibration.residuals
    rows = GapRows(
        pose=fit.pose,
        load_N=fit.load_N,
        place_mm=fit.place_mm,
        extrapolated=None,
        before_mm=fit.position_mm,
        after_mm=fit.position_mm,
    )
    return {"fitted": rows}


def _enlargement(places_mm: Array, residuals_mm: Array) -> float:
    """Return the largest round factor, at least 1, that leaves the longest line short enough.

    Args:
        places_mm: (N, 3) measured positions.
        residuals_mm: (N, 3) residual vectors.
    """
    longest_mm = max(float(np.linalg.norm(residuals_mm, axis=1).max()), _LEAST_MM)
    extent_mm = float(np.ptp(places_mm, axis=0).max())
    wanted = max(_LONGEST_PART * extent_mm / longest_mm, 1.0)
    factors = _ROUND_FACTORS * 10.0 ** np.floor(np.log10(wanted))
    return float(factors[factors <= wanted].max())


def _largest(rows_by_kind: dict[str, GapRows], model: str) -> list[tuple[Any, ...]]:
    """Return the rows of the table: the largest residuals of a model, the largest first."""
    table = [
        (label, load_N, kind, *vector, float(np.linalg.norm(vector)))
        for kind, rows in rows_by_kind.items()
        for label, load_N, vector in zip(rows.pose, rows.load_N, getattr(rows, model), strict=True)
    ]
    return sorted(table, key=lambda row: -row[-1])[:_MOST_ROWS]


def _drawing(
    rows_by_kind: dict[str, GapRows], model: str, scale: float, ranges_mm: Array
) -> Drawing:
    figure = new_space(460, ranges_mm)
    crowded = sum(map(len, rows_by_kind.values())) > _CROWD
    rms_by_kind = []
    for kind, rows in rows_by_kind.items():
        color, symbol = _LOOKS[kind]
        drawn = np.unique(np.linspace(0, len(rows) - 1, _MOST_LINES).round().astype(int))
        places_mm, residual_mm = rows.place_mm[drawn], getattr(rows, model)[drawn]
        # Each line: a place, its end, and nan, which interrupts the line.
        ends, gaps = places_mm + scale * residual_mm, np.full_like(places_mm, np.nan)
        lines = np.stack([places_mm, ends, gaps], axis=1)
        figure.add_scatter3d(
            **dict(zip("xyz", lines.reshape(-1, 3).round(2).T, strict=True)),
            mode="lines",
            line={"color": color, "width": 3 if crowded else 5},
            name=f"residual, {kind}",
            hoverinfo="skip",
            showlegend=False,
        )
        selection = f" ({len(drawn)} of {len(rows)})" if len(drawn) < len(rows) else ""
        figure.add_scatter3d(
            **dict(zip("xyz", places_mm.round(1).T, strict=True)),
            mode="markers",
            marker={"color": color, "size": 1.8 if crowded else 2.5, "symbol": symbol},
            name=f"{kind}{selection}",
            text=[
                f"{label}, {load:g} N: {np.linalg.norm(vector):.3f} mm"
                f"<br>({vector[0]:.3f}, {vector[1]:.3f}, {vector[2]:.3f})"
                for label, load, vector in zip(
                    rows.pose[drawn], rows.load_N[drawn], residual_mm, strict=True
                )
            ],
            hoverinfo="text",
        )
        rms_mm = np.sqrt(np.mean(np.sum(getattr(rows, model) ** 2, axis=1)))
        rms_by_kind.append(f"{kind} {rms_mm:.3f} mm rms")
    shapes = "Circles: fitted; diamonds: held out. " if len(rows_by_kind) > 1 else ""
    return Drawing(
        figure,
        f"Residuals, {_MODELS[model]}",
        f"{shapes}{sentence(', '.join(rms_by_kind))} Drag to turn, point at a mark for its "
        "numbers.",
        f"residuals-{_MODELS[model].replace(' ', '-')}",
        in_space=True,
    )
