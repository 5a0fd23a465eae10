"""The chain of links calibrated: rank, null directions and errors of both models."""

from __future__ import annotations

from collections.abc import Mapping

from pa10cal.figures.chain.curve_calibration import DEPARTS
from pa10cal.figures.parameter_names import written
from pa10cal.figures.registry import Picture
from pa10cal.figures.table import Row, Shown, Table, frame_of, shown
from pa10cal.results.studies import CurveCalibrationRecord, CurveStudySummary, Individual, OverFloor

PICTURE = Picture(
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

_MODELS = {
    "two_level": "two-level (paper)",
    "two_level_all": "two-level, all poses inside",
    "general": "general",
}
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


def tabulate(study: CurveCalibrationRecord) -> Table:
    """Return a row for each way to depart and each model."""
    first = [each for each in study.individuals if each.number == 1]
    redundant = first[0].models["general"].redundant
    data = frame_of(_HEADER, map(_row, study.summaries))
    return Table(
        title=f"A chain of {study.joints} joints, calibrated (synthetic)",
        data=data,
        shown=(
            Shown(data),
            shown(
                _ERRORS_HEADER,
                [row for each in first for row in _error_rows(each)],
                "The first arm of each, position errors [mm]",
            ),
            shown(("model", "direction"), _directions(study), "Null directions"),
            shown(
                ("parameter", "the same as"),
                [(written(name), _said(said)) for name, said in redundant.items()],
                "Omitted: redundant parameters of the general model",
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
        _MODELS[found.model],
        str(found.unknowns),
        str(found.rank),
        _of(found.converged, found),
        _times(found.fitted),
        _times(found.held_out),
        _of(found.fitted.within_bar, found),
        _of(found.held_out.within_bar, found),
        "" if found.rms_score is None else f"{found.rms_score:.2f}",
    )


def _error_rows(each: Individual) -> list[Row]:
    names = {"nominal": "nominal", **_MODELS}
    return [
        (
            DEPARTS[each.departs],
            names[model],
            *(
                f"{value:.4f}"
                for value in (
                    errors.fitted.mean_mm,
                    errors.fitted.peak_mm,
                    errors.held_out.mean_mm,
                    errors.held_out.peak_mm,
                    errors.held_out_true.mean_mm,
                )
            ),
        )
        for model, errors in each.errors.items()
    ]


def _directions(study: CurveCalibrationRecord) -> tuple[Row, ...]:
    return tuple(
        (_MODELS[found.model], _said(weights))
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
        parts.append(f"{'+' if weight > 0 else '−'} {times}{written(name)}")
    return " ".join(parts).removeprefix("+ ")


def _times(found: OverFloor) -> str:
    return f"{found.mean:.2f} ({found.largest:.2f})"


def _of(count: int, found: CurveStudySummary) -> str:
    return f"{count} of {found.individuals}"
